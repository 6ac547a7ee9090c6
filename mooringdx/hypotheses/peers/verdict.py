"""From a bank's probabilities to alarms and events: a line held for long enough, or odds that cross a level.

    held:   one hypothesis is the likeliest for ``hold`` samples in a row
    odds:   ln (sum of the lines / none) >= alarm; over when it is under warning again

The name is that of the likeliest line: when the hold is over, or up to ``confirm`` samples after the odds crossed.
What it cannot see: a second line while the first alarm stands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mooringdx.types import Array, Event, Rival

SHARE = 0.05
UNTOLD = (
    "this bank knows no squall, no step of the current and no group of waves: to it each of them, along the line, is "
    "the loss of it; onset_glr weighs them. It has no onset either: the interval is as long as it may lag behind"
)  # fmt: skip


@dataclass(frozen=True)
class Alarm:
    """One alarm, in samples: ``since`` when the line began to win, ``first`` of the alarm, ``named``; ``until`` None
    while it stands.
    """

    line: int
    since: int
    first: int
    named: int
    until: int | None


def held(choice: NDArray[np.int64], hold: int, none: int) -> tuple[Alarm, ...]:
    """Return an alarm for every line that ``choice``, (n,), keeps for ``hold`` samples, until the next is kept."""
    edges = np.flatnonzero(np.diff(choice)) + 1
    starts = np.concatenate([[0], edges]).astype(np.int64)
    ends = np.concatenate([edges, [choice.size]]).astype(np.int64)
    long = (ends - starts) >= max(hold, 1)
    kept: list[int] = []
    for at in starts[long].tolist():
        if not kept or choice[at] != choice[kept[-1]]:
            kept.append(at)
    out, later = [], max(hold, 1) - 1
    for i, at in enumerate(kept):
        if choice[at] != none:
            until = kept[i + 1] + later if i + 1 < len(kept) else None
            out.append(Alarm(int(choice[at]), at, at + later, at + later, until))
    return tuple(out)


def crossed(probability: Array, alarm: float, warning: float, confirm: int) -> tuple[Alarm, ...]:
    """Return an alarm for every time that the log odds of lines, all columns but the last, reach ``alarm``."""
    score = odds(probability)
    high, low = np.flatnonzero(score >= alarm), np.flatnonzero(score < warning)
    out: list[Alarm] = []
    at = 0
    while (i := int(np.searchsorted(high, at))) < high.size:
        first = int(high[i])
        j = int(np.searchsorted(low, first))
        until = int(low[j]) if j < low.size else None
        last = len(score) - 1 if until is None else until - 1
        named = min(first + confirm, max(last, first))
        since = int(low[j - 1]) + 1 if j else 0
        out.append(Alarm(int(np.argmax(probability[named, :-1])), since, first, named, until))
        if until is None:
            break
        at = until
    return tuple(out)


def odds(probability: Array) -> Array:
    """Return ln (all columns but the last / the last), (n,)."""
    least = 1e-300
    return np.asarray(
        np.log(np.maximum(probability[:, :-1].sum(axis=1), least)) - np.log(np.maximum(probability[:, -1], least))
    )


def events(
    alarms: Sequence[Alarm],
    probability: Array,
    lines: Sequence[str],
    clock: tuple[float, float],
    detector: str,
    memory: float,
    level: float | None,
    note: str = "",
) -> tuple[Event, ...]:
    """Return the events of ``alarms``; ``probability``: (n, lines + 1), the last column none.

    ``clock``: s of sample 0, s between samples. ``memory``: s by which the bank may lag behind the loss: the onset's
    interval reaches that far back, which is no 95 % interval: these banks have no onset. ``level``: log odds, or None.
    """
    out = []
    for one in alarms:
        since, first, named = (clock[0] + clock[1] * k for k in (one.since, one.first, one.named))
        chance = probability[one.named]
        peak = odds(probability[one.first : (one.until or len(probability))]).max()
        evidence: dict[str, Any] = {"detector": detector, "warning": since, "peak": float(peak), "threshold": level}
        out.append(
            Event(
                kind="line_lost",
                subject=lines[one.line],
                onset=since,
                onset_interval=(max(since - memory, clock[0]), first),
                detected=first,
                named=named,
                cleared=None if one.until is None else clock[0] + clock[1] * one.until,
                probability=float(chance[one.line]),
                rivals=rivals(chance, one.line, lines),
                cannot_tell=UNTOLD + note,
                evidence=evidence | {"channels": ["north", "east", "heading"]},
            )
        )
    return tuple(out)


def rivals(chance: Array, line: int, lines: Sequence[str]) -> tuple[Rival, ...]:
    """Return the other hypotheses with 5 % or more, the likeliest first; "none" as an unknown force."""
    out = [
        Rival("line_lost", name, float(chance[j]), "its loss explains the innovations less well")
        for j, name in enumerate(lines)
        if j != line and chance[j] >= SHARE
    ]
    if chance[-1] >= SHARE:
        out.append(Rival("environment", "force", float(chance[-1]), "whole lines explain the innovations less well"))
    return tuple(sorted(out, key=lambda r: -r.probability))
