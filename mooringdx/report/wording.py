"""Say a detection in words: times, sizes, rates, causes. No figure, no file."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

from mooringdx.config import rate_text
from mooringdx.types import Detection, Event

WHAT = {
    "line_lost": "{subject} is lost: it no longer pulls at the fairlead",
    "line_parted_low": "{subject} has parted near its anchor; the hanging part still pulls",
    "line_weakened": "{subject} has lost part of its {mode}",
    "sensor_fault": "the sensor {subject} is wrong{mode}",
    "actuator_fault": "the actuator {subject} does not do what it is told{mode}",
    "mooring_lost": "the mooring is lost: the vessel is adrift",
    "moved": "the vessel holds at a new place",
    "environment": "the weather, the sea or the current changed; this is no fault",
    "unknown": "something changed that fits none of the known causes",
}
MODE = {
    "dead": "dead, no reading",
    "stuck": "stuck at one value",
    "bias": "a constant offset",
    "drift": "drifting",
    "gain": "wrong scale",
    "noise": "too noisy",
    "delay": "late against the others",
    "jump": "jumping",
}
MARKS = {
    "extrapolated_threshold": "extrapolated threshold: the level rests on a fitted tail, not on counted alarms",
    "outside_fitted_envelope": "outside the fitted envelope: the sea is rougher than the no-fault record",
    "poorly_explained": "poorly explained: no known cause fits these residuals well; take the name as a hint",
    "while_another_stands": "found while another fault stood: its time is known to two windows only",
    "returned": "returned: the vessel came back to its watch circle",
}
RATE = {
    "supported": "The no-fault record supports the asked rate.",
    "extrapolated": (
        "EXTRAPOLATED: the no-fault record is too short to have seen such rare alarms;"
        " the level rests on a fitted tail. Read the interval, not the asked rate."
    ),
    "invalid": (
        "INVALID: the no-fault record cannot carry any statement about false alarms;"
        " take every alarm as a hint to look, not as a finding."
    ),
}
GRAVITY = (
    "mooring_lost", "line_lost", "line_parted_low", "line_weakened", "sensor_fault", "actuator_fault", "unknown",
    "moved", "environment",
)  # fmt: skip
VERDICT_LONG = {
    "nothing_found": "Nothing was found",
    "cannot_be_judged": "Too much of the log gave no statistic, or its end did: it cannot be judged",
}
VERDICT = {
    "fault_found": "Fault found",
    "nothing_found": "Nothing found",
    "cannot_be_judged": "Cannot be judged",
}


def iso(time: float | None, epoch_ns: int | None) -> str | None:
    """Return a time on the log clock, s, as ISO-8601 UTC to the millisecond; None without an epoch."""
    if time is None or epoch_ns is None or not math.isfinite(time):
        return None
    microseconds = round((epoch_ns + round(time * 1e9)) / 1e6) * 1000
    moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(microseconds=microseconds)
    return moment.strftime("%Y-%m-%dT%H:%M:%S.") + f"{moment.microsecond // 1000:03d}Z"


def clock_text(time: float, epoch_ns: int | None) -> str:
    """Return a time on the log clock, s, for people: "1300.1 s" and the instant where there is one."""
    instant = iso(time, epoch_ns)
    if instant is None:
        return f"{time:.1f} s"
    since = f"{time:.1f} s" if abs(time) < 172800.0 else f"day {time / 86400.0:.4g}"
    return f"{instant.replace('.000Z', 'Z')} ({since} of the log)"


def duration(seconds: float) -> str:
    """Return a span of time for people: "1.5 s", "4.2 min", "2 d"."""
    for per, unit in ((86400.0, "d"), (3600.0, "h"), (60.0, "min")):
        if abs(seconds) >= 2 * per:
            return f"{seconds / per:.3g} {unit}"
    return f"{seconds:.3g} s"


def sentence(text: str) -> str:
    """Return ``text`` with a capital at its start and a stop at its end; names such as line_4 keep their case."""
    text = text.strip()
    if not text:
        return ""
    first = text.split(" ", 1)[0]
    head = text if "_" in first else text[0].upper() + text[1:]
    return head if head[-1] in ".!?" else head + "."


def what(event: Event) -> str:
    """Say what an event is, as a clause without stop."""
    mode = "" if event.mode is None else f": {MODE.get(event.mode, event.mode)}"
    if event.kind == "line_weakened":
        mode = event.mode or ""
    if event.kind == "unknown" and event.subject.startswith("line_"):
        return f"{event.subject} or its tension sensor changed"
    return cause(event.kind, event.subject, mode)


def cause(kind: str, subject: str, mode: str = "") -> str:
    """Say a kind of event about a subject as a clause."""
    if kind == "line_weakened" and not mode:
        mode = "buoyancy or stiffness"
    return WHAT.get(kind, kind.replace("_", " ") + " of {subject}{mode}").format(subject=subject, mode=mode)


def size(event: Event) -> str:
    """Say how big, with its 95 % interval; empty where no size is known."""
    if event.size is None:
        return ""
    if event.size_unit.startswith("share"):
        return _shares(event)
    factor, unit = (1e-3, f"k{event.size_unit}") if _long(event) else (1.0, event.size_unit)
    text = f"{factor * event.size:.4g} {unit}".strip()
    if event.size_interval is None:
        return text
    low, high = event.size_interval
    return f"{text} (95 %: {factor * low:.4g} to {factor * high:.4g})"


def _shares(event: Event) -> str:
    low, high = event.size_interval or (None, None)
    whole = event.size_unit.removeprefix("share of ")
    whole = whole if whole.startswith("the ") else f"its {whole}"
    text = f"{100.0 * (event.size or 0.0):.3g} % of {whole}"
    return text if low is None or high is None else f"{text} (95 %: {100.0 * low:.3g} to {100.0 * high:.3g} %)"


def _long(event: Event) -> bool:
    return event.size is not None and abs(event.size) >= 5000.0 and event.size_unit in ("m", "N", "N m")


def sure(event: Event) -> str:
    """Say how sure the name is."""
    if event.probability is None:
        return "no probability is given"
    return f"probability {_share(event.probability)}"


def _share(p: float) -> str:
    if p > 0.9995:
        return "above 0.999"
    return "below 0.001" if p < 0.0005 else f"{p:.3g}"


def others(event: Event) -> str:
    """Say what else it could be."""
    if not event.rivals:
        return "no rival is left by these data"
    return "; ".join(f"{cause(r.kind, r.subject)} (probability {_share(r.probability)})" for r in event.rivals)


TENSION_SAYS = {
    "line": "the balance of forces says it was the line",
    "sensor": "the balance of forces says it was the sensor",
    "either": "the line or its sensor, it cannot tell which",
    "confirmed": "the gauge confirms the break",
    "refuted": "the gauge lives and still reads the intact line",
    "untold": "the gauge says neither yes nor no",
    "stuck": "the gauge does not move and has no say",
    "not seen": "the gauge of this line was not seen",
}


def witnesses(event: Event) -> str:
    """Say what tension and position say apart, in nats of break over no break; empty where only one was asked."""
    tension, position = event.evidence.get("tension"), event.evidence.get("position")
    if not isinstance(tension, Mapping) or not isinstance(position, Mapping):
        return ""
    words = TENSION_SAYS.get(str(tension.get("verdict")), str(tension.get("verdict")))
    nats = tension.get("log_likelihood_ratio")
    said = f"tension: {words}" + ("" if nats is None else f", {nats:+.3g} nats")
    return f"{said}; position: {_position(event, position)}"


def _position(event: Event, said: Mapping[str, Any]) -> str:
    alarms = said.get("alarms", [said] if "verdict" not in said else [])
    own = [
        f"alarm for {a['subject']} by itself {duration(a['detected'] - event.onset)} after the onset"
        + (" that did not stand" if a["cleared"] is not None else "")
        for a in alarms
    ]
    words = []
    if "verdict" in said:
        seen, score = duration(said["seconds"]), f"{said['log_likelihood_ratio']:+.1f} nats"
        untold = f"break neither confirmed nor refuted, {said['why']}"
        words.append(f"break {said['verdict']} after {seen}, {score}" if said["told"] is not None else untold)
        rows = said.get("trace") or []
        some = [rows[round(i * (len(rows) - 1) / 4)] for i in range(1, 4)] if len(rows) > 4 else []
        if some:
            words.append("on the way " + ", ".join(f"{n:+.1f} at {duration(t)}" for t, n in some))
    return "; ".join([*words, *own])


def when(event: Event, epoch_ns: int | None) -> str:
    """Say the onset with its 95 % interval."""
    low, high = event.onset_interval
    half = max(high - event.onset, event.onset - low)
    around = f", within {duration(half)} (95 %)" if half > 0 else ""
    return clock_text(event.onset, epoch_ns) + around


def delay(event: Event) -> str:
    """Say how fast it was found and named."""
    late = event.detected - event.onset
    words = f"found {duration(late)} after the onset" if late > 0 else "found at the onset"
    if event.named is not None:
        words += f", named after {duration(event.named - event.onset)}"
    return words


def rates(alarm_rate: Mapping[str, Any]) -> str:
    """Say the false-alarm rate: asked, what the record supports, and the verdict on it. Empty where there is none."""
    asked, interval = alarm_rate.get("asked"), alarm_rate.get("interval")
    if asked is None:
        return ""
    words = f"{rate_text(float(asked))} asked"
    if interval is not None:
        low, high = (_rate(r) for r in interval)
        words += f"; this record supports {high} to {low}"
    if alarm_rate.get("central") is not None:
        words += f" (central estimate {_rate(alarm_rate['central'])})"
    reason = sentence(str(alarm_rate.get("reason") or ""))
    return " ".join(x for x in (f"{words}.", RATE.get(str(alarm_rate.get("verdict")), ""), reason) if x)


def _rate(rate: float | None) -> str:
    return "an unknown rate" if rate is None or not math.isfinite(rate) else rate_text(float(rate))


def mark(word: str) -> str:
    """Say a mark of an event."""
    return MARKS.get(word, word.replace("_", " "))


def headline(detection: Detection) -> str:
    """Return the verdict as one line: its word and the leading event."""
    word = VERDICT.get(detection.verdict, detection.verdict.replace("_", " "))
    events = ranked(detection.events)
    if not events:
        return word
    more = f" (and {len(events) - 1} more)" if len(events) > 1 else ""
    return f"{word}: {what(events[0])}{more}"


def ranked(events: Sequence[Event]) -> list[Event]:
    """Return the events with the gravest kind first, in order of onset within a kind."""
    return sorted(events, key=lambda e: GRAVITY.index(e.kind) if e.kind in GRAVITY else len(GRAVITY))


def doubts(detection: Detection) -> list[str]:
    """Return what a signer must know before trusting the verdict: marks, failed checks, an unsupported rate."""
    out = []
    verdict = str(detection.alarm_rate.get("verdict", ""))
    if verdict in ("extrapolated", "invalid"):
        out.append(RATE[verdict])
    marks = dict.fromkeys(m for e in detection.events for m in e.marks)
    out += [sentence(mark(m)) for m in marks if not (m == "extrapolated_threshold" and out)]
    failed = [c for c in detection.checks if not c.passed]
    if failed:
        names = ", ".join(dict.fromkeys(f"{c.name} ({c.subject})" for c in failed[:4]))
        more = f" and {len(failed) - 4} more" if len(failed) > 4 else ""
        plural = "checks" if len(failed) > 1 else "check"
        out.append(f"{len(failed)} {plural} failed: {names}{more}.")
    return out
