"""How a text log is written, found from its first 64 KiB: delimiter, decimal mark, names, units, first line of data."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from mooringdx.channels import is_unit, unit_in_header
from mooringdx.config import CsvOptions
from mooringdx.errors import LogError
from mooringdx.logs.clock import is_stamp, number
from mooringdx.logs.text_stream import head

_COMMENTS = ("#", "%", "//")
# (delimiter, decimal mark); of equals the first wins.
_STYLES = ((",", "."), (";", "."), (";", ","), ("\t", "."), ("\t", ","), ("|", "."), (" ", "."), (" ", ","))
NULLS = ("", "NaN", "nan", "NAN", "-nan", "-NaN", "nan(ind)", "-nan(ind)", "1.#QNAN", "-1.#IND", "-", "--", "---", "NA",
         "N/A", "n/a", "#N/A", "#N/A N/A", "#NUM!", "#VALUE!", "#DIV/0!", "null", "NULL", "None", "none")  # fmt: skip
_EMPTY = frozenset(NULLS)


@dataclass(frozen=True)
class Layout:
    """How a text log is written. ``units``: from the header or a row of units, None where none is stated.

    ``skip``: lines before the first line of data. ``samples``: the cells of up to 200 lines of data.
    """

    delimiter: str
    decimal: str
    comment: str | None
    newline: str
    names: tuple[str, ...]
    units: tuple[str | None, ...]
    skip: int
    samples: tuple[tuple[str, ...], ...]

    def cells(self, column: int) -> list[str]:
        """Return the sample cells of one column."""
        return [row[column] for row in self.samples]

    def numeric(self, column: int) -> bool:
        """Return whether most of the filled sample cells of a column are numbers."""
        filled = [x for x in self.cells(column) if x not in _EMPTY]
        return not filled or 2 * sum(_is_number(x, self.decimal) for x in filled) > len(filled)


def layout(path: Path, options: CsvOptions) -> Layout:
    """Find how a text log is written; what ``options`` says is taken as it is. LogError when no line is data."""
    raw = head(path)
    try:
        text = raw.decode("utf-8")
    except UnicodeDecodeError as error:
        text = raw[: error.start].decode() if error.start > len(raw) - 4 else raw.decode("latin-1")
    newline = "\n" if "\n" in text or "\r" not in text else "\r"
    lines = [x.removesuffix("\r") for x in text.split(newline)]
    if len(lines) > 2:
        lines.pop()
    comment = options.comment or _comment(lines[options.skip_rows :])
    body = [i for i, x in enumerate(lines) if i >= options.skip_rows and x.strip() and not _is_comment(x, comment)]
    delimiter, decimal = _style([lines[i] for i in body], options)
    rows = {i: _split(lines[i], delimiter) for i in body}
    data, width = _data_rows(rows, decimal)
    if not data:
        raise LogError(f"{path}: no line with numbers in the first {len(raw)} bytes; is it a text log?")
    first = data[0] if options.header_row is None else options.skip_rows + options.header_row + 1
    names, units, first = _header(lines, rows, first, width, comment, delimiter, options)
    samples = tuple(tuple(_fit(rows[i], width)) for i in data if i >= first)[:200]
    return Layout(delimiter, decimal, comment, newline, names, units, first, samples)


def _comment(lines: Sequence[str]) -> str | None:
    for line in lines:
        for mark in _COMMENTS:
            if line.lstrip().startswith(mark):
                return mark
        if line.strip():
            break
    count = Counter(mark for line in lines for mark in _COMMENTS if line.lstrip().startswith(mark))
    return count.most_common(1)[0][0] if count and count.most_common(1)[0][1] > 1 else None


def _is_comment(line: str, comment: str | None) -> bool:
    return comment is not None and line.lstrip().startswith(comment)


def _is_number(cell: str, decimal: str) -> bool:
    if decimal == ",":
        cell = "x" if "." in cell else cell.replace(",", ".")
    return number(cell) is not None


def _good(cell: str, decimal: str) -> bool:
    return _is_number(cell, decimal) or is_stamp(cell)


def _split(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return [x.strip('"') for x in line.split()]
    if '"' not in line:
        return [x.strip() for x in line.split(delimiter)]
    try:
        return [x.strip() for x in next(csv.reader([line], delimiter=delimiter))]
    except csv.Error:
        return [x.strip() for x in line.split(delimiter)]


def _style(lines: Sequence[str], options: CsvOptions) -> tuple[str, str]:
    """Return the delimiter and the decimal mark under which most cells of most lines are numbers or stamps."""
    best = (-1.0, 0)
    found: tuple[str, str] = (options.delimiter or ",", options.decimal or ".")
    for delimiter, decimal in _STYLES:
        if options.delimiter not in (None, delimiter) or options.decimal not in (None, decimal):
            continue
        rows = [_split(x, delimiter) for x in lines[-100:]]
        width = Counter(len(r) for r in rows).most_common(1)[0][0] if rows else 0
        kept = [r for r in rows if len(r) == width]
        filled = [x for r in kept for x in r if x not in _EMPTY]
        share = sum(_good(x, decimal) for x in filled) / len(filled) if filled else 0.0
        score = (round(share * len(kept) / len(rows), 2) if rows else 0.0, width)
        if score > best and (width > 1 or share > 0.5):
            best, found = score, (delimiter, decimal)
    return found


def _data_rows(rows: dict[int, list[str]], decimal: str) -> tuple[list[int], int]:
    """Return the lines that are data, and their number of columns."""
    likely = {}
    for i, cells in rows.items():
        filled = [x for x in cells if x not in _EMPTY]
        if filled and 2 * sum(_good(x, decimal) for x in filled) > len(filled) - (len(cells) > 2):
            likely[i] = len(cells)
    if not likely:
        return [], 0
    width = Counter(likely.values()).most_common(1)[0][0]
    return [i for i, n in likely.items() if n == width], width


def _header(
    lines: Sequence[str],
    rows: dict[int, list[str]],
    first: int,
    width: int,
    comment: str | None,
    delimiter: str,
    options: CsvOptions,
) -> tuple[tuple[str, ...], tuple[str | None, ...], int]:
    """Return names, units and the first line of data; without a header the names are column_1, column_2, ..."""
    before = [i for i in rows if i < first and _near(len(rows[i]), width)]
    if options.header_row is not None:
        at = options.skip_rows + options.header_row
        before = [at] if at in rows else []
        after = [i for i in rows if i > at]
        if before and after and _is_unit_row(rows[after[0]]):
            before, first = [at, after[0]], after[0] + 1
    units: list[str | None] = [None] * width
    if len(before) > 1 and _is_unit_row(rows[before[-1]]):
        units = [x.strip("()[] ") or None for x in _fit(rows[before.pop()], width)]
    header = _fit(rows[before[-1]], width) if before else _commented(lines[:first], width, comment, delimiter)
    names: list[str] = []
    for i, text in enumerate(header):
        bare = text.strip().strip("\"'") or f"column_{i + 1}"
        names.append(bare if bare not in names else f"{bare}_{i + 1}")
        units[i] = units[i] or unit_in_header(bare)[1]
    return tuple(names), tuple(units), first


def _commented(lines: Sequence[str], width: int, comment: str | None, delimiter: str) -> list[str]:
    """Return the names from the last comment line that has as many cells as the data, else no names."""
    for line in reversed(lines):
        if comment is not None and _is_comment(line, comment):
            cells = _split(line.lstrip().lstrip(comment), delimiter)
            if len(cells) == width and width > 1:
                return cells
    return [""] * width


def _is_unit_row(cells: Sequence[str]) -> bool:
    filled = [x for x in cells if x.strip("()[]- ")]
    units = [x for x in filled if re.fullmatch(r"[(\[].*[)\]]", x) or is_unit(x)]
    return bool(filled) and len(units) >= 0.8 * len(filled)


def _near(count: int, width: int) -> bool:
    return count == width or (width > 2 and abs(count - width) == 1)


def _fit(cells: list[str], width: int) -> list[str]:
    return (cells + [""] * width)[:width]
