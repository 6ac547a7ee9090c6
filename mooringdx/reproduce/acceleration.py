"""The residual vector of [Fang2015, eqs. 4 and 6] in a form that can be computed: accelerations, then tensions.

    r_12  = M^-1 (tau + F_wind + R'(psi) sum_j H_j(x_j) u_j - D R'(psi) p_dot) - R'(psi) p_ddot        surge, sway, m/s2
    r_5+j = measured minus intact tension of line j, N

M inertia with added mass, D damping, H_j horizontal tension of the intact line j at its distance x_j, u_j towards its
anchor. Mended: the print subtracts a current, a velocity, from a position, and leaves the acceleration in earth axes.
No current is logged here, so its drag M^-1 D R' v_c stays in r_12. Every term passes the same filter w^2/(s + w)^2,
which gives p_dot and p_ddot without differencing noise twice; w is twice the natural frequency of surge on the lines
(a choice). A change v of line j's tension by a lost buoyancy element moves the mean by

    G_j   = [ -(dH/dT)_j M^-1 (u_j; arm x u_j) ; e_j ]        per newton, dH/dT between intact and damaged line

which the paper does not print. What it cannot see: thrust that is not logged, quick motion above w, anything in yaw.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mooringdx.config import RunConfig
from mooringdx.errors import ReportError
from mooringdx.physics.frames import rotation, unwrapped
from mooringdx.physics.mooring import Mooring
from mooringdx.physics.rig import fault_tables, mooring_of, period
from mooringdx.physics.vessel import VesselModel, vessel
from mooringdx.types import Array, Channels, Fault, Residuals, Signatures, replace

SURGE, SWAY = "surge acceleration", "sway acceleration"
THRUST = ("thrust_surge", "thrust_sway", "thrust_yaw")


def vector(channels: Channels, measured: Residuals, run: RunConfig) -> Residuals:
    """Return r1, r2 and the tension residuals of ``measured`` on one grid, with the direction of each lost buoyancy.

    Raises ReportError without a vessel file, a place, or a tension residual a line.
    """
    if not run.mooring.model:
        raise ReportError("the accelerations of the paper need a vessel file; name one under [mooring] vessel")
    ship = vessel(run.mooring.model)
    rig = mooring_of(ship)
    names = [pick(measured.names, f"tension_{line.removeprefix('line_')}") for line in rig.names]
    index = [measured.names.index(name) for name in names]
    place, eta = places(channels, run)
    fast = accelerations(channels, eta, ship, rig)
    good = np.isfinite(fast)
    titles = (SURGE, SWAY, *names)
    return replace(
        measured,
        names=titles,
        units=("m/s2", "m/s2", *(measured.units[i] for i in index)),
        values=np.hstack([fast, measured.values[:, index]]),
        valid=np.hstack([good, measured.valid[:, index]]),
        signatures=directions(ship, rig, place, titles),
    )


def pick(names: Sequence[str], wanted: str) -> str:
    """Return the first name that holds ``wanted``; ReportError when there is none."""
    for name in names:
        if wanted in name:
            return name
    raise ReportError(
        f'the run has no residual of {wanted}; it has {", ".join(names)}; put "tension" in [residuals] use'
    )


def places(channels: Channels, run: RunConfig) -> tuple[Array, Array]:
    """Return the middle of the no-fault places, (3,), and all places, (n, 3): m, m, rad, from the neutral place."""
    eta = np.column_stack([channels.column(name) for name in ("north", "east", "heading")])
    eta[:, :2] -= np.asarray(run.mooring.origin, dtype=np.float64)
    eta[:, 2] = unwrapped(eta[:, 2])
    return np.nanmedian(eta, axis=0), eta


def accelerations(channels: Channels, eta: Array, ship: VesselModel, rig: Mooring) -> Array:
    """Return r1 and r2, (n, 2), m/s2; NaN until the filter has forgotten its start, and where a place is missing."""
    dt = channels.grid.sample_time
    cut = 2.0 * 2.0 * np.pi / float(period(ship, rig)[0])
    missing = ~np.isfinite(eta).all(axis=1)
    held = np.column_stack([_bridged(column) for column in eta.T])
    slow, speed, pace = filtered(held, cut, dt)
    force = filtered(_known_force(channels, held, ship, rig), cut, dt)[0]
    inverse = np.linalg.inv(inertia(ship))
    out = np.empty((len(eta), 2))
    for k in range(len(eta)):
        turn = rotation(slow[k, 2]).T
        drag = np.asarray(ship.dynamics.damping) * (turn @ speed[k])
        out[k] = (inverse @ (force[k] - drag) - turn @ pace[k])[:2]
    out[: round(10.0 / (cut * dt))] = np.nan
    out[missing] = np.nan
    return out


def _known_force(channels: Channels, eta: Array, ship: VesselModel, rig: Mooring) -> Array:
    """Return what is known of the force on the vessel, (n, 3), body axes: lines by their statics, thrust, wind."""
    force = np.empty(eta.shape)
    for k in range(len(eta)):
        force[k] = rotation(eta[k, 2]).T @ rig.force(eta[k])
    for i, name in enumerate(THRUST):
        if name in channels.names:
            force[:, i] += _bridged(channels.column(name))
    if {"wind_speed", "wind_direction"} <= set(channels.names):
        speed = _bridged(channels.column("wind_speed"))
        travel = _bridged(unwrapped(channels.column("wind_direction"))) + np.pi - eta[:, 2]
        shape = np.column_stack([np.cos(travel), np.sin(travel), np.sin(2.0 * travel)])
        force += np.array([ship.wind.surge, ship.wind.sway, ship.wind.yaw]) * shape * (speed**2)[:, None]
    return force


def inertia(ship: VesselModel) -> Array:
    """Return the inertia of surge, sway and yaw with added mass, (3, 3), kg, kg m, kg m2."""
    out = np.diag(np.asarray(ship.dynamics.inertia, dtype=np.float64))
    out[1, 2] = out[2, 1] = ship.dynamics.coupling
    return out


def filtered(values: Array, cut: float, dt: float) -> tuple[Array, Array, Array]:
    """Return values, first and second rate of w^2/(s + w)^2 applied to (n, c) values, w = ``cut`` rad/s (bilinear)."""
    from scipy.signal import lfilter

    rate = 2.0 / dt
    below = np.convolve([rate + cut, cut - rate], [rate + cut, cut - rate])
    plus, minus = np.array([1.0, 1.0]), np.array([rate, -rate])
    tops = (np.convolve(plus, plus), np.convolve(minus, plus), np.convolve(minus, minus))
    start = values[0]
    low, first, second = (np.asarray(lfilter(cut**2 * top, below, values - start, axis=0)) for top in tops)
    return low + start, first, second


def directions(ship: VesselModel, rig: Mooring, place: Array, names: Sequence[str]) -> Signatures:
    """Return how the loss of each line's buoyancy element moves r1, r2 and the tension residuals, per newton."""
    horizontal, tension = fault_tables(ship, "buoyancy", [0.0, 1.0])
    there = rig.start + rig.step * np.arange(horizontal.shape[1])
    _, _, towards = rig.pulls(place)
    turn, inverse = rotation(place[2]).T, np.linalg.inv(inertia(ship))
    faults, rows, totals = [], [], []
    for j, line in enumerate(rig.names):
        arm = rotation(place[2])[:2, :2] @ rig.fairleads[j]
        x = float(np.hypot(*(rig.anchors[j] - place[:2] - arm)))
        more_h, more_t = (float(np.interp(x, there, t[1] - t[0])) for t in (horizontal, tension))
        pull = turn @ np.array([*towards[j], arm[0] * towards[j, 1] - arm[1] * towards[j, 0]])
        row = np.zeros(len(names))
        row[:2] = -(more_h / more_t) * (inverse @ pull)[:2]
        row[2 + j] = 1.0
        faults.append(Fault("line_weakened", line, "buoyancy"))
        rows.append(row)
        totals.append(more_t)
    signs = np.sign(totals)
    return Signatures(tuple(faults), tuple(names), np.array(rows), ("N",) * len(rows), np.array(totals), signs)


def _bridged(column: Array) -> Array:
    """Return (n,) with its gaps bridged by straight lines."""
    good = np.isfinite(column)
    at = np.arange(column.size)
    return np.asarray(np.interp(at, at[good], column[good])) if good.any() else np.zeros(column.size)
