"""Read and write text logs: comma, semicolon, tab or white space, plain, gzip or zstd, whole or damaged.

The file is walked in blocks of whole lines (4 MiB) that Arrow parses one by one, so that memory grows with the asked
columns only and a damage stays in its block: a column that does not convert is taken cell by cell there, a line with
another number of columns is left out, and all of it is counted.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mooringdx.channels import unit_in_header
from mooringdx.config import ChannelSource, CsvOptions, TimeSource
from mooringdx.errors import LogError
from mooringdx.logs.clock import Stamper, ambiguous_order, floats, guess_unit, number, stamper, unroll
from mooringdx.logs.text_checks import checks_of
from mooringdx.logs.text_layout import NULLS, Layout, layout
from mooringdx.logs.text_stream import Progress, Tally, blocks, clean, identify
from mooringdx.types import Array, Check, RawLog, Signal

_TIME_NAME = re.compile(
    r"(?i)(t|time|times?tamp|date_?time|utc|gmt|elapsed|epoch|stamp|clock|t_?s|time.*|.*_time|.*timestamp)"
)
_DATE_NAME = re.compile(r"(?i)(date|day|yyyy.*)")
_EXAMPLES = 3

LONG_STEP = 5.0
"""s; a logger of a moored vessel that steps this far more likely counts in another unit."""
SUSPICION = "unusually long"


@dataclass(frozen=True)
class TimeColumns:
    """Where the time of a text log stands and how it is read. ``date``: the index of a separate date column or None."""

    column: int
    date: int | None
    stamper: Stamper
    guessed: str = ""
    open_order: bool = False


@dataclass(frozen=True)
class Batch:
    """Some rows: ``stamps`` (n,) float64 s or int64 ns, and one (n,) float64 array a column; NaN where not readable."""

    stamps: NDArray[Any]
    values: tuple[Array, ...]


def read(
    path: Path,
    channels: Mapping[str, ChannelSource] | None,
    time: TimeSource,
    options: CsvOptions,
    progress: Progress | None = None,
) -> RawLog:
    """Read a text log in the units of the file; of a damaged one every line that is whole.

    Parameters
    ----------
    path : the file; gzip and zstd are recognised by their first bytes.
    channels : catalogue name -> column and unit; None reads every numeric column under its own name.
    time : where the time stands; what is not given is guessed, and the guess is a check row.
    options : how the file is written; what is not given is found from its first 64 KiB.
    progress : called with (bytes read, bytes of the file).

    Returns
    -------
    Signals that share one time array: s as logged for a clock that counts, else s since the first stamp, whose instant
    is ``epoch_ns``. Lines whose stamp cannot be read are left out and counted.

    Raises
    ------
    LogError : no such file, nothing readable, or an asked column is not in it.
    """
    source = identify(path, "csv")
    how = layout(path, options)
    clock = time_columns(path, how, time)
    wanted = _wanted(path, how, clock, channels)
    tally = Tally()
    stamps: list[NDArray[Any]] = []
    columns: list[list[Array]] = [[] for _ in wanted]
    for batch in batches(path, how, clock, list(wanted.values()), tally):
        stamps.append(batch.stamps)
        for kept, values in zip(columns, batch.values, strict=True):
            kept.append(values)
        if progress is not None:
            progress(tally.position, source.bytes)
    if not sum(x.size for x in stamps):
        column = how.names[clock.column]
        raise LogError(f"{path}: no line can be read with '{column}' as time in '{clock.stamper.unit}'; set [log] time")
    seconds, epoch_ns = on_log_clock(np.concatenate(stamps), clock.stamper)
    signals = {}
    for (name, at), kept in zip(wanted.items(), columns, strict=True):
        unit = (channels[name].unit if channels is not None else None) or how.units[at] or ""
        signals[name] = Signal(name, seconds, np.concatenate(kept), unit, how.names[at])
        kept.clear()
    taken = {clock.column, clock.date, *wanted.values()}
    skipped = [] if channels is not None else [n for i, n in enumerate(how.names) if i not in taken]
    checks = checks_of(path, tally, skipped) + _time_checks(how, clock)
    return RawLog(signals, source, epoch_ns, tuple(checks))


def batches(path: Path, how: Layout, clock: TimeColumns, columns: Sequence[int], tally: Tally) -> Iterator[Batch]:
    """Yield the rows of a text log block by block, memory bounded by a block, losses entered in ``tally``.

    Parameters
    ----------
    columns : indices of the columns in ``how.names``.
    """
    texts: set[int] = set()
    last: float | None = None
    skip = how.skip
    mark = None if how.comment is None else how.comment.encode()
    for block in blocks(path, tally, how.newline.encode()):
        lines = block.count(b"\n")
        if skip >= lines:
            skip -= lines
            tally.lines += lines
            continue
        if skip:
            at = _after_lines(block, skip)
            tally.lines, block, lines, skip = tally.lines + skip, block[at:], lines - skip, 0
        page = _Page(clean(block, how.delimiter.encode(), mark), tally.lines + 1, how, tally)
        if page.data.strip(b"\n"):
            (stamps, ok), values = page.rows(clock, columns, texts)
            if clock.stamper.kind == "clock" and ok.any():
                stamps[ok] = unroll(stamps[ok], last)
                last = float(stamps[ok][-1])
            page.count_late(ok)
            tally.rows += int(ok.sum())
            yield Batch(stamps, tuple(values)) if ok.all() else Batch(stamps[ok], tuple(x[ok] for x in values))
        tally.lines += lines


class _Page:
    """One cleaned block on its way through the parser."""

    def __init__(self, data: bytes, first_line: int, how: Layout, tally: Tally) -> None:
        self.data, self.first_line, self.how, self.tally = data, first_line, how, tally
        self.ragged: list[int] | None = None

    def parse(self, types: Mapping[int, Any]) -> list[Any]:
        """Return columns in the asked Arrow types; ArrowInvalid when a cell does not convert."""
        import pyarrow as pa
        from pyarrow import csv as arrow

        ragged: list[int] = []

        def leave_out(row: Any) -> str:
            ragged.append(row.number)
            return "skip"

        names = [f"c{i}" for i in range(len(self.how.names))]
        table = arrow.read_csv(
            pa.BufferReader(self.data),
            arrow.ReadOptions(use_threads=False, block_size=len(self.data) + 64, column_names=names),
            arrow.ParseOptions(
                delimiter=self.how.delimiter,
                quote_char='"' if b'"' in self.data else False,
                invalid_row_handler=leave_out,
            ),
            arrow.ConvertOptions(
                column_types={names[i]: kind for i, kind in types.items()},
                include_columns=[names[i] for i in types],
                null_values=list(NULLS),
                strings_can_be_null=True,
                decimal_point=self.how.decimal,
            ),
        )
        if self.ragged is None:
            self.ragged = ragged
            if ragged:
                line = self._line_of(ragged[0])
                self.tally.lose(len(ragged), line, self._text(line))
        return [_one(table.column(i)) for i in range(table.num_columns)]

    def rows(
        self, clock: TimeColumns, columns: Sequence[int], texts: set[int]
    ) -> tuple[tuple[NDArray[Any], NDArray[np.bool_]], list[Array]]:
        """Return ((stamps, readable), values): in one pass where every cell converts, else column by column."""
        import pyarrow as pa

        if clock.date is None and clock.column not in columns and not texts.intersection(columns):
            fast = list(dict.fromkeys(columns))
            try:
                first, *rest = self.parse(
                    {clock.column: clock.stamper.arrow_type()} | dict.fromkeys(fast, pa.float64())
                )
            except pa.ArrowInvalid:
                pass
            else:
                found = {i: self._values(i, column) for i, column in zip(fast, rest, strict=True)}
                return clock.stamper.of_arrow(first), [found[i] for i in columns]
        return self.stamps(clock), self.numbers(columns, texts)

    def stamps(self, clock: TimeColumns) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Return (stamps, readable) of the rows."""
        import pyarrow as pa

        if clock.date is None:
            try:
                return clock.stamper.of_arrow(self.parse({clock.column: clock.stamper.arrow_type()})[0])
            except pa.ArrowInvalid:
                return clock.stamper.of_text(self._texts(clock.column, clock.stamper.kind in ("relative", "epoch")))
        pairs = zip(self._texts(clock.date), self._texts(clock.column), strict=True)
        return clock.stamper.of_text([None if d is None or t is None else f"{d} {t}" for d, t in pairs])

    def numbers(self, columns: Sequence[int], texts: set[int]) -> list[Array]:
        """Return the values column by column; those in ``texts`` have failed before and are taken cell by cell."""
        import pyarrow as pa

        found: dict[int, Array] = {}
        for i in dict.fromkeys(columns):
            try:
                found[i] = self._cells(i) if i in texts else self._values(i, self.parse({i: pa.float64()})[0])
            except pa.ArrowInvalid:
                found[i] = self._cells(i)
                if 2 * np.isnan(found[i]).sum() > found[i].size:
                    texts.add(i)
        return [found[i] for i in columns]

    def count_late(self, ok: NDArray[np.bool_]) -> None:
        """Enter the rows whose stamp cannot be read."""
        if ok.all():
            return
        self.tally.late += int((~ok).sum())
        if self.tally.late_first is None:
            line = self._line_of_row(int(np.argmin(ok)))
            self.tally.late_first = (line, self._text(line))

    def _values(self, i: int, column: Any) -> Array:
        if column.null_count:
            self.tally.missing[self.how.names[i]] += column.null_count
        return floats(column)

    def _cells(self, i: int) -> Array:
        """Return a column cell by cell; what is no number is NaN and counted."""
        name = self.how.names[i]
        cells = self._texts(i, True)
        values = np.full(len(cells), np.nan)
        for k, cell in enumerate(cells):
            text = "" if cell is None else cell.strip()
            if text in NULLS:
                self.tally.missing[name] += 1
                continue
            value = number(text)
            if value is None:
                self.tally.unreadable[name] += 1
                if len(self.tally.examples) < _EXAMPLES:
                    self.tally.examples.append((self._line_of_row(k), name, text[:30]))
            else:
                values[k] = value
        return values

    def _texts(self, i: int, numeric: bool = False) -> list[str | None]:
        import pyarrow as pa

        cells: list[str | None] = self.parse({i: pa.string()})[0].to_pylist()
        if numeric and self.how.decimal == ",":
            return [None if x is None else _point(x) for x in cells]
        return cells

    def _line_of_row(self, row: int) -> int:
        """Return the line in the file of the row-th row that was kept."""
        number_ = row + 1
        for lost in self.ragged or ():
            number_ += lost <= number_
        return self._line_of(number_)

    def _line_of(self, filled: int) -> int:
        """Return the line in the file of the filled-th line that is not empty, both counted from 1."""
        for at, line in enumerate(self.data.split(b"\n")):
            filled -= bool(line)
            if not filled:
                return self.first_line + at
        return self.first_line

    def _text(self, line: int) -> str:
        return self.data.split(b"\n", line - self.first_line + 1)[line - self.first_line].decode("ascii")


