"""The true rig: the vessel file with the scenario's departures from it, as numbers for the plant.

A residual generator knows the file alone, so what stands in [rig] is its model error: constant over a record, drawn
once for a seed from streams of its own. Heavier lines keep their anchors. Line faults become levels of a stack of
tables (weakened), a sample from which a line is gone (lost), or a sliding force (parted near the anchor).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mooringdx.physics.mooring import Mooring
from mooringdx.physics.rig import Damage, fault_tables, mooring_of, neutral, sliding
from mooringdx.physics.vessel import VesselModel
from mooringdx.simulate.faults import Failure, grown
from mooringdx.simulate.plant import Hull, Lines, Loop
from mooringdx.simulate.scenario import Scenario
from mooringdx.simulate.streams import Draw
from mooringdx.types import Array

WATER = 1025.0  # kg/m3
STRIPS = 8
PLACE = ("north", "east", "heading")
NEVER = 2**62
SOLVED, LEVELS = 4, 12  # steps of a growing weakening: solved, and filled in between by a cubic spline


@dataclass(frozen=True)
class Rig:
    """What the plant integrates.

    ``levels``: (n, lines) or (1, lines); ``effect``, of the thrusters, and ``misread``, by the controller: (n, 3) or
    (1, 3); ``gain``: (lines,), of the gauges; ``rest``: (3,), where the run starts; ``drawn``: for the truth.
    """

    vessel: VesselModel
    hull: Hull
    lines: Lines
    loop: Loop
    levels: Array
    effect: Array
    misread: Array
    gain: Array
    rest: Array
    substeps: int
    drawn: dict[str, Any]


def draw_rig(scenario: Scenario, draw: Draw, time: Array) -> Rig:
    """Return the rig of a scenario with its faults at ``time``, (n,), s; ``draw`` gives the rig's own streams."""
    vessel, part = scenario.typed(), scenario.rig
    names = vessel.mooring.lines
    system = mooring_of(vessel)
    shift = np.array([[part.anchors * _one(draw, f"rig anchor {x} {a}") for a in ("north", "east")] for x in names])
    gain = 1.0 + part.gain * np.array([_one(draw, f"rig gain {x}") for x in names])
    pull = 1.0 + part.pull * np.array([_even(draw, f"rig pull {x}") for x in names])
    lines, levels = _lines(scenario, vessel, system, system.anchors + shift, pull, time)
    misread, stuck = _misread(scenario, time)
    loop, rest = _loop(scenario, vessel, stuck)
    hull = _hull(scenario, vessel)
    drawn = {"anchors": shift.tolist(), "gain": gain.tolist(), "pull": pull.tolist()}
    return Rig(
        vessel=vessel,
        hull=hull,
        lines=lines,
        loop=loop,
        levels=levels,
        effect=_effect(scenario, time),
        misread=misread,
        gain=gain,
        rest=rest,
        substeps=_substeps(scenario, vessel, system, rest),
        drawn=drawn,
    )


def _one(draw: Draw, name: str) -> float:
    return float(draw(name).standard_normal())


def _even(draw: Draw, name: str) -> float:
    return float(draw(name).uniform(-1.0, 1.0))


def _hull(scenario: Scenario, vessel: VesselModel) -> Hull:
    part, d = scenario.rig, vessel.dynamics
    inertia = np.diag(d.inertia).astype(np.float64)
    inertia[1, 2] = inertia[2, 1] = d.coupling
    length, drag = vessel.hull.length, 0.5 * WATER * d.cross_flow * vessel.hull.draught
    x = length * ((np.arange(STRIPS) + 0.5) / STRIPS - 0.5)
    strips = np.column_stack([x, np.full(STRIPS, drag * length / STRIPS)]) if drag > 0.0 else np.zeros((0, 2))
    return Hull(
        inverse=np.asarray(np.linalg.inv((1.0 + part.inertia) * inertia), dtype=np.float64),
        damping=(1.0 + part.damping) * np.array(d.damping),
        strips=strips,
        drift=np.array([vessel.drift.surge, vessel.drift.sway, vessel.drift.yaw]),
        wind=(1.0 + part.wind) * np.array([vessel.wind.surge, vessel.wind.sway, vessel.wind.yaw]),
    )


