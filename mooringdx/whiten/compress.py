"""Compress the tails of a whitened residual, so that a few wild samples do not decide.

    z = x / (1 + |x| / (k s)),   s = sd(z)          [Fang2015, eqs. 9 and 10]

The sd of the *compressed* signal sets its own knee. With u = x / s, sd(u / (1 + |u| / k)) falls strictly from
k sd(sign x) to 0 as s grows, so there is exactly one positive s where it is 1 if k sd(sign x) > 1 (k > 1 for a
symmetric x), and none otherwise. For N(0, 1) and k = 3: s = 0.536, |z| < 1.61, efficiency 0.957: Gaussian data become
nearly uniform, not more Gaussian as the paper has it, but data of heavy tails gain. s is frozen at its no-fault
value. The mean is taken off before.

The alternative is a true clip at k robust sd [Huber1981]: z = max(-c, min(c, x)), c = 1.4826 k median|x|.

A small step d in x moves the mean of z by ``slope`` d: E[1 / (1 + |x|/(k s))^2], or P(|x| < c). A large one
saturates: the size of a fault is never read from compressed values.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mooringdx.errors import FitError
from mooringdx.types import Array, locked

Law = Literal["fang", "huber"]


@dataclass(frozen=True)
class Compressor:
    """A fitted compression of r whitened residuals.

    ``scale``: (r,), s of "fang", the robust sd of "huber"; ``slope``: (r,), what is left of a small step.
    """

    kind: Law
    k: float
    scale: Array
    slope: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "scale", locked(self.scale))
        object.__setattr__(self, "slope", locked(self.slope))

    @property
    def bound(self) -> Array:
        """(r,), what no compressed value exceeds."""
        return np.asarray(self.k * self.scale)

    def __call__(self, values: Array) -> Array:
        """Return (n, r) compressed; NaN stays NaN."""
        if self.kind == "huber":
            return np.asarray(np.clip(values, -self.bound, self.bound))
        return np.asarray(values / (1.0 + np.abs(values) / self.bound))


def fit_compression(columns: list[Array], kind: Law, k: float) -> Compressor:
    """Fit the knee of each residual on its whitened no-fault values; NaN is left out.

    ``columns``: r arrays, (n_i,). Raises FitError where eq. 10 has no solution or the values do not vary.
    """
    finite = [np.asarray(x[np.isfinite(x)], dtype=np.float64) for x in columns]
    if kind == "huber":
        scale = np.array([1.4826 * float(np.median(np.abs(x))) if x.size else 0.0 for x in finite])
        if not np.all(scale > 0.0):
            raise FitError('more than half of the whitened no-fault values are zero; set the compression to "none"')
        slope = [float(np.mean(np.abs(x) < k * s)) for x, s in zip(finite, scale, strict=True)]
        return Compressor("huber", k, scale, np.array(slope))
    scale = np.array([fixed_point(x, k) for x in finite])
    slope = [float(np.mean((1.0 + np.abs(x) / (k * s)) ** -2)) for x, s in zip(finite, scale, strict=True)]
    return Compressor("fang", k, scale, np.array(slope))


def fixed_point(values: Array, k: float) -> float:
    """Return the s > 0 for which sd(x / (1 + |x|/(k s))) = s, by bisection of log s; FitError where there is none.

    ``values``: (n,), without NaN. Compression never spreads values, so s is at most their sd.
    """
    magnitude = np.abs(values)
    spread = float(values.std()) if values.size else 0.0
    limit = k * float(np.sign(values).std()) if values.size else 0.0
    if not (spread > 0.0 and limit > 1.0):
        raise FitError(
            f"tail compression with k = {k:g} has no scale of its own on these values (k sd(sign x) is {limit:.3g} "
            'and must exceed 1); raise k or set the compression to "none"'
        )

    def above(log_scale: float) -> bool:
        s = math.exp(log_scale)
        return float((values / (1.0 + magnitude / (k * s))).std()) > s

    high = math.log(spread) + 1e-12
    low = high - 1.0
    while not above(low):
        low -= 2.0 * (high - low)
        if low < high - 600.0:
            raise FitError(f"tail compression with k = {k:g} has no usable scale on these values; raise k")
    for _ in range(60):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if above(middle) else (low, middle)
        if high - low < 1e-14:
            break
    return math.exp(0.5 * (low + high))
