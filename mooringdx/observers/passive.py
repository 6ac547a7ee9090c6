"""A bank of nonlinear passive observers: one vessel, one measured place, one observer for every state of the lines.

    xi' = xi_w + K1a y~,   xi_w' = -w0^2 xi - 2 z w0 xi_w + K1b y~                       [PositionThesis, eq. 3.19a]
    eta' = R(psi) nu + K2 y~,   b' = -b/T_b + K3 y~                                     [PositionThesis, eqs. 3.19b, c]
    M nu' = -D nu + R'(psi) (b + K4 y~ + tau_m(eta)) + tau   [PositionThesis, eqs. 3.13, 3.19d]
    y~ = y - eta - xi_w,   tau_m = sum_j s_j H_j(r_j) u_j with its moment   [PositionThesis, eqs. 3.15, 3.17]
    K1a = -2 (zn - lambda) wc/w0,   K1b = 2 w0 (zn - lambda),   K2 = wc,   K3 = K4/10   [PositionThesis, eqs. 4.5-4.8]

eta: north, east, heading of the slow motion; nu: surge, sway, yaw rate; b: bias force, earth axes; psi: the measured
heading; s_j: what is left of line j, 0 where it is lost; zn = 1, lambda = 0.1. ``values``: "text" has wc = 1.2255 w0,
K4 = (0.1, 0.1, 0.01), "listing" wc = 1.1 rad/s at w0 = 2 pi/7 rad/s, K4 = (0.3, 0.3, 0.01). ``equations``: "printed"
has z = zn (as ran; the signs of eq. 3.7 would make the wave model run away) and K3, K4 in N/m on a vessel of 1e8 kg,
so that b stays all but zero; "mended" has z = lambda, and K3, K4 times the mass. Eq. 3.16's lever arm is zero
identically; here the moment is that of the fairleads, zero for a turret at the centre of gravity. Lines' forces,
thrust and measurement are held over a sample; the rest is Runge-Kutta 4.

What it cannot see: how sure it is (there is no covariance), a gap's growing doubt, and, as printed, any force that is
neither thrust nor line: a current on the beam passes for a lost line.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from mooringdx.errors import ConfigError
from mooringdx.observers.matrices import Plant
from mooringdx.physics.mooring import Mooring
from mooringdx.types import Array, locked

NOTCH, SHARE, CUTOFF, BIAS_TIME = 1.0, 0.1, 1.2255, 1000.0
VALUES = ("text", "listing")
EQUATIONS = ("printed", "mended")
STATES = 15
_State = tuple[
    float, float, float, float, float, float, float, float, float, float, float, float, float, float, float
]  # fmt: skip
_Row = tuple[float, ...]
_Rows = tuple[_Row, ...]
LANES = 16
"""Observers that are stepped side by side; their rows' distance has to be known when compiling."""


@dataclass(frozen=True)
class Passive:
    """The observer's numbers. ``wave``: (2, 3), w0^2 and 2 z w0; ``K1``: (2, 3); ``K2``, ``K3``, ``K4``: (3,) each,
    north, east, heading; ``decay``: 1/s, of the bias; ``damping``, ``inverse``: (3, 3), of inertia the inverse.
    """

    wave: Array
    K1: Array
    K2: Array
    K3: Array
    K4: Array
    decay: float
    damping: Array
    inverse: Array

    def __post_init__(self) -> None:
        for key in ("wave", "K1", "K2", "K3", "K4", "damping", "inverse"):
            object.__setattr__(self, key, locked(getattr(self, key)))


@dataclass(frozen=True)
class Watched:
    """What h observers say at n samples, before each sample's own correction has acted.

    ``innovation``: (n, h, 3), y~, NaN where nothing was measured; ``position``: (n, h, 3), slow motion, m, m, rad;
    ``bias``: (n, h, 3), N, N, N m, earth axes; ``final``: (h, 15), the state after the last sample.
    """

    innovation: Array
    position: Array
    bias: Array
    final: Array


