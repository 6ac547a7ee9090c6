"""Weather: irregular waves with the ship's first-order answer to them, and slowly wandering speeds.

Elevation at the origin, no repetition within the record (one harmonic per Fourier bin of the whole record):

    zeta(t) = Re sum_k sum_b A_kb exp(i w_k t),   A_kb complex Gaussian,   E|A_kb|^2 = 2 S(w_k) D(b) dw

S is JONSWAP [Hasselmann1973] scaled to the asked height; D is cos^2 over five headings b, each with phases of its
own. Wave-frequency motion: the hull follows the water's orbit, averaged over its length L and draught T (deep
water, w^2 = g k, a = k cos(b) L/2, j0 and j1 the spherical Bessel functions):

    surge, sway = -i (cos b, sin b) A j0(a) (1 - exp(-kT))/(kT),      yaw = -(6/L) sin b A j1(a) (1 - exp(-kT))/(kT)

It knows no radiation, diffraction or resonance: the size and phase are plausible, not those of one hull.
"""

from __future__ import annotations

import numpy as np
from scipy.special import spherical_jn

from mooringdx.types import Array

GRAVITY = 9.81
HEADINGS = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])


def jonswap(omega: Array, height: float, peak_period: float, peakedness: float) -> Array:
    """Return the spectrum on a uniform ``omega``: (n,), rad/s, as (n,), m2 s, whose integral is (height/4)^2."""
    ratio = np.where(omega > 0.0, omega * peak_period / (2.0 * np.pi), np.nan)
    width = np.where(ratio <= 1.0, 0.07, 0.09)
    shape = ratio**-5.0 * np.exp(-1.25 * ratio**-4.0) * peakedness ** np.exp(-((ratio - 1.0) ** 2) / (2.0 * width**2))
    shape = np.where((ratio > 0.4) & (ratio < 4.0), shape, 0.0)
    scale = (height / 4.0) ** 2 / (shape.sum() * (omega[1] - omega[0]))
    return np.asarray(scale * shape)


def hull_answer(omega: Array, heading: float, length: float, draught: float) -> Array:
    """Return surge, sway (m/m) and yaw (rad/m) per wave amplitude, (3, n) complex.

    ``omega``: (n,), rad/s; ``heading``: rad, of the waves' travel from the bow clockwise; ``length``, ``draught``: m.
    """
    k = np.maximum(omega, 1e-6) ** 2 / GRAVITY
    a = 0.5 * k * np.cos(heading) * length
    deep = -np.expm1(-k * draught) / (k * draught)
    shift = -1j * deep * spherical_jn(0, a)
    yaw = -6.0 / length * np.sin(heading) * deep * spherical_jn(1, a)
    return np.stack([np.cos(heading) * shift, np.sin(heading) * shift, yaw.astype(complex)])


def waves(
    rng: np.random.Generator, n: int, dt: float, spectrum: tuple[float, float, float], heading: float, spread: float,
    hull: tuple[float, float],
) -> tuple[Array, Array]:  # fmt: skip
    """Return wave-frequency motion (n, 3: m, m, rad, body axes) and the squared envelope over its mean, (n,).

    ``spectrum``: height m, peak period s, peakedness. ``heading``, ``spread``: rad. ``hull``: length, draught, m.
    """
    size = n + n % 2
    omega: Array = np.asarray(2.0 * np.pi * np.fft.rfftfreq(size, dt), dtype=np.float64)
    density = jonswap(omega, *spectrum)
    share = np.cos(0.5 * np.pi * HEADINGS / 1.5) ** 2
    elevation, motion = np.zeros(omega.size, complex), np.zeros((3, omega.size), complex)
    for offset, weight in zip(HEADINGS * spread, share / share.sum(), strict=True):
        gauss = rng.standard_normal((2, omega.size))
        amplitude = (gauss[0] + 1j * gauss[1]) * np.sqrt(density * weight * (omega[1] - omega[0]))
        elevation += amplitude
        motion += amplitude * hull_answer(omega, heading + offset, *hull)
    analytic = np.fft.ifft(np.concatenate([elevation, np.zeros(size - omega.size)])) * size
    envelope = np.abs(analytic[:n]) ** 2
    answer = np.fft.irfft(motion, size, axis=1)[:, :n].T * (size / 2)
    return np.ascontiguousarray(answer), np.asarray(envelope / envelope.mean())


def wander(rng: np.random.Generator, n: int, dt: float, sd: float, memory: float) -> Array:
    """Return a stationary Ornstein-Uhlenbeck process, (n,), of deviation ``sd``, time constant ``memory`` s."""
    keep = np.exp(-dt / memory)
    shocks = rng.standard_normal(n) * sd * np.sqrt(1.0 - keep**2)
    shocks[0] = sd * rng.standard_normal()
    out = np.empty(n)
    level = 0.0
    for i, shock in enumerate(shocks):
        level = keep * level + shock
        out[i] = level
    return out
