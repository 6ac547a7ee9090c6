"""What the onset bank says: events with rivals, and what its verdict rests on as checks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mooringdx.hypotheses.onset.bank import Beat, Trace
from mooringdx.hypotheses.onset.kernel import Odds, doubt, summed
from mooringdx.types import Array, Check, Event, Rival

CANNOT_TELL = (
    "position alone cannot refute a squall or a current step along the line, as large as its pull and as sudden; wind "
    "or a tension can"
)
SHARE = 0.05
LOUD = 1.5


@dataclass(frozen=True)
class Piece:
    """One walk: from sample ``first`` of the log; its own samples before ``skip`` repeat the walk before.

    ``gone``: the line that was named just before, -1 where none.
    """

    first: int
    skip: int
    gone: int
    trace: Trace
    nis: float

    def after(self) -> Array:
        """Return the probabilities from ``skip`` on; without another fault it is the line that was named before."""
        out = np.array(self.trace.probability[self.skip :])
        if self.gone >= 0:
            out[:, 1 + self.gone] += out[:, 0]
            out[:, 0] = 0.0
        return out

    def best(self) -> tuple[int, int]:
        """Return the likeliest line and its likeliest onset, in this walk's samples."""
        lines = self.trace.pulls.shape[1]
        worth = np.array([summed(self.trace.logs[:, j].copy()) for j in range(lines)])
        line = int(np.argmax(worth))
        return line, int(self.trace.when[int(np.argmax(self.trace.logs[:, line]))])


def events(
    pieces: Sequence[Piece],
    lines: tuple[str, ...],
    odds: Odds,
    times: Beat,
    clock: tuple[float, float],
    warning: float,
    alarm: float,
) -> tuple[Event, ...]:
    """Return one event a named line, and one that cleared for every alarm that did not stand.

    ``clock``: s of sample 0, and s between samples.
    """
    out: list[Event] = []
    for one in pieces:
        out += _passed(one, lines, times, clock, warning, alarm)
        if one.trace.alarm >= 0:
            out.append(_named(one, lines, odds, times, clock, warning, alarm))
    return tuple(out)


def _named(
    one: Piece,
    lines: tuple[str, ...],
    odds: Odds,
    times: Beat,
    clock: tuple[float, float],
    warning: float,
    alarm: float,
) -> Event:
    trace = one.trace
    line, _ = one.best()
    chance = trace.probability[trace.named]
    slot = int(np.argmax(trace.logs[:, line]))
    alpha, sd = _share(trace, slot, trace.pulls[slot, line], odds)
    straight = abs(alpha - 1.0) <= 3.0 * odds.along
    onset, low, high = _onset(trace, line, times)
    at = clock[0] + clock[1] * one.first
    return Event(
        kind="line_lost",
        subject=lines[line],
        onset=at + clock[1] * onset,
        onset_interval=(at + clock[1] * low, at + clock[1] * high),
        detected=at + clock[1] * trace.alarm,
        named=at + clock[1] * trace.named,
        size=alpha if straight else None,
        size_unit="share of the line's pull" if straight else "",
        size_interval=(alpha - 1.96 * sd, alpha + 1.96 * sd) if straight else None,
        probability=float(chance[1 + line]),
        rivals=_rivals(chance, line, lines),
        cannot_tell=CANNOT_TELL,
        evidence=_evidence(one, slot, odds, clock, warning, alarm),
    )


def _share(trace: Trace, slot: int, pull: Array, odds: Odds) -> tuple[float, float]:
    """Return which share of its pull a line lost, and its sd, given all that its onset has gathered.

    Far from 1 it says that the vessel went further than a straight-line response holds, and nothing of the share.
    """
    lam, size = trace.lam[slot] / odds.temper, float(np.hypot(pull[0], pull[1]))
    c00, c01, c11 = doubt(pull, odds.along, odds.across)
    spread = np.linalg.inv(lam[:2, :2] + np.linalg.inv(np.array([[c00, c01], [c01, c11]])))
    rest = trace.z[slot] / odds.temper + lam @ pull
    along = pull[:2] / size
    return 1.0 - float(along @ spread @ rest[:2]) / size, float(np.sqrt(along @ spread @ along)) / size


