"""Cumulative sum of the log-likelihood ratio of a fault of stated size, Page's rule, both signs.

    l_j(k) = v_j Gamma_j' Q^-1 ( d(k) - v_j Gamma_j / 2 ),    h_j(k) = max(0, h_j(k-1) + l_j(k))

v_j the design size, Gamma_j its direction, d the residual less its reference, Q covariance of window means times M
(its long-run covariance). h_j is the larger of the sums for +v_j and -v_j, or the one sum where only one sign
is the fault. For the stated size no test has a shorter worst delay
[Page1954].

Design for the *smallest* fault worth finding. Compressed residuals are bounded, so a reference v_j/2 above that bound
makes the sum blind: designed for a full loss it finds 8 % of them, designed for a 5 % loss all. Where a level
is known the sum is capped at twice the level, so that it clears again after the fault.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from mooringdx.detectors.design import Design
from mooringdx.detectors.reference import follow, restart, sub_inverse
from mooringdx.types import Array, Mask, Statistic, Whitened, locked


@dataclass(frozen=True)
class Cusum:
    """Page's cumulative sum, one column a fault.

    ``sizes``: (f,), or one for all, design sizes > 0 in the units of each signature's size. Left out, the size that
    moves the mean of a window by 5 sd, about the smallest that the moving-window detector finds.
    """

    design: Design
    sizes: Array | float | None = None

    def __post_init__(self) -> None:
        sizes = self._found_by_window() if self.sizes is None else self.sizes
        sizes = locked(np.broadcast_to(sizes, (len(self.design.labels),)))
        if not (sizes > 0.0).all():
            raise ValueError(f"design sizes {sizes} are not all positive")
        object.__setattr__(self, "sizes", sizes)

    def _found_by_window(self) -> Array:
        d = self.design
        energy = np.einsum("fr,rs,fs->f", d.directions, np.linalg.inv(d.covariance), d.directions)
        return np.asarray(5.0 / np.sqrt(np.where(energy > 0.0, energy, np.inf) * d.window) + (energy <= 0.0))

    def __call__(self, whitened: Whitened) -> Statistic:
        """Return h, (n, f), log-likelihood units; NaN where more than half of the last window is masked."""
        d = self.design
        values = np.empty((whitened.grid.n, len(d.labels)))
        frozen = np.zeros(whitened.grid.n, np.bool_)
        cumulative_sum(
            whitened.values,
            whitened.valid,
            d.directions * np.asarray(self.sizes)[:, None],
            d.sign,
            d.covariance,
            d.window,
            (d.reference.mean, d.reference.sd),
            d.reference.pace,
            d.levels(len(d.labels)),
            values,
            frozen,
        )
        return d.statistic(whitened, d.labels, values, frozen)

    @property
    def dof(self) -> int:
        """Two: the tail of the sum is exponential."""
        return 2


@njit(cache=True)
def cumulative_sum(
    z: Array,
    valid: Mask,
    shifts: Array,
    sign: Array,
    covariance: Array,
    window: int,
    start: tuple[Array, Array],
    pace: tuple[float, int, int, int],
    level: Array,
    out: Array,
    frozen: Mask,
) -> None:
    """Fill ``out`` (n, f) and ``frozen`` (n,). ``shifts`` (f, r): the change for which each sum is designed."""
    n, r = z.shape
    f = shifts.shape[0]
    a, guard, max_hold, span = pace
    sd = start[1]
    mean, power, gain = start[0].copy(), start[1] ** 2, np.ones(r)
    up, down = np.zeros(f), np.zeros(f)
    usable = np.zeros(r, np.bool_)
    part, d = np.zeros((r, r)), np.zeros(r)
    weights, half = np.zeros((f, r)), np.zeros(f)
    recent, good, slot = np.zeros(window, np.bool_), 0, 0
    held, since = 0, guard + 1
    for k in range(n):
        changed = False
        for i in range(r):
            changed = changed or valid[k, i] != usable[i]
            usable[i] = valid[k, i]
            d[i] = (z[k, i] - mean[i]) * gain[i] if usable[i] else 0.0
        if changed:
            sub_inverse(covariance, usable, part)
            for j in range(f):
                weights[j] = part @ shifts[j]
                half[j] = 0.5 * (weights[j] * shifts[j]).sum()
        any_ok = usable.any()
        good += int(any_ok) - int(recent[slot])
        recent[slot] = any_ok
        slot = slot + 1 if slot + 1 < window else 0
        alarm = False
        for j in range(f):
            score = (weights[j] * d).sum()
            cap = 2.0 * level[j]
            up[j] = min(cap, max(0.0, up[j] + score - half[j])) if sign[j] >= 0.0 else 0.0
            down[j] = min(cap, max(0.0, down[j] - score - half[j])) if sign[j] <= 0.0 else 0.0
            out[k, j] = max(up[j], down[j])
            alarm = alarm or out[k, j] > level[j]
        if 2 * good < min(window, k + 1):
            out[k] = np.nan
            up[:] = 0.0
            down[:] = 0.0
            alarm = False
        if a == 0.0:
            continue
        since = 0 if alarm else since + 1
        frozen[k] = since <= guard
        held = held + 1 if frozen[k] else 0
        if held >= max_hold:
            restart(z, valid, k + 1, span, sd, mean, power, gain)
            up[:] = 0.0
            down[:] = 0.0
            held, since = 0, guard + 1
        elif not frozen[k] and k >= guard:
            follow(z, valid, k - guard, a, sd, mean, power, gain)
