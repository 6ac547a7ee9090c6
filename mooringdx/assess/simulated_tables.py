"""The numbers of an assessment on simulated logs, as text, Markdown, JSON-safe values and a row a log.

    calibration: of two causes d' apart (standard deviations) the likelier is right in Phi(d'/2) of cases

Intervals and quantiles: `mooringdx.assess.simulated_figures`; what a bank adds: `mooringdx.assess.simulated_bank`.
"""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from mooringdx import __version__
from mooringdx.assess import simulated_bank
from mooringdx.assess.simulated import Walked
from mooringdx.assess.simulated_figures import (
    HOUR,
    MONTH,
    columns,
    number_text,
    quantile,
    quantile_text,
    rate,
    rate_in,
    share,
    share_text,
)
from mooringdx.assess.simulated_plan import Cell, Job
from mooringdx.assess.simulated_score import CANNOT_TELL, CAUSES, NOT_A_FAULT, NOTHING, Answer, answers
from mooringdx.config import rate_text
from mooringdx.results import encode, json_bytes

BINS = (0.0, 3.0, 3.3, 4.7, math.inf)
"""d': under 3 the cause "cannot be told"; 3, 3.3 and 4.7 are a right name in 93, 95 and 99 % of cases."""
TIMES: tuple[str, ...] = (
    "fault", "found", "delay s: median", "90 %", "95 %", "worst", "named after s: median", "90 %", "false before",
    "raised by",
)  # fmt: skip
NAMES: tuple[str, ...] = (
    "of the found ones", "line or channel right", "kind right", "both right", "mode right", "cannot tell",
    "size off: median", "95 %", "onset off s: median", "95 %", "onset in interval", "loss at alarm: median", "90 %",
)  # fmt: skip


def summary(job: Job, walked: Sequence[Walked]) -> dict[str, Any]:
    """Return every figure of the plan as plain values."""
    rows = {cell.name: [a for w in walked if w.cell == i for a in answers(cell, w)]
            for i, cell in enumerate(job.plan.cells)}  # fmt: skip
    every = [a for found in rows.values() for a in found if not a.refused]
    cells = []
    for i, cell in enumerate(job.plan.cells):
        run = job.lesson(i).run
        cells.append(_cell(cell, rows[cell.name], run.alarm.rate if run.residuals.use else None))
    return {
        "kind": "simulated",
        "version": __version__,
        "plan": job.plan.model_dump(mode="json"),
        "run_digests": list(dict.fromkeys(lesson.run.digest() for lesson in job.lessons)),
        "cells": cells,
        "confusion": confusion(every),
        "calibration": calibration(every),
    }


def _cell(cell: Cell, rows: Sequence[Answer], asked: float | None) -> dict[str, Any]:
    scored = [r for r in rows if not r.refused]
    refused = [{"seed": r.seed, "why": r.refused} for r in rows if r.refused]
    role = rows[0].role if rows else "fault"
    others = {"trap": trap_numbers, "healthy": healthy_numbers}
    figures = others[role](scored, asked) if role in others else fault_numbers(scored)
    banks = {"fault": simulated_bank.fault_numbers, "trap": simulated_bank.trap_numbers}
    bank = banks[role](scored) if role in banks else None
    return {"name": cell.name, "role": role, "n": len(scored), "refused": refused, **figures, "bank": bank}


def fault_numbers(rows: Sequence[Answer]) -> dict[str, Any]:
    """Return the figures of a cell with faults; names, sizes and onsets are shares of the found ones."""
    found = [r for r in rows if r.found]
    delays = [r.delay if r.delay is not None else math.inf for r in rows]
    told = [r.told_after if r.told_after is not None and r.named != CANNOT_TELL else math.inf for r in rows]
    sizes = [abs(r.size_error) for r in found if r.size_error is not None]
    onsets = [abs(r.onset_error) for r in found if r.onset_error is not None]
    grows = any(r.loss is not None for r in rows)
    losses = [r.loss if r.loss is not None else math.inf for r in rows]
    return {
        "found": share(r.found for r in rows),
        "delay": {"median": quantile(delays, 0.5), "90": quantile(delays, 0.9), "95": quantile(delays, 0.95),
                  "max": max(delays, default=None)},
        "told_after": {"median": quantile(told, 0.5), "90": quantile(told, 0.9)},
        "raised_by": dict(Counter(r.branch for r in found).most_common()),
        "kind_right": share(r.kind_right for r in found),
        "mode_right": share(r.mode_right for r in found),
        "modes": dict(Counter(r.mode for r in found if r.mode).most_common()),
        "subject_right": share(r.subject_right for r in found),
        "right": share(r.right for r in found),
        "cannot_tell": share(r.named == CANNOT_TELL for r in found),
        "size_error": {"median": quantile(sizes, 0.5), "95": quantile(sizes, 0.95)},
        "onset_error": {"median": quantile(onsets, 0.5), "95": quantile(onsets, 0.95)},
        "onset_covered": share(r.onset_covered for r in found),
        "loss_at_alarm": {"median": quantile(losses, 0.5), "90": quantile(losses, 0.9)} if grows else None,
        "false_before": sum(r.early for r in rows),
        "further_events": sum(r.further for r in found),
    }  # fmt: skip


