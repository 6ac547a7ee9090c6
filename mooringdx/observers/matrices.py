"""The matrices of the 15-state filter: exact over a step, and the steady gain.

For x' = A x + B u + w with u held over a step of h s and w white, of intensity W:

    F = expm(A h),   G = integral_0^h expm(A s) ds B,   Q = integral_0^h expm(A s) W expm(A s)' ds     [VanLoan1978]
    P = F (P - P C' S^-1 C P) F' + Q,   S = C P C' + R,   K = P C' S^-1                         [Fossen2011, ch. 11]

The Riccati equation is solved by doubling: each pass squares the number of steps that P has run, so that a bias with
a memory of a million steps costs twenty passes. A, B and C are in `mooringdx.observers.kalman`'s opening. What it
cannot see: a mooring whose stiffness changes with the place; it stands for one place.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mooringdx.physics.frames import rotation
from mooringdx.physics.vessel import Dynamics
from mooringdx.types import Array, locked

STATES = 15


@dataclass(frozen=True)
class Plant:
    """Inertia and linear damping, (3, 3) each, surge, sway, yaw; kg, kg m, kg m2 and N s/m, N s, N m s."""

    inertia: Array
    damping: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "inertia", locked(self.inertia))
        object.__setattr__(self, "damping", locked(self.damping))


@dataclass(frozen=True)
class Noise:
    """What drives the filter. Triples: surge, sway, yaw for ``force``; north, east, yaw for the rest.

    ``force``: S_F, N^2 s and (N m)^2 s. ``bias``: q_b, N^2/s. ``wave``: sigma_w, m s^-1/2 and rad s^-1/2 at the output.
    ``measurement``: variances, m2, m2, rad2. ``frequency``: w0, rad/s; ``share``: lambda.
    """

    force: tuple[float, float, float]
    bias: tuple[float, float, float]
    wave: tuple[float, float, float]
    measurement: tuple[float, float, float]
    frequency: float
    share: float


@dataclass(frozen=True)
class Model:
    """The filter at one heading: x(k+1) = F x(k) + G u(k) + w, w of covariance Q; y = C x + v, v of R.

    ``F``: (15, 15); ``G``: (15, 3), for a force in body axes, N, N, N m; ``P``: (15, 15), steady covariance before an
    update; ``K``: (15, 3), steady gain of the update; ``S``: (3, 3), covariance of the innovations. ``stiffness``:
    (3, 3), of the mooring in F, earth axes (zero where the lines' force is given). ``heading``: rad; ``step``: s.
    """

    heading: float
    step: float
    F: Array
    G: Array
    C: Array
    Q: Array
    R: Array
    P: Array
    K: Array
    S: Array
    stiffness: Array

    def __post_init__(self) -> None:
        for key in ("F", "G", "C", "Q", "R", "P", "K", "S", "stiffness"):
            object.__setattr__(self, key, locked(getattr(self, key)))

    @property
    def memory(self) -> float:
        """Slowest time constant of the filter's error, s."""
        radius = float(np.max(np.abs(np.linalg.eigvals(self.F @ (np.eye(STATES) - self.K @ self.C)))))
        return -self.step / float(np.log(min(radius, 1.0 - 1e-12)))


def plant_of(dynamics: Dynamics) -> Plant:
    """Return a vessel file's [dynamics] as matrices; quadratic cross-flow is left out."""
    inertia = np.diag(np.asarray(dynamics.inertia, dtype=np.float64))
    inertia[1, 2] = inertia[2, 1] = dynamics.coupling
    return Plant(inertia, np.diag(np.asarray(dynamics.damping, dtype=np.float64)))


def model(plant: Plant, noise: Noise, step: float, heading: float = 0.0, stiffness: Array | None = None) -> Model:
    """Return the filter's matrices at ``heading``, rad, for samples ``step`` s apart.

    ``stiffness``: (3, 3), -d(force of the lines)/d eta in earth axes; None where that force is given.
    """
    turn, inverse = rotation(heading), np.linalg.inv(plant.inertia)
    k = np.zeros((3, 3)) if stiffness is None else np.asarray(stiffness, dtype=np.float64)
    a, b, q = np.zeros((STATES, STATES)), np.zeros((STATES, 3)), np.zeros((STATES, STATES))
    a[0:3, 3:6] = turn
    a[3:6, 0:3] = -inverse @ turn.T @ k
    a[3:6, 3:6] = -inverse @ plant.damping
    a[3:6, 6:9] = inverse @ turn.T
    a[9:12, 12:15] = np.eye(3)
    a[12:15, 9:12] = -(noise.frequency**2) * np.eye(3)
    a[12:15, 12:15] = -2.0 * noise.share * noise.frequency * np.eye(3)
    b[3:6] = inverse
    q[3:6, 3:6] = inverse @ np.diag(noise.force) @ inverse.T
    q[6:9, 6:9] = np.diag(noise.bias)
    q[12:15, 12:15] = np.diag(np.square(noise.wave))
    f, g, w = discretised(a, b, q, step)
    c = np.hstack([np.eye(3), np.zeros((3, 9)), np.eye(3)])
    r = np.diag(np.asarray(noise.measurement, dtype=np.float64))
    scale = np.ones(STATES)
    scale[6:9] = np.diag(plant.inertia)
    p = riccati(f, w, c, r, scale)
    s = np.asarray(c @ p @ c.T + r, dtype=np.float64)
    gain = np.asarray(np.linalg.solve(s, c @ p).T, dtype=np.float64)
    return Model(heading, step, f, g, c, w, r, p, gain, s, k)


def discretised(a: Array, b: Array, q: Array, step: float) -> tuple[Array, Array, Array]:
    """Return F, G, Q over ``step`` s of x' = A x + B u + w with w of intensity ``q`` [VanLoan1978]."""
    from scipy.linalg import expm

    n, m = b.shape
    noise = expm(np.block([[-a, q], [np.zeros((n, n)), a.T]]) * step)
    f = noise[n:, n:].T
    moved = expm(np.block([[a, b], [np.zeros((m, n + m))]]) * step)
    w = f @ noise[:n, n:]
    return np.ascontiguousarray(f), np.ascontiguousarray(moved[:n, n:]), 0.5 * (w + w.T)


def riccati(f: Array, q: Array, c: Array, r: Array, scale: Array | None = None) -> Array:
    """Return the steady covariance before an update, P = F (P - P C'(C P C' + R)^-1 C P) F' + Q, by doubling.

    ``scale``: (n,), the size of a state's unit, so that kilonewtons and millimetres meet on equal terms.
    """
    n = len(f)
    d = np.ones(n) if scale is None else scale
    a = (f * d[None, :] / d[:, None]).T
    h = q / np.outer(d, d)
    cd = c * d[None, :]
    g = cd.T @ np.linalg.solve(r, cd)
    for _ in range(60):
        w = np.linalg.inv(np.eye(n) + g @ h)
        aw = a @ w
        more = a.T @ h @ w @ a
        g, a, h = g + aw @ g @ a.T, aw @ a, h + more
        h, g = 0.5 * (h + h.T), 0.5 * (g + g.T)
        if np.max(np.abs(np.diag(more))) <= 1e-14 * np.max(np.abs(np.diag(h))):
            break
    p: Array = h * np.outer(d, d)
    return p
