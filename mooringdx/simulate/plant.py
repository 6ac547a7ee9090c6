"""The moored vessel: slow motion in three degrees of freedom under waves' drift, wind, current, lines and thrusters.

    M nu' = R'(psi) tau_moor(eta) + tau_drift + tau_wind + tau - D (nu - R' v_c) - cross-flow,      eta' = R(psi) nu
    cross-flow sway = rho C_d T/2 int |v(x)| v(x) dx,   yaw = rho C_d T/2 int x |v(x)| v(x) dx,   v(x) = v_r + x r
    command = -(K_p R' e + K_i R' int e dt + K_d nu),  e = eta - eta_d                     [Fang2015, eq. 25]
    lag tau_logged' = command - tau_logged,  tau = what is left of tau_logged after a loss

eta: north, east, heading; nu: surge, sway, yaw rate, of the centre of gravity. The controller sees the slow motion with
no error but that of a faulty position or heading, limits each axis, and lets the integral go back by what the limit
cut off. Line forces are those of the
slow motion; Coriolis forces are left out (a moored vessel's speeds). Integrated by Runge-Kutta 4 with loads linear
between samples and the command held over a sample.

A line that parted near its anchor drags its end: H = H(r - s); where H would pass the sliding force, s grows instead.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mooringdx.physics.mooring import lookup
from mooringdx.types import Array


class Hull(NamedTuple):
    """Numbers of the hull. ``inverse``: (3, 3) of the inertia; ``damping``: (3,); ``strips``: (s, 2), x in m and
    N/(m/s)2 of each slice; ``drift``: (3,), N/m2 and N/m; ``wind``: (3,), N/(m/s)2 and N m/(m/s)2.
    """

    inverse: Array
    damping: Array
    strips: Array
    drift: Array
    wind: Array


class Lines(NamedTuple):
    """Numbers of the lines, n of them. Tables (n, levels, k), N, at ``start[j] + step[j] * arange(k)`` m, a level a
    state of weakening. ``parted``, ``low``: (n,), the sample from which a line is gone or drags; ``slide``: (n, 2),
    sliding force N and the distance m at which it is reached. ``dynamic``: N s/m, N s2/m2; ``rest``: N left.
    """

    anchors: Array
    fairleads: Array
    start: Array
    step: Array
    horizontal: Array
    tension: Array
    parted: NDArray[np.int64]
    low: NDArray[np.int64]
    slide: Array
    dynamic: Array
    rest: float


class Loop(NamedTuple):
    """Numbers of the controller: gains (3,), ``limit`` (3,), N, N, N m; ``keep``: what the lag keeps in a sample;
    ``set_point``: (3,), m, m, rad. ``stuck``: (3, 2), samples from which and until which an axis of the measured place
    repeats itself.
    """

    proportional: Array
    integral: Array
    derivative: Array
    limit: Array
    keep: float
    set_point: Array
    stuck: NDArray[np.int64]


@njit(cache=True)
def at_level(start: float, step: float, tables: Array, level: float, distance: float) -> float:
    """Return the value of ``tables``, (levels, k), at a fractional ``level`` and a ``distance``, m."""
    below = int(level)
    value = lookup(start, step, tables[below], distance)
    share = level - below
    if share > 0.0:
        value += share * (lookup(start, step, tables[below + 1], distance) - value)
    return value


@njit(cache=True)
def reach(eta: Array, lines: Lines, j: int) -> tuple[float, float, float, float, float]:
    """Return distance to anchor j, m, its direction (north, east), and the fairlead's arm (north, east), m."""
    c, s = np.cos(eta[2]), np.sin(eta[2])
    arm_n = c * lines.fairleads[j, 0] - s * lines.fairleads[j, 1]
    arm_e = s * lines.fairleads[j, 0] + c * lines.fairleads[j, 1]
    north, east = lines.anchors[j, 0] - eta[0] - arm_n, lines.anchors[j, 1] - eta[1] - arm_e
    distance = np.hypot(north, east)
    return distance, north / distance, east / distance, arm_n, arm_e


