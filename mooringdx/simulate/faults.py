"""What fails and what only looks like it: the entries of [[faults]] and [[traps]], and how they grow in time.

Every entry grows in a straight line from ``onset`` to ``onset + ramp`` and goes back the same way from ``end``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from mooringdx.registry import did_you_mean
from mooringdx.types import Array

NotNegative = Annotated[float, Field(ge=0)]
Positive = Annotated[float, Field(gt=0)]

WEAKENED = ("buoyancy", "stiffness")
ON_TENSION = ("dead", "stuck", "bias", "drift", "gain", "noise", "delay")
ON_POSITION = ("jump", "stuck", "drift")
ON_HEADING = ("bias", "stuck", "drift")
LINE_KINDS = ("line_lost", "line_parted_low", "line_weakened")
TRAPS = ("sea_growth", "sea_turn", "current_step", "squall", "wind", "push")


class Failure(BaseModel):
    """One of [[faults]]; ``onset``, ``ramp``, ``end``: s of the record; ``size`` is what the kind and mode make of it.

    - ``line_lost``: parts at the fairlead. ``line_parted_low``: parts near the anchor; ``size``: share of the tension
      lost. ``line_weakened`` mode ``buoyancy``: share of the buoy's force (1 neutral, more when it sinks) or
      ``stiffness``: share of EA. Lines stay as they are: no ``end``.
    - ``sensor_fault`` on ``tension_i``: ``dead`` (reads its noise about zero), ``stuck``, ``bias`` (N), ``drift`` (N
      after ``ramp``), ``gain`` (factor), ``noise`` (factor on its sd), ``delay`` (s); on ``north``, ``east``: ``jump``
      (m), ``stuck``, ``drift`` (m); on ``heading``: ``bias`` (deg), ``stuck``, ``drift`` (deg).
    - ``actuator_fault`` on ``thrust_surge``, ``thrust_sway``, ``thrust_yaw``: the share lost of what the log shows.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    kind: Literal["line_lost", "line_parted_low", "line_weakened", "sensor_fault", "actuator_fault"]
    subject: str
    onset: NotNegative
    mode: str | None = None
    ramp: NotNegative = 0.0
    size: float = 1.0
    end: Positive | None = None

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        allowed = self.modes()
        if not allowed and self.mode is not None:
            raise ValueError(f"a {self.kind} has no mode; leave '{self.mode}' out")
        if allowed and self.mode not in allowed:
            raise ValueError(
                f"{self.kind} of {self.subject}: unknown mode '{self.mode}'; allowed: {', '.join(allowed)}"
            )
        if self.end is not None and (self.kind in LINE_KINDS or self.end < self.onset + self.ramp):
            raise ValueError(f"{self.kind} of {self.subject}: a line stays as it is, others end after onset + ramp")
        share = {"line_parted_low": (0.0, 1.0), "actuator_fault": (0.0, 1.0)}.get(self.kind)
        share = {"buoyancy": (0.0, np.inf), "stiffness": (0.0, 0.99)}.get(self.mode or "", share)
        if share and not share[0] < self.size <= share[1]:
            raise ValueError(
                f"{self.kind} of {self.subject}: size {self.size} is a share above 0, at most {share[1]:g}"
            )
        if self.mode == "delay" and self.size < 0.0:
            raise ValueError(f"a delay of {self.subject} is a size of 0 s or more, got {self.size}")
        return self

    def modes(self) -> tuple[str, ...]:
        """Return the modes that this kind and subject know."""
        if self.kind == "line_weakened":
            return WEAKENED
        if self.kind != "sensor_fault":
            return ()
        return {"north": ON_POSITION, "east": ON_POSITION, "heading": ON_HEADING}.get(self.subject, ON_TENSION)

    def subjects(self, lines: Sequence[str]) -> list[str]:
        """Return what this kind can befall on a vessel with ``lines``."""
        if self.kind in LINE_KINDS:
            return list(lines)
        if self.kind == "actuator_fault":
            return ["thrust_surge", "thrust_sway", "thrust_yaw"]
        return [*(line.replace("line_", "tension_", 1) for line in lines), "north", "east", "heading"]

    def check(self, lines: Sequence[str], duration: float) -> None:
        """Raise ValueError unless the subject exists and the onset is within the record of ``duration`` s."""
        allowed = self.subjects(lines)
        if self.subject not in allowed:
            raise ValueError(f"unknown subject '{self.subject}'{did_you_mean(self.subject, allowed)}")
        if self.onset >= duration:
            raise ValueError(f"onset {self.onset} s is after the record's end, {duration} s")


class Trap(BaseModel):
    """One of [[traps]]: the weather changes and nothing is broken.

    ``sea_growth``: the significant height times ``size``. ``sea_turn``: the waves turn by ``size`` deg, clockwise.
    ``current_step``: mean speed to ``size`` m/s towards ``direction``. ``squall``, ``wind``: mean speed to ``size`` m/s
    from ``direction`` (deg true; left out: as before). ``push``: the mean wind whose force on the vessel, at the
    heading to hold, is ``size`` N from ``direction``; the speed grows in a straight line, the force with its square.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)
    mode: Literal["sea_growth", "sea_turn", "current_step", "squall", "wind", "push"]
    onset: NotNegative
    size: float
    ramp: NotNegative = 0.0
    end: Positive | None = None
    direction: float | None = None
    kind: Literal["environment"] = "environment"
    subject: str = "environment"

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.mode != "sea_turn" and self.size < 0.0:
            raise ValueError(f"{self.mode}: size {self.size} must be 0 or more; give a direction instead of a sign")
        if self.end is not None and self.end < self.onset + self.ramp:
            raise ValueError(f"{self.mode}: end {self.end} s is before onset + ramp")
        if self.direction is not None and self.mode.startswith("sea"):
            raise ValueError(f"{self.mode} takes no direction; sea_turn takes an angle as its size")
        if self.mode == "push" and self.direction is None:
            raise ValueError("push: direction is missing; give where the force comes from, deg true")
        return self


def grown(time: Array, entry: Failure | Trap) -> Array:
    """Return how far an entry has grown at ``time``, (n,), s: 0 before its onset, 1 after its ramp, (n,)."""
    half = 1e-6
    if entry.ramp > 0.0:
        up = np.clip((time - entry.onset) / entry.ramp, 0.0, 1.0)
    else:
        up = (time >= entry.onset - half).astype(np.float64)
    if entry.end is None:
        return np.asarray(up, dtype=np.float64)
    if entry.ramp > 0.0:
        return np.asarray(up * np.clip(1.0 - (time - entry.end) / entry.ramp, 0.0, 1.0))
    return np.asarray(up * (time < entry.end - half))
