"""Statics of one line of several sections with buoyancy elements between them: anchor on the seabed, fairlead above.

Each section is an elastic catenary, with or without seabed contact [Hall2021]. For joint i between sections i and i+1,
counted from the anchor, with force f of a section on its end and net upward force b of the buoyancy element there:

    f_i,upper end + f_(i+1),lower end + (0, b_i) = 0,    z_i >= 0 (a joint that would sink lies on the seabed)

solved by Newton's method on the joints' places (x_i, z_i) with the stiffness matrices of the catenaries. A line that
has lost the share s of a buoy's force carries b (1 - s), down to what the element weighs once full of water.

Not seen: bending, drag and inertia of the line, snap loads, a sloping seabed, friction of any but the lowest section.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mooringdx.errors import ConfigError, FitError
from mooringdx.physics.vessel import Section
from mooringdx.types import Array, locked

STRETCH = 1.25  # a line asked to stretch more than this is not a line any longer
ROUNDS = 60


@dataclass(frozen=True)
class Shape:
    """A line at rest. Tensions in N; ``horizontal``, ``vertical``, ``tension`` at the fairlead, ``anchor_...`` at the
    anchor; ``bottom``: length on the seabed, m; ``joints``: (n - 1, 2), m, x and z of the sections' joints from the
    anchor.
    """

    horizontal: float
    vertical: float
    tension: float
    anchor_horizontal: float
    anchor_vertical: float
    anchor_tension: float
    bottom: float
    joints: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "joints", locked(self.joints))


@dataclass(frozen=True)
class Ends:
    """One section's ends: (2,) forces of the section on its lower and upper end, N; (2, 2) stiffness matrices, N/m."""

    lower: Array
    upper: Array
    stiff_lower: Array
    stiff_upper: Array
    stiff_cross: Array
    bottom: float


def catenary(
    span: tuple[float, float], length: float, weight: float, stiffness: float, seabed: float = 0.0, guess: Any = (0, 0)
) -> Ends:
    """Return the elastic catenary over ``span`` (x, z from lower to upper end, m) by MoorPy.

    ``seabed``: friction coefficient with the lower end on the seabed, or, negative, minus its height above it, m.
    ``guess``: horizontal and vertical tension to start from, N. Raise FitError where MoorPy finds no shape.
    """
    from moorpy.Catenary import catenary as moorpy_catenary
    from moorpy.helpers import CatenaryError

    x, z = float(span[0]), float(span[1])
    try:
        ax, az, bx, bz, info = moorpy_catenary(
            x, z, length, stiffness, weight, CB=seabed, HF0=guess[0], VF0=guess[1], Tol=1e-9 * length, MaxIter=100
        )
    except (CatenaryError, ValueError, ZeroDivisionError, FloatingPointError) as error:
        raise FitError(f"no catenary of {length:g} m over {x:g} by {z:g} m: {error}") from None
    stiff = [np.array(info[key]) for key in ("stiffnessA", "stiffnessB", "stiffnessBA")]
    return Ends(np.array([ax, az]), np.array([bx, bz]), *stiff, float(info["LBot"]))


def solve(
    sections: Sequence[Section], depth: float, distance: float, friction: float = 0.0, start: Shape | None = None
) -> Shape:
    """Return the line at rest with its fairlead ``distance`` (horizontally) and ``depth`` (above) from the anchor, m.

    ``friction``: coefficient of the seabed under the lowest section. ``start`` continues from a neighbouring distance.
    Raise FitError when the line is too short to reach or no equilibrium is found.
    """
    _check(sections, depth, distance)
    free = len(sections) - 1
    joints = _first_joints(sections, depth, distance) if start is None else np.array(start.joints)
    joints = _inside(joints, distance)
    ends, residual, held = _balance(sections, joints, depth, distance, friction)
    scale = sum(s.weight * s.length for s in sections)
    for _ in range(ROUNDS):
        if free == 0 or np.max(np.abs(residual)) < 1e-9 * scale:
            return _shape(ends, joints)
        step = _newton(ends, residual, held)
        joints, ends, residual, held, moved = _search(
            sections, joints, step, residual, (depth, distance, friction), ends, held
        )
        if moved < 1e-11 * sum(s.length for s in sections):
            break
    if np.max(np.abs(residual)) < 1e-5 * scale:
        return _shape(ends, joints)
    raise FitError(
        f"no equilibrium of the line at {distance:g} m from its anchor (depth {depth:g} m): "
        f"{np.max(np.abs(residual)):.2g} N out of balance at a joint; check the sections' lengths, weights and buoys"
    )


