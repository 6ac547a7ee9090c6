"""What the onset bank says: events with rivals, and what its verdict rests on as checks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mooringdx.hypotheses.onset.bank import Beat, Trace
from mooringdx.hypotheses.onset.kernel import Odds, doubt, summed
from mooringdx.hypotheses.onset.losses import Loss
from mooringdx.types import Array, Check, Event, Rival, replace

CANNOT_TELL = (
    "position alone cannot refute a squall or a current step along the line, as large as its pull and as sudden; wind "
    "or a tension can"
)
SHARE = 0.05
STRAIGHT = 0.03
"""Sd of a size, as a share of a pull: the lines that are left do not give way in a straight line."""
LOUD = 1.5
RISEN = 2.0
ALIKE = 0.5
"""What a steady force may differ from a line's pull, as a share of it, to be taken for its loss."""


@dataclass(frozen=True)
class Piece:
    """One walk: from sample ``first`` of the log; its own samples before ``skip`` repeat the walk before.

    ``gone``: the loss that was named before, -1 where none; ``quiet``: its samples before the first onset;
    ``since``: sample of the log up to which all was seen before: an onset found at once may lie as far back.
    """

    first: int
    skip: int
    gone: int
    trace: Trace
    nis: float
    quiet: int
    since: int

    def after(self) -> Array:
        """Return the probabilities from ``skip`` on; without another fault it is the loss that was named before.

        A wave group or a push of the environment after it takes nothing from that loss.
        """
        out = np.array(self.trace.probability[self.skip :])
        if self.gone >= 0:
            for other in (0, -2, -1):
                out[:, 1 + self.gone] += out[:, other]
                out[:, other] = 0.0
        return out

    def best(self) -> tuple[int, int]:
        """Return the likeliest loss and its likeliest onset, in this walk's samples."""
        losses = self.trace.pulls.shape[1]
        worth = np.array([summed(self.trace.logs[:, j].copy()) for j in range(losses)])
        loss = int(np.argmax(worth))
        return loss, int(self.trace.when[int(np.argmax(self.trace.logs[:, loss]))])


def events(
    pieces: Sequence[Piece],
    losses: tuple[Loss, ...],
    odds: Odds,
    times: Beat,
    clock: tuple[float, float],
    warning: float,
    alarm: float,
) -> tuple[Event, ...]:
    """Return one event a named line, and one that cleared for every alarm that did not stand; a pair is two events.

    ``clock``: s of sample 0, and s between samples.
    """
    out: list[Event] = []
    for one in pieces:
        out += _passed(one, losses, times, clock, warning, alarm)
        if one.trace.alarm >= 0:
            event = _named(one, losses, odds, times, clock, warning, alarm)
            out += [replace(event, subject=line) for line in losses[one.best()[0]].lines]
    return tuple(out)


def _named(
    one: Piece,
    losses: tuple[Loss, ...],
    odds: Odds,
    times: Beat,
    clock: tuple[float, float],
    warning: float,
    alarm: float,
) -> Event:
    trace = one.trace
    best, _ = one.best()
    loss = losses[best]
    chance = trace.probability[trace.named]
    slot = int(np.argmax(trace.logs[:, best]))
    alpha, sd = _share(trace, slot, trace.pulls[slot, best], odds)
    straight = abs(alpha - 1.0) <= 3.0 * odds.along
    alpha, sd = loss.share * alpha, loss.share * sd
    onset, low, high = _onset(trace, best, times)
    low = min(low, one.since - one.first) if low <= one.quiet + 2 * times.fine else low
    at = clock[0] + clock[1] * one.first
    return Event(
        kind=loss.kind,
        subject=loss.lines[0],
        onset=at + clock[1] * onset,
        onset_interval=(at + clock[1] * low, at + clock[1] * high),
        detected=at + clock[1] * trace.alarm,
        named=at + clock[1] * trace.named,
        size=alpha if straight else None,
        size_unit="share of the line's pull" if straight else "",
        size_interval=(alpha - 1.96 * sd, alpha + 1.96 * sd) if straight else None,
        probability=float(chance[1 + best]),
        rivals=_rivals(chance, best, losses),
        cannot_tell=CANNOT_TELL,
        evidence=_evidence(one, slot, odds, clock, warning, alarm),
    )


def _share(trace: Trace, slot: int, pull: Array, odds: Odds) -> tuple[float, float]:
    """Return which share of its pull a line lost, and its sd, given all that its onset has gathered.

    Far from 1 it says that the vessel went further than a straight-line response holds, and nothing of the share.
    """
    temper = _temper(trace, slot, odds)
    lam, size = trace.lam[slot] / temper, float(np.hypot(pull[0], pull[1]))
    c00, c01, c11 = doubt(pull, odds.along, odds.across)
    spread = np.linalg.inv(lam[:2, :2] + np.linalg.inv(np.array([[c00, c01], [c01, c11]])))
    rest = trace.z[slot] / temper + lam @ pull
    along = pull[:2] / size
    sd = float(np.sqrt(along @ spread @ along)) / size
    return 1.0 - float(along @ spread @ rest[:2]) / size, float(np.hypot(sd, STRAIGHT))