@njit(cache=True)
def slope(
    state: Array, k: int, load: Array, thrust: Array, level: Array, dragged: Array, hull: Hull, lines: Lines
) -> Array:
    """Return the time derivative of ``state``: (6,), north, east, heading, surge, sway, yaw rate.

    ``load``: (6,), earth axes: drift over its coefficients (north, east), m2; squared wind (north, east), m2/s2;
    current (north, east), m/s. ``thrust``: (3,), body axes. ``level``, ``dragged``: (n,), weakening and m, a line.
    """
    c, s = np.cos(state[2]), np.sin(state[2])
    north, east, moment = 0.0, 0.0, 0.0
    for j in range(len(lines.anchors)):
        if k >= lines.parted[j]:
            continue
        distance, un, ue, arm_n, arm_e = reach(state, lines, j)
        pull = at_level(lines.start[j], lines.step[j], lines.horizontal[j], level[j], distance - dragged[j])
        if k >= lines.low[j]:
            pull = min(pull, lines.slide[j, 0])
        north += pull * un
        east += pull * ue
        moment += pull * (arm_n * ue - arm_e * un)
    ahead, aside = c * load[0] + s * load[1], c * load[1] - s * load[0]
    blow, beam = c * load[2] + s * load[3], c * load[3] - s * load[2]
    u, v, r = state[3] - c * load[4] - s * load[5], state[4] - c * load[5] + s * load[4], state[5]
    x = c * north + s * east + thrust[0] + hull.drift[0] * ahead + hull.wind[0] * blow - hull.damping[0] * u
    y = c * east - s * north + thrust[1] + hull.drift[1] * aside + hull.wind[1] * beam - hull.damping[1] * v
    n = moment + thrust[2] - hull.damping[2] * r
    n += 2.0 * hull.drift[2] * ahead * aside / max(np.hypot(ahead, aside), 1e-300)
    n += 2.0 * hull.wind[2] * blow * beam / max(np.hypot(blow, beam), 1e-300)
    for i in range(len(hull.strips)):
        local = v + hull.strips[i, 0] * r
        drag = hull.strips[i, 1] * local * abs(local)
        y -= drag
        n -= drag * hull.strips[i, 0]
    out = np.empty(6)
    out[0], out[1], out[2] = c * state[3] - s * state[4], s * state[3] + c * state[4], r
    for i in range(3):
        out[3 + i] = hull.inverse[i, 0] * x + hull.inverse[i, 1] * y + hull.inverse[i, 2] * n
    return out


@njit(cache=True)
def command(place: Array, speed: Array, sums: Array, dt: float, loop: Loop) -> Array:
    """Return the limited command, (3,), body axes, and bring the integral ``sums``, (3,), earth axes, up to date.

    ``place``: (3,), north, east, heading as measured; ``speed``: (3,), surge, sway, yaw rate.
    """
    c, s = np.cos(place[2]), np.sin(place[2])
    error = place - loop.set_point
    error[2] = (error[2] + np.pi) % (2.0 * np.pi) - np.pi
    turned = np.array([c * error[0] + s * error[1], c * error[1] - s * error[0], error[2]])
    summed = np.array([c * sums[0] + s * sums[1], c * sums[1] - s * sums[0], sums[2]])
    out, back = np.empty(3), np.zeros(3)
    for i in range(3):
        asked = -(loop.proportional[i] * turned[i] + loop.integral[i] * summed[i] + loop.derivative[i] * speed[i])
        out[i] = min(max(asked, -loop.limit[i]), loop.limit[i])
        if loop.proportional[i] > 0.0:
            back[i] = (asked - out[i]) / loop.proportional[i]
    sums[0] += dt * (error[0] + c * back[0] - s * back[1])
    sums[1] += dt * (error[1] + s * back[0] + c * back[1])
    sums[2] += dt * (error[2] + back[2])
    return out