def _loop(scenario: Scenario, vessel: VesselModel, stuck: NDArray[np.int64]) -> tuple[Loop, Array]:
    """Return the controller and where the run starts: its set-point, or the neutral place."""
    place = neutral(vessel)[1]
    asked = scenario.control.set_point
    if asked is not None:
        place = np.array([asked[0], asked[1], np.radians(asked[2])])
    zero = np.zeros(3)
    gains, thrust = vessel.control, vessel.thrust
    if scenario.control.kind == "none" or gains is None or thrust is None:
        return Loop(zero, zero, zero, zero, 0.0, place, stuck), place
    derivative = zero if scenario.control.kind == "pi" else np.array(gains.derivative)
    keep = float(np.exp(-scenario.record.sample_time / thrust.lag))
    pid = (np.array(gains.proportional), np.array(gains.integral), derivative)
    return Loop(*pid, np.array(thrust.limit), keep, place, stuck), place


def _effect(scenario: Scenario, time: Array) -> Array:
    """Return what the thrusters give for what is logged: the rig's departure, and what a fault takes."""
    out = np.full((1, 3), 1.0 + scenario.rig.thrust)
    for fault in scenario.faults:
        if fault.kind == "actuator_fault":
            axis = ("thrust_surge", "thrust_sway", "thrust_yaw").index(fault.subject)
            out = np.tile(out, (time.size, 1)) if len(out) == 1 else out
            out[:, axis] *= 1.0 - fault.size * grown(time, fault)
    return out


def _misread(scenario: Scenario, time: Array) -> tuple[Array, NDArray[np.int64]]:
    """Return what faulty positions and headings add to what the controller reads, (n, 3) or (1, 3), m, m, rad, and the
    samples between which each axis is stuck, (3, 2).
    """
    out, stuck = np.zeros((1, 3)), np.full((3, 2), NEVER, dtype=np.int64)
    for fault in scenario.faults:
        if fault.kind != "sensor_fault" or fault.subject not in PLACE:
            continue
        axis = PLACE.index(fault.subject)
        if fault.mode == "stuck":
            until = np.inf if fault.end is None else fault.end
            stuck[axis] = np.searchsorted(time, [fault.onset - 1e-6, until - 1e-6])
        else:
            out = np.tile(out, (time.size, 1)) if len(out) == 1 else out
            out[:, axis] += (np.radians(fault.size) if axis == 2 else fault.size) * grown(time, fault)
    return out, stuck


def _heavier(vessel: VesselModel, share: float) -> VesselModel:
    sections = [s.model_copy(update={"weight": s.weight * (1.0 + share)}) for s in vessel.mooring.sections]
    return vessel.model_copy(update={"mooring": vessel.mooring.model_copy(update={"sections": sections})})


def _lines(
    scenario: Scenario, vessel: VesselModel, system: Mooring, anchors: Array, factor: Array, time: Array
) -> tuple[Lines, Array]:  # fmt: skip
    """Return the lines and, (n, lines) or (1, lines), the level of each in its stack of tables.

    ``factor``: (lines,), on all that a line pulls.
    """
    part, names = scenario.rig, system.names
    heavy = _heavier(vessel, part.weight) if part.weight else vessel
    stacks, grids, slides = [], [], []
    levels = np.zeros((1, len(names)))
    for j, name in enumerate(names):
        own = heavy if not part.lines or name in part.lines else vessel
        faults = [f for f in scenario.faults if f.subject == name]
        intact = mooring_of(own)
        stack = (intact.horizontal[j][None], intact.tension[j][None])
        for fault in faults:
            if fault.kind == "line_weakened":
                stack = _weakened(own, stack, fault)
                levels = np.tile(levels, (time.size, 1)) if len(levels) == 1 else levels
                levels[:, j] = (len(stack[0]) - 1) * grown(time, fault)
        stacks.append((factor[j] * stack[0], factor[j] * stack[1]))
        grids.append((intact.start, intact.step))
        force, distance = _slide(own, intact, j, faults)
        slides.append((factor[j] * force, distance))
    deepest = max(len(h) for h, _ in stacks)
    horizontal, tension = (np.stack([_padded(stack[i], deepest) for stack in stacks]) for i in (0, 1))
    lines = Lines(
        anchors=np.ascontiguousarray(anchors),
        fairleads=np.array(system.fairleads),
        start=np.array([start for start, _ in grids]),
        step=np.array([step for _, step in grids]),
        horizontal=horizontal,
        tension=tension,
        parted=_first(scenario, names, "line_lost", time),
        low=_first(scenario, names, "line_parted_low", time),
        slide=np.array(slides),
        dynamic=np.array(vessel.mooring.dynamic),
        rest=vessel.mooring.parted,
    )
    return lines, levels


