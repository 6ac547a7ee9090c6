"""One verdict where tensions and position are both logged: what the branches say apart, and of that one event.

Tensions name a line or its gauge at once but cannot tell the two apart; position tells whether a pull was lost:

    line j, not its gauge           1 / (1 + e^-L)                even odds before
    line or gauge j, no other       1 - sum over others of q/o    q: by tensions, o: odds of position's own alarm

L is the log likelihood ratio of the line's loss at the tension's onset, where it was told
(`mooringdx.hypotheses.onset.witness`); o is 1 where position raised no alarm for line j by itself. Gauges and position
err independently, so that these multiply; the balance of forces reads the same positions as L, so that it is not
multiplied with it: of two that agree the surer stands. A cause is named only if no branch contradicts it: the balance
of forces does when its own ratio is beyond 7 nats the other way. An alarm of position alone is held against line j's
gauge, with r its mean residual since the onset, v what a total loss does to it and s the sd of r:

    L_T = (v r - v^2 / 2) / s^2                                                          [Basseville1993, ch. 2]

Below -7 a gauge that lives refutes the break: the environment pushed the vessel. What it cannot see: a gauge that dies
in the minute in which a squall pushes along its line; the loss of a part of a pull, of which position is not asked.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mooringdx.baseline import Fitted
from mooringdx.checks import agitation
from mooringdx.hypotheses.onset.witness import CERTAIN, Heard, summary
from mooringdx.residuals.tension import Tension
from mooringdx.residuals.training import SIGNATURE_ERROR
from mooringdx.types import Channels, Check, Event, Residuals, Rival, replace

Ask = Callable[[str, tuple[float, float], float], Heard]
LEAST_SHARE = 0.7
"""Share of a tension that must be gone before position is asked: two sd less than the whole of a pull."""
DEAD_SHARE = 0.95
REACH = 60.0
"""s at full scale by which the onsets of one fault may differ between the branches."""
_LIVES = 0.1


@dataclass(frozen=True)
class Spoken:
    """A gauge's testimony on its line's loss: ``score``, nats (None: not seen); ``alive``: it is not held."""

    score: float | None
    alive: bool


@dataclass(frozen=True)
class Gauges:
    """The tension residuals of one log, as witnesses against what position says alone."""

    channels: Channels
    residuals: Residuals
    fitted: Fitted
    part: Tension

    def line_of(self, subject: str) -> str | None:
        """Return the line that an event's subject is, or whose gauge it is; None for anything else."""
        return next((line for line, channel in self.part.lines if subject in (line, channel)), None)

    def channel_of(self, line: str) -> str | None:
        """Return the gauge of a line, None where it has none."""
        return dict(self.part.lines).get(line)

    def whole(self, line: str) -> float:
        """Return the tension of the intact line, N, at the middle of the no-fault places."""
        return self.part.intact(line, np.full((1, len(self.part.lines)), np.nan))

    def fall(self, event: Event) -> float | None:
        """Return which share of the line's tension is gone by its gauge; None where the event does not say."""
        line = self.line_of(event.subject)
        change = event.evidence.get("tension_change", event.size if event.size_unit == "N" else None)
        return None if line is None or change is None else -float(change) / self.whole(line)

    def spoken(self, line: str, start: float, stop: float) -> Spoken:
        """Return what the line's gauge says of its loss from ``start`` to ``stop``, s."""
        channel = self.channel_of(line)
        if channel is None:
            return Spoken(None, True)
        row, column = self.residuals.names.index(f"{channel} - intact"), self.channels.names.index(channel)
        look = self.channels.grid.window((start, stop))
        values = self.residuals.values[look, row][self.residuals.valid[look, row]]
        moves = agitation(self.channels.values[look])[column] > _LIVES * self.fitted.agitation[column]
        held = any(
            d.mode == "stuck" and channel in d.subjects and d.start < stop and d.stop > start
            for d in self.channels.defects
        )
        if len(values) < 4:
            return Spoken(None, not held)
        loss = self.part.parted - self.whole(line)
        spread = float(self.fitted.raw.covariance[row, row]) / min(len(values), self.fitted.timing.window)
        spread += (SIGNATURE_ERROR * loss) ** 2
        mean = float(values.mean()) - float(self.fitted.raw.mean[row])
        return Spoken((loss * mean - 0.5 * loss**2) / spread, bool(moves) and not held)


