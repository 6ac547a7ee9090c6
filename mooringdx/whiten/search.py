"""Search for the least conditional sum of squares over the stable and invertible ARMA models.

Start: two regressions [HannanRissanen1982], the long autoregression by least squares. Way down: Levenberg-Marquardt.
Side valleys: a pole and a zero that idle together are moved to where the score says they are missed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mooringdx.types import Array
from mooringdx.whiten.squares import Order, Point, Runs, evaluate, lagged_gram, loglik

_MA_RADIUS = 0.998
_AR_RADIUS = 0.99999
_PLACES = (0.99, 0.95, 0.85, 0.5, -0.5, -0.9)
_COMPLEX_PLACES = tuple(r * np.exp(1j * a) for r, a in ((0.98, 0.03), (0.95, 0.1), (0.95, 0.3), (0.9, 0.8), (0.8, 2.0)))


def search(runs: Runs, orders: Sequence[Order]) -> Point:
    """Fit each order, from the regressions and from the next smaller model; return the one of the best BIC."""
    long = long_residual(runs)
    found: list[Point] = []
    for p, q in orders:
        guesses = [regression(runs, long, p, q)]
        if found:
            last = found[-1]
            guesses.append(np.concatenate([_padded(last.theta[: last.p], p), _padded(last.theta[last.p :], q)]))
        ends = [descend(runs, evaluate(runs, p, projected(p, g)), 1.0) for g in guesses]
        found.append(descend(runs, _moved(runs, min(ends, key=lambda x: x.squares)), 0.05))
    return min(found, key=lambda x: bic(x, runs.rows))


def descend(runs: Runs, here: Point, tolerance: float) -> Point:
    """Go down to the least sum of squares by Levenberg-Marquardt, inside the stable and invertible region.

    Stops when the undamped step that is left, or each of three steps taken, is worth less than ``tolerance`` in
    log-likelihood. Damped by far less than is usual: neighbouring lags of a smooth record are nearly collinear, and
    the narrow valley along which the search has to move is what damping hides first.
    """
    damping, small = 1e-7, 0
    for _ in range(60):
        scale, power, axes, slope = _axes(here)
        if _promise(runs, here, slope, power) < tolerance or damping > 1e6 or small == 3:
            break
        step = -(axes @ (slope / (power + damping))) / scale
        there = evaluate(runs, here.p, projected(here.p, here.theta + step))
        gain = loglik(there.squares, runs.rows) - loglik(here.squares, runs.rows)
        if gain > 0.0:
            small = small + 1 if gain < tolerance else 0
            here, damping = there, max(damping / 10.0, 1e-12)
        else:
            damping *= 10.0
    return here


def _axes(point: Point) -> tuple[Array, Array, Array, Array]:
    """Return the scale of each coefficient, and powers, axes and slopes of the Gram matrix in that scale."""
    scale = np.sqrt(np.diag(point.gram)) + 1e-300
    power, axes = np.linalg.eigh(point.gram / np.outer(scale, scale))
    return scale, np.maximum(power, 1e-14), axes, axes.T @ (point.slope / scale)


def _promise(runs: Runs, point: Point, slope: Array, power: Array) -> float:
    """Return the log-likelihood that the undamped step promises (half a score statistic)."""
    return float(slope @ (slope / power)) * runs.rows / (2.0 * point.squares)


def _hoped(runs: Runs, point: Point) -> float:
    """Return the log-likelihood that a step from here should reach; directions of no consequence do not count."""
    _, power, _, slope = _axes(point)
    return loglik(point.squares, runs.rows) + _promise(runs, point, slope, np.maximum(power, 1e-10))


def _moved(runs: Runs, here: Point) -> Point:
    """Free a pole and a zero that all but cancel, and try them elsewhere, as long as that goes lower.

    This is the commonest way in which the search ends in a side valley: a pair idles at one end of the spectrum while a
    pole is missing at the other. Put down together on any place the pair changes nothing, and the score says
    whether parting there would.
    """
    for _ in range(4):
        poles, zeros = _roots(here.theta[: here.p]), _roots(here.theta[here.p :])
        if len(zeros) == 0:
            return here
        distance = np.abs(poles[:, None] - zeros[None, :])
        distance[(np.abs(poles.imag) > 0)[:, None] != (np.abs(zeros.imag) > 0)[None, :]] = np.inf
        if not np.isfinite(distance.min()):
            return here
        i, j = np.unravel_index(int(distance.argmin()), distance.shape)
        real = poles[i].imag == 0.0
        ends = []
        for place in _PLACES if real else _COMPLEX_PLACES:
            new = [place] if real else [place, np.conj(place)]
            theta = np.concatenate([_swapped(poles, poles[i], new), _swapped(zeros, zeros[j], new)])
            ends.append(evaluate(runs, here.p, projected(here.p, theta)))
        best = max(ends, key=lambda x: _hoped(runs, x))
        if _hoped(runs, best) < loglik(here.squares, runs.rows) + 1.0:
            return here
        there = descend(runs, best, 1.0)
        if loglik(there.squares, runs.rows) < loglik(here.squares, runs.rows) + 1.0:
            return here
        here = there
    return here


def _roots(coefficients: Array) -> NDArray[np.complex128]:
    return np.asarray(np.roots(np.concatenate([[1.0], coefficients])), dtype=np.complex128)


def _swapped(roots: NDArray[np.complex128], old: complex, new: list[complex]) -> Array:
    """Return the coefficients of a polynomial with one root (and its conjugate) replaced."""
    kept = [r for r in roots if abs(r - old) > 1e-12 and abs(r - np.conj(old)) > 1e-12]
    return np.asarray(np.real(np.poly([*kept, *new]))[1:])


@njit(cache=True)
def inside(coefficients: Array, radius: float) -> bool:
    """Say whether all roots of 1 + sum c_i q^-i lie within ``radius``, by stepping the polynomial down (Schur-Cohn)."""
    n = coefficients.size
    c = np.empty(n)
    for i in range(n):
        c[i] = coefficients[i] / radius ** (i + 1)
    for m in range(n, 0, -1):
        k = c[m - 1]
        if not abs(k) < 1.0:
            return False
        lower = c[: m - 1].copy()
        for i in range(m - 1):
            c[i] = (lower[i] - k * lower[m - 2 - i]) / (1.0 - k * k)
    return True


def projected(p: int, theta: Array) -> Array:
    """Reflect roots that lie outside the unit circle and cap their radius."""
    return np.concatenate([_schur(theta[:p], _AR_RADIUS), _schur(theta[p:], _MA_RADIUS)])


def _schur(coefficients: Array, radius: float) -> Array:
    """Return the coefficients of a polynomial whose roots all lie within ``radius``; unchanged where they do."""
    if inside(coefficients, radius):
        return coefficients
    roots = _roots(coefficients)
    size = np.abs(roots)
    roots = np.where(size > 1.0, 1.0 / np.conj(np.where(size > 0, roots, 1.0)), roots)
    size = np.abs(roots)
    roots = np.where(size > radius, roots * radius / np.where(size > 0, size, 1.0), roots)
    return _padded(np.real(np.poly(roots))[1:], len(coefficients))


def long_residual(runs: Runs) -> Array:
    """Return the innovations that a long autoregression, by least squares, leaves; zero in each run's first rows."""
    lags = int(min(200, max(4, (runs.stop - runs.start).max() // 20)))
    gram = lagged_gram(runs.values, runs.start, runs.stop, lags)
    solution = np.linalg.solve(gram[1:, 1:] + 1e-13 * gram[0, 0] * np.eye(lags), gram[1:, 0])
    whole = np.convolve(runs.values, np.concatenate([[1.0], -solution]))[: len(runs.values)]
    for a, b in zip(runs.start, runs.stop, strict=True):
        whole[a : min(a + lags, b)] = 0.0
    return np.asarray(whole)


def regression(runs: Runs, innovation: Array, p: int, q: int) -> Array:
    """Regress the data on their own past and on that of the long model's innovations (Hannan and Rissanen)."""
    solution = _regress(runs, (runs.values, innovation), (p, q), 200 + max(p, q))
    return np.concatenate([-solution[:p], solution[p:]])


def _regress(runs: Runs, series: Sequence[Array], lags: Sequence[int], skip: int) -> Array:
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


def _padded(coefficients: Array, n: int) -> Array:
    return np.asarray(np.concatenate([coefficients, np.zeros(max(0, n - len(coefficients)))])[:n])


def bic(point: Point, rows: int) -> float:
    """Return Schwarz's criterion, the innovation's variance counted as a parameter."""
    return (len(point.theta) + 1) * math.log(rows) - 2.0 * loglik(point.squares, rows)
