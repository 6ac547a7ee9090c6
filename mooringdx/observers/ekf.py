"""An extended Kalman filter of the moored vessel: the lines' forces and their stiffness at the filter's own place.

    eta' = R(psi) nu,   M nu' = -D nu + R'(psi) (b + tau_m(eta)) + tau + w3,   b' = w_b
    xi' = xi_w,   xi_w' = -w0^2 xi - 2 lambda w0 xi_w + w_w,   y = eta + xi_w + v
    P- = F P F' + Q,   F = expm(A h),   A = d(x')/dx at x(k),   Q = h/6 (W + 4 F(h/2) W F(h/2)' + F W F')
    S = C P- C' + R,   K = P- C' S^-1,   x+ = x- + K (y - C x-),   P+ = (I - K C) P-            [Fossen2011, ch. 11]

The states are those of `mooringdx.observers.kalman`, in that order; there the matrices stand for headings 3 deg apart
and one place of the mooring, here they follow the vessel. eta, nu and b go by Runge-Kutta 4 with lines' forces at its
stages, the waves exactly; expm is its series to the fourth power, Q is Simpson's rule. ``bias`` False holds b at zero:
twelve states. What it cannot see: how the bending of R(psi) and of the lines' forces skews its spread.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.linalg import expm

from mooringdx.observers.kalman import Estimate, Filter, held
from mooringdx.observers.matrices import STATES, Noise, Plant
from mooringdx.physics.mooring import Mooring, line_force
from mooringdx.types import Array

_NO_LINES = Mooring((), np.zeros((0, 2)), np.zeros((0, 2)), 0.0, 1.0, np.zeros((0, 2)), np.zeros((0, 2)))


@dataclass(frozen=True)
class Vessel:
    """The model that both nonlinear filters share. ``step``: s; ``mooring``: None where no line holds the vessel;
    ``bias``: False for twelve states, without the bias force.
    """

    plant: Plant
    noise: Noise
    step: float
    mooring: Mooring | None = None
    bias: bool = True

    @property
    def rig(self) -> Mooring:
        """The mooring, or one without lines."""
        return self.mooring or _NO_LINES

    @property
    def inverse(self) -> Array:
        """(3, 3), of the inertia."""
        return np.asarray(np.linalg.inv(self.plant.inertia), dtype=np.float64)

    @property
    def intensity(self) -> Array:
        """(15, 15), of the white noise that drives the states."""
        out = np.zeros((STATES, STATES))
        inverse = self.inverse
        out[3:6, 3:6] = inverse @ np.diag(self.noise.force) @ inverse.T
        out[6:9, 6:9] = np.diag(self.noise.bias) * float(self.bias)
        out[12:15, 12:15] = np.diag(np.square(self.noise.wave))
        return out

    def waves(self, step: float) -> Array:
        """Return the exact transition, (2, 2), of one axis's (xi, xi_w) over ``step`` s."""
        w0, share = self.noise.frequency, self.noise.share
        return np.asarray(expm(np.array([[0.0, 1.0], [-(w0**2), -2.0 * share * w0]]) * step), dtype=np.float64)

    def start(self, measured: Array) -> tuple[Array, Array]:
        """Return the state, (15,), at the first whole fix of ``measured``, (n, 3), and the steady covariance."""
        seen = measured[np.isfinite(measured).all(axis=1)]
        x = np.zeros(STATES)
        x[:3] = seen[0] if len(seen) else 0.0
        place = (float(x[0]), float(x[1]), float(x[2]))
        p = np.array(Filter(self.plant, self.noise, self.step, self.mooring, place).model(place[2]).P)
        if not self.bias:
            p[6:9, :], p[:, 6:9] = 0.0, 0.0
        return x, p


def ekf(
    vessel: Vessel,
    measured: Array,
    force: Array | None = None,
    start: tuple[Array, Array] | None = None,
) -> Estimate:
    """Filter a record in one pass.

    Parameters
    ----------
    measured : (n, 3), north, east, heading (m, m, rad, unwrapped); a row with a NaN is only predicted.
    force : (n, 3), known force in body axes held from each sample to the next, N, N, N m; NaN holds the last.
    start : state, (15,), and covariance, (15, 15), before the first sample; `Vessel.start` when None.
    """
    x, p = vessel.start(measured) if start is None else start
    rig, h = vessel.rig, vessel.step
    body = np.zeros(np.shape(measured)) if force is None else held(force)
    state, innovation, nis, final, covariance = _extended(
        np.array(x, dtype=np.float64), np.array(p, dtype=np.float64), np.ascontiguousarray(measured, np.float64), body,
        h, vessel.plant.damping, vessel.inverse, vessel.waves(h), vessel.waves(0.5 * h),
        vessel.intensity, np.diag(np.asarray(vessel.noise.measurement, dtype=np.float64)),
        rig.fairleads, rig.anchors, rig.start, rig.step, rig.horizontal,
    )  # fmt: skip
    return estimate(state, innovation, nis, final, covariance)


def estimate(state: Array, innovation: Array, nis: Array, final: Array, covariance: Array) -> Estimate:
    """Return the noun for states (n, 9), innovations (n, 3), their squares (n,), last state and covariance."""
    seen = innovation[np.isfinite(nis)]
    moment = seen.T @ seen / max(len(seen), 1)
    return Estimate(state[:, 0:3], state[:, 3:6], state[:, 6:9], innovation, nis, moment, final, covariance)


