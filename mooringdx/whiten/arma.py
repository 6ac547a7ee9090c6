"""Identify the colour of a residual: an ARMA model whose inverse whitens it.

    F(q) (r(k) - mean) = C(q) e(k),   F(q) = 1 + sum_i a_i q^-i,   C(q) = 1 + sum_i c_i q^-i     [Fang2015, eq. 7]
    e(k) = F(q)/C(q) (r(k) - mean)                                                               [Fang2015, eq. 8]

The paper writes both polynomials without the leading one; with it the innovation e has a scale of its own.
C must have all roots inside the unit circle (the paper says Hurwitz): a root outside is replaced by 1/conj(root),
which leaves the spectrum's shape, and radii are capped.

Estimation: conditional sum of squares. Each unbroken run of samples takes its first p values as given and starts
from e = 0; up to 256 rows are then dropped, because with a spectrum of 60 dB the start-up error outweighs the
record. The start is Hannan and Rissanen's two regressions [HannanRissanen1982] with a long autoregression by least
squares (biased autocovariances ruin it); the minimum is found by Levenberg-Marquardt with exact derivatives,

    de/da_i = q^-i/C r,   de/dc_i = -q^-i/C e,

filtered run by run, and their exact Gram matrix summed in blocks (a Toeplitz one stalls the search). Constant mean,
linear Gaussian colour is all this can see: a sea that grows during the record is averaged over.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mooringdx.errors import FitError
from mooringdx.types import Array, locked

Order = tuple[int, int]
Rows = NDArray[np.int64]
ORDERS: tuple[Order, ...] = tuple((p, 4 * p // 5) for p in range(2, 11))
"""The orders that ``"bic"`` compares: p = 2 ... 10, q = floor(0.8 p)."""

_DROP = 256
_STRETCH = 100_000
_MA_RADIUS = 0.998
_AR_RADIUS = 0.99999
_BLOCK = 128
_PAST = 8


@dataclass(frozen=True)
class Arma:
    """A fitted colour. ``ar``: (p,), ``ma``: (q,) without the leading ones; ``mean``, ``sd`` in the residual's unit.

    ``sd`` is of the innovation. ``n``: rows that carried the fit; ``loglik``, ``bic``: Gaussian, conditional, of those
    rows. ``covariance``: (p + q, p + q), of (ar, ma), from the Gram matrix of the derivatives.
    """

    ar: Array
    ma: Array
    mean: float
    sd: float
    n: int = 0
    loglik: float = math.nan
    bic: float = math.nan
    covariance: Array | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "ar", locked(self.ar))
        object.__setattr__(self, "ma", locked(self.ma))
        if self.covariance is not None:
            object.__setattr__(self, "covariance", locked(self.covariance))

    @property
    def order(self) -> Order:
        """(p, q)."""
        return len(self.ar), len(self.ma)

    @property
    def dc_gain(self) -> float:
        """F(1)/C(1): what is left of a step in the residual once the whitening filter has settled."""
        return float((1.0 + self.ar.sum()) / (1.0 + self.ma.sum()))

    @property
    def standard_errors(self) -> Array:
        """(p + q,), of (ar, ma); NaN where the model was not fitted."""
        if self.covariance is None:
            return np.full(len(self.ar) + len(self.ma), np.nan)
        return np.asarray(np.sqrt(np.diag(self.covariance)))


class _Runs(NamedTuple):
    """Unbroken runs end to end: run i is ``values[start[i]:stop[i]]``, its first ``drop[i]`` rows are not scored."""

    values: Array
    start: Rows
    stop: Rows
    drop: Rows

    @property
    def rows(self) -> int:
        return int((self.stop - self.start - self.drop).sum())


class _Point(NamedTuple):
    """One place of the search: order p, coefficients (ar, ma), sum of squares, half its gradient, Gram matrix."""

    p: int
    theta: Array
    squares: float
    slope: Array
    gram: Array


def fit_arma(segments: Sequence[Array], order: Order | Literal["bic"] = "bic", start: Arma | None = None) -> Arma:
    """Fit an ARMA model to no-fault data.

    Parameters
    ----------
    segments : records, each (n_i,), in the residual's unit; NaN where masked. A record is split at its NaNs, and each
        run contributes from its own start. Mean and linear trend of each record are removed for the fit;
        the reported ``mean`` is that of all samples together.
    order : (p, q), or "bic" for the best of ``ORDERS`` (as many as the data can carry).
    start : a model of a similar record to start from, which saves time; it takes part only if its order is asked for.

    Raises
    ------
    FitError : too few samples, or data without an innovation (constant, or predictable to the last digit).
    """
    kept = [np.asarray(s, dtype=np.float64) for s in segments]
    finite = np.concatenate([s[np.isfinite(s)] for s in kept]) if kept else np.zeros(0)
    mean = float(finite.mean()) if finite.size else math.nan
    flat = [_detrended(s) for s in kept]
    spread = float(np.sqrt(np.nanmean(np.concatenate(flat) ** 2))) if finite.size else 0.0
    if finite.size and spread <= 1e-10 * float(np.max(np.abs(finite))) + 1e-300:
        raise FitError(
            "the no-fault samples are constant; leave this residual out, or choose a window in which its channels move"
        )
    scaled = [s / spread for s in flat]
    asked = _affordable(scaled, ORDERS if order == "bic" else (order,))
    whole = _runs(scaled, asked[-1])
    part = _runs(_middle(scaled, finite.size), asked[-1]) if finite.size > _STRETCH else whole
    if start is not None and [start.order] == asked:
        point = _Point(start.order[0], np.concatenate([start.ar, start.ma]), 0.0, np.zeros(0), np.zeros((0, 0)))
    else:
        point = _search(part, asked)
    point = _descend(whole, _point(whole, point.p, _projected(point.p, point.theta)), 1e-4)
    return _arma(point, whole.rows, mean, spread)


def step_response(model: Arma, n: int) -> Array:
    """Return (n,), the answer of F/C to a unit step: a transient that settles at ``model.dc_gain``."""
    return np.asarray(_step(model.ar, model.ma, n))


def _detrended(record: Array) -> Array:
    """Remove the mean and the linear trend of the samples that are there."""
    there = np.isfinite(record)
    if not there.any():
        return record
    t = np.arange(len(record)) - float(np.flatnonzero(there).mean())
    flat = record - record[there].mean()
    power = float(t[there] @ t[there])
    return np.asarray(flat - t * (float(t[there] @ flat[there]) / power if power > 0 else 0.0))


def _middle(records: Sequence[Array], total: int) -> list[Array]:
    """Keep the same share from the middle of each record, ``_STRETCH`` samples in all."""
    cut = [(len(r) - len(r) * _STRETCH // total) // 2 for r in records]
    return [r[c : len(r) - c] for r, c in zip(records, cut, strict=True)]


def _runs(records: Sequence[Array], order: Order) -> _Runs:
    """Lay the unbroken runs that are long enough for ``order`` end to end."""
    p, q = order
    pieces: list[Array] = []
    for record in records:
        edges = np.flatnonzero(np.diff(np.isfinite(record).astype(np.int8), prepend=0, append=0))
        pieces += [record[a:b] for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= 4 * (p + q) + p]
    length = np.array([len(x) for x in pieces], dtype=np.int64)
    stop = np.cumsum(length)
    drop = np.maximum(p, np.minimum(_DROP, length // 4))
    return _Runs(np.concatenate(pieces) if pieces else np.zeros(0), stop - length, stop, drop)


def _affordable(records: Sequence[Array], orders: Sequence[Order]) -> list[Order]:
    """Return the orders, smallest first, that leave 20 rows a coefficient; refuse when there is none."""
    out = [o for o in sorted(orders) if _runs(records, o).rows >= 20 * (sum(o) + 1)]
    if not out:
        p, q = min(orders)
        raise FitError(
            f"{sum(int(np.isfinite(r).sum()) for r in records)} no-fault samples are too few for ARMA({p}, {q}), which "
            f'needs {27 * (p + q + 1) + p} in one piece; lengthen the no-fault window or set the order to "none"'
        )
    return out


def _search(runs: _Runs, orders: Sequence[Order]) -> _Point:
    """Fit each order, starting from the better of the regressions and the next smaller model; return the best BIC."""
    long = _long_residual(runs)
    found: list[_Point] = []
    for p, q in orders:
        guesses = [_regression(runs, long, p, q)]
        if found:
            last = found[-1]
            guesses.append(np.concatenate([_padded(last.theta[: last.p], p), _padded(last.theta[last.p :], q)]))
        points = [_point(runs, p, _projected(p, g)) for g in guesses]
        found.append(_descend(runs, min(points, key=lambda x: x.squares), 0.05))
    return min(found, key=lambda x: _bic(x, runs.rows))


def _padded(coefficients: Array, n: int) -> Array:
    return np.asarray(np.concatenate([coefficients, np.zeros(max(0, n - len(coefficients)))])[:n])


def _loglik(squares: float, rows: int) -> float:
    return -0.5 * rows * (math.log(2.0 * math.pi * squares / rows) + 1.0)


def _bic(point: _Point, rows: int) -> float:
    return (len(point.theta) + 1) * math.log(rows) - 2.0 * _loglik(point.squares, rows)


def _arma(point: _Point, rows: int, mean: float, spread: float) -> Arma:
    """Put the fitted point into the residual's unit, with the covariance of its coefficients."""
    if point.squares / rows < 1e-14:
        raise FitError(
            "the no-fault samples are predictable to the last digit, so nothing is left to test a fault against; "
            'leave this residual out or set the order to "none"'
        )
    scale = np.sqrt(np.diag(point.gram))
    covariance = np.linalg.pinv(point.gram / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
    shift = rows * math.log(spread)
    return Arma(
        ar=point.theta[: point.p],
        ma=point.theta[point.p :],
        mean=mean,
        sd=spread * math.sqrt(point.squares / rows),
        n=rows,
        loglik=_loglik(point.squares, rows) - shift,
        bic=_bic(point, rows) + 2.0 * shift,
        covariance=covariance * point.squares / rows,
    )


def _descend(runs: _Runs, here: _Point, tolerance: float) -> _Point:
    """Go down to the least sum of squares by Levenberg-Marquardt, inside the stable and invertible region.

    Stops when the undamped step that is left, or each of three steps taken, is worth less than ``tolerance`` in
    log-likelihood. Damped by far less than is usual: neighbouring lags of a smooth record are nearly collinear, and
    the narrow valley along which the search has to move is what damping hides first.
    """
    damping, small = 1e-7, 0
    for _ in range(60):
        scale = np.sqrt(np.diag(here.gram)) + 1e-300
        power, axes = np.linalg.eigh(here.gram / np.outer(scale, scale))
        power = np.maximum(power, 1e-14)
        slope = axes.T @ (here.slope / scale)
        if slope @ (slope / power) * runs.rows < 2.0 * tolerance * here.squares or damping > 1e6 or small == 3:
            break
        step = -(axes @ (slope / (power + damping))) / scale
        there = _point(runs, here.p, _projected(here.p, here.theta + step))
        gain = _loglik(there.squares, runs.rows) - _loglik(here.squares, runs.rows)
        if gain > 0.0:
            small = small + 1 if gain < tolerance else 0
            here, damping = there, max(damping / 10.0, 1e-12)
        else:
            damping *= 10.0
    return here


def _projected(p: int, theta: Array) -> Array:
    """Reflect roots that lie outside the unit circle and cap their radius."""
    return np.concatenate([_schur(theta[:p], _AR_RADIUS), _schur(theta[p:], _MA_RADIUS)])


def _schur(coefficients: Array, radius: float) -> Array:
    """Return the coefficients of a polynomial whose roots all lie within ``radius``; unchanged where they do."""
    roots = np.roots(np.concatenate([[1.0], coefficients]))
    size = np.abs(roots)
    if len(roots) == 0 or size.max() <= radius:
        return coefficients
    roots = np.where(size > 1.0, 1.0 / np.conj(np.where(size > 0, roots, 1.0)), roots)
    size = np.abs(roots)
    roots = np.where(size > radius, roots * radius / np.where(size > 0, size, 1.0), roots)
    return _padded(np.real(np.poly(roots))[1:], len(coefficients))


def _long_residual(runs: _Runs) -> Array:
    """Return the innovations that a long autoregression, by least squares, leaves; zero in each run's first rows."""
    lags = int(min(200, max(4, (runs.stop - runs.start).max() // 20)))
    gram = lagged_gram(runs.values, runs.start, runs.stop, lags)
    solution = np.linalg.lstsq(gram[1:, 1:], gram[1:, 0], rcond=1e-13)[0]
    whole = np.convolve(runs.values, np.concatenate([[1.0], -solution]))[: len(runs.values)]
    for a, b in zip(runs.start, runs.stop, strict=True):
        whole[a : min(a + lags, b)] = 0.0
    return np.asarray(whole)


def _regression(runs: _Runs, innovation: Array, p: int, q: int) -> Array:
    """Regress the data on their own past and on that of the long model's innovations (Hannan and Rissanen)."""
    solution = _regress(runs, (runs.values, innovation), (p, q), 200 + max(p, q))
    return np.concatenate([-solution[:p], solution[p:]])


def _regress(runs: _Runs, series: Sequence[Array], lags: Sequence[int], skip: int) -> Array:
    """Least squares of the data on ``lags`` past values of each series, skipping the first rows of each run."""
    width = sum(lags)
    gram = np.zeros((width + 1, width + 1))
    for a, b in zip(runs.start, runs.stop, strict=True):
        first = int(a) + min(skip, int(b - a) // 2)
        for lo in range(first, int(b), 8192):
            rows = np.arange(lo, min(lo + 8192, int(b)))
            columns = [x[rows - i] for x, m in zip(series, lags, strict=True) for i in range(1, m + 1)]
            block = np.stack([runs.values[rows], *columns])
            gram += block @ block.T
    scale = np.sqrt(np.diag(gram)) + 1e-300
    gram /= np.outer(scale, scale)
    return np.asarray(np.linalg.lstsq(gram[1:, 1:], gram[1:, 0], rcond=1e-13)[0] * scale[0] / scale[1:])


def _point(runs: _Runs, p: int, theta: Array) -> _Point:
    squares, slope, gram = conditional_squares(
        runs.values, runs.start, runs.stop, runs.drop, np.ascontiguousarray(theta[:p]), np.ascontiguousarray(theta[p:])
    )
    return _Point(p, theta, float(squares), slope, gram)


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


@njit(cache=True)
def _step(ar: Array, ma: Array, n: int) -> Array:
    out = np.zeros(n)
    for t in range(n):
        total = 1.0
        for i in range(min(t, ar.size)):
            total += ar[i]
        for j in range(min(t, ma.size)):
            total -= ma[j] * out[t - 1 - j]
        out[t] = total
    return out
