"""Hold what was found in one simulated log against its truth: one answer a fault, a trap, or a healthy log.

The alarm that answers a fault is the first event detected between its onset and ``within`` s later (or the next
fault's onset); an event before the first onset is a false one. Whatever it is called, it counts as found; its name is
that of the event, given one detector window after the alarm. A fault that begins while a false alarm stands raises no
alarm of its own and counts as missed.

    share at t of a fault that grows:   size min(1, (t - onset) / ramp)

Loss at the alarm is that share when the alarm came; the size of the event is held against the share at its sizing,
two windows after the alarm (the middle of the data that size it), where the right line or channel was named.

A bank warns before it alarms, and names a line some time after: the line that led at the alarm is scored apart from the
one that was named.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from mooringdx.assess.simulated import Walked
from mooringdx.assess.simulated_plan import Cell, Expect
from mooringdx.types import Event

CANNOT_TELL, NOTHING = "cannot tell", "nothing"
CAUSES = (
    "line_lost", "line_parted_low", "line_weakened", "sensor_fault", "actuator_fault", "mooring_lost", "environment",
    CANNOT_TELL, NOTHING,
)  # fmt: skip
WORDS = {"line_lost": "line parted", "line_parted_low": "line parted low", "environment": "environment"}
_RIVALS = 4
NOT_A_FAULT = ("environment", "moved")


@dataclass(frozen=True)
class Answer:
    """How one fault (``role`` "fault"), trap or healthy log was answered; a field is None where it does not apply.

    ``truth``: row of the confusion table; ``named``: its column. ``branch``: the detector that raised the alarm first.
    ``told_after``: s from the onset to the name. ``subject_right``: the channel, or a line and its gauge; the kind says
    which of the two.
    ``early``: events before the first onset; ``further``: after the one that answers. ``environment``: the event is
    one, or has it among its rivals. ``discrimination``: d' of the winner against the nearest other cause. ``kinds``: of
    all events. Times in s, ``size_error`` in shares of the whole or in the event's unit, ``loss`` the share lost at the
    alarm. ``warned_after``: s from the onset to the warning that led to the alarm. ``subject_led``: the right line was
    the likeliest at the alarm. ``adjacent``: a wrong line is a neighbour of the right one. ``size_covered``: by its
    interval. ``named_in_time``: some event from the onset on, within ``within``, has the right kind and subject.
    ``environment_probability``: of all rivals of that kind. ``quiet_hours``: before the first onset.
    """

    cell: str
    seed: int
    repeat: int
    weather: int
    role: str
    hours: float
    truth: str = ""
    subject: str = ""
    onset: float | None = None
    found: bool | None = None
    delay: float | None = None
    told_after: float | None = None
    branch: str = ""
    named: str = ""
    mode: str = ""
    kind_right: bool | None = None
    mode_right: bool | None = None
    subject_right: bool | None = None
    right: bool | None = None
    probability: float | None = None
    discrimination: float | None = None
    size_error: float | None = None
    onset_error: float | None = None
    onset_covered: bool | None = None
    loss: float | None = None
    early: int = 0
    further: int = 0
    environment: bool | None = None
    warned_after: float | None = None
    subject_led: bool | None = None
    adjacent: bool | None = None
    size_covered: bool | None = None
    named_in_time: bool | None = None
    environment_probability: float | None = None
    quiet_hours: float = 0.0
    kinds: tuple[str, ...] = ()
    words: str = ""
    refused: str = ""


def answers(cell: Cell, walked: Walked) -> list[Answer]:
    """Return how one log was answered: one answer a fault, or one for its trap, or one for a healthy log."""
    faults, traps = walked.truth["faults"], walked.truth["traps"]
    common: dict[str, Any] = {
        "cell": cell.name,
        "seed": walked.seed,
        "repeat": walked.repeat,
        "weather": walked.weather,
        "hours": walked.hours,
        "kinds": tuple(e.kind for e in walked.events),
        "words": "; ".join(words(e) for e in walked.events),
        "refused": walked.refused,
    }
    if not faults and not traps:
        return [Answer(role="healthy", early=len(walked.events), **common)]
    role = "fault" if faults else "trap"
    causes = sorted(faults or traps, key=lambda c: float(c["onset"]))
    causes = causes if faults else causes[:1]
    ends = [float(c["onset"]) for c in causes[1:]] + [math.inf]
    early = sum(e.detected < float(causes[0]["onset"]) - 1e-6 for e in walked.events)
    out = []
    for i, (cause, end) in enumerate(zip(causes, ends, strict=True)):
        fields = _answer(cell.score, cause, end, walked)
        fields["named_in_time"] = any(_named_so(cell.score, cause, e) for e in walked.events)
        if i == 0:
            fields |= {"early": early, "quiet_hours": float(cause["onset"]) / 3600.0}
        out.append(Answer(role=role, truth=cell.score.truth or cause_words(cause), **common, **fields))
    return out


def _named_so(score: Expect, cause: Mapping[str, Any], event: Event) -> bool:
    """Tell whether an event after a cause's onset, in time, is of its kind and on its subject."""
    after = event.detected - float(cause["onset"])
    return (
        -1e-6 <= after <= (math.inf if score.within is None else score.within)
        and event.kind in (score.kinds or [str(cause["kind"])])
        and _same_place(event.subject, score.subject or cause["subject"])
    )


