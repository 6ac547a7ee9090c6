"""From the no-fault statistic to a level for a wanted false-alarm rate, with what is known of the rate it really gives.

    rate(l) = sum_j p_j S(l q_j) / (Ts D(l)),      l the scaled level, level_j = scale_j l

S tail law of the pooled scaled values given that they are positive, p_j share of positive values of line j (1, or about
half where only one sign is the fault), D(l) mean cluster length in samples, Ts sample time. The paper's P_FA [Fang2015,
eq. 22] is per sample and stands for no rate; P = D Ts/(n T_FA) does.

Values are held-back ones (`folds`), each line divided by its mean, all lines pooled. Cross-fitting cannot see one
error: the noise variance of each line that the final detector divides by rests on N/M windows, a relative error with
nu = N/M degrees of freedom in the exponent. So each bootstrap replicate (blocks of 4 M) also draws q_j ~ chi2_nu/nu.
The level is the least at which the share ``assurance`` of the replicates gives at most the asked rate; the interval
of the rate runs from the least 5 % to the largest 95 % limit over the power law and the exponential one.

What was tried, on fits that no score uses (asked .8 a day, an hour of six channels): the paper's Weibull
gives 10^-4 of the asked rate or less, its upper half 10^-2, the exponential 1 to 6 times, the power law's
central estimate .3 to 2.7 times. The interval speaks of the fitted sea: it does not cover a change of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from mooringdx.errors import FitError
from mooringdx.threshold.folds import DRIFT_LIMIT
from mooringdx.threshold.tails import (
    BINS,
    Law,
    cluster_law,
    count_clusters,
    exponential,
    power_law,
    quantile,
    tail_weight,
    weibull,
)
from mooringdx.types import Array, Threshold

REPLICATES = 200
LEAST_WINDOWS = 40
"""Under so many independent windows no rate is claimed (400 wave periods at ten a window)."""
REACH = 10.0
"""A rate of one in more than so many no-fault records is extrapolated."""
_CURVE = 80


class Pool(NamedTuple):
    """No-fault values of all lines on one scale; row 0 of ``weights`` (b, k) is the record, the rest replicates."""

    scale: Array
    share: Array
    x: Array
    weights: Array
    start: float
    cluster: float


class Rates(NamedTuple):
    """What a rate is computed from: the pool, the relative noise variances (b, f), window and sample time."""

    pool: Pool
    variance: Array
    window: int
    sample_time: float

    def at(self, law: Law, level: float) -> Array:
        """Return the alarms per second at a scaled level, (b,), one for each row."""
        tail = np.exp(law.log_tail(level * self.variance)) @ self.pool.share
        return np.asarray(tail / (self.sample_time * self.cluster(level)))

    def level(self, law: Law, share: float, rate: float) -> float:
        """Return the least scaled level at which ``share`` of the replicates give at most ``rate``."""
        return level_for(lambda at: float(np.quantile(self.at(law, at)[1:], share)), rate)

    def cluster(self, level: float) -> float:
        """Return the mean cluster length at a scaled level, samples, carried from where it was measured."""
        measured = cluster_law(np.array([self.pool.start, level]), self.window)
        return float(max(1.0, self.pool.cluster * measured[1] / measured[0]))


def fit_threshold(
    branch: str,
    folds: Sequence[Array],
    window: int,
    sample_time: float,
    rate: float,
    assurance: float = 0.9,
    *,
    samples: int,
    drift_ratio: float,
    following: bool = True,
    dof: int = 1,
    system_rate: float | None = None,
    seed: int = 0,
) -> Threshold:
    """Return the level for ``rate`` on held-back no-fault statistics.

    Parameters
    ----------
    branch : name of the branch.
    folds : held-back statistics, each (n_i, f), NaN where there is none; the first two windows of each are dropped.
    window : detector window, samples.
    sample_time : s.
    rate : alarms per second asked of this branch.
    assurance : confidence with which the rate is to hold.
    samples : length of the no-fault record.
    drift_ratio : R of `drift_ratio`; NaN where it could not be judged.
    following : whether the reference follows; a frozen one cannot stand drift.
    dof : the detector's ``dof``: of the chi-square that twice the statistic is for Gaussian window means.
    system_rate : alarms per second asked of all branches together, for the verdict; ``rate`` when None.
    seed : of the bootstrap.

    Raises
    ------
    FitError : no held-back values at all.
    """
    pool = _pool(folds, window, dof, seed, sample_time)
    rng = np.random.default_rng([seed, 1])
    nu = max(samples / window, 2.0)
    draws = rng.chisquare(nu, (REPLICATES, len(pool.scale))) / nu
    rates = Rates(pool, np.concatenate([np.ones((1, len(pool.scale))), draws]), window, sample_time)
    central = power_law(pool.x, pool.weights, dof)
    laws = (central, exponential(pool.x, pool.weights))
    bound = weibull(pool.x, pool.weights[:1])
    assured = rates.level(central, assurance, rate)
    one = rates._replace(variance=rates.variance[:1])
    low = min(rates.level(law, 0.05, rate) for law in laws)
    high = max(rates.level(law, 0.95, rate) for law in laws)
    spread = np.stack([rates.at(law, assured)[1:] for law in laws])
    verdict, reason = judge(samples, window, sample_time, drift_ratio, following, system_rate or rate)
    cluster = rates.cluster(assured)
    grid = np.geomspace(max(pool.x[0], 1e-3), pool.x[-1], _CURVE)
    return Threshold(
        branch=branch,
        level=pool.scale * assured,
        scale=pool.scale,
        asked_rate=rate,
        central_rate=float(rates.at(central, assured)[0]),
        rate_interval=(float(np.quantile(spread, 0.05, axis=1).min()), float(np.quantile(spread, 0.95, axis=1).max())),
        scaled_level=assured,
        scaled_interval=(low, high),
        probability=float(rate * sample_time * cluster / pool.share.sum()),
        cluster_length=cluster,
        independent_windows=samples / window,
        drift_ratio=drift_ratio,
        verdict=verdict,
        reason=reason,
        tail={
            "degrees": float(dof),
            "shape": float(central.parameters["shape"][0]),
            "median": float(central.parameters["median"][0]),
            "central_level": level_for(lambda at: float(rates.at(central, at)[0]), rate),
            "weibull_shape": float(bound.parameters["shape"][0]),
            "weibull_level": level_for(lambda at: float(one.at(bound, at)[0]), rate),
            "cluster_at_start": pool.cluster,
            "start": pool.start,
        },
        curve=np.stack([grid, tail_weight(pool.x, pool.weights[:1], grid)[0]], axis=1),
    )


def judge(
    samples: int, window: int, sample_time: float, drift_ratio: float, following: bool, rate: float
) -> tuple[str, str]:
    """Return the verdict (supported, extrapolated, invalid) and its reason in one sentence, empty when supported."""
    missing = LEAST_WINDOWS * window - samples
    if missing > 0:
        return "invalid", (
            f"the no-fault window holds {samples / window:.0f} independent detector windows and at least "
            f"{LEAST_WINDOWS} are needed: {missing * sample_time:.0f} s more"
        )
    if drift_ratio > DRIFT_LIMIT and not following:
        return "invalid", (
            f"the residuals drift over the no-fault window (R = {drift_ratio:.1f}, limit {DRIFT_LIMIT}), which a "
            "frozen reference cannot stand; let the reference follow, or mend the drifting channel"
        )
    reach = 1.0 / (rate * samples * sample_time)
    if reach > REACH:
        return "extrapolated", (
            f"one alarm in {reach:.0f} times the no-fault window is asked for, up to {REACH:.0f} times is supported by "
            "data; the interval holds only if the tail goes on as fitted: by itself the record excludes no more than "
            f"one alarm in {samples * sample_time / 180:.0f} min"
        )
    return "supported", ""


def _pool(folds: Sequence[Array], window: int, dof: int, seed: int, sample_time: float) -> Pool:
    """Scale each line by its mean, pool all, bin by blocks of four windows, and draw the bootstrap replicates."""
    kept = [g[min(2 * window, g.shape[0] // 3) :] for g in folds]
    kept = [g[np.isfinite(g).any(axis=1)] for g in kept]
    joined = np.concatenate(kept)
    positive = joined > 0.0
    count = positive.sum(axis=0)
    if joined.size == 0 or not count.all():
        raise FitError(
            "cross-fitting leaves no value of some fault's statistic; lengthen the no-fault window to at least "
            f"{LEAST_WINDOWS * window * sample_time:.0f} s"
        )
    scale = 2.0 / dof * np.where(positive, joined, 0.0).sum(axis=0) / count
    share = count / np.isfinite(joined).sum(axis=0)
    blocks = [b / scale for g in kept for b in np.array_split(g, max(1, g.shape[0] // (4 * window)))]
    edges = np.linspace(np.log(1e-8), np.log(float(np.nanmax(joined / scale)) * 1.001), BINS + 1)
    binned = np.stack([np.histogram(np.log(np.maximum(b[b > 0.0], 1.001e-8)), edges)[0] for b in blocks])
    drawn = np.random.default_rng(seed).multinomial(len(blocks), np.full(len(blocks), 1 / len(blocks)), REPLICATES)
    weights = np.concatenate([binned.sum(axis=0)[None], drawn @ binned]).astype(np.float64)
    x = np.exp(0.5 * (edges[1:] + edges[:-1]))
    start = float(quantile(x, weights[:1], 0.9)[0])
    return Pool(scale, share, x, weights, start, _cluster_length(kept, scale * start, window))


def _cluster_length(kept: Sequence[Array], level: Array, window: int) -> float:
    """Return the mean length in samples of a cluster above ``level`` (f,), lines counted apart.

    Gaps up to half a window belong to one cluster; so counted at the 90 % quantile and carried by the law, the length
    at the level of an alarm comes out within a tenth of the one counted there, for windows of 20 to 400 samples.
    """
    above, clusters = 0, 0
    for g in kept:
        for j in range(g.shape[1]):
            found = count_clusters(np.ascontiguousarray(g[:, j]), level[j], window // 2)
            above, clusters = above + found[0], clusters + found[1]
    return above / max(clusters, 1)


def level_for(rate_at: Callable[[float], float], rate: float) -> float:
    """Return the scaled level at which a falling rate is ``rate``, by bisection."""
    low, high = 0.5, 1000.0
    for _ in range(50):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if rate_at(middle) > rate else (low, middle)
    return high
