"""What a bank adds to the figures of a cell: warnings, the line that led, sizes, two lines, the environment."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from mooringdx.assess.simulated_figures import MONTH, columns, quantile, quantile_text, rate, rate_in, share
from mooringdx.assess.simulated_figures import share_text as shares
from mooringdx.assess.simulated_score import Answer

FAULTS: tuple[str, ...] = (
    "a bank's alarms", "warning s: median", "90 %", "99 %", "alarm s: median", "90 %", "99 %",
    "line right at the alarm", "line right when named", "wrong ones next to it", "size in interval",
    "false before, h", "per 30 days",
)  # fmt: skip
TRAPS: tuple[str, ...] = (
    "a bank's alarms", "runs with an alarm", "environment a rival, of them", "its probability: median", "90 %",
)  # fmt: skip


def fault_numbers(rows: Sequence[Answer]) -> dict[str, Any] | None:
    """Return the figures of a cell with faults, None where no bank judged; a missed fault is an infinite delay."""
    found = [r for r in rows if r.found]
    if not any(r.warned_after is not None or r.subject_led is not None for r in found):
        return None
    warned = [r.warned_after if r.warned_after is not None else math.inf for r in rows]
    delays = [r.delay if r.delay is not None else math.inf for r in rows]
    hours = math.fsum(r.quiet_hours for r in rows)
    return {
        "warned_after": {str(q): quantile(warned, q / 100.0) for q in (50, 90, 99)},
        "alarm_after": {str(q): quantile(delays, q / 100.0) for q in (50, 90, 99)},
        "subject_led": share(r.subject_led for r in found),
        "subject_right": share(r.subject_right for r in found),
        "wrong_adjacent": share(r.adjacent for r in found),
        "size_covered": share(r.size_covered for r in found),
        "hours_before": hours,
        "false_before": rate(sum(r.early for r in rows), hours),
        "all_named": every_named(rows),
    }


def every_named(rows: Sequence[Answer]) -> dict[str, Any] | None:
    """Return the share of logs with several faults in which each was named in time; None where each log has one."""
    logs: dict[tuple[int, int], list[bool]] = {}
    for r in rows:
        logs.setdefault((r.seed, r.repeat), []).append(bool(r.named_in_time))
    several = [all(named) for named in logs.values() if len(named) > 1]
    return share(several) if several else None


def trap_numbers(rows: Sequence[Answer]) -> dict[str, Any] | None:
    """Return the figures of a cell whose weather alone changed, None where no bank alarmed."""
    found = [r for r in rows if r.environment_probability is not None]
    chances = [float(r.environment_probability or 0.0) for r in found]
    if not found:
        return None
    return {
        "alarms": share(r.found for r in rows),
        "rival": share(r.environment for r in found),
        "probability": {str(q): quantile(chances, q / 100.0) for q in (50, 90)},
    }


def text(cells: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the tables of the cells that a bank judged."""
    out: list[str] = []
    faults = [c for c in cells if c["role"] == "fault" and c.get("bank")]
    if faults:
        out += columns([FAULTS, *(_fault_row(c) for c in faults)])
    for c in faults:
        if c["bank"]["all_named"]:
            out.append(f"  {c['name']}: every line named in {shares(c['bank']['all_named'])} logs")
    traps = [c for c in cells if c["role"] == "trap" and c.get("bank")]
    if traps:
        out += columns([TRAPS, *(_trap_row(c) for c in traps)])
    return out


def _fault_row(c: Mapping[str, Any]) -> tuple[str, ...]:
    b = c["bank"]
    late = (quantile_text(b[key][q]) for key in ("warned_after", "alarm_after") for q in ("50", "90", "99"))
    right = (shares(b[key]) for key in ("subject_led", "subject_right", "wrong_adjacent", "size_covered"))
    before = f"{b['false_before']['count']} in {b['hours_before']:.0f}"
    return (c["name"], *late, *right, before, rate_in(b["false_before"], MONTH))


def _trap_row(c: Mapping[str, Any]) -> tuple[str, ...]:
    b = c["bank"]
    chances = (quantile_text(b["probability"][q]) for q in ("50", "90"))
    return (c["name"], shares(b["alarms"]), shares(b["rival"]), *chances)