def tabulate(
    sections: Sequence[Section], depth: float, distances: Array, friction: float = 0.0, middle: float | None = None
) -> tuple[Array, Array]:
    """Return horizontal and fairlead tension, (m,) N each, at rising ``distances``, (m,) m, from ``middle`` outwards.

    Inwards, where the line is slack and no shape is found, the tables are level; outwards FitError says why not.
    """
    distances = np.asarray(distances, dtype=np.float64)
    first = int(np.argmin(np.abs(distances - (np.median(distances) if middle is None else middle))))
    out = np.zeros((2, distances.size))
    shape = here = solve(sections, depth, float(distances[first]), friction)
    out[:, first] = shape.horizontal, shape.tension
    for i in range(first + 1, distances.size):
        shape = _continued(sections, depth, float(distances[i]), friction, shape)
        out[:, i] = shape.horizontal, shape.tension
    shape = here
    for i in range(first - 1, -1, -1):
        try:
            shape = _continued(sections, depth, float(distances[i]), friction, shape)
        except FitError:
            out[:, : i + 1] = out[:, i + 1 : i + 2]
            break
        out[:, i] = shape.horizontal, shape.tension
    return out[0], out[1]


def deprived(sections: Sequence[Section], buoyancy: float = 0.0, stiffness: float = 0.0) -> tuple[Section, ...]:
    """Return the sections of a damaged line.

    ``buoyancy``: share lost of every buoy's force: 1 leaves it neutral, ``1 - filled / buoy`` is full of water, and no
    more can be lost. ``stiffness``: share of EA lost, in [0, 1).
    """
    if buoyancy < 0.0 or not 0.0 <= stiffness < 1.0:
        raise ConfigError(
            f"a line cannot lose the shares {buoyancy:g} of its buoyancy and {stiffness:g} of its stiffness; give "
            "buoyancy 0 or more (1: neutral) and stiffness from 0 to below 1"
        )
    return tuple(
        s.model_copy(
            update={
                "buoy": max(s.buoy * (1.0 - buoyancy), min(s.filled, s.buoy)),
                "stiffness": s.stiffness * (1.0 - stiffness),
            }
        )
        for s in sections
    )


def _check(sections: Sequence[Section], depth: float, distance: float) -> None:
    length = sum(s.length for s in sections)
    if distance <= 0.0 or depth <= 0.0:
        raise FitError(f"a line needs a distance and a depth above 0 m; got {distance:g} m and {depth:g} m")
    if np.hypot(distance, depth) > STRETCH * length:
        raise FitError(
            f"the line of {length:g} m is too short to reach a fairlead {distance:g} m off and {depth:g} m up: it "
            f"would stretch by more than {100 * (STRETCH - 1):.0f} %; give a longer line or a smaller distance"
        )


def _continued(sections: Sequence[Section], depth: float, distance: float, friction: float, start: Shape) -> Shape:
    try:
        return solve(sections, depth, distance, friction, start)
    except FitError:
        return solve(sections, depth, distance, friction)


def _first_joints(sections: Sequence[Section], depth: float, distance: float) -> Array:
    """Return where the joints are on one catenary of the mean weight, (n - 1, 2), m."""
    length = sum(s.length for s in sections)
    if len(sections) == 1:
        return np.zeros((0, 2))
    net = sum(s.weight * s.length - s.buoy for s in sections)
    weight = max(net, 0.2 * sum(s.weight * s.length for s in sections)) / length
    ends = catenary((distance, depth), length, weight, min(s.stiffness for s in sections))
    h, v = max(-ends.upper[0], 1e-6 * weight * length), -ends.upper[1]
    above = np.cumsum([s.length for s in sections][:0:-1])[::-1]  # length from each joint to the fairlead
    low = np.maximum(v - weight * above, min(v - weight * length, 0.0) if ends.bottom == 0.0 else 0.0)
    x = distance - h / weight * (np.arcsinh(v / h) - np.arcsinh(low / h))
    z = depth - h / weight * (np.hypot(1.0, v / h) - np.hypot(1.0, low / h))
    x -= np.maximum(above - v / weight, 0.0) if ends.bottom > 0.0 else 0.0
    return np.column_stack([x, z])