def _temper(trace: Trace, slot: int, odds: Odds) -> float:
    """Return what the evidence of an onset was divided by when the line was named."""
    return float(trace.rise[trace.named]) * float(
        odds.temper[min(trace.named - int(trace.when[slot]), len(odds.temper) - 1)]
    )


def _onset(trace: Trace, line: int, times: Beat) -> tuple[float, float, float]:
    """Return the likeliest onset and its 95 % interval, samples, no finer than its neighbours on either side."""
    kept = np.flatnonzero(trace.when >= 0)
    kept = kept[np.argsort(trace.when[kept])]
    when, logs = trace.when[kept].astype(np.float64), trace.logs[kept, line]
    weight = np.exp(logs - logs.max())
    total = np.cumsum(weight) / weight.sum()
    low, high = (int(np.searchsorted(total, x)) for x in (0.025, 0.975))
    high = min(high, len(when) - 1)
    before = when[low] - when[low - 1] if low else float(times.fine)
    after = when[high + 1] - when[high] if high + 1 < len(when) else float(times.fine)
    return float(when[int(np.argmax(logs))]), float(when[low] - before), float(when[high] + after)


def _rivals(chance: Array, best: int, losses: tuple[Loss, ...]) -> tuple[Rival, ...]:
    """Return what else has a share of 5 % or more, the likeliest first, and a step of the environment always."""
    n = len(losses)
    out = [
        Rival(loss.kind, " + ".join(loss.lines), float(chance[1 + j]), "the force that was lost fits this less well")
        for j, loss in enumerate(losses)
        if j != best and chance[1 + j] >= SHARE
    ]
    step, group = float(chance[n + 1]), float(chance[n + 2])
    out.append(Rival("environment", "force", step, f"a change of this size along a line is rarer; {CANNOT_TELL}"))
    if group >= SHARE:
        out.append(Rival("environment", "wave group", group, "it lasts longer than a group of waves does"))
    return tuple(sorted(out, key=lambda r: -r.probability))


def _evidence(
    one: Piece, slot: int, odds: Odds, clock: tuple[float, float], warning: float, alarm: float
) -> dict[str, Any]:
    trace = one.trace
    lam, z = trace.lam[slot, :2, :2], trace.z[slot, :2]
    cov = _temper(trace, slot, odds) * np.linalg.inv(lam)
    force = np.linalg.solve(lam, z)
    return {
        "detector": "onset_glr",
        "warning": clock[0] + clock[1] * (one.first + _rise(trace.score, trace.alarm, warning)),
        "peak": float(np.nanmax(trace.score[trace.alarm : trace.named + 1])),
        "threshold": alarm,
        "channels": ["north", "east", "heading"],
        "force": [float(x) for x in force],
        "force_covariance": [[float(x) for x in row] for row in cov],
    }


def _rise(score: Array, at: int, warning: float) -> int:
    """Return the first sample of the run of samples over ``warning`` that leads up to ``at``."""
    low = np.flatnonzero(~(score[: at + 1] >= warning))
    return int(low[-1]) + 1 if low.size else 0


def runs(score: Array, level: float) -> list[tuple[int, int]]:
    """Return the half-open runs of samples at or over ``level``."""
    edge = np.diff(np.concatenate([[0], (score >= level).astype(np.int64), [0]]))
    return list(zip(np.flatnonzero(edge == 1).tolist(), np.flatnonzero(edge == -1).tolist(), strict=True))


def _passed(
    one: Piece, losses: tuple[Loss, ...], times: Beat, clock: tuple[float, float], warning: float, alarm: float
) -> list[Event]:
    """Return an event of the environment for every alarm of this walk that had sunk when it was to be named."""
    trace, out, free = one.trace, [], -1
    end = trace.alarm if trace.alarm >= 0 else len(trace.score)
    at = clock[0] + clock[1] * one.first
    for first, _ in runs(trace.score[:end], alarm):
        if first < free:
            continue
        free = first + times.confirm + 1
        best = int(np.argmax(trace.probability[first, 1 : 1 + len(losses)]))
        sunk = np.flatnonzero(trace.score[first:end] < warning)
        stop = first + (int(sunk[0]) if sunk.size else times.confirm)
        rise = at + clock[1] * _rise(trace.score, first, warning)
        lost = losses[best]
        chance = float(trace.probability[first, 1 + best])
        why = f"the alarm had sunk again {clock[1] * times.confirm:.0f} s later"
        out.append(
            Event(
                kind="environment",
                subject="force",
                onset=rise,
                onset_interval=(rise - clock[1] * times.end, rise),
                detected=at + clock[1] * first,
                cleared=at + clock[1] * stop,
                rivals=(Rival(lost.kind, " + ".join(lost.lines), chance, why),),
                cannot_tell=CANNOT_TELL,
                evidence={
                    "detector": "onset_glr",
                    "warning": rise,
                    "peak": float(trace.score[first]),
                    "threshold": alarm,
                },
            )
        )
    return out


