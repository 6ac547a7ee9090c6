"""Seeded colours with known coefficients: what a wave-borne residual of a moored vessel looks like."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

Array = NDArray[np.float64]


def arma64(peak_period: float, sample_time: float) -> tuple[Array, Array]:
    """Return (ar, ma) of an ARMA(6, 4) colour, without the leading ones: F(q) r = C(q) e.

    Its spectrum peaks sharply at ``peak_period`` (s), has a shoulder at 1.6 times that frequency and a low-frequency
    part (about 0.3 of the sd) around 8.7 peak periods, as a vessel of 13 s surge period has in waves of 1.5 s; over
    all frequencies it spans some 50 dB at 15 samples a peak period. Poles and zeros are placed in continuous time and
    sampled at ``sample_time`` (s).
    """
    step = 2.0 * math.pi * sample_time / peak_period
    poles = ((1.0, 0.07), (1.6, 0.25), (1.0 / 8.7, 0.3))  # frequency over that of the peak, damping ratio
    zeros = ((0.17, 0.5), (2.2, 0.4))
    return _polynomial(poles, step), _polynomial(zeros, step)


def simulate(ar: Array, ma: Array, n: int, rng: np.random.Generator) -> Array:
    """Return (n,), a stationary record with unit innovation; what precedes it is run in and thrown away."""
    radius = max(np.abs(np.roots(np.concatenate([[1.0], ar]))), default=0.0)
    burn = len(ar) + len(ma) + (math.ceil(math.log(1e-8) / math.log(radius)) if radius > 0 else 0)
    return np.asarray(_recursion(np.asarray(ar), np.asarray(ma), rng.standard_normal(n + burn))[burn:])


def _polynomial(pairs: tuple[tuple[float, float], ...], step: float) -> Array:
    roots = []
    for ratio, damping in pairs:
        s = ratio * step * complex(-damping, math.sqrt(1.0 - damping**2))
        roots += [np.exp(s), np.exp(s.conjugate())]
    return np.asarray(np.real(np.poly(roots))[1:])


@njit(cache=True)
def _recursion(ar, ma, e):
    out = np.zeros(e.size)
    for t in range(e.size):
        total = e[t]
        for j in range(min(t, ma.size)):
            total += ma[j] * e[t - 1 - j]
        for i in range(min(t, ar.size)):
            total -= ar[i] * out[t - 1 - i]
        out[t] = total
    return out