def gauges(channels: Channels, residuals: Residuals, fitted: Fitted) -> Gauges | None:
    """Return the gauges of a log; None where the run has no tension residuals."""
    part = next((p for p in fitted.stack.parts if isinstance(p, Tension)), None)
    return None if part is None else Gauges(channels, residuals, fitted, part)


def fuse(
    tension: Sequence[Event], position: Sequence[Event], ask: Ask, known: Gauges, reach: float = REACH
) -> tuple[tuple[Event, ...], tuple[Check, ...]]:
    """Return one list of events from both branches, and a check row for every contradiction.

    Parameters
    ----------
    tension, position : the branches' own events.
    ask : position's testimony on (line, onset interval in s, s up to which to look).
    known : the gauges. ``reach``: s by which onsets may differ.

    What was folded into another event stands in its evidence, under ``position`` and ``tension``.
    """
    asked: list[tuple[Event, Heard]] = []
    events: list[Event] = []
    for event in sorted(tension, key=lambda e: e.onset):
        share = known.fall(event)
        if share is None or share < LEAST_SHARE:
            events.append(event)
            continue
        after = [e.onset for e in tension if e.onset > event.onset_interval[1] + reach]
        asked.append((event, ask(str(known.line_of(event.subject)), event.onset_interval, min(after, default=np.inf))))
    folded: dict[int, list[Event]] = {}
    rows: list[Check] = []
    for own in position:
        at = _partner(own, asked, known, reach)
        if at is not None:
            folded.setdefault(at, []).append(own)
            continue
        alone, row = _alone(own, known)
        events.append(alone)
        rows += row
    for i, (event, heard) in enumerate(asked):
        one, row = _both(event, heard, folded.get(i, []), known)
        events.append(one)
        rows += row
    if asked and not rows:
        rows.append(Check("branches disagree", "tension, position", True, "no testimony contradicts another", 0.0))
    return tuple(sorted(events, key=lambda e: (e.onset, e.detected, e.subject))), tuple(rows)


def _partner(own: Event, asked: Sequence[tuple[Event, Heard]], known: Gauges, reach: float) -> int | None:
    """Return which asked event position's ``own`` is about: the same line first, then the nearest onset."""
    near = []
    for i, (event, heard) in enumerate(asked):
        same = known.line_of(event.subject) == own.subject
        low, high = own.onset_interval
        apart = max(low - event.onset_interval[1], event.onset_interval[0] - high, 0.0)
        if apart <= reach and (same or heard.verdict != "refuted"):
            near.append((not same, abs(own.onset - event.onset), i))
    return min(near)[2] if near else None


def _alone(own: Event, known: Gauges) -> tuple[Event, list[Check]]:
    """Return an alarm of position alone, held against the gauge of its line."""
    until = own.named or own.cleared or own.detected
    said = known.spoken(own.subject, min(own.onset_interval[1], own.detected), until)
    words: dict[str, Any] = {"verdict": "not seen", "log_likelihood_ratio": said.score}
    if not said.alive:
        detail = f"position says {own.subject} is lost; its gauge does not move and can neither confirm nor refute it"
        told = replace(own, cannot_tell=f"{own.cannot_tell}; the gauge of {own.subject} does not move")
        row = _row(own.subject, detail, said.score, "have the gauge looked at; it may have died before")
        return _with(told, position=_own(own), tension=words | {"verdict": "stuck"}), [row]
    if said.score is None:
        return _with(own, position=_own(own), tension=words), []
    if said.score > -CERTAIN:
        verdict = "confirmed" if said.score >= CERTAIN else "untold"
        return _with(own, position=_own(own), tension=words | {"verdict": verdict}), []
    odds = _log_odds(own.probability) + said.score
    share = 1.0 / (1.0 + math.exp(min(-odds, 700.0)))
    why = f"its gauge lives and still reads the intact line, {said.score:.3g} nats"
    event = replace(
        own, kind="environment", subject="force", size=None, size_unit="", size_interval=None,
        probability=1.0 - share, rivals=(Rival(own.kind, own.subject, share, why),), cannot_tell=None,
    )  # fmt: skip
    return _with(event, position=_own(own), tension=words | {"verdict": "refuted"}), []


