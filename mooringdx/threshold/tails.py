"""Tail laws of the pooled no-fault statistic, fitted to weighted bins so that a bootstrap costs nothing.

    power law      S(x) = P(chi2_r / 2 > c (x/m)^b), x >= m, maximum likelihood on the upper half
    exponential    S(x) = 0.1 exp(-(x - u)/e), u the 90 % quantile, e the mean excess over it
    Weibull        S(x) = exp(-(x/l)^b), maximum likelihood on all values        [Fang2015, eq. 20-22]
    cluster        D(x) = D(u) law(x)/law(u),  law(x) = M Q(b) / (b phi(b) nu(b sqrt(2/M))),  b = sqrt(2 x),
                   nu(y) = exp(-0.583 y)                                         [Siegmund1985, ch. IV and X]

x is the statistic on the scale where Gaussian window means make it half a chi-square with r degrees of freedom, m its
median, c the median of half that chi-square. The power law is then exact with b = 1, and b < 1 is a heavier tail: it
holds the ideal case and departs from it as the upper half of the data does. The paper's Weibull on all values does not
hold it: its shape is set by the mass near zero (.63), and from an hour's data to one a day it asks twice the level that
is needed, a rate 10^4 times too low; on the upper half 1.5 times the level and 10^2. It is kept as a far bound.
Every law is fitted per row of a weight matrix: row 0 the record, the rest its bootstrap replicates.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import njit

from mooringdx.types import Array

BINS = 2048
"""Logarithmic bins over the values, 1 % wide: far below any sampling error."""


class Law(NamedTuple):
    """A tail law for each of b rows; ``log_tail`` takes and gives (b, j)."""

    name: str
    parameters: dict[str, Array]
    log_tail: Callable[[Array], Array]


def power_law(x: Array, weights: Array, dof: int) -> Law:
    """Fit the law of a power of a chi-square with ``dof`` degrees. ``x``: (k,) bin centres > 0; ``weights``: (b, k)."""
    from scipy.special import gammaincc, gammainccinv

    centre = float(gammainccinv(0.5 * dof, 0.5))
    median = quantile(x, weights, 0.5)
    t = np.maximum(np.log(x) - np.log(median)[:, None], 0.0)
    upper = weights * (t > 0.0)
    number, sum_t = upper.sum(axis=1), (upper * t).sum(axis=1)

    def score(shape: Array) -> tuple[Array, Array]:
        grown = centre * upper * np.exp(shape[:, None] * t)
        value = number / shape + 0.5 * dof * sum_t - (grown * t).sum(axis=1)
        return value, -number / shape**2 - (grown * t * t).sum(axis=1)

    shape = _newton(score, np.ones(len(weights)))

    def log_tail(at: Array) -> Array:
        grown = centre * np.exp(shape[:, None] * np.log(np.maximum(at, 1e-300) / median[:, None]))
        return np.asarray(np.log(np.maximum(gammaincc(0.5 * dof, grown), 1e-300)))

    return Law("power", {"median": median, "shape": shape}, log_tail)


def weibull(x: Array, weights: Array) -> Law:
    """Fit a Weibull law by maximum likelihood. ``x``: (k,) bin centres > 0; ``weights``: (b, k)."""
    log_x = np.log(x)
    total = weights.sum(axis=1)
    mean_log = weights @ log_x / total

    def score(shape: Array) -> tuple[Array, Array]:
        weighted = weights * np.exp(shape[:, None] * log_x)
        s0, s1, s2 = weighted.sum(axis=1), weighted @ log_x, weighted @ log_x**2
        return s1 / s0 - 1.0 / shape - mean_log, s2 / s0 - (s1 / s0) ** 2 + 1.0 / shape**2

    shape = _newton(score, np.full(len(weights), 0.7))
    power = np.exp(shape[:, None] * log_x)
    scale = ((weights * power).sum(axis=1) / total) ** (1.0 / shape)
    return Law("weibull", {"scale": scale, "shape": shape}, lambda at: -((at / scale[:, None]) ** shape[:, None]))


def exponential(x: Array, weights: Array) -> Law:
    """Fit an exponential law to the excess over the 90 % quantile. ``x``: (k,); ``weights``: (b, k)."""
    u = quantile(x, weights, 0.9)
    above = weights * (x > u[:, None])
    excess = np.maximum((above * (x - u[:, None])).sum(axis=1) / np.maximum(above.sum(axis=1), 1.0), 1e-3 * u)
    return Law(
        "exponential", {"start": u, "excess": excess}, lambda at: np.log(0.1) - (at - u[:, None]) / excess[:, None]
    )


def _newton(score: Callable[[Array], tuple[Array, Array]], start: Array) -> Array:
    """Return the root of each row of a monotone score (value, slope), kept positive."""
    shape = start
    for _ in range(60):
        value, slope = score(shape)
        step = value / slope
        shape = np.clip(shape - step, 0.5 * shape, 2.0 * shape)
        if np.abs(step).max() < 1e-10:
            break
    return np.asarray(shape)


def quantile(x: Array, weights: Array, q: float) -> Array:
    """Return the q-quantile of each row, (b,)."""
    share = np.cumsum(weights, axis=1)
    return np.asarray(x[np.argmax(share >= q * share[:, -1:], axis=1)])


def tail_weight(x: Array, weights: Array, at: Array) -> Array:
    """Return the share of each row above ``at`` (j,), (b, j)."""
    share = np.concatenate([np.zeros((len(weights), 1)), np.cumsum(weights, axis=1)], axis=1)
    return np.asarray(1.0 - share[:, np.searchsorted(x, at, side="right")] / share[:, -1:])


def cluster_law(x: Array, window: int) -> Array:
    """Return the mean length in samples of an excursion above ``x`` of a window statistic of white noise."""
    from scipy.special import erfcx

    b = np.sqrt(2.0 * np.maximum(x, 1e-3))
    mills = np.sqrt(np.pi / 2.0) * erfcx(b / np.sqrt(2.0))
    return np.asarray(np.maximum(window * mills / b * np.exp(0.583 * b * np.sqrt(2.0 / window)), 1.0))


@njit(cache=True)
def count_clusters(values: Array, level: float, gap: int) -> tuple[int, int]:
    """Return (samples above ``level``, clusters of them): a new one starts after more than ``gap`` samples below."""
    above, clusters, last = 0, 0, -1
    for k in range(values.shape[0]):
        if values[k] > level:
            above += 1
            if last < 0 or k - last > gap:
                clusters += 1
            last = k
    return above, clusters


@njit(cache=True)
def count_alarms(ratio: Array, hysteresis: float, gap: int) -> int:
    """Return the distinct alarms: above 1, closed after more than ``gap`` samples in a row below ``hysteresis``.

    ``ratio``: (n,), largest statistic over its level; NaN counts as below.
    """
    alarms, on, quiet = 0, False, 0
    for k in range(ratio.shape[0]):
        if ratio[k] > 1.0 and not on:
            alarms += 1
            on = True
        if ratio[k] >= hysteresis:
            quiet = 0
        else:
            quiet += 1
            if quiet > gap:
                on = False
    return alarms
