"""Score a run file on labelled logs: what was found in each, a fault put on the healthy ones, and the same by other
residuals.

A log's label lists what must be found (subject, allowed rivals, when, how close); a healthy log must stay without
any event. The injection adds a bias to one channel of each healthy log that the fit has not seen. Variants change
the residuals and the whitening and are scored the same way; they are printed to compare, not to pass.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mooringdx.assess.intervals import binomial
from mooringdx.baseline import Baseline
from mooringdx.config import RunConfig, read_toml, validate
from mooringdx.errors import ConfigError, FitError
from mooringdx.logs import read_log
from mooringdx.pipeline import detect, fit, prepare
from mooringdx.results import decode, json_bytes, write_files
from mooringdx.types import Event, RawLog, Signal, replace


@dataclass(frozen=True)
class Expected:
    """One event that a log must show: ``subject``, allowed ``rivals``, ``onset`` with ``within`` in s, or anywhere."""

    subject: str
    mode: str | None = None
    rivals: tuple[str, ...] = ()
    onset: float | None = None
    within: float | None = None
    size: float | None = None
    size_within: float | None = None

    def met_by(self, event: Event) -> bool:
        """Tell whether an event is this one, named alone or with the allowed rivals only."""
        allowed = {self.subject, *self.rivals}
        named = event.subject == self.subject and {r.subject for r in event.rivals} <= allowed
        near = self.onset is None or abs(event.detected - self.onset) <= (self.within or 0.0)
        right = self.size is None or (
            event.size is not None and abs(event.size - self.size) <= (self.size_within or 0.0)
        )
        return named and near and right and self.mode in {None, event.mode}


@dataclass(frozen=True)
class Case:
    """One labelled log."""

    name: str
    log: RawLog
    expected: tuple[Expected, ...]
    fitted_on: bool


def assess_labelled(path: Path, out: Path, data: Path) -> tuple[str, dict[str, Any]]:
    """Carry out a plan of kind "labelled"; see `run_plan`."""
    plan = read_toml(path)
    body = read_toml(path.parent / str(plan["run"]))
    run = validate(RunConfig, body, path)
    cases = [_case(row, run, plan, data) for row in plan["logs"]]
    variants = [{"name": "as configured", "change": {}}, *plan.get("variants", [])]
    tables, result = [], []
    for variant in variants:
        changed = validate(RunConfig, _merged(body, variant["change"]), path)
        rows, injected, note = _score(cases, changed, plan.get("inject"))
        tables.append(_table(str(variant["name"]), rows, injected, note))
        result.append({"variant": variant["name"], "note": note, "logs": rows, "injected": injected})
    text = "\n\n".join(tables)
    write_files(out, {"assess.md": f"```\n{text}\n```\n".encode(), "assess.json": json_bytes(result)})
    return text, {"variants": result}


def _case(row: Mapping[str, Any], run: RunConfig, plan: Mapping[str, Any], data: Path) -> Case:
    name = str(row["log"])
    log = read_log(data / name, run.channels, run.log.time, run.log.csv)
    expected = tuple(decode(Expected, e) for e in row.get("expect", []))
    return Case(name.split(".")[0], log, expected, name in plan["fit"])


def _merged(body: Mapping[str, Any], change: Mapping[str, Any]) -> dict[str, Any]:
    out = {k: dict(v) if isinstance(v, dict) else v for k, v in body.items()}
    for part, values in change.items():
        if not isinstance(values, dict):
            raise ConfigError(
                f"variant: '{part}' must be a table of the run file, such as residuals = {{ use = [...] }}"
            )
        out[part] = {**out.get(part, {}), **values}
    return out


def _score(
    cases: Sequence[Case], run: RunConfig, inject: Mapping[str, Any] | None
) -> tuple[list[dict[str, Any]], list[dict[str, Any]], str]:
    """Fit on the plan's logs, detect on all, and on healthy ones with a bias put in."""
    try:
        baseline = fit([prepare(c.log, run) for c in cases if c.fitted_on], run, extrapolate=True)
    except FitError as error:
        return [], [], f"cannot be fitted: {error}"
    rows = [_row(case, baseline, run) for case in cases]
    injected = []
    for case in cases:
        if inject is not None and not case.expected and not case.fitted_on:
            injected += [
                _injected(case, baseline, run, inject, c, float(s)) for c in inject["channels"] for s in inject["sizes"]
            ]
    return rows, injected, baseline.rate_sentence()