def time_columns(path: Path, how: Layout, time: TimeSource) -> TimeColumns:
    """Return where the time stands and how it is read; what ``time`` leaves open is guessed from names and samples."""
    given = time.model_fields_set
    date = None if time.date_column is None else find(path, how.names, time.date_column)
    column = _guess_column(path, how) if time.column is None else find(path, how.names, time.column)
    if date is None and time.column is None:
        date = _guess_date(how, column)
    cells = how.cells(column)
    if date is not None:
        cells = [f"{d} {t}" for d, t in zip(how.cells(date), cells, strict=True)]
    header = how.units[column]
    guess = (
        "iso8601" if date is not None else guess_unit([_point(x) if how.decimal == "," else x for x in cells], header)
    )
    if guess is None and "unit" not in given:
        raise LogError(f"{path}: column '{how.names[column]}' holds no time, e.g. '{cells[0]}'; set [log] time.column")
    unit = time.unit if "unit" in given and date is None else str(guess)
    told = "" if {"unit", "column"} <= given else f"column '{how.names[column]}' is read as time in {unit}"
    if told and unit == "s" and header is None and "unit" not in given and _step(cells, how.decimal) >= LONG_STEP:
        told += f"; its header states no unit, and a step of {_step(cells, how.decimal):g} s is {SUSPICION}"
    return TimeColumns(column, date, stamper(unit, time.zone, cells), told, ambiguous_order(cells))