def _weakened(vessel: VesselModel, intact: tuple[Array, Array], fault: Failure) -> tuple[Array, Array]:
    """Return the stack of tables from ``intact``, (1, k) each, to the fault's size: two levels, or more if it grows.

    On the model-basin line the spline is within 5e-5 N of the solved shapes at the neutral place, 1e-3 N 0.7 m away.
    """
    from scipy.interpolate import CubicSpline

    kind: Damage = "buoyancy" if fault.mode == "buoyancy" else "stiffness"
    solved = np.linspace(0.0, fault.size, 1 + (SOLVED if fault.ramp > 0.0 else 1))
    damaged = fault_tables(vessel, kind, [float(x) for x in solved[1:]])
    horizontal, tension = (np.concatenate(pair) for pair in zip(intact, damaged, strict=True))
    if fault.ramp == 0.0:
        return horizontal, tension
    fine = np.linspace(0.0, fault.size, LEVELS + 1)
    return np.asarray(CubicSpline(solved, horizontal)(fine)), np.asarray(CubicSpline(solved, tension)(fine))


def _padded(stack: Array, deepest: int) -> Array:
    """Return (deepest, k): the last table again and again, so that lines of few levels share one array."""
    return np.concatenate([stack, np.repeat(stack[-1:], deepest - len(stack), axis=0)])


def _slide(vessel: VesselModel, system: Mooring, j: int, faults: Sequence[Failure]) -> tuple[float, float]:
    """Return the sliding force, N, and the distance, m, at which the intact line pulls so; infinite without a fault."""
    for fault in faults:
        if fault.kind == "line_parted_low":
            force = sliding(vessel, 1.0 - fault.size)
            grid = system.start + system.step * np.arange(system.horizontal.shape[1])
            return force, float(np.interp(force, system.horizontal[j], grid))
    return np.inf, np.inf


def _first(scenario: Scenario, names: Sequence[str], kind: str, time: Array) -> NDArray[np.int64]:
    """Return the first sample at which a fault of ``kind`` holds, (lines,); where there is none, `NEVER`."""
    out = np.full(len(names), NEVER, dtype=np.int64)
    for fault in scenario.faults:
        if fault.kind == kind:
            j = names.index(fault.subject)
            out[j] = min(out[j], int(np.searchsorted(time, fault.onset - 1e-6)))
    return out


def _substeps(scenario: Scenario, vessel: VesselModel, system: Mooring, place: Array) -> int:
    """Return the steps a sample that keep the fastest rate times a step under a half: lines four times as stiff."""
    inertia = np.array(vessel.dynamics.inertia)
    spring = 4.0 * np.abs(np.diag(system.stiffness(place)))
    rate = np.array(vessel.dynamics.damping)
    if vessel.control is not None and scenario.control.kind != "none":
        spring = spring + np.array(vessel.control.proportional)
        rate = rate + np.array(vessel.control.derivative)
    fastest = max(float(np.sqrt(spring / inertia).max()), float((rate / inertia).max()))
    return max(1, int(np.ceil(2.0 * fastest * scenario.record.sample_time)))