def _onset(trace: Trace, line: int, times: Beat) -> tuple[float, float, float]:
    """Return the likeliest onset and its 95 % interval, samples; an onset stands for what is nearest to it."""
    kept = np.flatnonzero(trace.when >= 0)
    kept = kept[np.argsort(trace.when[kept])]
    when, logs = trace.when[kept].astype(np.float64), trace.logs[kept, line]
    weight = np.exp(logs - logs.max())
    total = np.cumsum(weight) / weight.sum()
    low, high = (int(np.searchsorted(total, x)) for x in (0.025, 0.975))
    high = min(high, len(when) - 1)
    before = when[low] - when[low - 1] if low else float(times.fine)
    after = when[high + 1] - when[high] if high + 1 < len(when) else float(times.fine)
    return float(when[int(np.argmax(logs))]), float(when[low] - 0.5 * before), float(when[high] + 0.5 * after)


def _rivals(chance: Array, line: int, lines: tuple[str, ...]) -> tuple[Rival, ...]:
    """Return what else has a share of 5 % or more, the likeliest first."""
    out = [
        Rival("line_lost", name, float(chance[1 + j]), "the force that was lost points less along this line")
        for j, name in enumerate(lines)
        if j != line and chance[1 + j] >= SHARE
    ]
    whys = ("a change of this size along a line is rarer", "it lasts longer than a group of waves does")
    for i, (subject, why) in enumerate(zip(("force", "wave group"), whys, strict=True)):
        share = float(chance[len(lines) + 1 + i])
        if share >= SHARE:
            out.append(Rival("environment", subject, share, f"{why}; {CANNOT_TELL}" if i == 0 else why))
    return tuple(sorted(out, key=lambda r: -r.probability))


def _evidence(
    one: Piece, slot: int, odds: Odds, clock: tuple[float, float], warning: float, alarm: float
) -> dict[str, Any]:
    trace = one.trace
    lam, z = trace.lam[slot, :2, :2], trace.z[slot, :2]
    cov = odds.temper * np.linalg.inv(lam)
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
    one: Piece, lines: tuple[str, ...], times: Beat, clock: tuple[float, float], warning: float, alarm: float
) -> list[Event]:
    """Return an event for every alarm of this walk that had sunk when it was to be named."""
    trace, out, free = one.trace, [], -1
    end = trace.alarm if trace.alarm >= 0 else len(trace.score)
    at = clock[0] + clock[1] * one.first
    for first, _ in runs(trace.score[:end], alarm):
        if first < free:
            continue
        free = first + times.confirm + 1
        line = int(np.argmax(trace.probability[first, 1 : 1 + len(lines)]))
        sunk = np.flatnonzero(trace.score[first:end] < warning)
        stop = first + (int(sunk[0]) if sunk.size else times.confirm)
        rise = at + clock[1] * _rise(trace.score, first, warning)
        out.append(
            Event(
                kind="line_lost",
                subject=lines[line],
                onset=rise,
                onset_interval=(rise - clock[1] * times.end, rise),
                detected=at + clock[1] * first,
                cleared=at + clock[1] * stop,
                probability=float(trace.probability[first, 1 + line]),
                rivals=_rivals(trace.probability[first], line, lines),
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
    some = max(observability.values(), key=lambda row: -row["r"])
    least = min(row["r"] for row in observability.values())
    loud = pieces[0].nis / 3.0
    warned = runs(score, warning)
    spent = sum(b - a for a, b in warned) * clock[1]
    first = f", the first from {clock[0] + clock[1] * warned[0][0]:.0f} s" if warned else ""
    return (
        Check(
            "not observable", "lines", not blind,
            "; ".join(observability[line]["sentence"] for line in blind) or f"weakest: {some['sentence']}",
            least, 0.1, "1/s",
            "read no news of these lines as no news; log tensions, or a wave height" if blind else "",
        ),
        Check(
            "forces as learned", "position", bool(loud <= LOUD),
            f"mean normalised innovation squared over 3: {loud:.2f} before any alarm", loud, LOUD, "1",
            "" if loud <= LOUD else "the sea is rougher than in the no-fault window: fit on a window of this sea",
        ),
        Check(
            "warnings", "lines", True,
            f"{len(warned)} over {warning:g}{first}, {spent:.0f} s in all", float(len(warned)),
        ),
    )  # fmt: skip
