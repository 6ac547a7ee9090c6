"""A scenario file, typed: the vessel, the weather, the true rig, the sensors, and what fails when.

Defaults are the model basin of [Fang2015]: CyberShip III at model scale, 1 s of log is 6.06 s at full scale. The vessel
file is read into ``model``, so that a scenario, and the truth beside a log, holds all that made it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from mooringdx.config import read_toml, validate, vessel_file
from mooringdx.physics.vessel import VesselModel
from mooringdx.physics.vessel import vessel as typed_vessel
from mooringdx.registry import did_you_mean
from mooringdx.simulate.faults import Failure, NotNegative, Positive, Trap


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Record(_Part):
    """[record]: s; the first ``settle`` seconds are simulated and thrown away: some periods of the moored vessel."""

    duration: Positive = 1500.0
    sample_time: Positive = 0.1
    settle: NotNegative = 200.0


class Sea(_Part):
    """[sea]: m, s, direction *from* in deg true; ``spread``: exponent of the spreading; without it, long-crested.

    ``drift``: factor on the vessel's [drift]. ``start``: s of the record before which the water is flat.
    """

    spectrum: Literal["jonswap", "pierson-moskowitz"] = "jonswap"
    height: NotNegative = 0.06
    peak_period: Positive = 1.5
    peakedness: Positive = 3.3
    direction: float = 15.0
    spread: Positive | None = None
    drift: NotNegative = 1.0
    start: float | None = None


class Current(_Part):
    """[current]: m/s, direction *towards* in deg true; both wander with their sd over ``memory`` seconds.

    ``direction_memory``: s, that of the direction, left out for the same.
    """

    speed: NotNegative = 0.03
    direction: float = 200.0
    sd: NotNegative = 0.002
    direction_sd: NotNegative = 0.0
    memory: Positive = 600.0
    direction_memory: Positive | None = None


class Wind(_Part):
    """[wind]: m/s, direction *from* in deg true; gusts: a share of the speed, wandering over ``memory`` seconds."""

    speed: NotNegative = 1.3
    direction: float = 350.0
    gust: NotNegative = 0.3
    memory: Positive = 6.0


class Control(_Part):
    """[control]: "pid" with the vessel's gains, "pi" without its derivative part, or "none" (thrusters off).

    ``set_point``: north, east (m, centre of gravity), heading (deg); left out: the neutral place.
    """

    kind: Literal["pid", "pi", "none"] = "pid"
    set_point: tuple[float, float, float] | None = None


class Drifting(_Part):
    """[rig] tension_drift: the gauges' zeros wander with ``sd`` N over ``memory`` s."""

    sd: NotNegative = 0.0
    memory: Positive = 7200.0


class RigPart(_Part):
    """[rig]: how the true rig departs from the vessel file, which is all that a residual generator knows.

    Shares of the file's value for ``weight`` (of ``lines``, default all), ``wind``, ``thrust``, ``damping``,
    ``inertia``; sd of what is drawn once a rig for ``anchors`` (m, a line and axis) and ``gain`` (share, a gauge);
    ``pull``: share by which a line's force is at most larger or smaller, any share alike, drawn once a rig and line.
    """

    weight: Annotated[float, Field(gt=-1)] = 0.0
    lines: list[str] = []
    anchors: NotNegative = 0.0
    gain: NotNegative = 0.0
    pull: Annotated[float, Field(ge=0, lt=1)] = 0.0
    wind: Annotated[float, Field(ge=-1)] = 0.0
    thrust: Annotated[float, Field(ge=-1)] = 0.0
    damping: Annotated[float, Field(gt=-1)] = 0.0
    inertia: Annotated[float, Field(gt=-1)] = 0.0
    tension_drift: Drifting = Drifting()


class Sensor(_Part):
    """[sensors.*]: sd of the white ``noise`` and the rounding step ``quantum`` in the log's unit (0: none).

    ``sample_time``: s, a multiple of the record's, left out for the record's own.
    """

    noise: NotNegative = 0.0
    quantum: NotNegative = 0.0
    sample_time: Positive | None = None
    logged: bool = True


class Probe(Sensor):
    """[sensors.wave]: a sensor of the sea surface ``ahead`` m forward of the neutral place, which does not move."""

    ahead: float = 0.0


