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
from typing import Literal

import numpy as np
from numba import njit

from mooringdx.errors import FitError
from mooringdx.types import Array, locked
from mooringdx.whiten.search import bic, descend, projected, search
from mooringdx.whiten.squares import MOST_MA, Order, Point, evaluate, loglik, unbroken

__all__ = ["ORDERS", "Arma", "Order", "fit_arma", "step_response"]

ORDERS: tuple[Order, ...] = tuple((p, 4 * p // 5) for p in range(2, 11))
"""The orders that ``"bic"`` compares: p = 2 ... 10, q = floor(0.8 p)."""

_STRETCH = 100_000


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
    if order != "bic" and not (order[0] >= 1 and 0 <= order[1] <= MOST_MA):
        raise FitError(f"ARMA order {order} is not allowed; p is at least 1 and q from 0 to {MOST_MA}")
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
    whole = unbroken(scaled, asked[-1])
    part = unbroken(_middle(scaled, finite.size), asked[-1]) if finite.size > _STRETCH else whole
    if start is not None and [start.order] == asked:
        point = Point(start.order[0], np.concatenate([start.ar, start.ma]), 0.0, np.zeros(0), np.zeros((0, 0)))
    else:
        point = search(part, asked)
    point = descend(whole, evaluate(whole, point.p, projected(point.p, point.theta)), 1e-4)
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


def _affordable(records: Sequence[Array], orders: Sequence[Order]) -> list[Order]:
    """Return the orders, smallest first, that leave 20 rows a coefficient; refuse when there is none."""
    out = [o for o in sorted(orders) if unbroken(records, o).rows >= 20 * (sum(o) + 1)]
    if not out:
        p, q = min(orders)
        raise FitError(
            f"{sum(int(np.isfinite(r).sum()) for r in records)} no-fault samples are too few for ARMA({p}, {q}), which "
            f'needs {27 * (p + q + 1) + p} in one piece; lengthen the no-fault window or set the order to "none"'
        )
    return out


def _arma(point: Point, rows: int, mean: float, spread: float) -> Arma:
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
        loglik=loglik(point.squares, rows) - shift,
        bic=bic(point, rows) + 2.0 * shift,
        covariance=covariance * point.squares / rows,
    )


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
