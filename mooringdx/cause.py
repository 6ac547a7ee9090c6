"""Line, sensor or environment: what the balance of forces says of a tension that no longer fits its line.

A tension below (above) what its line must pull at the measured place has two explanations that tensions alone cannot
tell apart: the line, or its sensor. The force that the surroundings exert on the vessel can. With b_A that force as
the motion and the *measured* tensions give it, b_B as the motion and the *model* of the intact lines give it, and
c = (b_A + b_B)/2:

    line i changed:      b_A steady, b_B moves by  g_i v   so that c moves by   g_i v / 2 =: m_L
    sensor i is wrong:   b_A moves by -g_i v, b_B steady   so that c moves by  -g_i v / 2 =: m_S
    the environment:     both move alike, in any direction, and the tension keeps to its line

v is the change of the tension, N, g_i the horizontal force per newton of it towards the anchor. c is the mean over W
after the change less the mean over W before it, S its covariance on no-fault data:

    d'  = sqrt((m_L - m_S)' S^-1 (m_L - m_S))                 discrimination index; P(right) = Phi(d'/2)
    LLR = (m_L - m_S)' S^-1 (c - (m_L + m_S)/2)               above zero: the line
    E   = min_a (c - a g_i)' S_E^-1 (c - a g_i)               over chi-square's 99 %: the environment moved too

S_E is S with the error to which g_i is known. Under d' = 3 no cause is named. Source: paired observers on the parity
relations of [Fang2015, eqs. 4-6]; the index is the deflection of two Gaussian hypotheses [Kay1998, ch. 3].
What it cannot see: a change of the environment along the line in the same minute, of the same size.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2, norm

from mooringdx.types import Array, Mask

LEAST_INDEX = 3.0
"""Discrimination index under which no cause is named: one in fifteen would be wrong."""
GATE = 0.99
_LEAST_SHARE = 0.5


@dataclass(frozen=True)
class Testimony:
    """What `fit` learns of the common force: ``window`` and ``settle``, samples; covariances (r, r), units squared.

    ``near``: of the mean over a window less the mean over the window that ends ``settle`` before it; ``far``: of the
    same for two windows any time apart, twice the covariance of window means.
    """

    window: int
    settle: int
    near: Array
    far: Array


@dataclass(frozen=True)
class Cause:
    """What the forces say. ``probability`` is of the named cause; ``gate`` is E over its limit (above 1: tripped)."""

    verdict: Literal["line", "sensor", "untold"]
    index: float
    score: float
    gate: float
    probability: float


def horizontal(units: Sequence[str]) -> NDArray[np.intp]:
    """Return the columns that are forces: the moment is left out, because its environment is not known well enough."""
    return np.flatnonzero(np.array(units) == "N")


def learn(stretches: Sequence[tuple[Array, Mask]], window: int, settle: int) -> Testimony | None:
    """Learn the covariances of changes of the window mean from no-fault stretches; None where they are too short.

    Parameters
    ----------
    stretches : (n_i, r) force residuals, N, and their validity.
    window, settle : samples.
    """
    changes, levels, count = [], [], 0.0
    for values, valid in stretches:
        if len(values) < 3 * window + settle:
            continue
        seen: Mask = np.asarray(valid.all(axis=1), dtype=np.bool_)
        means = _moving_means(np.where(seen[:, None], values, np.nan), window)
        change = means[window + settle :] - means[: -(window + settle)]
        changes.append(_finite(change))
        levels.append(_finite(means))
        count += len(values) / (2.0 * window)
    if not sum(map(len, changes)):
        return None
    near, level = np.vstack(changes), np.vstack(levels)
    small = count / max(count - near.shape[1] - 1.0, 1.0)  # the inverse of a covariance from few windows is too large
    far = 2.0 * np.cov(level, rowvar=False).reshape(near.shape[1], -1)
    return Testimony(window, settle, small * near.T @ near / len(near), small * far)


def judge(change: Array, covariance: Array, line: Array, sensor: Array, error: Array) -> Cause:
    """Weigh line against sensor.

    Parameters
    ----------
    change : (r,), N, mean common force after less before. covariance : (r, r) of it on no-fault data.
    line, sensor : (r,), N, how the change would move under either. error : (r,), N, sd to which ``line`` is known.
    """
    inverse = np.linalg.inv(covariance)
    apart = line - sensor
    index = math.sqrt(max(float(apart @ inverse @ apart), 0.0))
    score = float(apart @ inverse @ (change - 0.5 * (line + sensor)))
    if index <= 0.0:
        return Cause("untold", 0.0, 0.0, 0.0, 0.5)
    wide = np.linalg.inv(covariance + np.diag(error**2))
    across = float(change @ wide @ change) - float(line @ wide @ change) ** 2 / float(line @ wide @ line)
    gate = across / float(chi2.ppf(GATE, max(len(change) - 1, 1))) if len(change) > 1 else 0.0
    told = index >= LEAST_INDEX and gate <= 1.0
    verdict: Literal["line", "sensor", "untold"] = "untold" if not told else "line" if score > 0.0 else "sensor"
    return Cause(verdict, index, score, gate, float(norm.cdf(0.5 * index)))


def mean_over(values: Array, valid: Mask, part: slice, window: int) -> Array | None:
    """Return the mean of the valid rows in ``part``, (r,); None where fewer than half a ``window`` of them are."""
    good = valid[part].all(axis=1)
    if good.sum() < _LEAST_SHARE * window:
        return None
    return np.asarray(values[part][good].mean(axis=0))


def _finite(rows: Array) -> Array:
    return np.asarray(rows[np.flatnonzero(np.isfinite(rows).all(axis=1))])


def _moving_means(values: Array, window: int) -> Array:
    """Return the mean of every full window, (n - window + 1, r); NaN where less than all of it is valid."""
    good = np.isfinite(values)
    total = np.vstack([np.zeros((1, values.shape[1])), np.cumsum(np.where(good, values, 0.0), axis=0)])
    count = np.vstack([np.zeros((1, values.shape[1])), np.cumsum(good, axis=0)])
    full = count[window:] - count[:-window] >= window
    return np.asarray(np.where(full, (total[window:] - total[:-window]) / window, np.nan))