def checks(
    pieces: Sequence[Piece],
    score: Array,
    observability: Mapping[str, Mapping[str, Any]],
    warning: float,
    clock: tuple[float, float],
) -> tuple[Check, ...]:
    """Return whether each line's loss can be seen, whether the sea is as learned, and the warnings that stood."""
    blind = [line for line, row in observability.items() if not row["observable"]]
    weakest = min(observability.values(), key=lambda row: row["r"])
    if not pieces:
        remedy = "map north, east and heading, or mend their gaps"
        return (Check("watched", "position", False, "no stretch with fixes of position and heading", remedy=remedy),)
    loud, rise = pieces[0].nis / 3.0, max(float(one.trace.rise.max()) for one in pieces)
    warned = runs(score, warning)
    spent = sum(b - a for a, b in warned) * clock[1]
    first = f", the first from {clock[0] + clock[1] * warned[0][0]:.0f} s" if warned else ""
    return (
        Check(
            "not observable", "lines", not blind,
            "; ".join(observability[line]["sentence"] for line in blind) or f"weakest: {weakest['sentence']}",
            weakest["margin"], 1.0, "1",
            "read no news of these lines as no news; log tensions, or a wave height" if blind else "",
        ),
        Check(
            "forces as learned", "position", bool(loud <= LOUD),
            f"mean normalised innovation squared over 3: {loud:.2f} before any alarm", loud, LOUD, "1",
            "" if loud <= LOUD else "the sea is rougher than in the no-fault window: fit on a window of this sea",
        ),
        Check(
            "sea as learned", "position", bool(rise <= RISEN),
            f"slow forces gathered {rise:.2f} times the evidence of the no-fault window at most; evidence was lowered "
            "by as much", rise, RISEN, "1",
            "" if rise <= RISEN else "losses are found later, or not: fit on a window of this sea",
        ),
        Check(
            "warnings", "lines", True,
            f"{len(warned)} over {warning:g}{first}, {spent:.0f} s in all", float(len(warned)),
        ),
    )  # fmt: skip


def across(change: Array, losses: Array, lines: Sequence[str], gap: tuple[float, float]) -> tuple[Event | None, Check]:
    """Return how the steady force changed over a ``gap``, s, and an event where a lost line explains it.

    ``change``: (2,), N, north and east; ``losses``: (lines, 2), N. The two sides are means of ten minutes at most.
    """
    row = steady(change, losses, lines, f"the {gap[1] - gap[0]:.0f} s without fixes from {gap[0]:.0f} s on")
    if row.passed:
        return None, row
    line = lines[int(np.argmin(np.hypot(*(losses - change).T)))]
    why = "nothing was seen while the force changed"
    event = Event(
        kind="unknown",
        subject=line,
        onset=0.5 * (gap[0] + gap[1]),
        onset_interval=gap,
        detected=gap[1],
        rivals=(Rival("line_lost", line, 0.5, why), Rival("environment", "force", 0.5, why)),
        cannot_tell=f"{line} was lost while there were no fixes, or current or wind changed by as much: {row.detail}",
        evidence={"detector": "onset_glr", "force": [float(x) for x in change]},
    )
    return event, row


def steady(
    change: Array, losses: Array, lines: Sequence[str], since: str = "this log, in the no-fault window"
) -> Check:
    """Return how a steady force has changed, (2,), N, north and east, beside what lost lines do, (lines, 2), N.

    A line that was lost between the no-fault window and the log leaves no onset: it looks like a current.
    """
    if not np.isfinite(change).all():
        return Check("steady force", "position", True, "not known: the log is shorter than the warm-up", None)
    size = float(np.hypot(*change))
    near = int(np.argmin(np.hypot(*(losses - change).T)))
    whole = float(np.hypot(*losses[near]))
    left = float(np.hypot(*(losses[near] - change))) / whole
    towards = float(np.degrees(np.arctan2(change[1], change[0]))) % 360.0
    words = f"{size / 1e3:.3g} kN towards {towards:.0f} deg more than before {since}; nearest to the loss of "
    words += f"{lines[near]}, which is {whole / 1e3:.3g} kN"
    return Check(
        "steady force", "position", left >= ALIKE, words, 1.0 - left, 1.0 - ALIKE, "1",
        "" if left >= ALIKE else f"see whether {lines[near]} was lost meanwhile: a current looks the same here",
    )  # fmt: skip