def _answer(score: Expect, cause: Mapping[str, Any], end: float, walked: Walked) -> dict[str, Any]:
    """Return the fields of an `Answer` that hold one cause against the events."""
    events = walked.events
    onset = float(cause["onset"])
    until = min(end, math.inf if score.within is None else onset + score.within)
    later = sorted((e for e in events if onset - 1e-6 <= e.detected < end), key=lambda e: e.detected)
    head = {"subject": str(cause["subject"]), "onset": onset}
    if not later or later[0].detected > until:
        return {**head, "found": False, "named": NOTHING, "further": len(later)}
    event = later[0]
    kind = event.kind in (score.kinds or [str(cause["kind"])])
    subject = kind if cause["kind"] == "environment" else _same_place(event.subject, score.subject or cause["subject"])
    told = named(event) != CANNOT_TELL
    first, last = event.onset_interval
    discrimination = event.evidence.get("discrimination")
    return {
        **head,
        "found": True,
        "delay": max(event.detected - onset, 0.0),
        "told_after": float(event.evidence.get("cause_told") or event.named or event.detected) - onset,
        "branch": str(event.evidence.get("detector", "")).partition(", ")[0],
        "named": named(event),
        "mode": event.mode or "",
        "kind_right": kind and told,
        "mode_right": kind and told and event.mode in score.modes if score.modes else None,
        "subject_right": subject,
        "right": kind and subject and told,
        "probability": event.probability,
        "discrimination": None if discrimination is None else float(discrimination),
        "size_error": _size_error(score, cause, event) if subject else None,
        "onset_error": event.onset - onset,
        "onset_covered": first - 1e-6 <= onset <= last + 1e-6,
        "loss": share_at(cause, event.detected) if float(cause.get("ramp") or 0.0) > 0.0 else None,
        "further": len(later) - 1,
        "environment": event.kind == "environment" or any(r.kind == "environment" for r in event.rivals),
        **_of_bank(score, cause, event, walked),
    }


def _of_bank(score: Expect, cause: Mapping[str, Any], event: Event, walked: Walked) -> dict[str, Any]:
    """Return what an event of a bank, or one with an interval of its size, says beyond."""
    out: dict[str, Any] = {}
    place = score.subject or str(cause["subject"])
    if walked.leading and cause["kind"] != "environment":
        out["subject_led"] = _same_place(walked.leading[walked.events.index(event)], place)
    wrong, right = (x.partition("_")[2] for x in (event.subject, place))
    if wrong != right and {wrong, right} <= set(walked.lines):
        apart = (walked.lines.index(wrong) - walked.lines.index(right)) % len(walked.lines)
        out["adjacent"] = apart in (1, len(walked.lines) - 1)
    if event.size_interval is not None and event.size_unit.startswith("share") and _same_place(event.subject, place):
        low, high = event.size_interval
        out["size_covered"] = low <= share_at(cause, event.named or event.detected) <= high
    if "warning" in event.evidence:
        out["warned_after"] = max(float(event.evidence["warning"]) - float(cause["onset"]), 0.0)
        out["environment_probability"] = math.fsum(r.probability for r in event.rivals if r.kind == "environment")
    return out


def _same_place(one: str, other: str) -> bool:
    """Tell whether two subjects are one channel, or a line and its gauge: the kind says which of the two."""
    bare = [word.removeprefix("line_").removeprefix("tension_") for word in (one, other)]
    return one == other or (bare[0] == bare[1] and bare[0] != one and bare[1] != other)


def named(event: Event) -> str:
    """Return the column of the confusion table: the kind, or "cannot tell" where rivals of another kind stay level.

    A bank always says what it cannot refute: there the rivals are level when they are at least as likely as the event.
    """
    rivals = [r for r in event.rivals if r.kind != event.kind]
    level = event.cannot_tell is not None and bool(rivals)
    if level and event.probability is not None and "warning" in event.evidence:
        level = math.fsum(r.probability for r in rivals) >= event.probability
    return CANNOT_TELL if event.kind == "unknown" or level else event.kind


def share_at(cause: Mapping[str, Any], time: float) -> float:
    """Return how much of a cause is there at ``time``, s: its size, reached linearly over its ramp."""
    size, ramp = float(cause.get("size") or 0.0), float(cause.get("ramp") or 0.0)
    grown = 1.0 if ramp <= 0.0 else min(max((time - float(cause["onset"])) / ramp, 0.0), 1.0)
    return size * grown


def _size_error(score: Expect, cause: Mapping[str, Any], event: Event) -> float | None:
    """Return size less truth: shares where the event or the plan says so; as it stands for a bias or a drift."""
    shares = event.size_unit.startswith("share")
    if event.size is None or not (shares or score.full is not None or cause.get("mode") in ("bias", "drift")):
        return None
    window = (event.named or event.detected) - event.detected
    truth = share_at(cause, event.detected + 2.0 * window)
    return event.size / (1.0 if shares or score.full is None else score.full) - truth


def cause_words(cause: Mapping[str, Any]) -> str:
    """Return the row of the confusion table: "line parted", "buoyancy lost", "sensor dead", "environment sea_turn"."""
    kind, mode = str(cause["kind"]), cause.get("mode")
    if kind == "line_weakened":
        return f"{mode or 'strength'} lost"
    word = WORDS.get(kind, kind.removesuffix("_fault").replace("_", " "))
    return f"{word} {mode}" if mode else word


def words(event: Event) -> str:
    """Return an event in a few words: what, rivals, size, when."""
    rivals = "".join(f" or {r.kind} {r.subject}" for r in event.rivals[:_RIVALS])
    rivals += f" or {len(event.rivals) - _RIVALS} more" if len(event.rivals) > _RIVALS else ""
    size = "" if event.size is None else f" {event.size:.3g} {event.size_unit}".rstrip()
    mode = f" {event.mode}" if event.mode else ""
    cannot = " cannot be told" if event.cannot_tell else ""
    return f"{event.kind}{mode} {event.subject}{rivals}{size}{cannot} at {event.detected:.1f} s"
