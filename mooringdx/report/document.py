"""One self-contained HTML page: the verdict in words first, then the evidence, in the order of its sections."""

from __future__ import annotations

import base64
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from mooringdx import __version__
from mooringdx.config import rate_text
from mooringdx.page import render
from mooringdx.report import wording
from mooringdx.report.record import sentences
from mooringdx.results import encode
from mooringdx.types import Detection, Event

INLINE_SVG = 150_000
"""bytes; larger drawings are shown as PNG, so that a page stays within a few MB."""
OPEN_PANELS = 3
SECTIONS = ("events", "alarms", "hypotheses", "track", "channels", "residuals", "whiteness")


@dataclass(frozen=True)
class Picture:
    """One drawn figure: ``name`` is its file name without ending, ``kind`` its key in FIGURES."""

    name: str
    kind: str
    section: str
    part: str
    caption: str
    png: bytes
    svg: bytes

    @property
    def uri(self) -> str:
        """The picture as a data URI: SVG while it is small, else PNG."""
        if len(self.svg) <= INLINE_SVG:
            return "data:image/svg+xml;base64," + base64.b64encode(self.svg).decode()
        return "data:image/png;base64," + base64.b64encode(self.png).decode()


def pictures(detection: Detection) -> tuple[Picture, ...]:
    """Draw every figure that the detection calls for."""
    from mooringdx.plots import FIGURES, paint, save

    source = f"log sha256 {detection.channels.source.sha256}; configuration {_digest(detection) or 'unknown'}"
    out = []
    for kind, plot in FIGURES.items():
        for part in plot.parts(detection):
            caption = plot.caption(detection, part)
            words = {"Title": f"{detection.name}: {plot.title}", "Description": caption, "Source": source}
            png, svg = save(paint(plot, detection, part), words)
            name = _file_name(part if part.startswith(kind) else f"{kind}_{part}".rstrip("_"))
            out.append(Picture(name, kind, plot.section, part, caption, png, svg))
    return tuple(out)


def _file_name(text: str) -> str:
    return "".join(c if c.isascii() and (c.isalnum() or c in "-_.") else "_" for c in text)


def page(detection: Detection, drawn: Sequence[Picture]) -> str:
    """Return the report as HTML that needs nothing from outside."""
    return render("report.html.j2", context(detection, drawn))


def context(detection: Detection, drawn: Sequence[Picture]) -> dict[str, Any]:
    """Return everything that the template shows."""
    shown = {section: [p for p in drawn if p.section == section] for section in SECTIONS}
    panels = shown["whiteness"]
    return {
        "title": f"{detection.name}: mooring diagnosis",
        "detection": detection,
        "headline": wording.sentence(wording.headline(detection)),
        "sentences": sentences(detection) if len(detection.events) != 1 else [],
        "doubts": wording.doubts(detection),
        "limits": limits(detection),
        "rates": wording.rates(detection.alarm_rate),
        "events": [event_block(detection, i, e, shown) for i, e in enumerate(detection.events, start=1)],
        "shown": shown,
        "panels": (panels[:OPEN_PANELS], panels[OPEN_PANELS:]),
        "thresholds": thresholds(detection),
        "choice": table(candidates(detection.choice)),
        "checks": sorted(detection.checks, key=lambda c: c.passed),
        "identity": identity(detection),
        "provenance": list(flat(encode(dict(detection.provenance)))),
        "run": list(flat(encode(dict(detection.run)))),
        "number": number,
    }


def event_block(
    detection: Detection, index: int, event: Event, shown: Mapping[str, Sequence[Picture]]
) -> dict[str, Any]:
    """Return one event in words, with its rivals and its figure (None beyond the first few)."""
    epoch = detection.channels.grid.epoch_ns
    cleared = "stands at the end of the log" if event.cleared is None else wording.clock_text(event.cleared, epoch)
    facts = [
        ("What", wording.sentence(wording.what(event))),
        ("When", wording.sentence(wording.when(event, epoch))),
        ("How sure", wording.sentence(wording.sure(event))),
        ("What else it could be", wording.sentence(wording.others(event))),
        ("How big", wording.sentence(wording.size(event)) or "No size can be given."),
        ("How fast", wording.sentence(wording.delay(event))),
        ("Until", wording.sentence(cleared)),
        ("What it cannot tell", wording.sentence(event.cannot_tell or "nothing is named as undecidable")),
    ]
    both = wording.witnesses(event)
    facts += [("What each witness says", wording.sentence(both))] if both else []
    return {
        "id": f"event_{index}",
        "event": event,
        "facts": facts,
        "onset": wording.clock_text(event.onset, epoch),
        "detected": wording.clock_text(event.detected, epoch),
        "size": wording.size(event),
        "cause": wording.cause,
        "marks": [wording.mark(m) for m in event.marks],
        "evidence": _evidence(event),
        "pictures": [p for p in shown.get("events", ()) if p.part == f"event_{index}"],
    }


