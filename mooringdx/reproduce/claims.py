"""Every claim of [Fang2015] that figures 3 to 8 carry, judged on one simulated record and on some more."""

from __future__ import annotations

from collections.abc import Sequence

from mooringdx.reproduce import claims_residual as residual
from mooringdx.reproduce import claims_statistic as statistic
from mooringdx.reproduce.effects import FAILS, HOLDS, PARTLY, Claim
from mooringdx.reproduce.study import Repeat, Study


def claims(study: Study, repeats: Sequence[Repeat] = ()) -> tuple[Claim, ...]:
    """Return the claims in the order of the paper."""
    pair = (study.force, study.tension)
    found = [
        residual.raw_gaussian(study, pair),
        residual.raw_correlated(study, pair),
        residual.whitened(study, pair),
        residual.tails(study, pair),
        residual.compression_shape(study, pair),
        residual.compression_correlation(study, pair),
        residual.order_of_steps(study),
        residual.tension_rises(study),
        statistic.statistic_correlated(study),
        statistic.weibull_law(study),
        statistic.threshold_rate(study),
        statistic.gaussian_theory(study),
        statistic.enough_data(study),
        statistic.sharp_change(study),
        statistic.named(study),
    ]
    return (*found, statistic.again(repeats)) if repeats else tuple(found)


def text(found: Sequence[Claim]) -> str:
    """Return the claims for a terminal: the count of verdicts, and a line a claim."""
    count = {verdict: sum(c.verdict == verdict for c in found) for verdict in (HOLDS, PARTLY, FAILS)}
    head = f"Fang2015, {len(found)} claims: " + ", ".join(f"{n} {verdict}" for verdict, n in count.items() if n)
    return "\n".join([head, *(f"  {c.verdict:16s}{c.where:24s}{c.paper}" for c in found)])
