"""The reference against which a change is judged: frozen, or following the sea slowly.

    d(k)  = (z(k) - m(k)) s0 / s(k)
    m(k)  = m(k-1)  + a (z(k-G) - m(k-1)),            a = 1/tau
    s2(k) = s2(k-1) + a ((z(k-G) - m(k))^2 - s2(k-1))

z whitened residual, m and s its reference mean and sd, s0 the sd of the no-fault window, G the guard (two
windows) that keeps a young fault out of its own reference. Both are held while any fault is in alarm and
for G samples after. An alarm that has stood for ``max_hold`` samples is closed: m and s restart from the
last tau samples. [Fang2015] has a frozen reference only (tau None); following is ours.

What following cannot see: any change slower than about tau. It is absorbed, by construction; the slow
channel against the frozen reference is there for it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from mooringdx.types import Array, Mask, locked

LEAST_SD = 0.25
"""A reference sd is not taken below this share of the no-fault one: a channel that holds still must not
blow up what follows when it moves again."""


@dataclass(frozen=True)
class Reference:
    """Mean and sd of each whitened residual without fault, and how they follow.

    Parameters
    ----------
    mean, sd : (r,), of the no-fault window, units of the whitened residual.
    tau : samples of the exponential memory, or None for a frozen reference.
    guard : samples between now and the newest sample that the reference has seen.
    max_hold : samples of standing alarm after which the reference starts anew; 6 tau when left at 0.
    """

    mean: Array
    sd: Array
    tau: float | None = None
    guard: int = 0
    max_hold: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "mean", locked(self.mean))
        object.__setattr__(self, "sd", locked(self.sd))
        if self.mean.shape != self.sd.shape or self.mean.ndim != 1:
            raise ValueError(f"reference mean {self.mean.shape} and sd {self.sd.shape} are not both (r,)")
        if self.tau is not None and not self.tau > 1.0:
            raise ValueError(f"reference memory of {self.tau} samples; it must exceed 1, or be None")

    @property
    def pace(self) -> tuple[float, int, int, int]:
        """Return (a, guard, max_hold, restart span) as the kernels want them; a = 0 is a frozen reference."""
        if self.tau is None:
            return 0.0, self.guard, 0, 0
        span = round(self.tau)
        return 1.0 / self.tau, self.guard, self.max_hold or 6 * span, span


@njit(cache=True)
def follow(z: Array, valid: Mask, at: int, a: float, sd: Array, mean: Array, power: Array, gain: Array) -> None:
    """Move the reference (in place) one sample towards ``z[at]``."""
    for i in range(mean.shape[0]):
        if valid[at, i]:
            mean[i] += a * (z[at, i] - mean[i])
            e = z[at, i] - mean[i]
            power[i] += a * (e * e - power[i])
            gain[i] = sd[i] / max(np.sqrt(power[i]), LEAST_SD * sd[i])


@njit(cache=True)
def restart(z: Array, valid: Mask, stop: int, span: int, sd: Array, mean: Array, power: Array, gain: Array) -> None:
    """Set the reference (in place) from the ``span`` samples before ``stop``; channels without data keep theirs."""
    start = max(0, stop - span)
    for i in range(z.shape[1]):
        count, total = 0, 0.0
        for k in range(start, stop):
            if valid[k, i]:
                count += 1
                total += z[k, i]
        if count < 2:
            continue
        mean[i] = total / count
        square = 0.0
        for k in range(start, stop):
            if valid[k, i]:
                square += (z[k, i] - mean[i]) ** 2
        power[i] = square / count
        gain[i] = sd[i] / max(np.sqrt(power[i]), LEAST_SD * sd[i])


@njit(cache=True)
def sub_inverse(covariance: Array, usable: Mask, out: Array) -> None:
    """Write the inverse of the usable channels' covariance, (r, r), zero elsewhere, into ``out``."""
    r = usable.shape[0]
    index = np.empty(r, np.int64)
    count = 0
    for i in range(r):
        if usable[i]:
            index[count] = i
            count += 1
    out[:] = 0.0
    if count == 0:
        return
    part = np.empty((count, count))
    for i in range(count):
        for j in range(count):
            part[i, j] = covariance[index[i], index[j]]
    inverse = np.linalg.inv(part)
    for i in range(count):
        for j in range(count):
            out[index[i], index[j]] = inverse[i, j]
