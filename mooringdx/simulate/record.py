"""From a scenario and a seed to a log and its truth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from mooringdx.registry import resolve
from mooringdx.simulate.plant import run, tensions
from mooringdx.simulate.rig import Rig, draw_rig
from mooringdx.simulate.scenario import Scenario
from mooringdx.simulate.sea import VERTICAL, elevation, first_order
from mooringdx.simulate.sensors import logged
from mooringdx.simulate.streams import Draw, stream, streams, wander
from mooringdx.simulate.weather import Weather, draw_weather
from mooringdx.types import Array, LogSource, RawLog

__all__ = ["save_log", "simulate", "stream"]

AXES = ("thrust_surge", "thrust_sway", "thrust_yaw")


def simulate(scenario: Scenario, seed: int, weather: int | None = None) -> tuple[RawLog, dict[str, Any]]:
    """Return the log of a moored vessel with the scenario's faults, and the truth about it.

    The log has ``north``, ``east`` (m, centre of gravity, from the mooring's origin), ``heading`` (deg),
    ``tension_<i>`` (N), where there are thrusters ``thrust_surge``, ``thrust_sway`` (N) and ``thrust_yaw`` (N m), and
    where there is wind ``wind_speed`` (m/s) and ``wind_direction`` (deg, from). The truth has the keys of
    docs/interface.md (truth.json) and what the rig drew. One ``seed`` is one rig; ``weather`` changes the weather and
    the noise on the same rig. Line forces that move the vessel follow its slow motion; the logged tensions follow the
    whole motion.
    """
    dt = scenario.record.sample_time
    before = round(scenario.record.settle / dt)
    time: Array = dt * np.arange(-before, round(scenario.record.duration / dt), dtype=np.float64)
    draw = streams(seed if weather is None else (seed, weather))
    rig = draw_rig(scenario, streams(seed), time)
    air = draw_weather(scenario, draw, time)
    motion, thrust, pulls = _moved(scenario, rig, air, before, dt)
    true = _true(scenario, rig, draw, motion[before:], thrust[before:], pulls[before:])
    true |= {name: (kind, values[before:]) for name, (kind, values) in _seaway(scenario, rig, air).items()}
    signals = logged(scenario, draw, np.round(time[before:], 6), true, air.wind[before:])
    name = f"simulated, seed {seed}" + ("" if weather is None else f", weather {weather}")
    source = LogSource(path=name, format="simulated", bytes=0, sha256="")
    return RawLog(signals, source), _truth(scenario, seed, weather, rig)


def _moved(scenario: Scenario, rig: Rig, air: Weather, before: int, dt: float) -> tuple[Array, Array, Array]:
    """Return the whole motion (n, 3), the logged thrust (n, 3) and the tensions (n, lines).

    The first-order answer is that at the heading to hold, or, without a controller, at the heading after settling.
    """
    inputs = (rig.rest, air.loads, rig.levels, rig.effect, rig.misread)
    slow, thrust, dragged = run(*inputs, dt, rig.substeps, rig.hull, rig.lines, rig.loop)
    heading = float(rig.rest[2] if scenario.control.kind != "none" else slow[before, 2])
    fast = first_order(air.waves, rig.vessel.hull, air.travel - heading, air.turn)
    fast *= air.growth[:, None]
    c, s = np.cos(slow[:, 2]), np.sin(slow[:, 2])
    motion = slow.copy()
    motion[:, 0] += c * fast[:, 0] - s * fast[:, 1]
    motion[:, 1] += s * fast[:, 0] + c * fast[:, 1]
    motion[:, 2] += fast[:, 2]
    return motion, thrust, tensions(motion, dt, rig.levels, dragged, rig.lines)


def _seaway(scenario: Scenario, rig: Rig, air: Weather) -> dict[str, tuple[str, Array]]:
    """Return what probes of the sea and sensors of the vertical motion see, where the scenario logs them.

    At the heading to hold, or, without a controller, at the neutral one.
    """
    sensors, out = scenario.sensors, {}
    angle = air.travel - float(rig.rest[2])
    if sensors.wave.logged:
        out["wave_elevation_1"] = ("wave", air.growth * elevation(air.waves, angle, sensors.wave.ahead))
    if sensors.motion.logged:
        moved = air.growth[:, None] * first_order(air.waves, rig.vessel.hull, angle, air.turn, VERTICAL)
        out |= {"heave": ("motion", moved[:, 0]), "pitch": ("motion", np.degrees(moved[:, 1]))}
    return out


def _true(
    scenario: Scenario, rig: Rig, draw: Draw, motion: Array, thrust: Array, pulls: Array
) -> dict[str, tuple[str, Array]]:
    """Return what the sensors see, by channel: the kind of sensor and (n,) in the log's unit, zeros and gains on."""
    out = {"north": ("position", motion[:, 0]), "east": ("position", motion[:, 1])}
    out["heading"] = ("heading", np.degrees(motion[:, 2]))
    drift = scenario.rig.tension_drift
    for j, line in enumerate(rig.vessel.mooring.lines):
        name = line.replace("line_", "tension_", 1)
        zero = wander(draw(f"drift {name}"), len(pulls), scenario.record.sample_time, drift.sd, drift.memory)
        out[name] = ("tension", rig.gain[j] * pulls[:, j] + zero)
    if scenario.control.kind != "none":
        out |= {name: ("thrust", thrust[:, i]) for i, name in enumerate(AXES)}
    return out


def _truth(scenario: Scenario, seed: int, weather: int | None, rig: Rig) -> dict[str, Any]:
    sea, current, wind = scenario.sea, scenario.current, scenario.wind
    keys = ("kind", "subject", "mode", "onset", "end", "ramp", "size")
    return {
        "healthy_until": min([fault.onset for fault in scenario.faults], default=scenario.record.duration),
        "faults": [{key: getattr(fault, key) for key in keys} for fault in scenario.faults],
        "traps": [{key: getattr(trap, key) for key in (*keys, "direction")} for trap in scenario.traps],
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
        "weather": weather,
        "rig": rig.drawn,
        "scenario": scenario.model_dump(mode="json"),
    }


def save_log(log: RawLog, path: Path) -> None:
    """Write ``log`` in the format that the ending of ``path`` names; raises ConfigError for an unknown one."""
    from mooringdx.logs import WRITERS

    resolve(path.suffix.removeprefix("."), WRITERS, "log format")(log, path)
