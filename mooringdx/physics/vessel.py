"""A vessel and its mooring, typed: one TOML file in configs/vessels, a source beside every number.

Axes: body x forward, y to starboard; yaw positive clockwise from above. Triples are surge, sway, yaw. Forces in N,
moments in N m about the centre of gravity, lengths in m, weights per metre in water.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from mooringdx.config import read_toml, validate
from mooringdx.registry import did_you_mean

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Triple = tuple[Positive, Positive, Positive]
AnyTriple = tuple[NotNegative, NotNegative, NotNegative]


class _Part(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Hull(_Part):
    """[hull]: between perpendiculars, m; ``mass`` kg; ``block``: block coefficient."""

    length: Positive
    breadth: Positive
    draught: Positive
    mass: Positive
    block: Annotated[float, Field(gt=0, le=1)]


class Dynamics(_Part):
    """[dynamics]: low-frequency inertia with added mass (kg, kg, kg m2), its sway-yaw term (kg m), linear damping
    relative to the water (N s/m, N s/m, N m s), and the drag coefficient of quadratic cross-flow.
    """

    inertia: Triple
    coupling: float = 0.0
    damping: Triple
    cross_flow: NotNegative = 0.0


class Wind(_Part):
    """[wind]: force per squared relative speed: along times cos, across times sin, N/(m/s)2; yaw times sin 2."""

    surge: NotNegative = 0.0
    sway: NotNegative = 0.0
    yaw: float = 0.0


class Drift(_Part):
    """[drift]: mean second-order wave force per squared significant wave height: N/m2 times cos, times sin; N/m times
    sin 2, of the angle between the waves' travel and the bow.
    """

    surge: NotNegative = 0.0
    sway: NotNegative = 0.0
    yaw: float = 0.0


class Thrust(_Part):
    """[thrust]: limit of each axis (N, N, N m), first-order lag s."""

    limit: AnyTriple
    lag: Positive


class Control(_Part):
    """[control]: gains on body-axes errors of the slow motion [Fang2015, eq. 25, mended: R'(psi) throughout]."""

    proportional: AnyTriple
    integral: AnyTriple
    derivative: AnyTriple


class Section(_Part):
    """A part of a line, from the anchor up: length m, weight in water N/m, axial stiffness EA N, and the net upward
    force N of a buoyancy element at its upper end (``filled``: the same once full of water, negative when it sinks).
    """

    length: Positive
    weight: Positive
    stiffness: Positive
    buoy: NotNegative = 0.0
    filled: float = 0.0


class MooringModel(_Part):
    """[mooring]: all lines are of the same ``sections`` (anchor first) and run from a fairlead ``depth`` above the
    seabed to an anchor.

    ``azimuth`` (deg true towards the anchor, with ``radius`` m from the fairlead at the neutral place) or ``anchors``
    (north, east, m). The origin of north and east is the neutral place of the turret; without one, that of the centre
    of gravity, with ``heading`` deg. ``turret``: m ahead of the centre of gravity, where all lines meet; or
    ``fairleads``: forward, starboard, m, a line. ``friction``: of the seabed. ``parted``: N left after a break.
    ``dynamic``: tension per fairlead speed away from the anchor, N s/m and N s2/m2.
    """

    depth: Positive
    sections: Annotated[list[Section], Field(min_length=1)]
    turret: float | None = None
    fairleads: dict[str, tuple[float, float]] = {}
    azimuth: dict[str, float] = {}
    radius: Positive | None = None
    heading: float = 0.0
    anchors: dict[str, tuple[float, float]] = {}
    friction: NotNegative = 0.0
    dynamic: tuple[NotNegative, NotNegative] = (0.0, 0.0)
    parted: NotNegative = 0.0

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if bool(self.azimuth) == bool(self.anchors):
            raise ValueError("give either azimuth with radius, or anchors")
        if self.azimuth and self.radius is None:
            raise ValueError("azimuth needs radius: the horizontal distance from fairlead to anchor, m")
        if (self.turret is None) == (not self.fairleads):
            raise ValueError("give either turret (all lines meet there), or fairleads, one a line")
        for line in self.lines:
            if not line.startswith("line_"):
                raise ValueError(f"a line is called line_1, line_2, ...; got '{line}'")
            if self.fairleads and line not in self.fairleads:
                raise ValueError(f"fairleads: '{line}' is missing; one a line")
        for line in self.fairleads:
            if line not in self.lines:
                raise ValueError(f"fairleads: unknown line '{line}'{did_you_mean(line, self.lines)}")
        return self

    @property
    def lines(self) -> tuple[str, ...]:
        """The lines' names in the file's order."""
        return tuple(self.azimuth or self.anchors)


class VesselModel(_Part):
    """A vessel file. ``time_scale``: seconds at full scale per second of its logs (Froude; 1 at full scale)."""

    name: str
    source: str
    time_scale: Positive = 1.0
    hull: Hull
    dynamics: Dynamics
    wind: Wind = Wind()
    drift: Drift = Drift()
    thrust: Thrust | None = None
    control: Control | None = None
    mooring: MooringModel


def vessel(body: Mapping[str, Any], where: Path = Path("vessel")) -> VesselModel:
    """Return a vessel file's content as a `VesselModel`; the first fault is one ConfigError sentence."""
    return validate(VesselModel, dict(body), where)


def load_vessel(path: Path) -> VesselModel:
    """Read a vessel file; see `vessel`."""
    return vessel(read_toml(path), path)