def _evidence(event: Event) -> str:
    e = event.evidence
    words = [f"detector {e['detector']}"] if e.get("detector") else []
    if e.get("peak") is not None:
        words.append(f"peak {number(e['peak'])}")
    if e.get("threshold") is not None:
        words.append(f"alarm level {number(e['threshold'])}")
    named = e.get("channels") or ()
    named = [named] if isinstance(named, str) else list(named)
    return "; ".join(words + ([f"from {', '.join(str(c) for c in named)}"] if named else []))


def limits(detection: Detection) -> list[str]:
    """Say what the whole analysis cannot see."""
    out = []
    valid = detection.channels.valid
    share = float(valid.mean()) if valid.size else 0.0
    if share < 0.9995:
        out.append(f"{100 * share:.1f} % of the samples are valid; what happened in the rest is not judged.")
    if detection.verdict == "nothing_found":
        words = "Nothing found means that no change passed the alarm level; a fault smaller than the detectable one"
        out.append(
            f"{words} (see the whitening table) is not excluded." if detection.choice else f"{words} may be there."
        )
    branches = {s.branch for s in detection.statistics}
    if branches and "slow" not in branches:
        out.append("No slow branch was run: a change so slow that the reference adapts to it is not excluded.")
    if detection.statistics and not {"north", "east"} & set(detection.channels.names):
        out.append("No position in north and east was logged, which is what tells a lost line from a wrong gauge.")
    return out


def thresholds(detection: Detection) -> list[dict[str, str]]:
    """Return one row a branch of the table of alarm levels."""
    return [
        {
            "Branch": t.branch,
            "Asked": rate_text(t.asked_rate),
            "Central estimate": rate_text(t.central_rate),
            "Supported": f"{rate_text(t.rate_interval[1])} to {rate_text(t.rate_interval[0])}",
            "Level, scaled (-)": f"{number(t.scaled_level)} ({number(t.scaled_interval[0])} to "
            f"{number(t.scaled_interval[1])})",
            "Independent windows": number(t.independent_windows),
            "Drift ratio R (-)": number(t.drift_ratio),
            "Verdict": t.verdict.upper() if t.verdict != "supported" else t.verdict,
        }
        for t in detection.thresholds
    ]


def candidates(choice: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the whitening candidates as a table: one row a fault with its smallest size, one column a candidate."""
    if not choice or not isinstance(choice[0].get("smallest"), Mapping):
        return [dict(row) for row in choice]
    names = [f"{row['whitening']} (taken)" if row.get("taken") else str(row["whitening"]) for row in choice]
    faults = list(choice[0]["smallest"])
    return [
        {"fault": fault, **{n: row["smallest"].get(fault) for n, row in zip(names, choice, strict=True)}}
        for fault in faults
    ]


def table(rows: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[tuple[bool, list[str]]]]:
    """Return (columns, rows of texts with a flag for the chosen one) of a list of mappings."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    flags = [c for c in columns if c in ("taken", "chosen")]
    shown = [c for c in columns if c not in flags]
    return shown, [(any(bool(row.get(f)) for f in flags), [number(row.get(c)) for c in shown]) for row in rows]


def number(value: Any) -> str:
    """Return a value as a reader wants it: four digits, yes and no, an en dash for nothing."""
    if value is None:
        return "\N{EN DASH}"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:.4g}"
    if isinstance(value, (list, tuple)):
        return ", ".join(number(v) for v in value)
    return str(value)


def identity(detection: Detection) -> list[tuple[str, str]]:
    """Return what ties the page to its input: log, digests, version, command."""
    source = detection.channels.source
    made = detection.provenance
    grid = detection.channels.grid
    span = f"{wording.clock_text(grid.start, grid.epoch_ns)} to {wording.clock_text(grid.stop, grid.epoch_ns)}"
    rows = [
        ("Log", source.path),
        ("sha256 of the log", source.sha256),
        ("Record", f"{span}; {grid.n:,} samples each {grid.sample_time:g} s; {len(detection.channels.names)} channels"),
        ("mooringdx", str(made.get("mooringdx") or made.get("version") or __version__)),
        ("Configuration digest", _digest(detection)),
        ("Command", str(made.get("command") or "")),
    ]
    return [(key, value) for key, value in rows if value]


def _digest(detection: Detection) -> str:
    made = detection.provenance
    return str(made.get("configuration_digest") or made.get("config_digest") or "")


def flat(body: Mapping[str, Any], prefix: str = "") -> Iterable[tuple[str, str]]:
    """Yield (dotted key, text) of a nested mapping, in its order."""
    for key, value in body.items():
        if isinstance(value, Mapping):
            yield from flat(value, f"{prefix}{key}.")
        elif value not in (None, "", [], {}):
            yield f"{prefix}{key}", number(value)