def _step(cells: Sequence[str], decimal: str) -> float:
    """Return the median step of the first stamps, in their own unit; 0 where they are no numbers."""
    try:
        stamps = [float(_point(x) if decimal == "," else x) for x in cells if x.strip()]
    except ValueError:
        return 0.0
    return float(np.median(np.diff(stamps))) if len(stamps) > 2 else 0.0


def find(path: Path, names: Sequence[str], wanted: str) -> int:
    """Return the index of a column by its header, with or without unit; LogError with the nearest if there is none."""
    if wanted in names:
        return list(names).index(wanted)
    bare = [unit_in_header(x)[0] for x in names]
    if bare.count(wanted) == 1:
        return bare.index(wanted)
    near = difflib.get_close_matches(wanted, bare, n=1, cutoff=0.5)
    hint = f"; did you mean '{names[bare.index(near[0])]}'?" if near else ";"
    raise LogError(f"{path}: no column '{wanted}'{hint} the columns are: {', '.join(names)}")


def on_log_clock(stamps: NDArray[Any], how: Stamper) -> tuple[Array, int | None]:
    """Return (time in s on the log clock, locked; instant of the first stamp in ns or None)."""
    epoch_ns = int(stamps[0]) if how.absolute else None
    seconds = np.asarray(stamps if epoch_ns is None else (stamps - epoch_ns) / 1e9, dtype=np.float64)
    seconds.flags.writeable = False
    return seconds, epoch_ns


