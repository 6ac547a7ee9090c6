"""An unscented Kalman filter of the same vessel, in the additive form, with twelve or fifteen states.

    chi = [x, x + sqrt((L + l) P), x - sqrt((L + l) P)],   l = alpha^2 (L + kappa) - L       [Herrero2021, eqs. 25, 26]
    W0m = l/(L + l),   W0c = W0m + 1 - alpha^2 + beta,   Wi = 1/(2 (L + l))
    x- = sum Wm f(chi),   P- = sum Wc (f(chi) - x-)(f(chi) - x-)' + Q                        [Herrero2021, eqs. 28-30]
    chi drawn anew from x-, P-;   y- = sum Wm C chi,   S = sum Wc (C chi - y-)(C chi - y-)' + R
    K = sum Wc (chi - x-)(C chi - y-)' S^-1,   x = x- + K (y - y-),   P = P- - K S K'        [Herrero2021, eqs. 31-35]

Roots are Cholesky columns. Departures from the print: eq. 27 augments the state with the noise while eqs. 30 and 32 add
Q and R, which would count it twice, so the augmentation is dropped; eq. 31 needs the propagated points. The paper's
alpha of 1e-3 makes W0 about -1e6 and loses six digits, so P is made symmetric and alpha is 1 unless asked. Its states
are twelve: with a small Q and a steady force they settle beside the truth, which a bias force mends.

What it cannot see: more than the extended filter, here; only R(psi) and the lines bend, and by little in a spread.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mooringdx.errors import ConfigError
from mooringdx.observers.ekf import Vessel, advanced, estimate
from mooringdx.observers.kalman import Estimate, held
from mooringdx.observers.matrices import STATES, discretised
from mooringdx.types import Array


def ukf(
    vessel: Vessel,
    measured: Array,
    force: Array | None = None,
    start: tuple[Array, Array] | None = None,
    alpha: float = 1.0,
    beta: float = 2.0,
    kappa: float = 0.0,
    noise: Array | None = None,
) -> Estimate:
    """Filter a record in one pass.

    Parameters
    ----------
    measured, force, start : as `mooringdx.observers.ekf.ekf` takes them.
    alpha, beta, kappa : spread and weights of the sigma points.
    noise : (15, 15), covariance Q that a step adds; None: that of the vessel's intensities at the first heading.
    """
    if not alpha > 0.0:
        raise ConfigError(
            f"ukf: alpha {alpha:g} must be above 0; 1 spreads the points over a standard deviation or more"
        )
    x, p = vessel.start(measured) if start is None else start
    keep: NDArray[np.int64] = np.array([i for i in range(STATES) if vessel.bias or not 6 <= i < 9], dtype=np.int64)
    rig, h = vessel.rig, vessel.step
    body = np.zeros(np.shape(measured)) if force is None else held(force)
    q = step_noise(vessel, float(x[2])) if noise is None else noise
    state, innovation, nis, final, covariance = _unscented(
        np.array(x, dtype=np.float64), np.array(p, dtype=np.float64)[np.ix_(keep, keep)],
        np.ascontiguousarray(measured, np.float64), body, keep, np.ascontiguousarray(q[np.ix_(keep, keep)]),
        np.diag(np.asarray(vessel.noise.measurement, dtype=np.float64)), alpha, beta, kappa,
        h, vessel.plant.damping, vessel.inverse, vessel.waves(h),
        rig.fairleads, rig.anchors, rig.start, rig.step, rig.horizontal,
    )  # fmt: skip
    whole = np.zeros((STATES, STATES))
    whole[np.ix_(keep, keep)] = covariance
    return estimate(state, innovation, nis, final, whole)


def step_noise(vessel: Vessel, heading: float) -> Array:
    """Return Q, (15, 15), of one step of a vessel at rest at ``heading``, rad, without its lines' stiffness."""
    a, inverse = np.zeros((STATES, STATES)), vessel.inverse
    c, s = np.cos(heading), np.sin(heading)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    a[0:3, 3:6], a[3:6, 3:6], a[3:6, 6:9] = turn, -inverse @ vessel.plant.damping, inverse @ turn.T
    a[9:12, 12:15], a[12:15, 9:12] = np.eye(3), -(vessel.noise.frequency**2) * np.eye(3)
    a[12:15, 12:15] = -2.0 * vessel.noise.share * vessel.noise.frequency * np.eye(3)
    return discretised(a, np.zeros((STATES, 1)), vessel.intensity, vessel.step)[2]


@njit(cache=True)
def _points(x: Array, P: Array, spread: float) -> Array:
    """Return the sigma points, (2 L + 1, L)."""
    n = x.size
    root = np.linalg.cholesky(spread * P)
    out = np.empty((2 * n + 1, n))
    out[0] = x
    for i in range(n):
        out[1 + i] = x + root[:, i]
        out[1 + n + i] = x - root[:, i]
    return out


@njit(cache=True)
def _unscented(
    whole: Array, P: Array, measured: Array, body: Array, keep: NDArray[np.int64], Q: Array, R: Array,
    alpha: float, beta: float, kappa: float, h: float, damping: Array, inverse: Array, wave: Array,
    fairleads: Array, anchors: Array, start: float, step: float, horizontal: Array,
) -> tuple[Array, Array, Array, Array, Array]:  # fmt: skip
    """Return states after the updates (n, 9), innovations (n, 3), their squares (n,), last state and covariance."""
    n, size = len(measured), len(keep)
    states, innovations, squares = np.zeros((n, 9)), np.full((n, 3), np.nan), np.full(n, np.nan)
    spread = alpha**2 * (size + kappa)
    mean, moment = np.full(2 * size + 1, 0.5 / spread), np.full(2 * size + 1, 0.5 / spread)
    mean[0] = 1.0 - size / spread
    moment[0] = mean[0] + 1.0 - alpha**2 + beta
    x = whole[keep]
    for k in range(n):
        if np.isfinite(measured[k]).all():
            chi = _points(x, P, spread)
            seen = chi[:, :3] + chi[:, size - 3 :]
            expected = seen[0] + mean @ (seen - seen[0])  # about the middle: large weights cancel there
            off = seen - expected
            weighted = off * moment.reshape(-1, 1)
            S = R + off.T @ weighted
            weight = np.linalg.inv(S)
            gain, error = (chi - x).T @ weighted @ weight, measured[k] - expected
            innovations[k], squares[k] = error, error @ weight @ error
            x = x + gain @ error
            P = P - gain @ S @ gain.T
            P = 0.5 * (P + P.T)
        whole[keep] = x
        states[k] = whole[:9]
        chi = _points(x, P, spread)
        for i in range(2 * size + 1):
            whole[keep] = chi[i]
            on = advanced(whole, body[k], h, damping, inverse, wave, fairleads, anchors, start, step, horizontal)
            chi[i] = on[keep]
        x = chi[0] + mean @ (chi - chi[0])
        apart = chi - x
        P = Q + apart.T @ (apart * moment.reshape(-1, 1))
        P = 0.5 * (P + P.T)
    whole[keep] = x
    return states, innovations, squares, whole, P