def _row(case: Case, baseline: Baseline, run: RunConfig) -> dict[str, Any]:
    events = detect(prepare(case.log, run), baseline, name=case.name).events
    missing = [e.subject for e in case.expected if not any(e.met_by(x) for x in events)]
    extra = [x for x in events if not any(e.met_by(x) for e in case.expected)]
    return {
        "log": case.name,
        "fitted_on": case.fitted_on,
        "expected": [e.subject for e in case.expected],
        "found": [_words(x) for x in events],
        "missing": missing,
        "extra": [_words(x) for x in extra],
        "right": not missing and not extra,
    }


def _injected(
    case: Case, baseline: Baseline, run: RunConfig, inject: Mapping[str, Any], channel: str, size: float
) -> dict[str, Any]:
    at, within = float(inject["at"]), float(inject["within"])
    signal = case.log.signals[channel]
    values = np.where(signal.time >= at, signal.values + size, signal.values)
    signals = {**case.log.signals, channel: Signal(channel, signal.time, values, signal.unit, signal.source)}
    events = detect(prepare(replace(case.log, signals=signals), run), baseline, name=case.name).events
    first = next((e for e in events if e.detected >= at), None)
    delay = None if first is None else first.detected - at
    early = sum(e.detected < at for e in events)
    alone = first is not None and first.subject == channel and not first.rivals
    return {
        "log": case.name,
        "channel": channel,
        "size": size,
        "delay": delay,
        "found": delay is not None and delay <= within,
        "named_alone": alone,
        "named": None if first is None else _words(first),
        "events": len(events),
        "before": early,
    }


def _words(event: Event) -> str:
    rivals = f" or {', '.join(r.subject for r in event.rivals)}" if event.rivals else ""
    size = "" if event.size is None else f" {event.size:.3g} {event.size_unit}"
    return f"{event.subject}{rivals} ({event.mode or event.kind}{size}) at {event.detected:.2f} s"


def _table(name: str, rows: Sequence[Mapping[str, Any]], injected: Sequence[Mapping[str, Any]], note: str) -> str:
    lines = [f"== {name}", note]
    for row in rows:
        tuned = " (fitted on)" if row["fitted_on"] else ""
        expected = ", ".join(row["expected"]) or "nothing"
        verdict = "right" if row["right"] else "WRONG"
        lines.append(
            f"  {row['log'] + tuned:24s} {verdict:6s} expected {expected}; found {'; '.join(row['found']) or 'nothing'}"
        )
    if injected:
        n = len(injected)
        found, alone = sum(r["found"] for r in injected), sum(r["found"] and r["named_alone"] for r in injected)
        delays = [r["delay"] for r in injected if r["delay"] is not None]
        lines.append(
            f"  bias put on a healthy log: found in time {_share(found, n)}, and named alone {_share(alone, n)}"
        )
        if delays:
            lines.append(f"  delay median {np.median(delays):.2f} s, worst {max(delays):.2f} s (n = {len(delays)})")
        for r in injected:
            if not (r["found"] and r["named_alone"]):
                lines.append(f"    not so: {r['log']} {r['channel']} {r['size']:+g}: {r['named'] or 'nothing found'}")
    return "\n".join(lines)


def _share(count: int, n: int) -> str:
    low, high = binomial(count, n)
    return f"{count} of {n} (95 %: {low:.2f} to {high:.2f})"
