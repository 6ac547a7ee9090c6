"""From what is to what is logged: noise, rounding, each sensor's own sampling, and its faults.

    logged = quantum * round((gain (true(t - delay) + offset) + sd w) / quantum)

w is white and Gaussian, from a stream of its own for every channel. A dead sensor reads its noise about zero; a stuck
one repeats its last value, noise and all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mooringdx.simulate.faults import Failure, grown
from mooringdx.simulate.scenario import Scenario, Sensor
from mooringdx.simulate.streams import Draw
from mooringdx.types import Array, Signal

UNITS = {"position": "m", "heading": "deg", "tension": "N", "thrust": "N", "wind": "m/s", "wave": "m", "motion": "m"}
UNITS_OF = {"thrust_yaw": "N m", "pitch": "deg"}
"""Where a channel's unit is not that of its sensor."""


def logged(
    scenario: Scenario, draw: Draw, time: Array, true: Mapping[str, tuple[str, Array]], wind: Array
) -> dict[str, Signal]:
    """Return the log's signals.

    ``time``: (n,), s; ``true``: name -> (kind of sensor, (n,) in the log's unit); ``wind``: (n, 2), m/s and rad from,
    logged where the scenario has any.
    """
    sensors = dict(scenario.sensors.items())
    out = {}
    for name, (kind, values) in true.items():
        sensor = sensors[kind]
        if not sensor.logged:
            continue
        faults = [fault for fault in scenario.faults if fault.kind == "sensor_fault" and fault.subject == name]
        clock = time[:: every(scenario, sensor)]
        noise = sensor.noise * draw(f"noise {name}").standard_normal(clock.size)
        seen = read(time, values, clock, noise, sensor, faults)
        out[name] = Signal(name, clock, seen, UNITS_OF.get(name, UNITS[kind]))
    if scenario.sensors.wind.logged and wind[:, 0].any():
        out |= _anemometer(scenario, draw, time, wind)
    return out


def every(scenario: Scenario, sensor: Sensor) -> int:
    """Return how many of the record's samples lie between two of the sensor's."""
    return round((sensor.sample_time or scenario.record.sample_time) / scenario.record.sample_time)


def _anemometer(scenario: Scenario, draw: Draw, time: Array, wind: Array) -> dict[str, Signal]:
    """Return speed and direction with noise on the components along and across the wind, so that calm has any side."""
    sensor = scenario.sensors.wind
    step = every(scenario, sensor)
    clock, speed, angle = time[::step], wind[::step, 0], wind[::step, 1]
    along = speed + sensor.noise * draw("noise wind_speed").standard_normal(clock.size)
    across = sensor.noise * draw("noise wind_direction").standard_normal(clock.size)
    seen = np.degrees(angle + np.arctan2(across, along)) % 360.0
    return {
        "wind_speed": Signal("wind_speed", clock, rounded(np.hypot(along, across), sensor.quantum), "m/s"),
        "wind_direction": Signal("wind_direction", clock, rounded(seen, 0.1), "deg"),
    }


def rounded(values: Array, quantum: float) -> Array:
    """Return values on multiples of ``quantum``, as decimals print them; 0 leaves them."""
    if quantum <= 0.0:
        return values
    return np.asarray(np.round(quantum * np.round(values / quantum), 12) + 0.0)


def read(time: Array, true: Array, clock: Array, noise: Array, sensor: Sensor, faults: Sequence[Failure]) -> Array:
    """Return what a sensor reads at ``clock``, (m,), s, of ``true``, (n,), at ``time``, (n,), with ``noise``, (m,)."""
    late = np.zeros(clock.size)
    for fault in faults:
        if fault.mode == "delay":
            late = late + fault.size * grown(clock, fault)
    values = np.interp(clock - late, time, true) if late.any() or clock.size < time.size else true
    for fault in faults:
        share = grown(clock, fault)
        if fault.mode == "gain":
            values = values * (1.0 + (fault.size - 1.0) * share)
        elif fault.mode in ("bias", "drift", "jump"):
            values = values + fault.size * share
        elif fault.mode == "noise":
            noise = noise * (1.0 + (fault.size - 1.0) * share)
        elif fault.mode == "dead":
            values = values * (1.0 - (share > 0.0))
    values = np.array(rounded(values + noise, sensor.quantum))
    for fault in faults:
        if fault.mode == "stuck":
            held = np.flatnonzero(grown(clock, fault) > 0.0)
            if held.size:
                values[held] = values[max(int(held[0]) - 1, 0)]
    return np.asarray(values)
