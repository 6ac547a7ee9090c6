"""A claim with its verdict, and the effect sizes that verdicts are drawn from.

    KS distance   D = max |F_n(x) - F(x)|, F with its parameters fitted to the same values

as an effect size: 0.03 is what the eye calls a straight line on Gaussian paper, 0.05 a visible bend. No p-value is
given, because the samples are correlated. A verdict is drawn from the numbers by the rule, never set by hand.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mooringdx.reproduce.study import Course
from mooringdx.types import Array

HOLDS, PARTLY, FAILS = "holds", "holds in part", "does not hold"
CLOSE, BENT = 0.03, 0.05


@dataclass(frozen=True)
class Claim:
    """One sentence of the paper with its place, what was measured, the rule, and the verdict by the rule."""

    where: str
    paper: str
    measured: str
    rule: str
    verdict: str
    numbers: Mapping[str, float] = field(default_factory=dict)


def grade(*good: bool) -> str:
    """Return "holds" when all are true, "does not hold" when none is, "holds in part" otherwise."""
    return HOLDS if all(good) else PARTLY if any(good) else FAILS


def gaussian_distance(values: Array) -> float:
    """Return the KS distance of (n,) values from the Gaussian of their own mean and sd; NaN is left out."""
    from scipy.special import ndtr

    x = np.sort(values[np.isfinite(values)])
    return _distance(np.asarray(ndtr((x - x.mean()) / x.std())))


def weibull_distance(course: Course) -> float:
    """Return the KS distance of the no-fault statistic from its fitted Weibull law."""
    return _distance(-np.expm1(-((np.sort(course.quiet) / course.scale) ** course.shape)))


def _distance(law: Array) -> float:
    """Return the KS distance from a law's values at the sorted sample, (n,)."""
    steps = np.arange(law.size + 1) / law.size
    return float(max(np.max(steps[1:] - law), np.max(law - steps[:-1])))


def kurtosis(values: Array) -> float:
    """Return the excess kurtosis of (n,) values; NaN is left out."""
    x = values[np.isfinite(values)]
    return float(np.mean((x - x.mean()) ** 4) / x.var() ** 2 - 3.0)


def wave_share(values: Array, sample_time: float, period: float) -> float:
    """Return the share of the variance of (n,) values between half and twice the wave frequency."""
    x = np.where(np.isfinite(values), values - np.nanmean(values), 0.0)
    power = np.abs(np.fft.rfft(np.hanning(x.size) * x)) ** 2
    frequency = np.fft.rfftfreq(x.size, sample_time) * period
    return float(power[(frequency > 0.5) & (frequency < 2.0)].sum() / power[1:].sum())
