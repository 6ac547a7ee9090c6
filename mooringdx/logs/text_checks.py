"""What a text log lost, as rows of the checks table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from mooringdx.logs.text_stream import Tally
from mooringdx.types import Check


def checks_of(path: Path, tally: Tally, skipped: Sequence[str]) -> list[Check]:
    """Return the check rows of a tally. ``skipped``: columns that hold text and were not read."""
    found = []
    if tally.cut:
        detail = f"{tally.cut}; the {tally.rows} rows before it were read"
        found.append(Check("file damaged", path.name, False, detail, remedy="copy the file again from its origin"))
    if tally.ragged and tally.ragged_first:
        line, text = tally.ragged_first
        detail = f"{tally.ragged} rows with another number of columns were left out, first line {line}: '{text}'"
        remedy = "see these lines; the samples are missing, not filled"
        found.append(Check("rows left out", path.name, False, detail, float(tally.ragged), 0.0, "lines", remedy))
    if tally.late and tally.late_first:
        line, text = tally.late_first
        detail = f"{tally.late} rows without a readable time were left out, first line {line}: '{text}'"
        remedy = "see these lines; check [log] time if there are many"
        found.append(Check("stamps unreadable", path.name, False, detail, float(tally.late), 0.0, "lines", remedy))
    if tally.unreadable:
        cells = "; ".join(f"line {line} {name} '{text}'" for line, name, text in tally.examples)
        detail = f"cells that are no number: {_counts(tally.unreadable)}; for example {cells}"
        total = float(tally.unreadable.total())
        remedy = "the cells are masked; declare the decimal mark if it is another"
        found.append(Check("cells unreadable", path.name, False, detail, total, 0.0, "cells", remedy))
    if tally.missing:
        total = float(tally.missing.total())
        detail = f"empty or NaN: {_counts(tally.missing)}"
        found.append(Check("cells empty", path.name, True, detail, total, None, "cells"))
    if skipped:
        found.append(Check("columns of text", path.name, True, f"not read: {', '.join(skipped)}"))
    return found


def _counts(count: Counter[str]) -> str:
    return ", ".join(f"{name} {n}" for name, n in count.most_common(8)) + (" ..." if len(count) > 8 else "")