def checked(values: str, equations: str) -> None:
    """Raise ConfigError unless ``values`` and ``equations`` are known."""
    if values not in VALUES or equations not in EQUATIONS:
        raise ConfigError(
            f"thesis bank: values '{values}' and equations '{equations}' are unknown; values are {', '.join(VALUES)}, "
            f"equations {', '.join(EQUATIONS)}"
        )


def passive(plant: Plant, frequency: float, values: str = "text", equations: str = "printed") -> Passive:
    """Return the observer for waves of peak ``frequency``, rad/s; see the module for ``values`` and ``equations``."""
    checked(values, equations)
    ones = np.ones(3)
    cutoff = CUTOFF * frequency if values == "text" else 1.1 * frequency / (2.0 * np.pi / 7.0)
    gain = np.array([0.1, 0.1, 0.01]) if values == "text" else np.array([0.3, 0.3, 0.01])
    damped = NOTCH if equations == "printed" else SHARE
    if equations == "mended":
        mass = np.diag(plant.inertia)
        horizontal = 0.5 * (mass[0] + mass[1])  # one number, because the gain stands in earth axes
        gain = gain * np.array([horizontal, horizontal, mass[2]])
    return Passive(
        wave=np.array([frequency**2 * ones, 2.0 * damped * frequency * ones]),
        K1=np.array([-2.0 * (NOTCH - SHARE) * cutoff / frequency * ones, 2.0 * frequency * (NOTCH - SHARE) * ones]),
        K2=cutoff * ones,
        K3=0.1 * gain,
        K4=gain,
        decay=1.0 / BIAS_TIME,
        damping=plant.damping,
        inverse=np.asarray(np.linalg.inv(plant.inertia), dtype=np.float64),
    )


def single_losses(lines: int) -> Array:
    """Return what is left of every line under every hypothesis, (lines + 1, lines): each lost alone, last none."""
    return np.vstack([1.0 - np.eye(lines), np.ones((1, lines))])


def watch(
    observer: Passive,
    mooring: Mooring,
    shares: Array,
    measured: Array,
    force: Array,
    step: float,
    first: Array | None = None,
) -> Watched:
    """Run one observer a hypothesis over a record.

    Parameters
    ----------
    shares : (h, lines), what is left of each line: 1 whole, 0 lost.
    measured : (n, 3), north, east, heading (m, m, rad, unwrapped), ``step`` s apart; rows with a NaN are predicted.
    force : (n, 3), thrust in body axes, N, N, N m, held from each sample to the next.
    first : (15,) or (h, 15), the state to start from (xi, xi_w, eta, b, nu); at rest at the first fix when None.
    """
    h = len(shares)
    state = np.zeros((h, STATES))
    if first is None:
        seen = np.flatnonzero(np.isfinite(measured).all(axis=1))
        state[:, 6:9] = measured[seen[0]] if seen.size else 0.0
    else:
        state[:] = first
    table = np.ascontiguousarray
    gains = (
        _rows(observer.wave), _rows(observer.K1), tuple(observer.K2.tolist()), tuple(observer.K3.tolist()),
        tuple(observer.K4.tolist()), observer.decay, _rows(observer.damping), _rows(observer.inverse),
    )  # fmt: skip
    out = _watched(
        state, table(measured, np.float64), table(force, np.float64), step, table(shares, np.float64), gains,
        mooring.fairleads, mooring.anchors, mooring.start, mooring.step, mooring.horizontal,
    )  # fmt: skip
    return Watched(*out)