@njit(cache=True)
def _rate(
    x: Array, body: Array, damping: Array, inverse: Array, fairleads: Array, anchors: Array, start: float, step: float,
    horizontal: Array,
) -> Array:  # fmt: skip
    """Return the time derivative of eta and nu, (6,)."""
    c, s = np.cos(x[2]), np.sin(x[2])
    earth = line_force(x[:3], fairleads, anchors, start, step, horizontal) + x[6:9]
    f0 = body[0] + c * earth[0] + s * earth[1]
    f1 = body[1] + c * earth[1] - s * earth[0]
    f2 = body[2] + earth[2]
    u, v, r = x[3], x[4], x[5]
    f0 -= damping[0, 0] * u + damping[0, 1] * v + damping[0, 2] * r
    f1 -= damping[1, 0] * u + damping[1, 1] * v + damping[1, 2] * r
    f2 -= damping[2, 0] * u + damping[2, 1] * v + damping[2, 2] * r
    out = np.empty(6)
    out[0], out[1], out[2] = c * u - s * v, s * u + c * v, r
    for i in range(3):
        out[3 + i] = inverse[i, 0] * f0 + inverse[i, 1] * f1 + inverse[i, 2] * f2
    return out


@njit(cache=True)
def advanced(
    x: Array, body: Array, h: float, damping: Array, inverse: Array, wave: Array, fairleads: Array, anchors: Array,
    start: float, step: float, horizontal: Array,
) -> Array:  # fmt: skip
    """Return the state, (15,), ``h`` s on. ``wave``: (2, 2), the waves' transition over ``h``; ``body``: (3,), held."""
    at = x.copy()
    a = _rate(at, body, damping, inverse, fairleads, anchors, start, step, horizontal)
    at[:6] = x[:6] + 0.5 * h * a
    b = _rate(at, body, damping, inverse, fairleads, anchors, start, step, horizontal)
    at[:6] = x[:6] + 0.5 * h * b
    c = _rate(at, body, damping, inverse, fairleads, anchors, start, step, horizontal)
    at[:6] = x[:6] + h * c
    d = _rate(at, body, damping, inverse, fairleads, anchors, start, step, horizontal)
    at[:6] = x[:6] + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
    for i in range(3):
        at[9 + i] = wave[0, 0] * x[9 + i] + wave[0, 1] * x[12 + i]
        at[12 + i] = wave[1, 0] * x[9 + i] + wave[1, 1] * x[12 + i]
    return at


@njit(cache=True)
def jacobian(
    x: Array, damping: Array, inverse: Array, fairleads: Array, anchors: Array, start: float, step: float,
    horizontal: Array,
) -> Array:  # fmt: skip
    """Return d(eta', nu', b')/d(eta, nu, b) at ``x``, (9, 9); the lines' part by central differences."""
    out = np.zeros((9, 9))
    c, s = np.cos(x[2]), np.sin(x[2])
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    earth = line_force(x[:3], fairleads, anchors, start, step, horizontal) + x[6:9]
    out[0:3, 3:6] = turn
    out[0, 2], out[1, 2] = -s * x[3] - c * x[4], c * x[3] - s * x[4]
    slope = np.zeros((3, 3))
    for i in range(3):
        width = 1e-3 * step if i < 2 else 1e-5
        up, down = x[:3].copy(), x[:3].copy()
        up[i] += width
        down[i] -= width
        more = line_force(up, fairleads, anchors, start, step, horizontal)
        slope[:, i] = (more - line_force(down, fairleads, anchors, start, step, horizontal)) / (2.0 * width)
    force = turn.T @ slope
    force[0, 2] += c * earth[1] - s * earth[0]
    force[1, 2] -= c * earth[0] + s * earth[1]
    out[3:6, 0:3] = inverse @ force
    out[3:6, 3:6] = -inverse @ damping
    out[3:6, 6:9] = inverse @ turn.T
    return out


@njit(cache=True)
def _transition(a: Array, h: float, wave: Array) -> Array:
    """Return the transition, (15, 15), of the linearised slow states over ``h`` s, waves' exact."""
    ah = a * h
    square = ah @ ah
    slow = np.eye(9) + ah + 0.5 * square + square @ ah / 6.0 + square @ square / 24.0
    out = np.zeros((15, 15))
    out[:9, :9] = slow
    for i in range(3):
        out[9 + i, 9 + i], out[9 + i, 12 + i] = wave[0, 0], wave[0, 1]
        out[12 + i, 9 + i], out[12 + i, 12 + i] = wave[1, 0], wave[1, 1]
    return out


@njit(cache=True)
def _extended(
    x: Array, P: Array, measured: Array, body: Array, h: float, damping: Array, inverse: Array, wave: Array,
    half: Array, W: Array, R: Array, fairleads: Array, anchors: Array, start: float, step: float, horizontal: Array,
) -> tuple[Array, Array, Array, Array, Array]:  # fmt: skip
    """Return states after the updates (n, 9), innovations (n, 3), their squares (n,), last state and covariance."""
    n = len(measured)
    states, innovations, squares = np.empty((n, 9)), np.full((n, 3), np.nan), np.full(n, np.nan)
    for k in range(n):
        if np.isfinite(measured[k]).all():
            error = measured[k] - x[:3] - x[12:15]
            pc = P[:, :3] + P[:, 12:15]
            weight = np.linalg.inv(pc[:3] + pc[12:15] + R)
            gain = pc @ weight
            innovations[k], squares[k] = error, error @ weight @ error
            x = x + gain @ error
            P = P - gain @ pc.T
            P = 0.5 * (P + P.T)
        states[k] = x[:9]
        a = jacobian(x, damping, inverse, fairleads, anchors, start, step, horizontal)
        F, G = _transition(a, h, wave), _transition(a, 0.5 * h, half)
        x = advanced(x, body[k], h, damping, inverse, wave, fairleads, anchors, start, step, horizontal)
        P = F @ P @ F.T + h / 6.0 * (W + 4.0 * (G @ W @ G.T) + F @ W @ F.T)
        P = 0.5 * (P + P.T)
    return states, innovations, squares, x, P
