"""The conditional sum of squares of an ARMA model, its exact derivatives and Gram matrix, run by run.

    e = F/C r,   de/da_i = q^-i/C r,   de/dc_i = -q^-i/C e

The hot loops of the identification stand here. Columns are filtered block by block and multiplied while they are in
the cache, so memory does not grow with the record.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mooringdx.types import Array

Order = tuple[int, int]
Rows = NDArray[np.int64]
MOST_MA = 8
"""The largest q: its coefficients are kept in registers."""

_DROP = 256
_BLOCK = 128
_PAST = MOST_MA


class Runs(NamedTuple):
    """Unbroken runs end to end, run i ``values[start[i]:stop[i]]``; without its first ``drop[i]``, ``rows`` count."""

    values: Array
    start: Rows
    stop: Rows
    drop: Rows
    rows: int


class Point(NamedTuple):
    """One place of the search: order p, coefficients (ar, ma), sum of squares, half its gradient, Gram matrix."""

    p: int
    theta: Array
    squares: float
    slope: Array
    gram: Array


def unbroken(records: Sequence[Array], order: Order) -> Runs:
    """Lay the unbroken runs that are long enough for ``order`` end to end."""
    p, q = order
    pieces: list[Array] = []
    for record in records:
        edges = np.flatnonzero(np.diff(np.isfinite(record).astype(np.int8), prepend=0, append=0))
        pieces += [record[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= 4 * (p + q) + p]
    length = np.array([len(x) for x in pieces], dtype=np.int64)
    stop = np.cumsum(length)
    drop = np.maximum(p, np.minimum(_DROP, length // 4))
    values = np.concatenate(pieces) if pieces else np.zeros(0)
    return Runs(values, stop - length, stop, drop, int((length - drop).sum()))


def evaluate(runs: Runs, p: int, theta: Array) -> Point:
    """Return the sum of squares and its derivatives at theta = (ar, ma)."""
    squares, slope, gram = conditional_squares(
        runs.values, runs.start, runs.stop, runs.drop, np.ascontiguousarray(theta[:p]), np.ascontiguousarray(theta[p:])
    )
    return Point(p, theta, float(squares), slope, gram)


def loglik(squares: float, rows: int) -> float:
    """Return the Gaussian log-likelihood with the innovation's variance at its best."""
    return -0.5 * rows * (math.log(2.0 * math.pi * squares / rows) + 1.0)


@njit(cache=True, fastmath={"reassoc", "contract"})  # the sum may be regrouped so that it runs in vector lanes
def _dot(x: Array, y: Array) -> float:
    total = 0.0
    for i in range(x.size):
        total += x[i] * y[i]
    return total


@njit(cache=True, fastmath={"contract"})
def _divide(out: Array, n: int, taps: Array) -> None:
    """Divide columns _PAST.._PAST+n of a row by C, in place; its first _PAST columns hold what came before.

    ``taps``: (_PAST,), C's coefficients, zeros behind. Written out because eight values kept in registers are six times
    as fast as a loop over them.
    """
    c0, c1, c2, c3, c4, c5, c6, c7 = taps[0], taps[1], taps[2], taps[3], taps[4], taps[5], taps[6], taps[7]
    x7, x6, x5, x4, x3, x2, x1, x0 = out[0], out[1], out[2], out[3], out[4], out[5], out[6], out[7]
    for m in range(_PAST, _PAST + n):
        older = out[m] - c7 * x7 - c6 * x6 - c5 * x5 - c4 * x4 - c3 * x3 - c2 * x2 - c1 * x1
        x7, x6, x5, x4, x3, x2, x1, x0 = x6, x5, x4, x3, x2, x1, x0, older - c0 * x0
        out[m] = x0


@njit(cache=True, fastmath={"contract"})
def _fill(buffer: Array, values: Array, lo: int, n: int, ar: Array, taps: Array) -> None:
    """Fill n columns of the buffer: rows 0..p-1 de/da, row p the filtered -e, row p+1 e itself."""
    p = ar.size
    w, e = buffer[p, _PAST : _PAST + n], buffer[p + 1, _PAST : _PAST + n]
    e[:] = values[lo : lo + n]
    for i in range(p):
        before = values[lo - 1 - i : lo - 1 - i + n]
        buffer[i, _PAST : _PAST + n] = before
        _divide(buffer[i], n, taps)
        for m in range(n):
            e[m] += ar[i] * before[m]
    _divide(buffer[p + 1], n, taps)
    for m in range(n):
        w[m] = -e[m]
    _divide(buffer[p], n, taps)


@njit(cache=True)
def conditional_squares(
    values: Array, start: Rows, stop: Rows, drop: Rows, ar: Array, ma: Array
) -> tuple[float, Array, Array]:
    """Return sum e^2, J'e and J'J over the scored rows of all runs, J the derivatives of e by (ar, ma).

    ``values``: (n,), runs end to end; ``start, stop, drop``: (runs,), as in the fit. e = 0 and its derivatives
    are 0 before a run's p-th sample, which makes the derivatives exact. Columns are filtered block by block, so
    memory does not grow with the record.
    """
    p, q = ar.size, ma.size
    k = p + q
    taps = np.zeros(_PAST)
    taps[:q] = ma
    buffer = np.zeros((p + 2, _PAST + _BLOCK))
    squares = 0.0
    slope = np.zeros(k)
    gram = np.zeros((k, k))
    for run in range(start.size):
        buffer[:] = 0.0
        scored = start[run] + drop[run]
        for lo in range(start[run] + p, stop[run], _BLOCK):
            n = min(_BLOCK, stop[run] - lo)
            _fill(buffer, values, lo, n, ar, taps)
            first = min(max(scored - lo, 0), n)
            e = buffer[p + 1, _PAST + first : _PAST + n]
            squares += _dot(e, e)
            for i in range(k):
                row, lag = (i, 0) if i < p else (p, i - p + 1)
                x = buffer[row, _PAST + first - lag : _PAST + n - lag]
                slope[i] += _dot(x, e)
                for j in range(i + 1):
                    row, lag = (j, 0) if j < p else (p, j - p + 1)
                    gram[i, j] += _dot(x, buffer[row, _PAST + first - lag : _PAST + n - lag])
            for row in range(p + 2):
                for m in range(_PAST):
                    buffer[row, m] = buffer[row, n + m]
    for i in range(k):
        for j in range(i):
            gram[j, i] = gram[i, j]
    return squares, slope, gram


@njit(cache=True)
def lagged_gram(values: Array, start: Rows, stop: Rows, lags: int) -> Array:
    """Return (lags + 1, lags + 1), sums over all runs of r(k-i) r(k-j), k from a run's first row with a full past.

    Only the first row is summed; each next diagonal element differs from the one before by the terms at the ends.
    """
    gram = np.zeros((lags + 1, lags + 1))
    for run in range(start.size):
        x = values[start[run] : stop[run]]
        n = x.size
        if n <= lags:
            continue
        part = np.zeros((lags + 1, lags + 1))
        for j in range(lags + 1):
            part[0, j] = _dot(x[lags:], x[lags - j : n - j])
        for i in range(lags):
            for j in range(i, lags):
                part[i + 1, j + 1] = part[i, j] + x[lags - 1 - i] * x[lags - 1 - j] - x[n - 1 - i] * x[n - 1 - j]
        gram += part
    for i in range(lags + 1):
        for j in range(i):
            gram[i, j] = gram[j, i]
    return gram
