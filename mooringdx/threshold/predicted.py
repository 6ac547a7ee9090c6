"""A level from theory, for a window too long to be tried on the record: the slow channel.

    rate = (1/Ts W) sum_j sum_{+,-} b phi(b) nu(b sqrt(2/W)),   b = l sqrt(q_j) -+ delta_j,   nu(y) = exp(-0.583 y)
    q_j ~ chi2_nu / nu,  nu = N/M,      delta_j ~ N(0, W/N)

the rate of excursions of a moving mean over W samples of Gaussian noise [Siegmund1985, ch. IV], with two
things that the record of N samples knows only so well: the noise at zero frequency, from N/M window means,
and the frozen mean itself, whose error stays in every later window (a third of a sd of the slow mean for an hour).
The level is the least at which the share ``assurance`` of the draws gives at most the asked rate, never under 5 sd,
times the drift ratio where that is above one.

What it cannot know: how the noise behaves at periods longer than the record. Drift slower than the
no-fault window looks like a slow fault, and is one for this channel.
"""

from __future__ import annotations

import numpy as np

from mooringdx.threshold.fit import REPLICATES, judge, level_for
from mooringdx.threshold.tails import cluster_law
from mooringdx.types import Array, Threshold

LEAST_SD = 5.0
"""Least level in sd of the slow mean: under it, ordinary drift of gauges over hours raises alarms (measured)."""
_DRAWS = 5 * REPLICATES


def predicted_threshold(
    branch: str,
    sign: Array,
    window: int,
    covariance_window: int,
    sample_time: float,
    rate: float,
    assurance: float = 0.9,
    *,
    samples: int,
    drift_ratio: float,
    system_rate: float | None = None,
    seed: int = 0,
) -> Threshold:
    """Return the level for ``rate`` of a window statistic against the frozen reference.

    Parameters
    ----------
    branch : name of the branch.
    sign : (f,), the signatures' signs: a fault of one sign raises half the chance alarms.
    window : this branch's window, samples, W.
    covariance_window : window at which the detector's covariance was measured, samples, M.
    sample_time : s.
    rate : alarms per second asked of this branch.
    assurance : confidence with which the rate is to hold.
    samples : length of the no-fault record, N.
    drift_ratio : R of `drift_ratio`; NaN counts as 1.
    system_rate : alarms per second asked of all branches together, for the verdict; ``rate`` when None.
    seed : of the draws.
    """
    rng = np.random.default_rng([seed, 2])
    nu = max(samples / covariance_window - 1.0, 2.0)
    shape = (_DRAWS, len(sign))
    variance, offset = rng.chisquare(nu, shape) / nu, rng.normal(0.0, np.sqrt(window / samples), shape)

    def rates(level: float) -> Array:
        b = np.sqrt(2.0 * level * variance)
        both = np.where(sign >= 0.0, _one_sided(b - offset, window), 0.0)
        both += np.where(sign <= 0.0, _one_sided(b + offset, window), 0.0)
        return np.asarray(both.sum(axis=1) / sample_time)

    inflation = max(1.0, drift_ratio) if np.isfinite(drift_ratio) else 1.0

    def least(share: float) -> float:
        return level_for(lambda at: float(np.quantile(rates(at), share)), rate)

    asked = least(assurance)
    level = inflation * max(asked, 0.5 * LEAST_SD**2)
    at_level = rates(level / inflation)
    central, low, high = (float(x) for x in np.quantile(at_level, (0.5, 0.05, 0.95)))
    verdict, reason = judge(samples, covariance_window, sample_time, drift_ratio, True, system_rate or rate)
    return Threshold(
        branch=branch,
        level=np.full(len(sign), level),
        scale=np.ones(len(sign)),
        asked_rate=rate,
        central_rate=central,
        rate_interval=(low, high),
        scaled_level=level,
        scaled_interval=(inflation * least(0.05), inflation * least(0.95)),
        probability=float("nan"),
        cluster_length=float(cluster_law(np.array([level]), window)[0]),
        independent_windows=samples / window,
        drift_ratio=drift_ratio,
        verdict=verdict,
        reason=reason,
        tail={"degrees": 1.0, "shape": 1.0, "inflation": inflation, "asked_level": asked},
    )


def _one_sided(b: Array, window: int) -> Array:
    """Return the up-crossings per sample of level ``b`` (sd) by a moving mean; capped at one a window."""
    bounded = np.maximum(b, 1.0)
    density = np.exp(-0.5 * bounded**2) / np.sqrt(2.0 * np.pi)
    return np.asarray(bounded * density * np.exp(-0.583 * bounded * np.sqrt(2.0 / window)) / window)