def write(log: RawLog, path: Path) -> None:
    """Write a log whose signals share one clock as CSV, units in the header, 17 significant digits at most.

    A log with an epoch is stamped in ISO-8601 UTC; values that are not finite become empty cells. LogError when the
    signals have different clocks or the file cannot be written.
    """
    import gzip

    from mooringdx.logs.clock import iso

    seconds = shared_clock(log, path)
    if log.epoch_ns is None:
        head_, stamps = "time [s]", [repr(x) for x in seconds.tolist()]
    else:
        ns = log.epoch_ns + np.round(seconds * 1e9).astype(np.int64)
        head_, stamps = "time", [iso(x) for x in ns.tolist()]
    names = [f"{s.name} [{s.unit}]" if s.unit else s.name for s in log.signals.values()]
    columns = [[repr(x) if np.isfinite(x) else "" for x in s.values.tolist()] for s in log.signals.values()]
    rows = "\n".join(",".join(row) for row in zip(stamps, *columns, strict=True))
    body = (",".join([head_, *names]) + "\n" + rows + "\n").encode()
    save(path, gzip.compress(body, mtime=0) if path.suffix == ".gz" else body)


def shared_clock(log: RawLog, path: Path) -> Array:
    """Return the one clock of all signals of a log; LogError when there are several."""
    clocks = [s.time for s in log.signals.values()]
    if not clocks:
        raise LogError(f"{path}: the log holds no signal; nothing to write")
    if any(c is not clocks[0] and not np.array_equal(c, clocks[0]) for c in clocks):
        raise LogError(f"{path}: the signals have different clocks; a table cannot hold them, write .mcap instead")
    return clocks[0]


def save(path: Path, body: bytes) -> None:
    """Write a file under another name, then rename it."""
    draft = path.with_name(path.name + ".part")
    try:
        draft.write_bytes(body)
        draft.replace(path)
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}; give a path that can be written") from None


def _wanted(
    path: Path, how: Layout, clock: TimeColumns, channels: Mapping[str, ChannelSource] | None
) -> dict[str, int]:
    if channels is None:
        taken = (clock.column, clock.date)
        return {n: i for i, n in enumerate(how.names) if i not in taken and how.numeric(i)}
    found = {}
    for name, place in channels.items():
        if place.column is None:
            raise LogError(f"{path}: channel '{name}' asks for a topic, and this log has columns; write column = ...")
        found[name] = find(path, how.names, place.column)
    return found


def _guess_column(path: Path, how: Layout) -> int:
    bare = [unit_in_header(x)[0] for x in how.names]
    named = [i for i, x in enumerate(bare) if _TIME_NAME.fullmatch(x) and guess_unit(how.cells(i), None)]
    dated = [i for i in range(len(bare)) if guess_unit(how.cells(i), None) in ("iso8601", "clock")]
    rising = [i for i in range(len(bare)) if how.numeric(i) and _rises(how, i)]
    for found in (named, dated, rising):
        if found:
            return found[0]
    raise LogError(f"{path}: no column looks like time; set [log] time.column to one of: {', '.join(how.names)}")


def _guess_date(how: Layout, column: int) -> int | None:
    if guess_unit(how.cells(column), None) != "clock":
        return None
    for i, name in enumerate(how.names):
        if i != column and guess_unit(how.cells(i), None) == "iso8601":
            return i
        if i != column and _DATE_NAME.fullmatch(name) and all(re.fullmatch(r"\d{8}", x) for x in how.cells(i)):
            return i
    return None


def _rises(how: Layout, column: int) -> bool:
    values = [number(_point(x) if how.decimal == "," else x) for x in how.cells(column)]
    known = np.array([x for x in values if x is not None and np.isfinite(x)])
    return known.size > 2 and bool(np.mean(np.diff(known) > 0) > 0.95)


def _time_checks(how: Layout, clock: TimeColumns) -> list[Check]:
    found = []
    name = how.names[clock.column]
    if clock.guessed:
        sure = SUSPICION not in clock.guessed
        remedy = "" if sure else f'if the logger counts ms, write [log] time = {{ column = "{name}", unit = "ms" }}'
        found.append(Check("time column", name, sure, clock.guessed, remedy=remedy))
    s = clock.stamper
    if s.kind == "date" and not s.zoned and s.zone is None:
        remedy = "set [log] time.zone if the logger kept another"
        found.append(Check("time zone", name, False, "the stamps state no zone; UTC is assumed", remedy=remedy))
    if clock.open_order:
        remedy = "write the dates as 2025-03-14 if this is wrong"
        found.append(Check("date order", name, False, "day before month is assumed", remedy=remedy))
    return found


def _after_lines(block: bytes, count: int) -> int:
    at = 0
    for _ in range(count):
        at = block.index(b"\n", at) + 1
    return at


def _one(column: Any) -> Any:
    import pyarrow as pa

    return (
        column.chunk(0)
        if column.num_chunks == 1
        else pa.concat_arrays(column.chunks)
        if column.num_chunks
        else (pa.array([], column.type))
    )


def _point(cell: str) -> str:
    return "?" if "." in cell else cell.replace(",", ".")
