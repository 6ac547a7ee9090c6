"""The numbers of a detection as data: events.json, events.csv, summary.csv, and a few lines of text."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from mooringdx.report import wording
from mooringdx.results import encode
from mooringdx.types import Check, Detection, Event, Threshold

COLUMNS = (
    "id", "kind", "subject", "mode", "onset", "onset_iso", "onset_low", "onset_high", "detected", "detected_iso",
    "named", "named_iso", "cleared", "cleared_iso", "size_value", "size_unit", "size_low", "size_high", "probability",
    "rivals", "cannot_tell", "detector", "peak", "threshold", "channels", "marks",
)  # fmt: skip
SUMMARY = (
    "name", "verdict", "events", "kind", "subject", "mode", "onset", "onset_iso", "detected", "probability",
    "rivals", "cannot_tell", "alarm_rate_verdict", "failed_checks", "sha256",
)  # fmt: skip


def as_json(detection: Detection) -> dict[str, Any]:
    """Return the content of events.json: JSON-safe, times in s on the log clock and, with an epoch, in ISO-8601."""
    epoch = detection.channels.grid.epoch_ns
    body = {
        "format": "mooringdx events 1",
        "name": detection.name,
        "verdict": detection.verdict,
        "sentences": sentences(detection),
        "alarm_rate": _alarm_rate(detection.alarm_rate),
        "thresholds": [_threshold(t) for t in detection.thresholds],
        "observability": dict(detection.observability),
        "events": [_event(i, e, epoch) for i, e in enumerate(detection.events, start=1)],
        "checks": [_check(c) for c in detection.checks],
        "provenance": {**detection.provenance, "source": detection.channels.source},
    }
    return dict(encode(body))


def _alarm_rate(rate: Mapping[str, Any]) -> dict[str, Any] | None:
    if rate.get("asked") is None:
        return None
    known = {key: rate.get(key) for key in ("asked", "central", "interval", "verdict")}
    return {**known, "unit": "1/s", "words": wording.rates(rate)}


def _threshold(t: Threshold) -> dict[str, Any]:
    return {
        "branch": t.branch,
        "asked": t.asked_rate,
        "central": t.central_rate,
        "interval": t.rate_interval,
        "verdict": t.verdict,
        "reason": t.reason,
        "scaled_level": t.scaled_level,
        "scaled_interval": t.scaled_interval,
        "independent_windows": t.independent_windows,
        "drift_ratio": t.drift_ratio,
    }


def _event(number: int, e: Event, epoch: int | None) -> dict[str, Any]:
    row: dict[str, Any] = {"id": f"event_{number}", "kind": e.kind, "subject": e.subject, "mode": e.mode}
    for key in ("onset", "detected", "named", "cleared"):
        row[key] = getattr(e, key)
        row[f"{key}_iso"] = wording.iso(getattr(e, key), epoch)
    ends = [wording.iso(t, epoch) for t in e.onset_interval]
    size = {"value": e.size, "unit": e.size_unit, "interval": e.size_interval}
    return row | {
        "onset_interval": e.onset_interval,
        "onset_interval_iso": None if epoch is None else ends,
        "size": None if e.size is None else size,
        "probability": e.probability,
        "rivals": [encode(r) for r in e.rivals],
        "cannot_tell": e.cannot_tell,
        "evidence": dict(e.evidence),
        "marks": e.marks,
    }


def _check(c: Check) -> dict[str, Any]:
    return dict(encode(c))


def events_csv(detection: Detection) -> str:
    """Return events.csv: one row an event, named as in events.json; lists joined by "; ", intervals as low and high."""
    epoch = detection.channels.grid.epoch_ns
    rows = []
    for number, event in enumerate(detection.events, start=1):
        row = dict(encode(_event(number, event, epoch)))
        size, evidence = row["size"] or {}, row["evidence"]
        row["onset_low"], row["onset_high"] = row["onset_interval"]
        row["size_value"], row["size_unit"] = size.get("value"), size.get("unit")
        row["size_low"], row["size_high"] = size.get("interval") or (None, None)
        row |= {key: evidence.get(key) for key in ("detector", "peak", "threshold")}
        row["channels"] = "; ".join(str(c) for c in _listed(evidence.get("channels")))
        row["rivals"] = "; ".join(f"{r['kind']} {r['subject']} {r['probability']:.3g}" for r in row["rivals"])
        row["marks"] = "; ".join(row["marks"])
        rows.append(row)
    return _table(COLUMNS, rows)


def _listed(value: Any) -> Iterable[Any]:
    return () if value is None else [value] if isinstance(value, str) else list(value)


def summary_csv(rows: Iterable[Mapping[str, Any]]) -> str:
    """Return summary.csv from the rows of `summary_row`, one a log."""
    return _table(SUMMARY, rows)


def summary_row(detection: Detection) -> dict[str, Any]:
    """Return one log's row of summary.csv, with its gravest event (the first of equals)."""
    body = as_json(detection)
    order = {id(e): i for i, e in enumerate(detection.events)}
    lead: dict[str, Any] = {}
    if detection.events:
        lead = body["events"][order[id(wording.ranked(detection.events)[0])]]
    row = {key: lead.get(key) for key in ("kind", "subject", "mode", "onset", "onset_iso", "detected")}
    return row | {
        "name": detection.name,
        "verdict": detection.verdict,
        "events": len(detection.events),
        "probability": lead.get("probability"),
        "rivals": "; ".join(f"{r['kind']} {r['subject']} {r['probability']:.3g}" for r in lead.get("rivals", ())),
        "cannot_tell": lead.get("cannot_tell"),
        "alarm_rate_verdict": detection.alarm_rate.get("verdict"),
        "failed_checks": sum(not c.passed for c in detection.checks),
        "sha256": detection.channels.source.sha256,
    }


