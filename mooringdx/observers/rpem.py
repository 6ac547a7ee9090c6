"""The waves' frequency, followed: a Kalman filter of one axis that turns one knob by its own prediction error.

    x = [x_L, v_L, int x_H, x_H, F_E],   z = x_L + x_H + v                               [Tannuri2006, eqs. 7, 8]
    w <- w + P psi e/(lam + P psi^2),   P <- (P - P^2 psi^2/(lam + P psi^2))/lam         [Tannuri2006, eq. 11]
    psi = H dx-/dw,   dx-[k+1]/dw = Phi (I - K H) dx-[k]/dw + (dPhi/dw) x+[k]            [Tannuri2006, eqs. 12-14]

e: innovation; lam: forgetting. Departures from the print ("mended"): eq. 14 has x- for x+, which loses the term of
the gain; Phi = I + A dt runs away unless dt < 2 zeta/w0, so Phi is exact, with dPhi/dw by central difference; P is
capped and w kept in bounds, because a calm sea tells nothing of w and P then grows without limit. "printed" has
eqs. 9 and 14 to the letter, with the same cap and bounds. Gamma = E dt in both: Q is a covariance a sample.

What it cannot see: the waves' own frequency. It follows the mean or peak frequency of the motion, which the hull's
answer moves; and its tuning is not free: with small R or Q_H it settles elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.linalg import expm

from mooringdx.errors import ConfigError, FitError
from mooringdx.observers.passive import EQUATIONS
from mooringdx.types import Array

WIDTH = 1e-4
"""rad/s, of the central difference."""


@dataclass(frozen=True)
class Tuning:
    """Numbers of [Tannuri2006], a 60,000 t tanker in surge. ``low``, ``slow``: N^2 a sample; ``high``: m2 s-2;
    ``measurement``: m2; ``share``: zeta; ``cap``: of P, which starts there; ``bounds``: rad/s.
    """

    low: float = 4e10
    high: float = 2.6
    slow: float = 1.2e10
    measurement: float = 1.0
    share: float = 0.1
    forgetting: float = 0.996
    cap: float = 0.01
    bounds: tuple[float, float] = (0.25, 1.3)


@dataclass(frozen=True)
class Tracked:
    """One axis followed over n samples. ``frequency``: (n,), rad/s; ``slow``, ``wave``: (n,), m; ``force``: (n,), N,
    all after the update; ``innovation``: (n,), m, NaN where nothing was measured; ``sensitivity``: (n,), psi, m s;
    ``gain``: (n, 5).
    """

    frequency: Array
    slow: Array
    wave: Array
    force: Array
    innovation: Array
    sensitivity: Array
    gain: Array


def track(
    measured: Array,
    force: Array,
    step: float,
    mass: float,
    damping: float,
    frequency: float | None = None,
    tuning: Tuning | None = None,
    equations: str = "mended",
    adapt: bool = True,
) -> Tracked:
    """Follow the frequency of the waves in one axis of a record.

    Parameters
    ----------
    measured, force : (n,), m and N, ``step`` s apart; a NaN of ``measured`` is only predicted.
    mass, damping : kg with added mass, N s/m.
    frequency : rad/s to start from; the spectrum's peak in the first 100 s when None.
    adapt : False keeps the frequency.
    """
    tuning = tuning or Tuning()
    if equations not in EQUATIONS:
        raise ConfigError(f"rpem: unknown equations '{equations}'; allowed: {', '.join(EQUATIONS)}")
    w = spectral_start(measured, step, tuning.bounds) if frequency is None else frequency
    a = np.array([[0.0, 1.0, 0.0], [0.0, -damping / mass, 1.0 / mass], [0.0, 0.0, 0.0]])
    push = np.array([0.0, 1.0 / mass, 0.0])
    if equations == "printed":
        low, kick = np.eye(3) + step * a, step * push
    else:
        block = expm(np.block([[a, push[:, None]], [np.zeros((1, 4))]]) * step)
        low, kick = block[:3, :3], block[:3, 3]
    gamma = np.zeros((5, 3))
    gamma[1, 0], gamma[3, 1], gamma[4, 2] = step / mass, step, step
    q = gamma @ np.diag([tuning.low, tuning.high, tuning.slow]) @ gamma.T
    seen = np.flatnonzero(np.isfinite(measured))
    x0 = float(measured[seen[0]]) if seen.size else 0.0
    out = _tracked(
        np.ascontiguousarray(measured, np.float64), np.ascontiguousarray(force, np.float64), step,
        np.ascontiguousarray(low), np.ascontiguousarray(kick), q, tuning.measurement, tuning.share, tuning.forgetting,
        tuning.cap if adapt else 0.0, tuning.bounds[0], tuning.bounds[1], w, x0, equations == "printed",
    )  # fmt: skip
    return Tracked(*out)


def spectral_start(measured: Array, step: float, bounds: tuple[float, float], span: float = 100.0) -> float:
    """Return the frequency, rad/s, of the largest squared speed in the first ``span`` s, within ``bounds``."""
    from scipy.signal import detrend, periodogram

    first = measured[: round(span / step)]
    first = first[np.isfinite(first)]
    if first.size < 20:
        raise FitError(f"rpem: under 20 fixes in the first {span:g} s; give the frequency to start from")
    f, density = periodogram(detrend(first), 1.0 / step, window="hann", nfft=8 * first.size)
    omega = 2.0 * np.pi * f
    inside = (omega >= bounds[0]) & (omega <= bounds[1])
    if not inside.any():
        raise FitError(f"rpem: samples {step:g} s apart hold no frequency from {bounds[0]:g} to {bounds[1]:g} rad/s")
    return float(omega[inside][np.argmax((omega**2 * density)[inside])])


@njit(cache=True)
def _filled(phi: Array, low: Array, w: float, share: float, h: float, printed: bool) -> None:
    """Put the transition at frequency ``w`` into ``phi``, (5, 5); order x_L, v_L, int x_H, x_H, F_E."""
    place = (0, 1, 4)
    for i in range(3):
        for j in range(3):
            phi[place[i], place[j]] = low[i, j]
    if printed:
        phi[2, 2], phi[2, 3], phi[3, 2], phi[3, 3] = 1.0, h, -w * w * h, 1.0 - 2.0 * share * w * h
        return
    damped = w * np.sqrt(1.0 - share * share)
    fade, c, s = np.exp(-share * w * h), np.cos(damped * h), np.sin(damped * h) / damped
    phi[2, 2], phi[2, 3] = fade * (c + share * w * s), fade * s
    phi[3, 2], phi[3, 3] = -fade * w * w * s, fade * (c - share * w * s)


@njit(cache=True)
def _tracked(
    measured: Array, force: Array, h: float, low: Array, kick: Array, q: Array, r: float, share: float, forget: float,
    cap: float, least: float, most: float, w: float, x0: float, printed: bool,
) -> tuple[Array, Array, Array, Array, Array, Array, Array]:  # fmt: skip
    """Return frequency, slow motion, wave, force, innovation, sensitivity, (n,) each, and gain, (n, 5)."""
    n = len(measured)
    out, gains = np.zeros((4, n)), np.zeros((n, 5))
    innovation, sensitivity = np.full(n, np.nan), np.zeros(n)
    phi, up, down = np.zeros((5, 5)), np.zeros((5, 5)), np.zeros((5, 5))
    x, d, P = np.zeros(5), np.zeros(5), cap
    x[0] = x0
    X = q.copy() * 100.0
    X[0, 0] += r
    X[2, 2], X[3, 3] = X[2, 2] + r, X[3, 3] + r
    for k in range(n):
        before = x.copy()
        psi = d[0] + d[3]
        sensitivity[k] = psi
        slip = d.copy()
        if np.isfinite(measured[k]):
            e = measured[k] - x[0] - x[3]
            innovation[k] = e
            xh = X[:, 0] + X[:, 3]
            gain = xh / (xh[0] + xh[3] + r)
            gains[k] = gain
            x = x + gain * e
            slip = d - gain * psi
            X = X - np.outer(gain, xh)
            X = 0.5 * (X + X.T)
            below = forget + P * psi * psi
            w = min(max(w + P * psi * e / below, least), most)
            P = min((P - P * P * psi * psi / below) / forget, cap)
        out[0, k], out[1, k], out[2, k], out[3, k] = w, x[0], x[3], x[4]
        _filled(phi, low, w, share, h, printed)
        _filled(up, low, w + WIDTH, share, h, printed)
        _filled(down, low, w - WIDTH, share, h, printed)
        bent = (up - down) / (2.0 * WIDTH)
        d = phi @ slip + bent @ (before if printed else x)
        x = phi @ x
        x[0], x[1], x[4] = x[0] + kick[0] * force[k], x[1] + kick[1] * force[k], x[4] + kick[2] * force[k]
        X = phi @ X @ phi.T + q
    return out[0], out[1], out[2], out[3], innovation, sensitivity, gains