def _both(event: Event, heard: Heard, own: Sequence[Event], known: Gauges) -> tuple[Event, list[Check]]:
    """Return the one event of a line or gauge of which both branches spoke."""
    line = heard.line
    channel = str(known.channel_of(line))
    alarm = next((e for e in own if e.subject == line and e.cleared is None), None)
    verdict = "confirmed" if alarm is not None else heard.verdict
    forces = _forces(event)
    says = "either" if abs(forces) < CERTAIN else "line" if forces > 0.0 else "sensor"
    spoke = {key: event.evidence.get(key) for key in ("discrimination", "log_likelihood_ratio", "cause_told")}
    noted = _with(
        event,
        tension={"verdict": says, "kind": event.kind, "subject": event.subject, **spoke},
        position={**summary(heard), "verdict": verdict, "alarms": [_own(e) for e in own]},
    )
    noted = replace(noted, detected=min([event.detected, *(e.detected for e in own if e.subject == line)]))
    wanted = {"confirmed": "line", "refuted": "sensor"}.get(verdict)
    if wanted is None:
        return noted, []
    named = event.named if event.named is not None else event.detected
    window = known.fitted.timing.window * known.channels.grid.sample_time
    told = max(min(named, event.detected + window), heard.time if heard.verdict == verdict else _told(alarm))
    score = heard.score if heard.verdict == verdict else _log_odds(alarm.probability if alarm else None)
    if says not in ("either", wanted):
        return _apart(noted, line, channel, (forces, score), max(told, named), known)
    told = min(told, named) if says == wanted else told
    sure = 1.0 / (1.0 + math.exp(-min(abs(score), 700.0)))
    if says == wanted and event.probability is not None:
        sure = max(sure, event.probability)
    loser = Rival(
        *(("sensor_fault", channel) if wanted == "line" else (_lost(event, line, known), line)),
        1.0 - sure,
        f"position {'confirmed' if wanted == 'line' else 'refuted'} the break, {score:+.1f} nats",
    )
    others = _others(event, line, channel, alarm if wanted == "line" else None)
    pair = max(1.0 - sum(r.probability for r in others), 0.0)
    rivals = (*(() if says == wanted else (loser,)), *others)
    out = replace(
        noted, probability=sure * pair, rivals=rivals, cannot_tell=None, named=told,
        evidence={**noted.evidence, "cause_told": told},
    )  # fmt: skip
    return _named(out, event, wanted, line, channel, known), []


def _named(out: Event, event: Event, wanted: str, line: str, channel: str, known: Gauges) -> Event:
    """Return the event under the name that both branches bear, with the size that is usual for that name."""
    share, whole = known.fall(event) or 0.0, known.whole(line)
    change = event.evidence.get("tension_change", event.size)
    ends = event.evidence.get("tension_change_interval", event.size_interval)
    if wanted == "sensor":
        mode = "dead" if share >= DEAD_SHARE else event.mode if event.kind == "sensor_fault" else "bias"
        interval = None if ends is None else (float(ends[0]), float(ends[1]))
        return replace(
            out, kind="sensor_fault", subject=channel, mode=mode, size=change, size_unit="N", size_interval=interval
        )
    if event.kind in ("line_lost", "line_parted_low"):
        return out
    kept = {**out.evidence, "tension_change": change, "tension_change_interval": None if ends is None else list(ends)}
    return replace(
        out, kind=_lost(event, line, known), subject=line, mode=None, size=share, size_unit="share of tension",
        size_interval=None if ends is None else (-ends[1] / whole, -ends[0] / whole), evidence=kept,
    )  # fmt: skip


