"""From a vessel file to its mooring system: tables of every line, intact and damaged, and what follows from them.

All lines of a vessel have the same sections, so one table over the distance x from fairlead to anchor serves all:

    H(x), T(x) from `mooringdx.physics.line` at knots where H grows by an even share, then a cubic spline onto a
    uniform grid from slack to 20 times the tension at the neutral place                               [Hall2021]
    natural period of an axis held alone: 2 pi sqrt(M_ii / K_ii)                                       [Fossen2011]

Not seen: dynamics of the lines, and lines of one vessel that differ in their sections.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import Literal

import numpy as np

from mooringdx.errors import ConfigError
from mooringdx.physics.frames import rotation
from mooringdx.physics.line import deprived, follow, solve, tabulate
from mooringdx.physics.mooring import Mooring
from mooringdx.physics.vessel import MooringModel, VesselModel
from mooringdx.types import Array, locked

Damage = Literal["buoyancy", "stiffness"]

CELLS = 1000  # of the uniform grid
TAUT = 20.0  # the grid ends where the tension is this many times that of the neutral place


def neutral(vessel: VesselModel) -> tuple[Array, Array]:
    """Return each line's distance at the neutral place, (n,), m, and that place of the centre of gravity, (3,).

    The place is north, east, m, and heading, rad, in the axes of the anchors.
    """
    anchors, fairleads, eta = _layout(vessel.mooring)
    arms = fairleads @ rotation(eta[2])[:2, :2].T
    return np.asarray(np.hypot(*(anchors - eta[:2] - arms).T)), eta


def mooring_of(vessel: VesselModel, points: int = 90) -> Mooring:
    """Return the intact mooring system of ``vessel``; about ``points`` shapes of the line are solved for its tables.

    The tables run from all but slack to 20 times the tension at the neutral place. Raise FitError when the line is too
    short for its anchors.
    """
    return _mooring(vessel.model_dump_json(), points)


def fault_tables(vessel: VesselModel, kind: Damage, levels: Sequence[float], points: int = 90) -> tuple[Array, Array]:
    """Return horizontal and fairlead tension, (levels, k) N each, of a line that has lost a share of what it has.

    ``kind``: "buoyancy" (share of the buoy's force: 1 neutral, more is taking water, at most full of it) or "stiffness"
    (share of EA, below 1). The distances are those of the tables of `mooring_of`. Raise ConfigError on another kind.
    """
    if kind not in ("buoyancy", "stiffness"):
        raise ConfigError(f"a line cannot lose '{kind}'; give buoyancy or stiffness")
    rows = [_damaged(vessel.model_dump_json(), points, kind, float(level)) for level in levels]
    return np.array([h for h, _ in rows]), np.array([t for _, t in rows])


def sliding(vessel: VesselModel, share: float) -> float:
    """Return the horizontal force, N, at which what remains of a line parted near its anchor slides over the seabed.

    It is the horizontal tension where the fairlead tension is ``share`` (up to 1) of that at the neutral place. With w
    the weight per metre of the lowest section and b the length still on the seabed in that shape, less what the break
    took, it stands for a friction coefficient of force / (w b). Raise ConfigError when ``share`` is less than hangs.
    """
    system = mooring_of(vessel)
    distances, _ = neutral(vessel)
    grid = system.start + system.step * np.arange(system.tension.shape[1])
    tension, horizontal = system.tension[0], system.horizontal[0]
    there = float(np.mean(np.interp(distances, grid, tension)))
    least = float(tension[0]) / there
    if not least <= share <= 1.0:
        raise ConfigError(
            f"a sliding line cannot keep {share:g} of its tension; what hangs from the fairlead already pulls "
            f"{least:.3f} of it: give a share from {least:.3f} to 1"
        )
    return float(np.interp(share * there, tension, horizontal))


def period(vessel: VesselModel, mooring: Mooring) -> Array:
    """Return the undamped natural periods of surge, sway and yaw at the neutral place, (3,), s, each axis held alone.

    Infinite where the lines do not hold an axis (yaw about a turret in the middle).
    """
    _, eta = neutral(vessel)
    width = np.array([5.0, 5.0, 0.0]) * mooring.step
    width[2] = min(0.02, width[0] / max(float(np.max(np.abs(mooring.fairleads))), 1e-9))
    stiffness = np.zeros(3)
    turn = rotation(eta[2])
    for i in range(3):
        delta = turn[:, i] * width[i]
        stiffness[i] = (turn.T @ (mooring.force(eta - delta) - mooring.force(eta + delta)))[i] / (2.0 * width[i])
    inertia = np.array(vessel.dynamics.inertia)
    noise = 1e-9 * stiffness[0] * vessel.hull.length**2
    held = stiffness > np.array([0.0, 0.0, noise])
    return np.where(held, 2.0 * np.pi * np.sqrt(inertia / np.where(held, stiffness, 1.0)), np.inf)


def _layout(model: MooringModel) -> tuple[Array, Array, Array]:
    """Return anchors and fairleads, (n, 2) each, and the neutral place of the centre of gravity, (3,)."""
    heading = np.radians(model.heading)
    if model.turret is not None:
        fairleads = np.tile([model.turret, 0.0], (len(model.lines), 1))
        eta = np.array([-model.turret * np.cos(heading), -model.turret * np.sin(heading), heading])
    else:
        fairleads = np.array([model.fairleads[line] for line in model.lines])
        eta = np.array([0.0, 0.0, heading])
    if model.anchors:
        return np.array([model.anchors[line] for line in model.lines]), fairleads, eta
    azimuth = np.radians([model.azimuth[line] for line in model.lines])
    ends = eta[:2] + fairleads @ rotation(heading)[:2, :2].T
    radius = model.radius or 0.0
    return ends + radius * np.column_stack([np.cos(azimuth), np.sin(azimuth)]), fairleads, eta


@lru_cache(maxsize=8)
def _mooring(body: str, points: int) -> Mooring:
    vessel = VesselModel.model_validate_json(body)
    anchors, fairleads, _ = _layout(vessel.mooring)
    knots, horizontal, tension = _knots(body, points)
    grid = np.linspace(knots[0], knots[-1], CELLS + 1)
    n = len(anchors)
    return Mooring(
        names=vessel.mooring.lines,
        anchors=anchors,
        fairleads=fairleads,
        start=float(grid[0]),
        step=float(grid[1] - grid[0]),
        horizontal=np.tile(_spline(knots, horizontal, grid), (n, 1)),
        tension=np.tile(_spline(knots, tension, grid), (n, 1)),
    )


@lru_cache(maxsize=8)
def _knots(body: str, points: int) -> tuple[Array, Array, Array]:
    """Return distances, (m,), m, where H grows by an even share, and both tensions there, (m,), N."""
    vessel = VesselModel.model_validate_json(body)
    m = vessel.mooring
    distances, _ = neutral(vessel)
    near, far = float(distances.min()), float(distances.max())
    least = sum(s.length for s in m.sections) - m.depth
    floor = least + 0.02 * (near - least) if 0.0 < least < near else 0.5 * near
    here = solve(m.sections, m.depth, far, m.friction)
    rows = []
    for sign in (1.0, -1.0):
        known, step = [(far, here)], sign * 1e-3 * (far - floor)
        while (known[-1][1].tension < TAUT * here.tension) if sign > 0 else (known[-1][0] > floor):
            x = max(known[-1][0] + step, floor)
            shape = follow(m.sections, m.depth, x, m.friction, known)
            rows.append((x, shape.horizontal, shape.tension))
            slope = max((shape.horizontal - known[-1][1].horizontal) / (x - known[-1][0]), 1e-300)
            known = [known[-1], (x, shape)]
            step = sign * min(9.0 / points * shape.horizontal / slope, (far - floor) / 20.0)
    rows.append((far, here.horizontal, here.tension))
    out = np.array(sorted(rows))
    return locked(out[:, 0]), locked(out[:, 1]), locked(out[:, 2])


@lru_cache(maxsize=256)
def _damaged(body: str, points: int, kind: Damage, level: float) -> tuple[Array, Array]:
    m = VesselModel.model_validate_json(body).mooring
    distances, _ = neutral(VesselModel.model_validate_json(body))
    knots, _, _ = _knots(body, points)
    sections = deprived(m.sections, **{kind: level})
    horizontal, tension = tabulate(sections, m.depth, knots, m.friction, middle=float(distances.max()))
    grid = np.linspace(knots[0], knots[-1], CELLS + 1)
    return locked(_spline(knots, horizontal, grid)), locked(_spline(knots, tension, grid))


def _spline(knots: Array, values: Array, grid: Array) -> Array:
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(knots, values)(grid), dtype=np.float64)
