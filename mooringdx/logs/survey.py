"""Say what is in a log: every signal with its unit, rate, span, gaps, defects and range, before any run file exists."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from mooringdx.channels import unit_in_header
from mooringdx.logs.naming import Guess, guess_names
from mooringdx.logs.stamps import find_steps, order, period_of
from mooringdx.logs.stuck import find_holds
from mooringdx.types import RawLog, Signal

GAP_PERIODS = 3.0
LEAST_HOLD = 1.0


@dataclass(frozen=True)
class SurveyRow:
    """One signal of a log.

    ``rate``: Hz, of the median spacing; ``start``, ``stop``, ``span``: s on the log clock; ``gaps``: spacings over
    three periods; ``stuck``: stretches over 1 s (and five update intervals) without change; ``guess``: the catalogue
    name that it looks like, ``known`` unless a free one, and why; ``clock``: it looks like time itself. ``topic``,
    ``field`` for messages, empty for columns. Numbers are None where the signal has none.
    """

    signal: str
    unit: str
    source: str
    topic: str
    field: str
    samples: int
    nonfinite: int
    duplicates: int
    out_of_order: int
    clock_steps: int
    rate: float | None
    start: float | None
    stop: float | None
    span: float | None
    gaps: int
    longest_gap: float | None
    stuck: int
    longest_stuck: float | None
    min: float | None
    median: float | None
    max: float | None
    guess: str
    reason: str
    known: bool
    clock: bool


def survey(log: RawLog) -> tuple[SurveyRow, ...]:
    """Return one row a signal, in the order of the log."""
    places = {name: _place(name, signal, log.source.format) for name, signal in log.signals.items()}
    texts = [(places[n][1] or n, s.unit, places[n][0]) for n, s in log.signals.items()]
    guesses = guess_names(texts)
    return tuple(
        _row(name, signal, places[name], guess)
        for (name, signal), guess in zip(log.signals.items(), guesses, strict=True)
    )


def as_dict(row: SurveyRow) -> dict[str, Any]:
    """Return a row as plain values for JSON and tables; None where there is no number."""
    plain = dataclasses.asdict(row)
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in plain.items()}


def _place(name: str, signal: Signal, kind: str) -> tuple[str, str]:
    """Return (topic, field) of a signal of a message log, two empty texts otherwise."""
    if kind != "mcap":
        return "", ""
    topic, _, field = (signal.source or name).partition(" ")
    return topic, field


def _row(name: str, signal: Signal, place: tuple[str, str], guess: Guess) -> SurveyRow:
    stamped = np.isfinite(signal.time)
    time, values = signal.time[stamped], signal.values[stamped]
    # A spacing of ten periods is surely a gap; a smaller step back is sorted as out of order.
    steps = find_steps(time, 10.0 * max(period_of(np.sort(time)), 0.0)) if time.size > 1 else ()
    ordered = order(time, values, steps, True)
    good = values[ordered.index]
    period = period_of(ordered.time)
    spacing = np.diff(ordered.time)
    wide = spacing[spacing > GAP_PERIODS * period]
    kept = Signal(name, ordered.time, good, signal.unit)
    holds = find_holds(kept, period, max(LEAST_HOLD, GAP_PERIODS * period), GAP_PERIODS * period) if good.size else ()
    start, stop = (float(ordered.time[0]), float(ordered.time[-1])) if good.size else (None, None)
    return SurveyRow(
        signal=name,
        unit=signal.unit or (unit_in_header(name)[1] or ""),
        source=signal.source or name,
        topic=place[0],
        field=place[1],
        samples=signal.time.size,
        nonfinite=signal.time.size - int(np.count_nonzero(np.isfinite(values))),
        duplicates=ordered.doubled,
        out_of_order=ordered.late,
        clock_steps=len(steps),
        rate=1.0 / period if period > 0.0 else None,
        start=start,
        stop=stop,
        span=stop - start if start is not None and stop is not None else None,
        gaps=int(wide.size),
        longest_gap=float(wide.max()) if wide.size else None,
        stuck=len(holds),
        longest_stuck=max((h.length for h in holds), default=None),
        min=float(good.min()) if good.size else None,
        median=float(np.median(good)) if good.size else None,
        max=float(good.max()) if good.size else None,
        guess=guess.name,
        reason=guess.reason,
        known=guess.known,
        clock=guess.time,
    )
