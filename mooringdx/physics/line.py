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

import numpy as np

from mooringdx.errors import ConfigError, FitError
from mooringdx.physics.catenary import SHARP, Ends, catenary
from mooringdx.physics.vessel import Section
from mooringdx.types import Array, Mask, locked, replace

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


def solve(
    sections: Sequence[Section], depth: float, distance: float, friction: float = 0.0, start: Shape | None = None
) -> Shape:
    """Return the line at rest with its fairlead ``distance`` (horizontally) and ``depth`` (above) from the anchor, m.

    ``friction``: coefficient of the seabed under the lowest section. ``start`` continues from a neighbouring distance.
    Raise FitError when the line is too short to reach or no equilibrium is found.
    """
    _check(sections, depth, distance)
    try:
        joints = _first_joints(sections, depth, distance) if start is None else start.joints
        return _settled(sections, joints, (depth, distance, friction))
    except FitError:
        return _from_taut(sections, (depth, distance, friction))


def tabulate(
    sections: Sequence[Section], depth: float, distances: Array, friction: float = 0.0, middle: float | None = None
) -> tuple[Array, Array]:
    """Return horizontal and fairlead tension, (m,) N each, at rising ``distances``, (m,) m, from ``middle`` outwards.

    Inwards, where the line is slack and no shape is found, the tables are level; outwards FitError says why not.
    """
    distances = np.asarray(distances, dtype=np.float64)
    first = int(np.argmin(np.abs(distances - (np.median(distances) if middle is None else middle))))
    start = solve(sections, depth, float(distances[first]), friction)
    out = np.zeros((2, distances.size))
    out[:, first] = start.horizontal, start.tension
    for way in (range(first + 1, distances.size), range(first - 1, -1, -1)):
        known = [(float(distances[first]), start)]
        for i in way:
            try:
                shape = follow(sections, depth, float(distances[i]), friction, known)
            except FitError:
                if i > first:
                    raise
                out[:, : i + 1] = out[:, i + 1 : i + 2]
                break
            known = [known[-1], (float(distances[i]), shape)]
            out[:, i] = shape.horizontal, shape.tension
    return out[0], out[1]


def follow(
    sections: Sequence[Section], depth: float, distance: float, friction: float, known: Sequence[tuple[float, Shape]]
) -> Shape:
    """Return `solve` with the joints carried on from the last one or two ``known`` distances and shapes."""
    start = known[-1][1]
    if len(known) > 1:
        (x0, older), (x1, last) = known[-2:]
        start = replace(last, joints=last.joints + (last.joints - older.joints) * (distance - x1) / (x1 - x0))
    return solve(sections, depth, distance, friction, start)


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


def _settled(sections: Sequence[Section], joints: Array, place: tuple[float, float, float]) -> Shape:
    """Return the equilibrium that Newton's method finds from ``joints``; FitError without."""
    state = _balance(sections, _inside(joints, place[1]), place)
    scale, blur = sum(s.weight * s.length for s in sections), 0.3 * SHARP * sum(s.length for s in sections)
    for _ in range(ROUNDS):
        near = max(1e-9 * scale, blur * max(float(np.max(e.stiff_upper.diagonal())) for e in state.ends))
        after = None if state.left <= near else _search(sections, state, place)
        if after is None:
            break
        state = after
    if not state.left <= 1e-5 * scale or any(e.rough for e in state.ends):
        raise FitError(
            f"no equilibrium of the line at {place[1]:g} m from its anchor (depth {place[0]:g} m): {state.left:.2g} N "
            "out of balance at a joint; check the sections' lengths, weights and buoys, or ask a smaller distance"
        )
    return _shape(state)