def _rows(matrix: Array) -> _Rows:
    return tuple(tuple(row) for row in matrix.tolist())


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _lines(
    eta: tuple[float, float, float], share: Array, i: int, fairleads: Array, anchors: Array, start: float,
    per_step: float, horizontal: Array,
) -> tuple[float, float, float]:  # fmt: skip
    """Return the force and moment of what hypothesis ``i`` leaves of the lines, earth axes."""
    c, s = np.cos(eta[2]), np.sin(eta[2])
    x, y, n, last = 0.0, 0.0, 0.0, horizontal.shape[1] - 2
    for j in range(anchors.shape[0]):
        arm_n = c * fairleads[j, 0] - s * fairleads[j, 1]
        arm_e = s * fairleads[j, 0] + c * fairleads[j, 1]
        north, east = anchors[j, 0] - eta[0] - arm_n, anchors[j, 1] - eta[1] - arm_e
        distance = np.sqrt(north * north + east * east)
        place = (distance - start) * per_step  # as in `mooringdx.physics.mooring.lookup`, without a view of the row
        k = min(int(place), last) if place > 0.0 else 0
        pull = horizontal[j, k] + max(place - k, 0.0) * (horizontal[j, k + 1] - horizontal[j, k])
        pull *= share[i, j] / distance
        x += pull * north
        y += pull * east
        n += pull * (arm_n * east - arm_e * north)
    return x, y, n


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _slope(
    x: _State, y: tuple[float, float, float], seen: float, held: tuple[float, float, float], c: float, s: float,
    wave: _Rows, K1: _Rows, K2: _Row, K3: _Row, K4: _Row, decay: float, damping: _Rows, inverse: _Rows,
) -> _State:  # fmt: skip
    """Return the state's time derivative. ``held``: lines and thrust, body axes; ``seen``: 1 or 0.

    States are tuples, not arrays: nothing is written until the step is done, so the compiler need not read twice.
    """
    e0, e1, e2 = seen * (y[0] - x[6] - x[3]), seen * (y[1] - x[7] - x[4]), seen * (y[2] - x[8] - x[5])
    u, v, r = x[12], x[13], x[14]
    north, east = x[9] + K4[0] * e0, x[10] + K4[1] * e1
    f0 = held[0] + c * north + s * east - damping[0][0] * u - damping[0][1] * v - damping[0][2] * r
    f1 = held[1] + c * east - s * north - damping[1][0] * u - damping[1][1] * v - damping[1][2] * r
    f2 = held[2] + x[11] + K4[2] * e2 - damping[2][0] * u - damping[2][1] * v - damping[2][2] * r
    return (
        x[3] + K1[0][0] * e0,
        x[4] + K1[0][1] * e1,
        x[5] + K1[0][2] * e2,
        -wave[0][0] * x[0] - wave[1][0] * x[3] + K1[1][0] * e0,
        -wave[0][1] * x[1] - wave[1][1] * x[4] + K1[1][1] * e1,
        -wave[0][2] * x[2] - wave[1][2] * x[5] + K1[1][2] * e2,
        c * u - s * v + K2[0] * e0,
        s * u + c * v + K2[1] * e1,
        r + K2[2] * e2,
        -decay * x[9] + K3[0] * e0,
        -decay * x[10] + K3[1] * e1,
        -decay * x[11] + K3[2] * e2,
        inverse[0][0] * f0 + inverse[0][1] * f1 + inverse[0][2] * f2,
        inverse[1][0] * f0 + inverse[1][1] * f1 + inverse[1][2] * f2,
        inverse[2][0] * f0 + inverse[2][1] * f1 + inverse[2][2] * f2,
    )


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _on(x: _State, h: float, a: _State) -> _State:
    """Return x + h a."""
    return (
        x[0] + h * a[0], x[1] + h * a[1], x[2] + h * a[2], x[3] + h * a[3], x[4] + h * a[4], x[5] + h * a[5],
        x[6] + h * a[6], x[7] + h * a[7], x[8] + h * a[8], x[9] + h * a[9], x[10] + h * a[10], x[11] + h * a[11],
        x[12] + h * a[12], x[13] + h * a[13], x[14] + h * a[14],
    )  # fmt: skip


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _stepped(
    count: int, y: tuple[float, float, float], seen: float, dt: float,
    gains: tuple[_Rows, _Rows, _Row, _Row, _Row, float, _Rows, _Rows], lanes: Array,
) -> None:  # fmt: skip
    """Step the first ``count`` observers of ``lanes``, flat rows of LANES: 15 states, 3 forces held, cosine and sine.

    No branch and no call stands in the loop, and all that it writes is one array, so that it becomes vector code.
    """
    z = lanes
    for i in range(count):
        x = (
            z[i], z[LANES + i], z[2 * LANES + i], z[3 * LANES + i], z[4 * LANES + i], z[5 * LANES + i],
            z[6 * LANES + i], z[7 * LANES + i], z[8 * LANES + i], z[9 * LANES + i], z[10 * LANES + i],
            z[11 * LANES + i], z[12 * LANES + i], z[13 * LANES + i], z[14 * LANES + i],
        )  # fmt: skip
        held, c, s = (z[15 * LANES + i], z[16 * LANES + i], z[17 * LANES + i]), z[18 * LANES + i], z[19 * LANES + i]
        a = _slope(x, y, seen, held, c, s, *gains)
        b = _slope(_on(x, 0.5 * dt, a), y, seen, held, c, s, *gains)
        w = _slope(_on(x, 0.5 * dt, b), y, seen, held, c, s, *gains)
        d = _slope(_on(x, dt, w), y, seen, held, c, s, *gains)
        x = _on(_on(_on(_on(x, dt / 6.0, a), dt / 3.0, b), dt / 3.0, w), dt / 6.0, d)
        z[i], z[LANES + i], z[2 * LANES + i], z[3 * LANES + i], z[4 * LANES + i] = x[0], x[1], x[2], x[3], x[4]
        z[5 * LANES + i], z[6 * LANES + i], z[7 * LANES + i], z[8 * LANES + i] = x[5], x[6], x[7], x[8]
        z[9 * LANES + i], z[10 * LANES + i], z[11 * LANES + i], z[12 * LANES + i] = x[9], x[10], x[11], x[12]
        z[13 * LANES + i], z[14 * LANES + i] = x[13], x[14]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _watched(
    state: Array, measured: Array, force: Array, dt: float, shares: Array,
    gains: tuple[_Rows, _Rows, _Row, _Row, _Row, float, _Rows, _Rows], fairleads: Array, anchors: Array,
    start: float, step: float, horizontal: Array,
) -> tuple[Array, Array, Array, Array]:  # fmt: skip
    """Return innovations, positions, biases, (n, h, 3) each, and the last states, (h, 15)."""
    n, h, lanes = len(measured), len(shares), np.zeros(20 * LANES)
    innovation, position, bias = np.empty((n, h, 3)), np.empty((n, h, 3)), np.empty((n, h, 3))
    for first in range(0, h, LANES):
        count, y = min(LANES, h - first), (0.0, 0.0, 0.0)
        for i in range(count):
            for m in range(15):
                lanes[m * LANES + i] = state[first + i, m]
        for k in range(n):
            whole = np.isfinite(measured[k, 0]) and np.isfinite(measured[k, 1]) and np.isfinite(measured[k, 2])
            if whole:
                y = (measured[k, 0], measured[k, 1], measured[k, 2])
            cy, sy = np.cos(y[2]), np.sin(y[2])
            for i in range(count):
                at = first + i
                slow = lanes[6 * LANES + i], lanes[7 * LANES + i], lanes[8 * LANES + i]
                pull = _lines(slow, shares, at, fairleads, anchors, start, 1.0 / step, horizontal)
                c, s = cy, sy
                if whole:
                    innovation[k, at, 0] = y[0] - slow[0] - lanes[3 * LANES + i]
                    innovation[k, at, 1] = y[1] - slow[1] - lanes[4 * LANES + i]
                    innovation[k, at, 2] = y[2] - slow[2] - lanes[5 * LANES + i]
                else:
                    innovation[k, at] = np.nan
                    c, s = np.cos(slow[2]), np.sin(slow[2])
                position[k, at, 0], position[k, at, 1], position[k, at, 2] = slow
                bias[k, at, 0], bias[k, at, 1] = lanes[9 * LANES + i], lanes[10 * LANES + i]
                bias[k, at, 2] = lanes[11 * LANES + i]
                lanes[15 * LANES + i] = force[k, 0] + c * pull[0] + s * pull[1]
                lanes[16 * LANES + i] = force[k, 1] + c * pull[1] - s * pull[0]
                lanes[17 * LANES + i] = force[k, 2] + pull[2]
                lanes[18 * LANES + i], lanes[19 * LANES + i] = c, s
            _stepped(count, y, 1.0 if whole else 0.0, dt, gains, lanes)
        for i in range(count):
            for m in range(15):
                state[first + i, m] = lanes[m * LANES + i]
    return innovation, position, bias, state
