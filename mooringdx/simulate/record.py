"""From a scenario and a seed to a log and its truth.

Every random process draws from a stream of its own, keyed by its name: two axes fed by one stream once made a
published study's results unusable, and a stream that depends on its place in a list changes when the list grows.
"""

from __future__ import annotations

import zlib
from pathlib import Path
from typing import Any

import numpy as np

from mooringdx.registry import resolve
from mooringdx.simulate.rig import drift_about, tensions
from mooringdx.simulate.scenario import Scenario
from mooringdx.simulate.sea import wander, waves
from mooringdx.types import Array, LogSource, RawLog, Signal


def stream(seed: int, name: str) -> np.random.Generator:
    """Return the random stream of ``name``: independent of every other name, the same for the same seed."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(zlib.crc32(name.encode()),)))


def simulate(scenario: Scenario, seed: int) -> tuple[RawLog, dict[str, Any]]:
    """Return the log of a moored vessel with the scenario's faults, and the truth about it.

    The log has ``north``, ``east`` (m), ``heading`` (deg) and ``tension_<i>`` (N). The truth has the keys of
    docs/interface.md (truth.json). Line forces that move the vessel follow its slow motion; the logged tensions
    follow the whole motion.
    """
    time, motion, holds = _motion(scenario, seed)
    keep = time >= -0.5 * scenario.record.sample_time
    rig = _rig(scenario)
    pulls = tensions(motion, scenario.record.sample_time, holds, scenario.mooring.parted_tension, *rig[:4])
    signals = _logged(scenario, seed, time[keep], motion[keep], pulls[keep])
    name = f"simulated, seed {seed}"
    return RawLog(signals, LogSource(path=name, format="simulated", bytes=0, sha256="")), _truth(scenario, seed)


def _rig(scenario: Scenario) -> tuple[Array, Array, float, Array, float]:
    mooring, heading = scenario.mooring, np.radians(scenario.vessel.heading)
    fairleads = np.array([line.fairlead for line in mooring.lines])
    azimuths = np.radians([line.azimuth for line in mooring.lines])
    turn = np.array([[np.cos(heading), np.sin(heading)], [-np.sin(heading), np.cos(heading)]])
    anchors = fairleads @ turn + mooring.anchor_distance * np.column_stack([np.cos(azimuths), np.sin(azimuths)])
    spring = np.array([mooring.pretension, mooring.stiffness, *mooring.dynamic])
    return fairleads, anchors, mooring.anchor_distance, spring, mooring.horizontal_share


def _motion(scenario: Scenario, seed: int) -> tuple[Array, Array, Array]:
    """Return time (n,), s, from before zero; the whole motion (n, 3); which lines hold (n, lines)."""
    record, vessel = scenario.record, scenario.vessel
    dt, heading = record.sample_time, np.radians(vessel.heading)
    before = round(record.settle / dt)
    time: Array = dt * np.arange(-before, round(record.duration / dt), dtype=np.float64)
    holds = np.ones((time.size, len(scenario.mooring.lines)))
    for fault in scenario.faults:
        if fault.kind == "line_lost":
            holds[time >= fault.onset - 0.5 * dt, int(fault.subject.removeprefix("line_")) - 1] = 0.0
    loads, currents, fast = _weather(scenario, seed, time.size)
    mass, damping = np.array(vessel.mass), np.array(vessel.damping)
    slow = drift_about(loads, currents, holds, dt, heading, mass, damping, *_rig(scenario))
    c, s = np.cos(slow[:, 2]), np.sin(slow[:, 2])
    turned = np.column_stack([c * fast[:, 0] - s * fast[:, 1], s * fast[:, 0] + c * fast[:, 1], fast[:, 2]])
    return time, slow + turned, holds


def _weather(scenario: Scenario, seed: int, n: int) -> tuple[Array, Array, Array]:
    """Return loads (n, 3), earth axes; current (n, 2); wave-frequency motion (n, 3), body axes at the rest heading."""
    dt, heading = scenario.record.sample_time, np.radians(scenario.vessel.heading)
    sea, wind, current = scenario.sea, scenario.wind, scenario.current
    travel = np.radians(sea.direction) + np.pi
    spectrum = (sea.height, sea.peak_period, sea.peakedness)
    hull = (scenario.vessel.length, scenario.vessel.draught)
    fast, envelope = waves(stream(seed, "waves"), n, dt, spectrum, travel - heading, np.radians(sea.spread), hull)
    push = sea.drift_force * envelope
    speed = wind.speed + wander(stream(seed, "wind"), n, dt, wind.gust * wind.speed, wind.memory)
    blow = np.radians(wind.direction) + np.pi - heading
    ahead, aside = (area * speed**2 * part for area, part in zip(wind.drag, (np.cos(blow), np.sin(blow)), strict=True))
    c, s = np.cos(heading), np.sin(heading)
    north = push * np.cos(travel) + c * ahead - s * aside
    east = push * np.sin(travel) + s * ahead + c * aside
    set_speed = current.speed + wander(stream(seed, "current"), n, dt, current.sd, current.memory)
    towards = np.radians(current.direction)
    currents = np.column_stack([set_speed * np.cos(towards), set_speed * np.sin(towards)])
    return np.column_stack([north, east, np.zeros(n)]), currents, fast


def _logged(scenario: Scenario, seed: int, time: Array, motion: Array, pulls: Array) -> dict[str, Signal]:
    sensors = scenario.sensors
    rows = [("north", motion[:, 0], sensors.position, "m", 0), ("east", motion[:, 1], sensors.position, "m", 0)]
    rows.append(("heading", np.degrees(motion[:, 2]), sensors.heading, "deg", 1))
    rows += [(f"tension_{i + 1}", pull, sensors.tension, "N", 2) for i, pull in enumerate(pulls.T)]
    dead = {fault.subject: fault.onset for fault in scenario.faults if fault.kind == "sensor_fault"}
    clock = np.round(time, 6)
    out = {}
    for name, true, sd, unit, kind in rows:
        seen = np.where(clock >= dead.get(name, np.inf), 0.0, true)
        values = np.round(seen + sd * stream(seed, f"noise {name}").standard_normal(seen.size), sensors.decimals[kind])
        out[name] = Signal(name, clock, values + 0.0, unit)
    return out


def _truth(scenario: Scenario, seed: int) -> dict[str, Any]:
    sea, current, wind = scenario.sea, scenario.current, scenario.wind
    end = scenario.record.duration
    return {
        "healthy_until": min([fault.onset for fault in scenario.faults], default=end),
        "faults": [
            {
                "kind": f.kind,
                "subject": f.subject,
                "mode": f.mode,
                "onset": f.onset,
                "end": None,
                "ramp": 0.0,
                "size": 1.0,
            }
            for f in scenario.faults
        ],
        "traps": [],
        "conditions": {
            "wave_height": sea.height,
            "wave_period": sea.peak_period,
            "wave_direction": sea.direction,
            "current_speed": current.speed,
            "current_direction": current.direction,
            "wind_speed": wind.speed,
            "wind_direction": wind.direction,
        },
        "seed": seed,
        "scenario": scenario.model_dump(mode="json"),
    }


def save_log(log: RawLog, path: Path) -> None:
    """Write ``log`` in the format that the ending of ``path`` names; raises ConfigError for an unknown one."""
    from mooringdx.logs import WRITERS

    resolve(path.suffix.removeprefix("."), WRITERS, "log format")(log, path)
