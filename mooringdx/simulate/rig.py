"""The moored vessel: three degrees of freedom on spring lines, low-frequency motion.

    M nu_dot = R(psi)' (f_env + sum_i h T_i u_i) + moments - D (nu - R(psi)' v_c),      p_dot = R(psi) nu
    T_i = max(0, T_0 + k (r_i - r_0) + d_1 r_i_dot + d_2 r_i_dot |r_i_dot|)             (0 once the line has parted)

p is north, east, heading; nu surge, sway, yaw rate; r_i and u_i are distance and direction from fairlead to anchor;
h is the horizontal share of the tension. Coriolis forces are left out: speeds are a few cm/s. A line cannot push.
"""

from __future__ import annotations

import numba
import numpy as np

from mooringdx.types import Array


@numba.njit(cache=True)
def tension(stretch: float, speed: float, spring: Array) -> float:
    """Return one line's tension, N. ``spring``: pretension N, stiffness N/m, dynamic N s/m and N s2/m2."""
    pull: float = spring[0] + spring[1] * stretch + spring[2] * speed + spring[3] * speed * abs(speed)
    return max(0.0, pull)


@numba.njit(cache=True)
def reach(p: Array, fairlead: Array, anchor: Array) -> tuple[float, float, float]:
    """Return the distance to the anchor (m) and its direction (north, east) for a vessel at ``p`` (m, m, rad)."""
    c, s = np.cos(p[2]), np.sin(p[2])
    north = anchor[0] - p[0] - c * fairlead[0] + s * fairlead[1]
    east = anchor[1] - p[1] - s * fairlead[0] - c * fairlead[1]
    distance = np.hypot(north, east)
    return distance, north / distance, east / distance


@numba.njit(cache=True)
def slope(
    state: Array, load: Array, current: Array, holds: Array, mass: Array, damping: Array,
    fairleads: Array, anchors: Array, rest: float, spring: Array, share: float,
) -> Array:  # fmt: skip
    """Return the time derivative of ``state``: (6,), north, east, heading, surge, sway, yaw rate."""
    c, s = np.cos(state[2]), np.sin(state[2])
    north_speed, east_speed = c * state[3] - s * state[4], s * state[3] + c * state[4]
    north, east, moment = load[0], load[1], load[2]
    for i in range(len(anchors)):
        distance, un, ue = reach(state, fairleads[i], anchors[i])
        arm_n = c * fairleads[i, 0] - s * fairleads[i, 1]
        arm_e = s * fairleads[i, 0] + c * fairleads[i, 1]
        speed = -(un * (north_speed - state[5] * arm_e) + ue * (east_speed + state[5] * arm_n))
        pull = holds[i] * share * tension(distance - rest, speed, spring)
        north += pull * un
        east += pull * ue
        moment += pull * (arm_n * ue - arm_e * un)
    out = np.empty(6)
    out[0], out[1], out[2] = north_speed, east_speed, state[5]
    out[3] = (c * north + s * east - damping[0] * (state[3] - c * current[0] - s * current[1])) / mass[0]
    out[4] = (c * east - s * north - damping[1] * (state[4] - c * current[1] + s * current[0])) / mass[1]
    out[5] = (moment - damping[2] * state[5]) / mass[2]
    return out


@numba.njit(cache=True)
def drift_about(
    loads: Array, currents: Array, holds: Array, dt: float, heading: float, mass: Array, damping: Array,
    fairleads: Array, anchors: Array, rest: float, spring: Array, share: float,
) -> Array:  # fmt: skip
    """Integrate from rest by Runge-Kutta 4 with loads linear between samples.

    ``loads``: (n, 3), N, N, N m, earth axes; ``currents``: (n, 2), m/s; ``holds``: (n, lines), 1 or 0,
    held over the step. Returns (n, 3): north and east m, heading rad.
    """
    n = len(loads)
    out = np.empty((n, 3))
    state = np.zeros(6)
    state[2] = heading
    out[0] = state[:3]
    for k in range(n - 1):
        mid_load, mid_current = 0.5 * (loads[k] + loads[k + 1]), 0.5 * (currents[k] + currents[k + 1])
        rig = (holds[k], mass, damping, fairleads, anchors, rest, spring, share)
        a = slope(state, loads[k], currents[k], *rig)
        b = slope(state + 0.5 * dt * a, mid_load, mid_current, *rig)
        c = slope(state + 0.5 * dt * b, mid_load, mid_current, *rig)
        d = slope(state + dt * c, loads[k + 1], currents[k + 1], *rig)
        state = state + dt / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        out[k + 1] = state[:3]
    return out


@numba.njit(cache=True)
def tensions(
    motion: Array, dt: float, holds: Array, parted: float, fairleads: Array, anchors: Array, rest: float, spring: Array
) -> Array:
    """Return the tension of every line under the whole motion, (n, lines), N; ``parted`` is what hangs from a fairlead.

    ``motion``: (n, 3), north, east, heading. The fairlead's speed is the central difference of its distance.
    """
    n, lines = len(motion), len(anchors)
    out = np.empty((n, lines))
    for i in range(lines):
        distance = np.empty(n)
        for k in range(n):
            distance[k] = reach(motion[k], fairleads[i], anchors[i])[0]
        for k in range(n):
            first, last = max(k - 1, 0), min(k + 1, n - 1)
            speed = (distance[last] - distance[first]) / (dt * (last - first))
            out[k, i] = tension(distance[k] - rest, speed, spring) if holds[k, i] > 0.0 else parted
    return out