class Sensors(_Part):
    """[sensors]: position m, heading deg, tension N, thrust N and N m, wind m/s on each component.

    ``wave``: elevation, m; ``motion``: heave m, down, and pitch deg, bow up. Both are logged only where asked for.
    """

    position: Sensor = Sensor(noise=0.001, quantum=0.0001)
    heading: Sensor = Sensor(noise=0.05, quantum=0.001)
    tension: Sensor = Sensor(noise=0.02, quantum=0.001)
    thrust: Sensor = Sensor(quantum=0.0001)
    wind: Sensor = Sensor(noise=0.02, quantum=0.001)
    wave: Probe = Probe(logged=False)
    motion: Sensor = Sensor(logged=False)

    @model_serializer(mode="wrap")
    def _without_silent(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        """Leave out what is not logged by default and as by default, so that older truths keep their bytes."""
        body: dict[str, Any] = handler(self)
        return {k: v for k, v in body.items() if k not in ("wave", "motion") or getattr(self, k) != SILENT[k]}

    def items(self) -> tuple[tuple[str, Sensor], ...]:
        """Return each kind with its sensor."""
        names = ("position", "heading", "tension", "thrust", "wind", "wave", "motion")
        return tuple((name, getattr(self, name)) for name in names)


SILENT: dict[str, Sensor] = {"wave": Probe(logged=False), "motion": Sensor(logged=False)}


class Scenario(_Part):
    """A scenario file. ``vessel``: a path or a name in configs/vessels; ``model``: its content, read in."""

    vessel: str = "cybership3"
    model: dict[str, Any] = {}
    record: Record = Record()
    sea: Sea = Sea()
    current: Current = Current()
    wind: Wind = Wind()
    control: Control = Control()
    rig: RigPart = RigPart()
    sensors: Sensors = Sensors()
    faults: list[Failure] = []
    traps: list[Trap] = []

    @model_validator(mode="before")
    @classmethod
    def _with_model(cls, body: Any) -> Any:
        return _embedded(body, Path("scenario")) if isinstance(body, dict) else body

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        vessel, record = self.typed(), self.record
        lines = vessel.mooring.lines
        for fault in self.faults:
            fault.check(lines, record.duration)
        for trap in self.traps:
            if trap.onset >= record.duration:
                raise ValueError(f"onset {trap.onset} s is after the record's end, {record.duration} s")
            if trap.mode == "push" and min(vessel.wind.surge, vessel.wind.sway) <= 0.0:
                raise ValueError(f"a push is a wind: vessel '{vessel.name}' needs [wind] surge and sway above 0")
        for line in self.rig.lines:
            if line not in lines:
                raise ValueError(f"[rig] lines: unknown line '{line}'{did_you_mean(line, lines)}")
        _one_way_of_weakening(self.faults)
        for name, sensor in self.sensors.items():
            ratio = (sensor.sample_time or record.sample_time) / record.sample_time
            if ratio < 0.999 or abs(ratio - round(ratio)) > 1e-6:
                raise ValueError(f"[sensors.{name}] sample_time must be a multiple of {record.sample_time} s")
        if self.control.kind != "none" and (vessel.control is None or vessel.thrust is None):
            raise ValueError(f"vessel '{vessel.name}' has no [control] or [thrust]; set [control] kind = \"none\"")
        return self

    def typed(self) -> VesselModel:
        """Return the vessel file's content as a `VesselModel`."""
        return typed_vessel(self.model, Path(self.vessel))


def _one_way_of_weakening(faults: list[Failure]) -> None:
    seen: dict[str, Failure] = {}
    for fault in faults:
        if fault.kind != "line_weakened":
            continue
        if fault.subject in seen:
            raise ValueError(
                f"two line_weakened entries of {fault.subject}; give one, whose ramp reaches the last size"
            )
        seen[fault.subject] = fault


def _embedded(body: dict[str, Any], path: Path) -> dict[str, Any]:
    if body.get("model"):
        return body
    name = body.get("vessel", "cybership3")
    return {**body, "model": read_toml(vessel_file(name, path))} if isinstance(name, str) else body


def load_scenario(path: Path) -> Scenario:
    """Read a scenario file; every fault in it is one ConfigError sentence with file, key, what is allowed."""
    return validate(Scenario, _embedded(read_toml(path), path), path)
