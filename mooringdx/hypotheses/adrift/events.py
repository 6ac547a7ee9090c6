"""From the verdict to events, checks and posterior: each open warning becomes one event with its rivals."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from mooringdx.config import AdriftPart
from mooringdx.hypotheses.adrift.nouns import CALLS, HOLDING, HYPOTHESES, LEARNING, NOT_HOLDING, WARNING, Verdict
from mooringdx.hypotheses.adrift.verdict import judge
from mooringdx.types import Channels, Check, Event, Posterior, Rival

SUBJECT = "mooring"
CANNOT_TELL = {
    "mooring_lost": (
        "Daily positions cannot tell a parted mooring from a buoy aboard a ship or under tow, "
        "nor at first a dragging anchor from a break-away."
    ),
    "moved": (
        "Daily positions cannot tell a service visit with a new anchor from a mooring that dragged, "
        "or parted and was caught, and holds again."
    ),
    "unknown": (
        "The buoy left its watch circle but neither travels nor holds elsewhere: current, a stray fix, a slow drag "
        "and a part-lost mooring look alike in daily positions."
    ),
}
UNSEEN = "a line that parted while the buoy stays inside its watch circle, and any move within it, leave no trace here"
REPEATED_LIMIT = 0.2


@dataclass(frozen=True)
class Adrift:
    """The adrift-or-moved bank on aligned channels ``north`` and ``east`` (m), one sample a day."""

    settings: AdriftPart = field(default_factory=AdriftPart)

    def __call__(self, channels: Channels) -> tuple[Posterior, tuple[Event, ...], tuple[Check, ...]]:
        """Return the posterior (n rows), one event a warning, and checks; samples that are not valid are no fixes."""
        north, east = channels.column("north"), channels.column("east")
        columns = [channels.names.index(name) for name in ("north", "east")]
        valid = channels.valid[:, columns].all(axis=1)
        verdict = judge(
            channels.grid.time, np.where(valid, north, np.nan), np.where(valid, east, np.nan), self.settings
        )
        posterior = Posterior("adrift", HYPOTHESES, verdict.time, verdict.probability)
        return posterior, events(verdict, self.settings), checks(verdict, north, east)


def events(verdict: Verdict, settings: AdriftPart) -> tuple[Event, ...]:
    """Return one event for each warning, in order: ``mooring_lost``, ``moved`` or ``unknown``."""
    fixes = np.flatnonzero(verdict.seen)
    episode = verdict.episode[fixes]
    out = []
    for number in range(int(episode.max(initial=-1)) + 1):
        rows = np.flatnonzero(episode == number)
        out.append(_event(verdict, settings, fixes[rows], fixes[rows[0] - 1], fixes[rows[-1] + 1 : rows[-1] + 2]))
    return tuple(out)


def kind_at(verdict: Verdict, rows: np.ndarray) -> tuple[str, int | None]:
    """Return what the fixes ``rows`` of one warning amount to, and the row at which that was first said.

    More fixes only ever raise the kind: unknown, moved, mooring_lost; what was said is not unsaid.
    """
    call = verdict.call[rows]
    lost = rows[call == NOT_HOLDING]
    if lost.size:
        return "mooring_lost", int(lost[0])
    moved = rows[(call == HOLDING) & ~verdict.near[rows]]
    return ("moved", int(moved[0])) if moved.size else ("unknown", None)


def _event(verdict: Verdict, settings: AdriftPart, rows: np.ndarray, before: int, after: np.ndarray) -> Event:
    time, first = verdict.time, int(rows[0])
    kind, named = kind_at(verdict, rows)
    by_jump = bool(verdict.offset[first] > verdict.limit[first])
    earliest = float(time[before]) if by_jump else float(verdict.rise[first])
    onset = 0.5 * (earliest + float(time[first])) if by_jump else earliest
    lost = after.size > 0 and verdict.call[after[0]] == LEARNING
    offset = float(verdict.offset[rows].max() if kind == "mooring_lost" else verdict.offset[rows[-1]])
    radius = float(verdict.radius[first])
    return Event(
        kind=kind,
        subject=SUBJECT,
        onset=onset,
        onset_interval=(earliest, float(time[first])),
        detected=float(time[first]),
        named=None if named is None else float(time[named]),
        cleared=_cleared(verdict, kind, rows, closed=after.size > 0),
        size=offset,
        size_unit="m",
        size_interval=None if kind == "mooring_lost" else (max(offset - radius, 0.0), offset + radius),
        probability=None if named is None else _probability(verdict, kind, named),
        rivals=_rivals(verdict, kind, named if named is not None else int(rows[-1])),
        cannot_tell=CANNOT_TELL[kind],
        evidence={
            "detector": "adrift",
            "warned_by": "distance" if by_jump else "cusum",
            "peak": float(verdict.not_holding[rows].max()),
            "threshold": settings.alarm,
            "channels": ["north", "east"],
            "cause": _cause(verdict, rows, settings) if kind == "mooring_lost" else None,
            "said": _said(verdict, rows),
        },
        marks=("contact_lost",) * bool(lost) + ("returned",) * bool(named is not None and verdict.near[rows[-1]]),
    )


def _cleared(verdict: Verdict, kind: str, rows: np.ndarray, closed: bool) -> float | None:
    if kind == "mooring_lost":
        last = int(np.flatnonzero(verdict.call[rows] == NOT_HOLDING)[-1])
        if last + 1 < rows.size:
            return float(verdict.time[rows[last + 1]])
    return float(verdict.time[rows[-1]]) if closed else None


def _cause(verdict: Verdict, rows: np.ndarray, settings: AdriftPart) -> str:
    row = rows[verdict.call[rows] == NOT_HOLDING][-1]
    drag, adrift = (float(verdict.probability[row, i : i + 2].sum()) for i in (4, 6))
    share = adrift / (drag + adrift)
    return "adrift" if share >= settings.adrift else "drag" if share <= 1.0 - settings.adrift else "undecided"


def _said(verdict: Verdict, rows: np.ndarray) -> list[dict[str, object]]:
    """Return every change of the call with its time and what P(not holding) and P(holding) were then."""
    call = verdict.call[rows]
    turns = rows[np.concatenate([[True], call[1:] != call[:-1]])]
    return [
        {
            "time": float(verdict.time[i]),
            "call": CALLS[verdict.call[i]] + (" outside" if verdict.call[i] == HOLDING and not verdict.near[i] else ""),
            "not_holding": float(verdict.not_holding[i]),
            "holding": float(verdict.holding[i]),
        }
        for i in turns
    ]


def _probability(verdict: Verdict, kind: str, row: int) -> float:
    return float(verdict.not_holding[row] if kind == "mooring_lost" else verdict.holding[row])


def _rivals(verdict: Verdict, kind: str, row: int) -> tuple[Rival, ...]:
    lost, held = float(verdict.not_holding[row]), float(verdict.holding[row])
    visit = float(verdict.probability[row, 2])
    table = {
        "mooring_lost": Rival("mooring_lost", SUBJECT, lost, "too little travel after the departure"),
        "moved": Rival("moved", SUBJECT, min(1.0, held + visit), "travels on for longer than a service visit does"),
    }
    return tuple(rival for name, rival in table.items() if name != kind)


def checks(verdict: Verdict, north: np.ndarray, east: np.ndarray) -> tuple[Check, ...]:
    """Return what the verdict rests on: learned circle, days with a fix, measured fixes; and what stays unseen."""
    fixes = np.flatnonzero(verdict.seen)
    n = verdict.time.size
    step = np.hypot(np.diff(north[fixes]), np.diff(east[fixes]))
    repeated = float(np.mean(step == 0.0)) if step.size else 0.0
    learned = int(np.count_nonzero(verdict.call[fixes] > LEARNING))
    warned = int(np.count_nonzero(verdict.call[fixes] >= WARNING))
    share = fixes.size / n if n else 0.0
    return (
        Check(
            "watch circle learned",
            "position",
            learned > 0,
            f"{learned} of {fixes.size} fixes judged, {fixes.size - learned} spent on learning, {warned} under warning",
            value=float(learned),
            remedy="" if learned else "give a record with more fixes near one place than [bank.adrift] learn_fixes",
        ),
        Check(
            "days with a fix", "position", share >= 0.5, f"{fixes.size} of {n} samples", share, 0.5, "1",
            "" if share >= 0.5 else "delays below count days, not fixes: read them with the gaps",
        ),
        Check(
            "repeated positions", "position", repeated <= REPEATED_LIMIT,
            f"{100 * repeated:.0f} % of the fixes repeat the one before exactly (nominal or coarse positions)",
            repeated, REPEATED_LIMIT, "1",
            "" if repeated <= REPEATED_LIMIT else "a repeated nominal position cannot show a move: use measured fixes",
        ),
        Check("not observable", "position", True, UNSEEN),
    )  # fmt: skip