def trap_numbers(rows: Sequence[Answer], asked: float | None) -> dict[str, Any]:
    """Return the figures of a cell in which nothing failed but the environment changed; ``asked``: rate, 1/s."""
    hours = math.fsum(r.hours for r in rows)
    faults = [k for r in rows for k in r.kinds if k not in NOT_A_FAULT]
    said = [r for r in rows if r.found]
    wrong = [r for r in said if r.named not in (*NOT_A_FAULT, CANNOT_TELL)]
    return {
        "without_any_event": share(not r.found for r in rows),
        "fault_named": share(r in wrong for r in rows),
        "environment_said": share(r.environment for r in said),
        "named": dict(Counter(r.named for r in rows).most_common()),
        "hours": hours,
        "faults": rate(len(faults), hours, asked),
        "runs_with_a_fault_event": share(any(k not in NOT_A_FAULT for k in r.kinds[r.early :]) for r in rows),
        "false_before": sum(r.early for r in rows),
    }


def healthy_numbers(rows: Sequence[Answer], asked: float | None) -> dict[str, Any]:
    """Return the false alarms of healthy logs per hour; with their ratio to the asked rate, 1/s, where there is one."""
    hours = math.fsum(r.hours for r in rows)
    kinds = [k for r in rows for k in r.kinds]
    return {
        "hours": hours,
        "asked_per_hour": None if asked is None else asked * HOUR,
        "all": rate(len(kinds), hours, asked),
        "faults": rate(sum(k not in NOT_A_FAULT for k in kinds), hours, asked),
        "by_kind": dict(Counter(kinds).most_common()),
        "logs_with_an_alarm": share(bool(r.kinds) for r in rows),
    }


def confusion(rows: Sequence[Answer]) -> dict[str, dict[str, Any]]:
    """Return truth by named cause: the count of each, and n; with the share of right kind and subject among all."""
    out: dict[str, dict[str, Any]] = {}
    for truth in dict.fromkeys(r.truth for r in rows if r.truth):
        mine = [r for r in rows if r.truth == truth]
        counts = Counter(r.named for r in mine)
        columns = {c: counts[c] for c in (*CAUSES, *sorted(set(counts) - set(CAUSES)))}
        out[truth] = {"n": len(mine), "named": columns, "right": share(bool(r.right) for r in mine)}
    return out


def calibration(rows: Sequence[Answer]) -> list[dict[str, Any]]:
    """Return, by discrimination d', how often the named cause is right beside what d' promises."""
    from scipy.special import ndtr

    with_d = [r for r in rows if r.found and r.discrimination is not None]
    out = []
    for low, high in pairwise(BINS):
        mine = [r for r in with_d if low <= float(r.discrimination or 0.0) < high]
        told = [r for r in mine if r.named != CANNOT_TELL]
        promised = [float(ndtr(float(r.discrimination or 0.0) / 2.0)) for r in told]
        said = [r.probability for r in told if r.probability is not None]
        out.append(
            {
                "from": low,
                "to": high,
                "n": len(mine),
                "named_a_cause": len(told),
                "right_of_named": share(bool(r.right) for r in told),
                "promised": float(np.mean(promised)) if promised else None,
                "mean_probability": float(np.mean(said)) if said else None,
            }
        )
    return out


def text(result: Mapping[str, Any]) -> str:
    """Return the tables for the terminal."""
    parts = ["Simulated logs: [a, b] is a 95 % interval (?: too few logs); a missed fault counts as an infinite delay"]
    for role, block in (("fault", _faults), ("trap", _traps), ("healthy", _healthy)):
        cells = [c for c in result["cells"] if c["role"] == role and c["n"]]
        if cells:
            parts.append("\n".join(block(cells)))
    if judged := simulated_bank.text([c for c in result["cells"] if c["n"]]):
        parts.append("\n".join(["Alarms of a bank", *judged]))
    if result["confusion"]:
        parts.append("\n".join(_confusion(result["confusion"])))
    if any(b["n"] for b in result["calibration"]):
        parts.append("\n".join(_calibration(result["calibration"])))
    refused = [(c["name"], r) for c in result["cells"] for r in c["refused"]]
    if refused:
        parts.append("\n".join(["Not scored: the training log was refused",
                                *(f"  {name}, seed {r['seed']}: {r['why']}" for name, r in refused)]))  # fmt: skip
    return "\n\n".join([*parts, "Every log with its events: runs.csv"])


