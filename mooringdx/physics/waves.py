"""The sea: spectra, spreading, moments, and how long a wave of a given frequency is.

    Pierson-Moskowitz:  S(w) = 5/16 Hs^2 wp^4 w^-5 exp(-5/4 (w/wp)^-4),   wp = 2 pi/Tp
    JONSWAP:            S(w) = c(p) S_PM(w) p^r,   r = exp(-(w/wp - 1)^2/(2 s^2)),   s = .07 (w <= wp), .09 (w > wp)
    spreading:          D(b) proportional to cos^2s(b/2),  -pi < b < pi
    dispersion:         w^2 = g k tanh(k d)

S: one-sided density of the elevation, m2 s; Hs: significant height, Tp: peak period, p: peakedness, c(p) such that the
integral over all frequencies is Hs^2/16 [PiersonMoskowitz1964], [Hasselmann1973]. In terms of the mean zero-crossing
period Tz = Tp (5 pi/4)^-1/4 the first is 4 pi^3 Hs^2 Tz (w Tz)^-5 exp(-(w Tz/2 pi)^-4/pi) [Nielsen2012]. Linear,
stationary waves of one system; the spread does not depend on frequency; nothing breaks.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from mooringdx.errors import ConfigError
from mooringdx.registry import resolve
from mooringdx.types import Array

GRAVITY = 9.81


def _width(ratio: Array) -> Array:
    """Return the exponent r of the peak at ``ratio`` = w/wp."""
    return np.asarray(np.exp(-((ratio - 1.0) ** 2) / (2.0 * np.where(ratio <= 1.0, 0.07, 0.09) ** 2)))


def _pierson_moskowitz(ratio: Array, _peakedness: float) -> Array:
    """Return the shape over w/wp, integral 1; it has no free peak."""
    return np.asarray(5.0 * ratio**-5.0 * np.exp(-1.25 * ratio**-4.0))


def _jonswap(ratio: Array, peakedness: float) -> Array:
    """Return the shape over w/wp, integral 1.

    With u = exp(-5/4 (w/wp)^-4), the share of Pierson-Moskowitz below w, the norm is the mean of p^r over u in (0, 1).
    """
    share = (np.arange(4000) + 0.5) / 4000.0
    norm = np.mean(peakedness ** _width((-np.log(share) / 1.25) ** -0.25))
    return np.asarray(_pierson_moskowitz(ratio, 1.0) * peakedness ** _width(ratio) / norm)


SPECTRA: dict[str, Callable[[Array, float], Array]] = {
    "jonswap": _jonswap,
    "pierson-moskowitz": _pierson_moskowitz,
}


def density(kind: str, omega: Array, height: float, peak_period: float, peakedness: float = 3.3) -> Array:
    """Return the spectral density of the elevation at each frequency, (n,), m2 s.

    ``kind``: a key of `SPECTRA`. ``omega``: (n,), rad/s, zero below or at 0. ``height``: significant, m;
    ``peak_period``: s; ``peakedness``: at least 1, of JONSWAP only (1 is Pierson-Moskowitz). The integral over all
    frequencies is height^2/16; a grid that ends at q peak frequencies leaves out about 1.25/q^4 of it.

    Raises ConfigError for an unknown spectrum or a height, period or peakedness out of range.
    """
    shape = resolve(kind, SPECTRA, "wave spectrum")
    if not (height >= 0.0 and peak_period > 0.0 and peakedness >= 1.0):
        raise ConfigError(
            f"waves: height {height:g} m, peak_period {peak_period:g} s and peakedness {peakedness:g} must be at least "
            "0, above 0 and at least 1; correct the sea state"
        )
    omega = np.asarray(omega, dtype=np.float64)
    peak = 2.0 * np.pi / peak_period
    ratio = omega / peak
    out = np.zeros(omega.shape)
    wet = ratio > 0.1  # below a tenth of the peak the density is under exp(-12000)
    out[wet] = (height**2 / 16.0) * shape(ratio[wet], peakedness) / peak
    return out


def spreading(exponent: float | None, count: int) -> tuple[Array, Array]:
    """Return directions about the mean and the share of the energy in each: ``(offsets, shares)``, rad and sum 1.

    The law is cos^2s(b/2) with s = ``exponent`` (about 5 a broad wind sea, 25 and more swell), carried by the ``count``
    directions of Gauss's rule: with t = sin(b/2) the law is (1 - t^2)^(s - 1/2) dt, whose nodes are those of the
    Gegenbauer polynomial, so that mean cos b = s/(s + 1) holds exactly from two directions on. None or 0 means
    long-crested, one direction, whatever ``count`` is.

    Raises ConfigError for a negative exponent or fewer than one direction.
    """
    if (exponent is not None and not exponent >= 0.0) or count < 1:
        raise ConfigError(
            f"waves: spreading exponent {exponent} and {count} directions must be at least 0 (0 is long-crested) and "
            "at least 1; correct the sea state"
        )
    if not exponent:
        return np.zeros(1), np.ones(1)
    from scipy.special import roots_gegenbauer

    node, weight = roots_gegenbauer(count, exponent)
    return np.asarray(2.0 * np.arcsin(node)), np.asarray(weight / weight.sum())


def moments(omega: Array, spectrum: Array, order: float) -> float:
    """Return the integral of omega^order times a density over the grid, by the trapezoidal rule.

    ``omega``: (n,), rad/s, increasing; ``spectrum``: (n,), m2 s. Order 0 gives the variance, m2.
    """
    kept = omega > 0.0 if order < 0 else np.ones(np.shape(omega), dtype=bool)
    return float(np.trapezoid(omega[kept] ** order * spectrum[kept], omega[kept]))


def wavenumber(omega: Array, depth: float = np.inf) -> Array:
    """Return the wavenumber, (n,), 1/m, of waves of frequency ``omega``, (n,), rad/s, in water of ``depth``, m.

    Newton's method on k d tanh(k d) = w^2 d/g; the sign of omega is not used.
    """
    deep = np.asarray(omega, dtype=np.float64) ** 2 / GRAVITY
    if not depth > 0.0:
        raise ConfigError(f"waves: depth {depth:g} m must be above 0; correct the depth of the water")
    if np.isinf(depth):
        return deep
    want = deep * depth
    x = np.maximum(want, np.sqrt(want))  # above the root: Newton then falls to it without overshoot
    for _ in range(30):
        t = np.tanh(x)
        slope = t + x * (1.0 - t**2)
        x = x - (x * t - want) / np.where(slope > 0.0, slope, 1.0)
    return np.asarray(x / depth)
