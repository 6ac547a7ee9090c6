"""Irregular waves over a whole record, their squared envelope, and the ship's first-order answer.

One harmonic a Fourier bin of the whole record, so that nothing repeats within it:

    zeta(t)  = g(t) Re sum_k sum_b A_kb exp(i w_k t),   A_kb complex Gaussian,   E|A_kb|^2 = 2 S(w_k) D_b dw
    probe    = g(t) Re sum_k sum_b A_kb exp(i (w_k t - k_k d cos(travel_b - heading))),   d m ahead of the origin
    motion   = g(t) Re sum_k sum_b A_kb X(w_k, travel_b(t) - heading) exp(i w_k t)
    drift    = c Hs^2 g(t)^2 Re(z* sum_b z_b u_b) / mean |z|^2,   z_b(t) = sum_k A_kb exp(i w_k t),   z = sum_b z_b

u_b: unit vector along direction b, so that in a short-crested sea the drift across the mean direction is a process of
its own; in a long-crested one the drift is the squared envelope along it. S, D: `mooringdx.physics.waves`; X:
`mooringdx.physics.response`; the product of envelopes stands for Newman's approximation of the slow drift with one
coefficient for all frequencies [Newman1974]. g: growth of the sea. A turning
sea keeps its elevation at the origin; its answers are blended between headings 15 deg apart.

A growing sea keeps its period; a turning sea does not turn what a probe sees. The answer is for a fixed heading: yawing
by more than a spreading angle is not in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mooringdx.physics.response import closed_form
from mooringdx.physics.vessel import Hull
from mooringdx.physics.waves import GRAVITY, density, spreading
from mooringdx.simulate.scenario import Sea
from mooringdx.simulate.streams import Draw
from mooringdx.types import Array

DIRECTIONS = 5
HIGHEST = 8.0  # peak frequencies; 0.03 % of the energy lies above
BLEND = np.radians(15.0)
HORIZONTAL, VERTICAL = (0, 1, 5), (2, 4)
"""Surge, sway, yaw, and heave, pitch among a hull's six motions."""


@dataclass(frozen=True)
class Waves:
    """A record's waves. ``omega``: (m,), rad/s; ``offsets``: (b,), rad about the mean direction;
    ``amplitude``: (b, m), m; ``first``: the Fourier bin of omega[0]; ``n`` samples cut from a transform of ``size``.
    """

    omega: Array
    offsets: Array
    amplitude: NDArray[np.complex128]
    first: int
    n: int
    size: int


def draw_waves(draw: Draw, n: int, dt: float, sea: Sea) -> Waves:
    """Return ``n`` samples' worth of the sea, ``dt`` s apart; each direction draws from a stream of its own."""
    from scipy.fft import next_fast_len

    size = int(next_fast_len(n + n % 2, real=True))
    size += size % 2
    step = 2.0 * np.pi / (size * dt)
    last = min(size // 2 - 1, int(HIGHEST * 2.0 * np.pi / sea.peak_period / step))
    first = max(1, int(0.1 * 2.0 * np.pi / sea.peak_period / step))
    omega = step * np.arange(first, last + 1, dtype=np.float64)
    spectrum = density(sea.spectrum, omega, sea.height, sea.peak_period, sea.peakedness)
    offsets, shares = spreading(sea.spread, DIRECTIONS)
    amplitude = np.empty((offsets.size, omega.size), dtype=np.complex128)
    for i, share in enumerate(shares):
        gauss = draw(f"waves {i}").standard_normal((2, omega.size))
        amplitude[i] = (gauss[0] + 1j * gauss[1]) * np.sqrt(spectrum * share * step)
    return Waves(omega, offsets, amplitude, first, n, size)


def record(waves: Waves, spectrum: NDArray[np.complex128]) -> Array:
    """Return Re sum_k spectrum_k exp(i w_k t), (..., n), of ``spectrum`` (..., m)."""
    from scipy.fft import irfft

    full = np.zeros((*spectrum.shape[:-1], waves.size // 2 + 1), dtype=np.complex128)
    full[..., waves.first : waves.first + waves.omega.size] = spectrum
    out = irfft(full, waves.size, axis=-1)[..., : waves.n]
    return np.asarray(out * (waves.size / 2.0), dtype=np.float64)


def squared_envelope(waves: Waves) -> Array:
    """Return the squared envelope of the elevation times 8, (n,), m2: its mean is the squared significant height."""
    total = waves.amplitude.sum(axis=0)
    return np.asarray(8.0 * (record(waves, total) ** 2 + record(waves, -1j * total) ** 2))


def elevation(waves: Waves, angle: float, ahead: float) -> Array:
    """Return the sea surface, (n,), m, up, at a probe ``ahead`` m forward of the origin, before growth.

    ``angle``: rad, of the waves' travel from the bow, clockwise. Deep water: k = w^2/g.
    """
    path = np.cos(angle + waves.offsets)[:, None] * (ahead * waves.omega**2 / GRAVITY)
    spectrum = (waves.amplitude * np.exp(-1j * path)).sum(axis=0)
    return record(waves, np.asarray(spectrum))


def slow_drift(waves: Waves) -> Array:
    """Return the drift before its coefficient along and across the mean direction, (n, 2), m2.

    The mean along a long-crested sea is the squared significant height; spreading takes a little of it away.
    """
    total = waves.amplitude.sum(axis=0)
    z = record(waves, total), record(waves, -1j * total)
    out = np.empty((waves.n, 2))
    for i, part in enumerate((np.cos(waves.offsets), np.sin(waves.offsets))):
        spectrum = (part[:, None] * waves.amplitude).sum(axis=0)
        out[:, i] = 8.0 * (z[0] * record(waves, spectrum) + z[1] * record(waves, -1j * spectrum))
    return out


def first_order(waves: Waves, hull: Hull, angle: float, turn: Array, rows: tuple[int, ...] = HORIZONTAL) -> Array:
    """Return surge, sway (m) and yaw (rad) in body axes, or other ``rows`` of the hull's six motions, (n, rows).

    ``angle``: rad, of the waves' travel from the bow, clockwise; ``turn``: (n,), rad, added to it as the sea turns, or
    (1,) zero.
    """
    low, high = min(0.0, float(turn.min())), max(0.0, float(turn.max()))
    count = 1 + int(np.ceil((high - low) / BLEND - 1e-9))
    nodes = np.linspace(low, high, count)
    out = np.zeros((waves.n, len(rows)))
    for i, node in enumerate(nodes):
        spectrum = np.zeros((len(rows), waves.omega.size), dtype=np.complex128)
        for offset, amplitude in zip(waves.offsets, waves.amplitude, strict=True):
            spectrum += amplitude * closed_form(hull, waves.omega, angle + node + offset)[list(rows)]
        weight = 1.0 if count == 1 else np.interp(turn, nodes, np.eye(count)[i])[:, None]
        out += weight * record(waves, spectrum).T
    return out