def _faults(cells: Sequence[Mapping[str, Any]]) -> list[str]:
    times, names = [TIMES], [NAMES]
    for c in cells:
        d, s, o, loss = c["delay"], c["size_error"], c["onset_error"], c["loss_at_alarm"]
        raised = ", ".join(f"{k}: {v}" for k, v in c["raised_by"].items())
        late = (quantile_text(d[q]) for q in ("median", "90", "95"))
        told = (quantile_text(c["told_after"][q]) for q in ("median", "90"))
        row = (c["name"], share_text(c["found"]), *late, number_text(d["max"]), *told, str(c["false_before"]), raised)
        times.append(row)
        lost = (quantile_text(loss["median"]), quantile_text(loss["90"])) if loss else ("-", "-")
        right = (share_text(c[k]) for k in ("subject_right", "kind_right", "right", "mode_right", "cannot_tell"))
        off = (quantile_text(x[q]) for x in (s, o) for q in ("median", "95"))
        names.append((c["name"], *right, *off, share_text(c["onset_covered"]), *lost))
    return ["Faults", *columns(times), "", *columns(names)]


def _traps(cells: Sequence[Mapping[str, Any]]) -> list[str]:
    table = [("nothing failed, but", "no event", "a fault named", "environment said, of events", "named",
              "fault events per hour")]  # fmt: skip
    for c in cells:
        kinds = ", ".join(f"{k}: {v}" for k, v in c["named"].items())
        cells_of = (share_text(c[k]) for k in ("without_any_event", "fault_named", "environment_said"))
        table.append((c["name"], *cells_of, kinds, rate_in(c["faults"])))
    return ["Traps", *columns(table)]


def _healthy(cells: Sequence[Mapping[str, Any]]) -> list[str]:
    table = [("nothing wrong", "hours", "asked", "alarms", "per hour", "per 30 days", "times the asked rate", "called")]
    for c in cells:
        seen, asked = c["all"], "-" if c["asked_per_hour"] is None else rate_text(c["asked_per_hour"] / HOUR)
        ratio = "-" if seen["ratio"][0] is None else "{:.3g} [{:.3g}, {:.3g}]".format(*seen["ratio"])
        kinds = ", ".join(f"{k}: {v}" for k, v in c["by_kind"].items())
        per = (rate_in(seen), rate_in(seen, MONTH))
        table.append((c["name"], f"{c['hours']:.1f}", asked, str(seen["count"]), *per, ratio, kinds))
    return ["False alarms on healthy logs", *columns(table)]


def _confusion(rows: Mapping[str, Mapping[str, Any]]) -> list[str]:
    used = [c for c in next(iter(rows.values()))["named"] if any(r["named"].get(c) for r in rows.values())]
    used += sorted({c for r in rows.values() for c in r["named"]} - set(CAUSES) - set(used))
    table = [("truth", "n", *used, "cause and subject right")]
    for truth, row in rows.items():
        table.append((truth, str(row["n"]), *(str(row["named"].get(c, 0)) for c in used), share_text(row["right"])))
    return [f"What was called what ({NOTHING}: no event in time)", *columns(table)]


def _calibration(bins: Sequence[Mapping[str, Any]]) -> list[str]:
    table = [("d' to the nearest other cause", "n", "named a cause", "right of them", "promised", "mean P said")]
    for b in bins:
        span = f"{b['from']:g} to {b['to']:g}" if math.isfinite(b["to"]) else f"{b['from']:g} and more"
        said = (number_text(b["promised"]), number_text(b["mean_probability"]))
        table.append((span, str(b["n"]), str(b["named_a_cause"]), share_text(b["right_of_named"]), *said))
    return ["Is the name as sure as it says? (under 3 none should be named)", *columns(table)]


def files(job: Job, walked: Sequence[Walked], body: str, result: Mapping[str, Any]) -> dict[str, bytes]:
    """Return assess.md, assess.json and runs.csv."""
    page = f"# {job.path.stem}\n\n```text\n{body.rstrip()}\n```\n"
    return {"assess.md": page.encode(), "assess.json": json_bytes(result), "runs.csv": runs_csv(job, walked)}


def runs_csv(job: Job, walked: Sequence[Walked]) -> bytes:
    """Return one line a fault, trap or healthy log, so that a miss can be looked up and made again."""
    names = list(Answer.__dataclass_fields__)
    out = io.StringIO()
    table = csv.writer(out, lineterminator="\n")
    table.writerow(names)
    for w in walked:
        for row in answers(job.plan.cells[w.cell], w):
            body = encode(row)
            table.writerow([_field(body[name]) for name in names])
    return out.getvalue().encode()


def _field(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    return "" if value is None else " ".join(value) if isinstance(value, list) else str(value)