def _from_taut(sections: Sequence[Section], place: tuple[float, float, float]) -> Shape:
    """Return the equilibrium by paying out from a straight line, whose joints are known, to the distance asked for."""
    depth, distance, friction = place
    length = sum(s.length for s in sections)
    taut = float(np.sqrt(max(length**2 - depth**2, 0.0)))
    shares = np.cumsum([s.length for s in sections])[:-1, None] / length
    joints = older = shares * np.array([taut, depth])
    if distance >= taut or len(sections) == 1:
        return _settled(sections, shares * np.array([distance, depth]), place)
    x, step = taut, (taut - distance) / 16.0
    shape = _settled(sections, joints, (depth, taut, friction))
    while x > distance:
        to = max(x - step, distance)
        try:
            shape = _settled(sections, 2.0 * joints - older, (depth, to, friction))
        except FitError:
            older, step = joints, step / 2.0
            if step < 1e-4 * (taut - distance):
                raise
            continue
        x, older, joints = to, joints, shape.joints
    return shape


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


@dataclass(frozen=True)
class _State:
    """A guess: the sections' ends, the joints (n - 1, 2), m, and the force left over there, N, zero where held."""

    joints: Array
    ends: list[Ends]
    residual: Array
    held: Mask

    @property
    def left(self) -> float:
        return float(np.linalg.norm(self.residual))


def _balance(
    sections: Sequence[Section], joints: Array, place: tuple[float, float, float], near: _State | None = None
) -> _State:
    """Return the forces left over at ``joints`` for a ``place``: depth, distance, friction; ``near``: one like it."""
    depth, distance, friction = place
    points = np.vstack([np.zeros((1, 2)), joints, [[distance, depth]]])
    ends = []
    for i, s in enumerate(sections):
        x, z = points[i + 1] - points[i]
        guess = -near.ends[i].upper if near and z > 0.0 else np.zeros(2)  # MoorPy turns a falling section round
        ends.append(catenary((x, z), s.length, s.weight, s.stiffness, friction if i == 0 else -points[i, 1], guess))
    residual = np.zeros((len(joints), 2))
    for i in range(len(joints)):
        residual[i] = ends[i].upper + ends[i + 1].lower + np.array([0.0, sections[i].buoy])
    held = np.zeros(residual.shape, dtype=bool)
    held[:, 1] = (joints[:, 1] <= 0.0) & (residual[:, 1] <= 0.0)
    residual[held] = 0.0
    return _State(joints, ends, residual, held)


def _newton(state: _State) -> Array:
    """Return the step of the joints, (n - 1, 2), m, that the stiffness matrices ask for."""
    n = len(state.joints)
    k = np.zeros((2 * n, 2 * n))
    for i in range(n):
        here = slice(2 * i, 2 * i + 2)
        k[here, here] = state.ends[i].stiff_upper + state.ends[i + 1].stiff_lower
        if i + 1 < n:
            above = slice(2 * i + 2, 2 * i + 4)
            k[above, here] = state.ends[i + 1].stiff_cross
            k[here, above] = state.ends[i + 1].stiff_cross.T
    held = state.held.ravel()
    k[held, :] = 0.0
    k[:, held] = 0.0
    k[held, held] = 1.0
    k += max(1e-9 * float(np.max(np.diag(k))), 1e-300) * np.eye(2 * n)
    return np.asarray(np.linalg.solve(k, state.residual.ravel()).reshape(n, 2))


def _search(sections: Sequence[Section], state: _State, place: tuple[float, float, float]) -> _State | None:
    """Return the state after the longest halved Newton step that brings the forces nearer to balance, None without."""
    step = _newton(state)
    step = step * min(1.0, 0.2 * place[1] / max(float(np.max(np.abs(step))), 1e-300))
    while np.max(np.abs(step)) > 0.1 * SHARP * place[1]:
        try:
            trial = _balance(sections, _inside(state.joints + step, place[1]), place, state)
        except FitError:
            trial = state
        if trial.left < state.left:
            return trial
        step = step / 2.0
    return None


def _shape(state: _State) -> Shape:
    top, low = -state.ends[-1].upper, state.ends[0].lower
    return Shape(
        horizontal=float(top[0]),
        vertical=float(top[1]),
        tension=float(np.hypot(*top)),
        anchor_horizontal=float(low[0]),
        anchor_vertical=float(low[1]),
        anchor_tension=float(np.hypot(*low)),
        bottom=float(sum(e.bottom for e in state.ends)),
        joints=state.joints,
    )
