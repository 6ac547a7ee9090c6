"""The moving window that both likelihood-ratio detectors share, one pass, constant cost a sample.

    S_i(k) = S_i(k-1) + d_i(k) - d_i(k-M),   c_i(k) valid samples among them,   x_i = S_i / sqrt(c_i)
    known direction    g_j = (a_j' Q^-1 x)^2 / (2 a_j' Q^-1 a_j),   a_ji = sqrt(c_i) Gamma_ji
    unknown direction  g   = x' Q^-1 x / 2

With nothing masked this is g_j = (M/2) (Gamma_j' Q^-1 zbar)^2 / (Gamma_j' Q^-1 Gamma_j), the corrected
form of [Fang2015, eq. 15]: the factor M/2 is missing there and the sum has M + 1 terms. Q is the covariance
of window means times M. d is the residual less its reference, see `reference`.

A masked sample adds zero and shortens the window of its channel. A channel with more than half of its
window masked is left out, with Q reduced to the rest; with no channel left, or none that a fault moves, the
value is NaN: no verdict. Where only one sign of the size is the fault, a projection of the other sign is
zero: the rate of chance alarms of that fault halves.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mooringdx.detectors.reference import follow, restart, sub_inverse
from mooringdx.types import Array, Mask

RESTART = 8192
"""Samples between exact recomputations of the running sums: bounds rounding."""


@njit(cache=True)
def moving_window(
    z: Array,
    valid: Mask,
    directions: Array,
    sign: Array,
    covariance: Array,
    window: int,
    start: tuple[Array, Array],
    pace: tuple[float, int, int, int],
    level: Array,
    pooled: bool,
    out: Array,
    frozen: Mask,
) -> None:
    """Fill ``out`` (n, f) (or (n, 1) when ``pooled``) and ``frozen`` (n,).

    ``directions`` (f, r), ``sign`` (f,) in {-1, 0, 1}, ``covariance`` (r, r), ``start`` = mean and sd (r,), ``pace``
    as `Reference.pace`, ``level`` (f,), inf where no alarm may hold the reference.
    """
    n, r = z.shape
    a, guard, max_hold, span = pace
    sd = start[1]
    mean, power, gain = start[0].copy(), start[1] ** 2, np.ones(r)
    ring, ring_ok = np.zeros((window, r)), np.zeros((window, r), np.bool_)
    sums, counts, x = np.zeros(r), np.zeros(r, np.int64), np.zeros(r)
    usable, everything = np.ones(r, np.bool_), np.ones(r, np.bool_)
    part = np.zeros((r, r))
    sub_inverse(covariance, everything, part)
    weights = _weights(directions, part, window, pooled)
    f = weights.shape[0]
    side = np.zeros(f) if pooled else sign
    seen, held, since, slot, missing = 0, 0, guard + 1, 0, window * r
    for k in range(n):
        for i in range(r):
            ok = valid[k, i]
            d = (z[k, i] - mean[i]) * gain[i] if ok else 0.0
            sums[i] += d - ring[slot, i]
            ring[slot, i] = d
            if ok != ring_ok[slot, i]:
                ring_ok[slot, i] = ok
                counts[i] += 1 if ok else -1
                missing -= 1 if ok else -1
        slot = slot + 1 if slot + 1 < window else 0
        seen += 1
        if k % RESTART == RESTART - 1:
            for i in range(r):
                sums[i] = ring[:, i].sum()
        alarm = False
        if seen < window:
            out[k] = np.nan
        elif missing == 0:
            pool = 0.0
            for j in range(f):
                p = 0.0
                for i in range(r):
                    p += sums[i] * weights[j, i]
                g = 0.0 if p * side[j] < 0.0 else 0.5 * p * p
                if pooled:
                    pool += g
                else:
                    out[k, j] = g
                    alarm = alarm or g > level[j]
            if pooled:
                out[k, 0] = pool
                alarm = pool > level[0]
        else:
            _masked(sums, counts, window, directions, sign, covariance, pooled, usable, part, x, out[k])
            for j in range(out.shape[1]):
                alarm = alarm or out[k, j] > level[j]
        if a == 0.0:
            continue
        since = 0 if alarm else since + 1
        frozen[k] = since <= guard
        held = held + 1 if frozen[k] else 0
        if held >= max_hold:
            restart(z, valid, k + 1, span, sd, mean, power, gain)
            ring[:] = 0.0
            ring_ok[:] = False
            sums[:] = 0.0
            counts[:] = 0
            seen, held, since, missing = 0, 0, guard + 1, window * r
        elif not frozen[k] and k >= guard:
            follow(z, valid, k - guard, a, sd, mean, power, gain)


@njit(cache=True)
def _weights(directions: Array, inverse: Array, window: int, pooled: bool) -> Array:
    """Return (f, r) so that p = weights @ sums has g = p^2 / 2; (r, r), a factor of the inverse, when ``pooled``."""
    if pooled:
        factor: Array = np.ascontiguousarray(np.linalg.cholesky(inverse).T) / np.sqrt(window)
        return factor
    weights = np.zeros(directions.shape)
    for j in range(directions.shape[0]):
        w = inverse @ directions[j]
        energy = (w * directions[j]).sum()
        weights[j] = w / np.sqrt(window * energy) if energy > 0.0 else np.full(w.shape, np.nan)
    return weights


@njit(cache=True)
def _masked(
    sums: Array,
    counts: NDArray[np.int64],
    window: int,
    directions: Array,
    sign: Array,
    covariance: Array,
    pooled: bool,
    usable: Mask,
    part: Array,
    x: Array,
    out: Array,
) -> None:
    """Value one sample whose window has masked samples; ``usable`` and ``part`` remember the last pattern."""
    r = sums.shape[0]
    changed = False
    for i in range(r):
        ok = 2 * counts[i] >= window and counts[i] > 0
        changed = changed or ok != usable[i]
        usable[i] = ok
        x[i] = sums[i] / np.sqrt(counts[i]) if ok else 0.0
    if changed:
        sub_inverse(covariance, usable, part)
    if pooled:
        out[0] = 0.5 * (x * (part @ x)).sum() if usable.any() else np.nan
        return
    y = part @ x
    moved = np.zeros(r)
    for j in range(directions.shape[0]):
        top = 0.0
        for i in range(r):
            moved[i] = directions[j, i] * np.sqrt(counts[i]) if usable[i] else 0.0
            top += moved[i] * y[i]
        energy = (moved * (part @ moved)).sum()
        if energy > 0.0:
            out[j] = 0.0 if top * sign[j] < 0.0 else 0.5 * top * top / energy
        else:
            out[j] = np.nan