def _apart(
    event: Event, line: str, channel: str, scores: tuple[float, float], told: float, known: Gauges
) -> tuple[Event, list[Check]]:
    """Return an event of which the branches say opposite things: both causes stand, none is named."""
    forces, score = scores
    words = f"the balance of forces says {'the line' if forces > 0.0 else 'its sensor'} ({forces:+.1f} nats)"
    words += f", position says the break {'happened' if score > 0.0 else 'did not happen'} ({score:+.1f} nats)"
    rivals = (
        Rival(_lost(event, line, known), line, 0.5, f"against it: {min(scores):+.1f} nats"),
        Rival("sensor_fault", channel, 0.5, f"against it: {max(scores):+.1f} nats for the line"),
    )
    sizes = event.evidence.get("tension_change", event.size), event.evidence.get("tension_change_interval")
    ends = event.size_interval if sizes[1] is None else (float(sizes[1][0]), float(sizes[1][1]))
    out = replace(
        event, kind="unknown", subject=line, mode=None, size=sizes[0], size_unit="N", size_interval=ends,
        probability=None, rivals=rivals, cannot_tell=f"{line} or {channel}: {words}", named=told,
    )  # fmt: skip
    return out, [_row(line, words, score, f"look at {line} and at its gauge; take neither name as a finding")]


def _row(subject: str, detail: str, value: float | None, remedy: str) -> Check:
    return Check("branches disagree", subject, False, detail, value, CERTAIN, "nat", remedy)


def _forces(event: Event) -> float:
    """Return the nats of line over sensor by the balance of forces; 0 where it told nothing."""
    told = event.kind != "unknown" and event.cannot_tell is None
    value = event.evidence.get("log_likelihood_ratio")
    return float(value) if told and value is not None else 0.0


def _lost(event: Event, line: str, known: Gauges) -> str:
    """Return which kind of loss the tension that is left says."""
    if event.kind in ("line_lost", "line_parted_low"):
        return event.kind
    share = known.fall(event)
    left = np.full((1, len(known.part.lines)), np.nan)
    return known.part.kind(line, -(1.0 if share is None else share) * known.whole(line), 0.0, left)


def _others(event: Event, line: str, channel: str, alarm: Event | None) -> tuple[Rival, ...]:
    """Return the tension's rivals beside the pair; where position alarmed by itself its odds come on top."""
    rest = [r for r in event.rivals if r.subject not in (line, channel, "force")]  # of forces position has spoken
    lower = math.exp(-max(_log_odds(alarm.probability), 0.0)) if alarm is not None else 1.0
    return tuple(replace(r, probability=r.probability * lower) for r in rest)


def _own(event: Event) -> dict[str, Any]:
    """Return an alarm of position's own as evidence."""
    rivals = [{"kind": r.kind, "subject": r.subject, "probability": r.probability} for r in event.rivals]
    return {
        "kind": event.kind, "subject": event.subject, "onset": event.onset, "detected": event.detected,
        "named": event.named, "cleared": event.cleared, "probability": event.probability,
        "peak": event.evidence.get("peak"), "threshold": event.evidence.get("threshold"), "rivals": rivals,
    }  # fmt: skip


def _told(event: Event | None) -> float:
    return -math.inf if event is None else event.named or event.detected


def _log_odds(probability: float | None) -> float:
    p = min(max(0.5 if probability is None else probability, 1e-12), 1.0 - 1e-12)
    return math.log(p / (1.0 - p))


def _with(event: Event, **spoken: Mapping[str, Any]) -> Event:
    return replace(event, evidence={**event.evidence, **spoken})
