"""What the weather does over a record: loads before coefficients, the sea's growth and turn, the wind as it blows.

Speeds wander about their means as in `mooringdx.simulate.streams`; traps move the means, in straight lines. Wind and
current are the same everywhere at one time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mooringdx.simulate.faults import Trap, grown
from mooringdx.simulate.scenario import Scenario
from mooringdx.simulate.sea import Waves, draw_waves, slow_drift
from mooringdx.simulate.streams import Draw, wander
from mooringdx.types import Array


@dataclass(frozen=True)
class Weather:
    """Weather on the record's samples. ``loads``: (n, 6), as `mooringdx.simulate.plant.slope` takes them.

    ``growth``: (n,) or (1,), factor on the waves' amplitude; ``travel``: rad, where the waves go to at first; ``turn``:
    (n,) or (1,), rad, added to it. ``wind``: (n, 2), speed m/s and direction *from*, rad.
    """

    waves: Waves
    loads: Array
    growth: Array
    travel: float
    turn: Array
    wind: Array


def draw_weather(scenario: Scenario, draw: Draw, time: Array) -> Weather:
    """Return the weather at ``time``, (n,), s of the record, uniform, from before zero."""
    n, dt, sea = time.size, scenario.record.sample_time, scenario.sea
    waves = draw_waves(draw, n, dt, sea)
    growth, turn = _growth(scenario, time), _turn(scenario.traps, time)
    travel = np.radians(sea.direction) + np.pi
    push = sea.drift * slow_drift(waves) * growth[:, None] ** 2
    ahead, aside = np.cos(travel + turn), np.sin(travel + turn)
    wind_speed, wind_from = _moved(scenario, ("squall", "wind", "push"), time)
    gusts = wander(draw("wind"), n, dt, scenario.wind.gust, scenario.wind.memory)
    wind_speed = np.maximum(wind_speed * (1.0 + gusts), 0.0)
    current = scenario.current
    speed, towards = _moved(scenario, ("current_step",), time)
    speed = speed + wander(draw("current"), n, dt, current.sd, current.memory)
    veer = wander(
        draw("current direction"), n, dt, np.radians(current.direction_sd), current.direction_memory or current.memory
    )
    loads = np.column_stack(
        [
            push[:, 0] * ahead - push[:, 1] * aside,
            push[:, 0] * aside + push[:, 1] * ahead,
            *(-(wind_speed**2) * part(wind_from) for part in (np.cos, np.sin)),
            *(speed * part(towards + veer) for part in (np.cos, np.sin)),
        ]
    )
    return Weather(waves, loads, growth, float(travel), turn, np.column_stack([wind_speed, wind_from]))


def _growth(scenario: Scenario, time: Array) -> Array:
    """Return the factor on the waves' amplitude: growth by traps, and the start of the waves over two peak periods."""
    out = np.ones(1)
    for trap in scenario.traps:
        if trap.mode == "sea_growth":
            out = out * (1.0 + (trap.size - 1.0) * grown(time, trap))
    start = scenario.sea.start
    if start is not None:
        share = np.clip((time - start) / (2.0 * scenario.sea.peak_period), 0.0, 1.0)
        out = out * 0.5 * (1.0 - np.cos(np.pi * share))
    return out


def _turn(traps: list[Trap], time: Array) -> Array:
    out = np.zeros(1)
    for trap in traps:
        if trap.mode == "sea_turn":
            out = out + np.radians(trap.size) * grown(time, trap)
    return out


def _moved(scenario: Scenario, modes: tuple[str, ...], time: Array) -> tuple[Array, Array]:
    """Return the mean speed, (n,), m/s, and direction, (n,), rad, of current or wind as traps move them."""
    base = scenario.current if "current_step" in modes else scenario.wind
    speed, angle = np.full(time.size, base.speed), np.full(time.size, np.radians(base.direction))
    for trap in scenario.traps:
        if trap.mode not in modes:
            continue
        share = grown(time, trap)
        size, aim = _blown(scenario, trap)
        if aim is not None:
            turn = np.angle(np.exp(1j * (aim - angle)))
            angle = angle + np.where(speed > 0.0, share, 1.0) * turn  # what does not blow yet has no way to turn
        speed = speed + share * (size - speed)
    return speed, angle


def _blown(scenario: Scenario, trap: Trap) -> tuple[float, float | None]:
    """Return the speed, m/s, and direction, rad, that a trap reaches.

    A push from direction d on a vessel heading psi: v^2 (C_x cos b, C_y sin b) = F (cos(d - psi), sin(d - psi)), b: the
    wind's direction from the bow.
    """
    if trap.direction is None:
        return trap.size, None
    aim = float(np.radians(trap.direction))
    if trap.mode != "push":
        return trap.size, aim
    vessel, place = scenario.typed(), scenario.control.set_point
    heading = float(np.radians(vessel.mooring.heading if place is None else place[2]))
    ahead = trap.size * np.cos(aim - heading) / vessel.wind.surge
    aside = trap.size * np.sin(aim - heading) / vessel.wind.sway
    return float(np.sqrt(np.hypot(ahead, aside))), heading + float(np.arctan2(aside, ahead))
