"""The nouns. Frozen, SI units, read-only arrays, half-open windows ``[start, stop)``.

Each stage of the walk from the log to the report has its own type, so that handing residuals to a
detector that wants whitened ones is a type error. Times are seconds on the *log clock*: the stamp as
logged when the log counts in seconds, else seconds since the first stamp, whose instant is ``epoch_ns``.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


def locked(array: Any, dtype: Any = np.float64) -> Any:
    """Return ``array`` as a read-only contiguous array (a copy only when needed)."""
    out = np.ascontiguousarray(array, dtype=dtype)
    if out.flags.writeable:
        out = out.view()
        out.flags.writeable = False
    return out


@dataclass(frozen=True)
class Check:
    """One row of the checks table: warnings are data, not scrolling lines.

    ``subject`` is a channel, a file or a stage; ``value`` and ``limit`` are in ``unit``; ``remedy`` is one
    sentence, empty where the check passed.
    """

    name: str
    subject: str
    passed: bool
    detail: str
    value: float | None = None
    limit: float | None = None
    unit: str = ""
    remedy: str = ""


@dataclass(frozen=True)
class Defect:
    """Something wrong with the *data* that the alignment found, at a time.

    ``mode`` is one of gap, duplicate, out_of_order, clock_step, spike, stuck, delay, range. ``subjects``: the channels.
    ``start, stop``: s on the log clock. ``value`` in ``unit`` (a delay in s, a hold in s), ``interval`` its 95 %
    interval. ``alarming`` defects become events (stuck while the others move, a late clock); the rest are check rows.
    ``detected``: s, when the log up to there suffices to say so (None where only the whole log does).
    """

    mode: str
    subjects: tuple[str, ...]
    start: float
    stop: float
    value: float
    unit: str
    detail: str
    alarming: bool = False
    interval: tuple[float, float] | None = None
    detected: float | None = None


@dataclass(frozen=True)
class Signal:
    """One logged quantity on its own clock. ``time``: (n,), s, log clock; ``values``: (n,), in ``unit``."""

    name: str
    time: Array
    values: Array
    unit: str
    source: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "time", locked(self.time))
        object.__setattr__(self, "values", locked(self.values))
        if self.time.shape != self.values.shape or self.time.ndim != 1:
            raise ValueError(f"signal {self.name}: time {self.time.shape} and values {self.values.shape} differ")


@dataclass(frozen=True)
class LogSource:
    """Where a log came from. ``sha256`` is of the file's bytes as they stand."""

    path: str
    format: str
    bytes: int
    sha256: str


@dataclass(frozen=True)
class RawLog:
    """Every asked-for signal on its own clock, with what the reader had to leave out as checks."""

    signals: Mapping[str, Signal]
    source: LogSource
    epoch_ns: int | None = None
    checks: tuple[Check, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "signals", MappingProxyType(dict(self.signals)))


@dataclass(frozen=True)
class Grid:
    """A uniform clock: sample i is at ``start + i * sample_time`` s, ``n`` samples."""

    start: float
    sample_time: float
    n: int
    epoch_ns: int | None = None

    @property
    def time(self) -> Array:
        """(n,), s on the log clock."""
        return np.asarray(self.start + self.sample_time * np.arange(self.n), dtype=np.float64)

    @property
    def stop(self) -> float:
        """End of the half-open span, s."""
        return self.start + self.sample_time * self.n

    def index(self, time: float) -> int:
        """Return the sample at or after ``time``, clipped to [0, n]."""
        return int(np.clip(np.ceil((time - self.start) / self.sample_time - 1e-6), 0, self.n))

    def window(self, window: tuple[float, float]) -> slice:
        """Return the samples of a half-open window in s."""
        return slice(self.index(window[0]), self.index(window[1]))