@njit(cache=True)
def run(
    first: Array, loads: Array, levels: Array, effect: Array, misread: Array, dt: float, substeps: int, hull: Hull,
    lines: Lines, loop: Loop,
) -> tuple[Array, Array, Array]:  # fmt: skip
    """Integrate from rest at ``first``, (3,), over the record.

    ``loads``: (n, 6); ``levels``: (n, lines), or (1, lines) where they stay; ``effect``: (n, 3), or (1, 3), what the
    thrusters give for what is logged; ``misread``: (n, 3), or (1, 3), what the controller reads above the true place.
    Returns the slow motion (n, 3), the logged thrust (n, 3), body axes, and the
    distance that each line's end was dragged, (n, lines), m, or (1, lines) where none drags.
    """
    n, count = len(loads), len(lines.anchors)
    some = False
    for j in range(count):
        some = some or lines.low[j] < n
    path, logged = np.empty((n, 3)), np.zeros((n, 3))
    dragged = np.zeros((n if some else 1, count))
    state, sums, given, far = np.zeros(6), np.zeros(3), np.zeros(3), np.zeros(count)
    state[:3] = first
    seen = first.copy()
    path[0] = first
    h = dt / substeps
    for k in range(n - 1):
        level = levels[k if len(levels) > 1 else 0]
        for i in range(3):
            if not loop.stuck[i, 0] <= k < loop.stuck[i, 1]:
                seen[i] = state[i] + misread[k if len(misread) > 1 else 0, i]
        wanted = command(seen, state[3:], sums, dt, loop)
        after = wanted + (given - wanted) * loop.keep
        thrust = 0.5 * (given + after) * effect[k if len(effect) > 1 else 0]
        given = after
        rise = (loads[k + 1] - loads[k]) / substeps
        for i in range(substeps):
            load = loads[k] + i * rise
            a = slope(state, k, load, thrust, level, far, hull, lines)
            b = slope(state + 0.5 * h * a, k, load + 0.5 * rise, thrust, level, far, hull, lines)
            c = slope(state + 0.5 * h * b, k, load + 0.5 * rise, thrust, level, far, hull, lines)
            d = slope(state + h * c, k, load + rise, thrust, level, far, hull, lines)
            state = state + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        path[k + 1] = state[:3]
        logged[k + 1] = given
        if some:
            for j in range(count):
                if lines.low[j] <= k + 1 < lines.parted[j]:
                    far[j] = max(far[j], reach(state, lines, j)[0] - lines.slide[j, 1])
            dragged[k + 1] = far
    return path, logged, dragged


@njit(cache=True)
def tensions(motion: Array, dt: float, levels: Array, dragged: Array, lines: Lines) -> Array:
    """Return the tension at every fairlead under the whole motion, (n, lines), N.

    ``motion``: (n, 3), north, east m, heading rad. The statics at the fairlead's place, and ``dynamic`` times its speed
    away from the anchor (central difference); no less than zero.
    """
    n, count = len(motion), len(lines.anchors)
    out, distance = np.empty((n, count)), np.empty(n)
    for j in range(count):
        for k in range(n):
            distance[k] = reach(motion[k], lines, j)[0]
        for k in range(n):
            if k >= lines.parted[j]:
                out[k, j] = lines.rest
                continue
            before, after = max(k - 1, 0), min(k + 1, n - 1)
            speed = (distance[after] - distance[before]) / (dt * (after - before))
            far = dragged[k if len(dragged) > 1 else 0, j]
            level = levels[k if len(levels) > 1 else 0, j]
            pull = at_level(lines.start[j], lines.step[j], lines.tension[j], level, distance[k] - far)
            out[k, j] = max(0.0, pull + lines.dynamic[0] * speed + lines.dynamic[1] * speed * abs(speed))
    return out