def _table(columns: Sequence[str], rows: Iterable[Mapping[str, Any]]) -> str:
    out = io.StringIO()
    writer = csv.DictWriter(out, columns, extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for row in rows:
        writer.writerow({key: "" if row.get(key) is None else row[key] for key in columns})
    return out.getvalue()


def sentences(detection: Detection) -> list[str]:
    """Return the verdict in words, a sentence an event."""
    epoch = detection.channels.grid.epoch_ns
    said = [wording.sentence(f"{wording.what(e)}, {clock_words(e, epoch)}") for e in detection.events]
    return said or [wording.sentence(wording.VERDICT_LONG.get(detection.verdict, detection.verdict))]


def text(detection: Detection) -> str:
    """Return the outcome for a terminal: at most ten lines in plain words."""
    epoch = detection.channels.grid.epoch_ns
    lines = [f"{detection.name}: {wording.headline(detection)}"]
    ranked = wording.ranked(detection.events)
    for event in ranked[:1]:
        lines += [
            f"  when       {wording.when(event, epoch)}; {wording.delay(event)}",
            f"  how sure   {wording.sure(event)}; what else: {wording.others(event)}",
        ]
        if event.size is not None:
            lines.append(f"  how big    {wording.size(event)}")
        if both := wording.witnesses(event):
            lines.append(f"  witnesses  {both}")
        if event.cannot_tell:
            lines.append(f"  not told   {wording.sentence(event.cannot_tell)}")
    for event in ranked[1:3]:
        lines.append(f"  also       {wording.what(event)}, {clock_words(event, epoch)}")
    if len(detection.events) > 3:
        lines.append(f"  and {len(detection.events) - 3} more events")
    if not detection.events:
        lines.append(f"  {sentences(detection)[0]}")
    said = wording.rates(detection.alarm_rate)
    if said:
        lines.append(f"  false alarms: {said}")
    lines += [f"  note: {words}" for words in wording.doubts(detection) if words not in wording.RATE.values()]
    return "\n".join(lines[:10])


def clock_words(event: Event, epoch: int | None) -> str:
    """Say from when to when an event stands."""
    start = wording.clock_text(event.onset, epoch)
    if event.cleared is None:
        return f"from {start} to the end of the log"
    return f"from {start} to {wording.clock_text(event.cleared, epoch)}"