@dataclass(frozen=True)
class Channels:
    """Aligned channels. ``values``: (n, c), SI, NaN where not valid; ``valid``: (n, c)."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    grid: Grid
    values: Array
    valid: Mask
    source: LogSource
    checks: tuple[Check, ...] = ()
    defects: tuple[Defect, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", locked(self.values))
        object.__setattr__(self, "valid", locked(self.valid, np.bool_))

    def column(self, name: str) -> Array:
        """Return one channel, (n,)."""
        return np.asarray(self.values[:, self.names.index(name)])


@dataclass(frozen=True)
class Fault:
    """A named cause: ``kind`` and ``subject`` as in docs/interface.md; ``mode`` for sensor faults or None."""

    kind: str
    subject: str
    mode: str | None = None

    @property
    def label(self) -> str:
        """A short unique text, e.g. ``line_lost line_4``."""
        return f"{self.kind} {self.subject}" + (f" ({self.mode})" if self.mode else "")


@dataclass(frozen=True)
class Signatures:
    """In which direction each fault moves the residual mean.

    ``matrix``: (f, r), change of the residual's mean per unit of the fault's size, residual units per ``units[f]``.
    ``total``: (f,), the signed size of a total loss (NaN where unknown). ``sign``: (f,), +1 or -1 where only
    that sign of the size is this fault, 0 where both are. ``error``: (f, r), sd to which a row is known, as ``matrix``;
    zero where it follows exactly (a biased channel in a linear relation), not where physics is linearised (a line).
    """

    faults: tuple[Fault, ...]
    residuals: tuple[str, ...]
    matrix: Array
    units: tuple[str, ...]
    total: Array
    sign: Array
    error: Array = field(default_factory=lambda: np.zeros((0, 0)))

    def __post_init__(self) -> None:
        if self.error.shape != self.matrix.shape:
            object.__setattr__(self, "error", np.zeros_like(self.matrix))
        for key in ("matrix", "total", "sign", "error"):
            object.__setattr__(self, key, locked(getattr(self, key)))
        if self.matrix.shape != (len(self.faults), len(self.residuals)):
            raise ValueError(f"signature matrix {self.matrix.shape} is not faults x residuals")


@dataclass(frozen=True)
class Residuals:
    """Residuals on the grid. ``values``: (n, r), in ``units``, zero-mean when nothing is wrong; ``valid``: (n, r)."""

    names: tuple[str, ...]
    units: tuple[str, ...]
    grid: Grid
    values: Array
    valid: Mask
    signatures: Signatures

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", locked(self.values))
        object.__setattr__(self, "valid", locked(self.valid, np.bool_))


@dataclass(frozen=True)
class Whitened:
    """Whitened residuals ``z``: (n, r), unit-free only when whitened; ``signatures`` as carried through the filter."""

    names: tuple[str, ...]
    grid: Grid
    values: Array
    valid: Mask
    signatures: Signatures
    kind: str = "none"

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", locked(self.values))
        object.__setattr__(self, "valid", locked(self.valid, np.bool_))


@dataclass(frozen=True)
class Statistic:
    """A detector's output. ``values``: (n, f), one column a fault (or one for all); NaN where no verdict is allowed;
    single precision once computed, because a day of thirty faults is large.

    ``frozen``: (n,), true where an adaptive reference was held because of an alarm.
    """

    branch: str
    labels: tuple[str, ...]
    grid: Grid
    values: Array
    frozen: Mask | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "values", locked(self.values, np.asarray(self.values).dtype))


@dataclass(frozen=True)
class Threshold:
    """A level for a wanted false-alarm rate, with what is known of the rate it really gives.

    ``level``: (f,), alarm when the statistic of fault f is above. Rates are alarms per second of log clock for the
    branch as a whole. ``verdict`` is supported, extrapolated or invalid. ``tail`` names the law and its parameters;
    ``curve``: (k, 2), exceedance probability of the pooled scaled no-fault statistic, for the report.
    """

    branch: str
    level: Array
    scale: Array
    asked_rate: float
    central_rate: float
    rate_interval: tuple[float, float]
    scaled_level: float
    scaled_interval: tuple[float, float]
    probability: float
    cluster_length: float
    independent_windows: float
    drift_ratio: float
    verdict: str
    reason: str
    tail: Mapping[str, float] = field(default_factory=dict)
    curve: Array = field(default_factory=lambda: np.zeros((0, 2)))

    def __post_init__(self) -> None:
        for key in ("level", "scale", "curve"):
            object.__setattr__(self, key, locked(getattr(self, key)))


@dataclass(frozen=True)
class Rival:
    """Another cause that the data do not rule out, with its probability and why it came second."""

    kind: str
    subject: str
    probability: float
    why_not: str


@dataclass(frozen=True)
class Event:
    """One fault, once. Times in s on the log clock; ``cleared`` is None while it stands at the end of the log."""

    kind: str
    subject: str
    onset: float
    onset_interval: tuple[float, float]
    detected: float
    named: float | None = None
    cleared: float | None = None
    mode: str | None = None
    size: float | None = None
    size_unit: str = ""
    size_interval: tuple[float, float] | None = None
    probability: float | None = None
    rivals: tuple[Rival, ...] = ()
    cannot_tell: str | None = None
    evidence: Mapping[str, Any] = field(default_factory=dict)
    marks: tuple[str, ...] = ()


@dataclass(frozen=True)
class Posterior:
    """Probabilities of the rival hypotheses of one bank. ``time``: (n,), s; ``probability``: (n, h), rows sum to 1."""

    bank: str
    hypotheses: tuple[str, ...]
    time: Array
    probability: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "time", locked(self.time))
        object.__setattr__(self, "probability", locked(self.probability))


@dataclass(frozen=True)
class Detection:
    """Every stage of one log's walk, so that the report recomputes nothing.

    ``verdict`` is nothing_found, fault_found or cannot_be_judged. ``no_fault`` are the
    windows (s, this log's clock) that the baseline was learned on, empty when it was learned on other logs.
    ``statistics`` and ``thresholds`` go together by branch (main, short, slow). ``alarm_rate``: asked, central,
    interval (per second) and verdict for the system. ``run`` is the configuration, ``provenance`` what made this.
    ``choice`` is the table by which the whitening was chosen: one mapping a candidate, key = column. ``forces``: the
    balance of forces that tells a line from its sensor, where a vessel is known; no detector watches it.
    ``observability``: what a position bank can see of each line, {line: {r, observable, sentence}}.
    """

    name: str
    verdict: str
    channels: Channels
    residuals: Residuals | None
    whitened: Whitened | None
    statistics: tuple[Statistic, ...]
    thresholds: tuple[Threshold, ...]
    posteriors: tuple[Posterior, ...]
    events: tuple[Event, ...]
    checks: tuple[Check, ...]
    no_fault: tuple[tuple[float, float], ...]
    alarm_rate: Mapping[str, Any]
    choice: tuple[Mapping[str, Any], ...]
    run: Mapping[str, Any]
    provenance: Mapping[str, Any]
    forces: Residuals | None = None
    observability: Mapping[str, Any] = field(default_factory=dict)


Noun = TypeVar("Noun")


def replace(noun: Noun, **changes: Any) -> Noun:
    """Return a copy of a frozen noun with some fields changed."""
    return dataclasses.replace(noun, **changes)  # type: ignore[type-var]
