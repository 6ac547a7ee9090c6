"""A scenario file, typed: the vessel, its lines, the weather, the sensors, and what fails when.

Defaults are the model basin of [Fang2015] as far as a spring line can stand for it: CyberShip III at model scale
(1 s of log is 6.06 s full scale). The lines leave the hull from six fairleads instead of a turret, so that the
vessel keeps its heading without thrusters.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from mooringdx.config import read_toml, validate
from mooringdx.registry import did_you_mean

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Triple = tuple[Positive, Positive, Positive]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Record(_Part):
    """[record]: s; the first ``settle`` seconds are simulated and thrown away."""

    duration: Positive = 1500.0
    sample_time: Positive = 0.1
    settle: NotNegative = 200.0


class Vessel(_Part):
    """[vessel]: surge, sway, yaw; kg and kg m2, N s/m and N m s; m; heading at rest in deg true."""

    mass: Triple = (80.0, 140.0, 32.0)
    damping: Triple = (6.0, 20.0, 8.0)
    length: Positive = 1.974
    draught: Positive = 0.153
    heading: float = 0.0


class Line(_Part):
    """One line: direction towards the anchor (deg true), fairlead on the hull (m forward, m to starboard)."""

    azimuth: float
    fairlead: tuple[float, float]


class Mooring(_Part):
    """[mooring]: every line is a spring under a constant angle; N, N/m, m.

    ``horizontal_share`` is the cosine of that angle, ``dynamic`` the tension per fairlead speed (N s/m, N s2/m2).
    """

    lines: list[Line] = [
        Line(azimuth=30, fairlead=(0.9, 0.2)),
        Line(azimuth=90, fairlead=(0.0, 0.22)),
        Line(azimuth=150, fairlead=(-0.9, 0.2)),
        Line(azimuth=210, fairlead=(-0.9, -0.2)),
        Line(azimuth=270, fairlead=(0.0, -0.22)),
        Line(azimuth=330, fairlead=(0.9, -0.2)),
    ]
    pretension: Positive = 4.0
    stiffness: Positive = 8.64
    horizontal_share: Annotated[float, Field(gt=0, le=1)] = 0.625
    anchor_distance: Positive = 12.48
    dynamic: tuple[NotNegative, NotNegative] = (4.0, 20.0)
    parted_tension: NotNegative = 0.05


class Sea(_Part):
    """[sea]: JONSWAP; m, s, direction *from* in deg true, half width of the spreading in deg, mean drift force in N."""

    height: Positive = 0.06
    peak_period: Positive = 1.5
    peakedness: Positive = 3.3
    direction: float = 15.0
    spread: NotNegative = 20.0
    drift_force: NotNegative = 0.5


class Current(_Part):
    """[current]: m/s, direction *towards* in deg true; speed wanders with ``sd`` over ``memory`` seconds."""

    speed: NotNegative = 0.03
    direction: float = 200.0
    sd: NotNegative = 0.002
    memory: Positive = 600.0


class Wind(_Part):
    """[wind]: m/s, direction *from* in deg true; gusts as a share of the speed; N per (m/s)2 along and across."""

    speed: NotNegative = 1.3
    direction: float = 350.0
    gust: NotNegative = 0.3
    memory: Positive = 6.0
    drag: tuple[NotNegative, NotNegative] = (0.05, 0.25)


class Sensors(_Part):
    """[sensors]: noise sd (m, deg, N) and the logger's decimals (m, deg, N)."""

    position: NotNegative = 0.001
    heading: NotNegative = 0.05
    tension: NotNegative = 0.02
    decimals: tuple[int, int, int] = (4, 3, 3)


class Failure(_Part):
    """[[faults]]: a line parts at its fairlead, or a tension gauge dies (reads its noise about zero)."""

    kind: Literal["line_lost", "sensor_fault"]
    subject: str
    onset: NotNegative
    mode: Literal["dead"] | None = None

    @model_validator(mode="after")
    def _mode_fits(self) -> Self:
        if (self.kind == "sensor_fault") != (self.mode is not None):
            raise ValueError('a sensor_fault needs mode = "dead"; a line_lost has no mode')
        return self


class Scenario(_Part):
    """A scenario file."""

    record: Record = Record()
    vessel: Vessel = Vessel()
    mooring: Mooring = Mooring()
    sea: Sea = Sea()
    current: Current = Current()
    wind: Wind = Wind()
    sensors: Sensors = Sensors()
    faults: list[Failure] = []

    @model_validator(mode="after")
    def _subjects_exist(self) -> Self:
        for fault in self.faults:
            stem = "line" if fault.kind == "line_lost" else "tension"
            allowed = [f"{stem}_{i + 1}" for i in range(len(self.mooring.lines))]
            if fault.subject not in allowed:
                raise ValueError(f"unknown subject '{fault.subject}'{did_you_mean(fault.subject, allowed)}")
            if fault.onset >= self.record.duration:
                raise ValueError(f"onset {fault.onset} s is after the record's end, {self.record.duration} s")
        return self


def load_scenario(path: Path) -> Scenario:
    """Read a scenario file; every fault in it is one ConfigError sentence with file, key, what is allowed."""
    return validate(Scenario, read_toml(path), path)