def _inside(joints: Array, distance: float) -> Array:
    """Return joints above the seabed and in order between anchor and fairlead."""
    n = len(joints)
    out: Array = np.array(joints)
    gap = 1e-4 * distance
    for i in range(n):
        low = (out[i - 1, 0] if i else 0.0) + gap
        out[i, 0] = np.clip(out[i, 0], low, distance - gap * (n - i))
    out[:, 1] = np.where(out[:, 1] < 2e-5 * distance, 0.0, out[:, 1])
    return out


def _balance(
    sections: Sequence[Section], joints: Array, depth: float, distance: float, friction: float
) -> tuple[list[Ends], Array, Array]:
    """Return the sections' ends, the force left over at each joint (n - 1, 2), N, and which coordinates are held."""
    places = np.vstack([np.zeros((1, 2)), joints, [[distance, depth]]])
    ends = []
    for i, s in enumerate(sections):
        seabed = friction if i == 0 else -places[i, 1]
        span = (places[i + 1, 0] - places[i, 0], places[i + 1, 1] - places[i, 1])
        ends.append(catenary(span, s.length, s.weight, s.stiffness, seabed))
    residual = np.array([ends[i].upper + ends[i + 1].lower + [0.0, sections[i].buoy] for i in range(len(joints))])
    residual = residual.reshape(-1, 2)
    held = np.zeros(residual.shape, dtype=bool)
    held[:, 1] = (joints[:, 1] <= 0.0) & (residual[:, 1] < 0.0)
    residual[held] = 0.0
    return ends, residual, held


def _newton(ends: list[Ends], residual: Array, held: Array) -> Array:
    """Return the step of the joints, (n - 1, 2), m, that the stiffness matrices ask for."""
    n = len(residual)
    k = np.zeros((2 * n, 2 * n))
    for i in range(n):
        a = slice(2 * i, 2 * i + 2)
        k[a, a] = ends[i].stiff_upper + ends[i + 1].stiff_lower
        if i + 1 < n:
            b = slice(2 * i + 2, 2 * i + 4)
            k[b, a] = ends[i + 1].stiff_cross
            k[a, b] = ends[i + 1].stiff_cross.T
    flat = held.ravel()
    k[flat, :] = 0.0
    k[:, flat] = 0.0
    k[flat, flat] = 1.0
    k += 1e-9 * np.max(np.diag(k)) * np.eye(2 * n)
    return np.asarray(np.linalg.solve(k, residual.ravel()).reshape(n, 2))


def _search(
    sections: Sequence[Section],
    joints: Array,
    step: Array,
    residual: Array,
    place: tuple[float, float, float],
    ends: list[Ends],
    held: Array,
) -> tuple[Array, list[Ends], Array, Array, float]:
    """Return the joints after the longest halved ``step`` that brings the forces nearer to balance."""
    before = float(np.linalg.norm(residual))
    limit = 0.2 * place[1]
    step = step * min(1.0, limit / max(float(np.max(np.abs(step))), 1e-300))
    for _ in range(30):
        trial = _inside(joints + step, place[1])
        try:
            found = _balance(sections, trial, *place)
        except FitError:
            step = step / 2.0
            continue
        if np.linalg.norm(found[1]) < before:
            return trial, *found, float(np.max(np.abs(trial - joints)))
        step = step / 2.0
    return joints, ends, residual, held, 0.0


def _shape(ends: list[Ends], joints: Array) -> Shape:
    top, low = -ends[-1].upper, ends[0].lower
    return Shape(
        horizontal=float(top[0]),
        vertical=float(top[1]),
        tension=float(np.hypot(*top)),
        anchor_horizontal=float(low[0]),
        anchor_vertical=float(low[1]),
        anchor_tension=float(np.hypot(*low)),
        bottom=float(sum(e.bottom for e in ends)),
        joints=joints,
    )
