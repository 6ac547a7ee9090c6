"""Read and write Parquet logs, row group by row group, only the columns that are asked for."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mooringdx.channels import unit_in_header
from mooringdx.config import ChannelSource, TimeSource
from mooringdx.errors import LogError
from mooringdx.logs.clock import EPOCH, RELATIVE, Stamper, guess_unit, stamper
from mooringdx.logs.csv import find, on_log_clock, save, shared_clock
from mooringdx.logs.text_stream import Progress, identify
from mooringdx.types import Array, Check, RawLog, Signal


def read(
    path: Path, channels: Mapping[str, ChannelSource] | None, time: TimeSource, progress: Progress | None = None
) -> RawLog:
    """Read a Parquet log in the units of the file.

    Parameters
    ----------
    path : the file.
    channels : catalogue name -> column and unit; None reads every numeric column under its own name. The unit is found
        in the field's metadata (key ``unit``) or in the column's name when none is given.
    time : a timestamp column (taken exactly, whatever ``unit`` says), or a number or text in ``unit``.
    progress : called with (row groups read, row groups).

    Returns
    -------
    Signals that share one time array, as the text reader gives them.

    Raises
    ------
    LogError : no such file, no Parquet file, or an asked column is not in it. A Parquet file that is cut has lost its
        index at the end, so nothing of it can be read.
    """
    import pyarrow as pa
    from pyarrow import parquet

    source = identify(path, "parquet")
    try:
        with parquet.ParquetFile(path) as file:
            schema = file.schema_arrow
            at, clock = _time(path, file, schema, time)
            wanted = _wanted(path, schema, at, channels)
            stamps, columns, lost = _groups(file, at, clock, list(wanted.values()), progress)
    except (pa.ArrowException, OSError) as error:
        raise LogError(f"{path}: cannot be read as Parquet ({str(error).splitlines()[0]}); copy it again") from None
    if not sum(x.size for x in stamps):
        raise LogError(f"{path}: no row of column '{at}' can be read as time; set [log] time")
    seconds, epoch_ns = on_log_clock(np.concatenate(stamps), clock)
    signals = {}
    for (name, column), kept in zip(wanted.items(), columns, strict=True):
        unit = (channels[name].unit if channels is not None else None) or _unit(schema, column) or ""
        signals[name] = Signal(name, seconds, np.concatenate(kept), unit, column)
    detail = f"{lost} rows have no readable time and were left out"
    check = Check("stamps unreadable", path.name, False, detail, float(lost), 0.0, "rows", "see these rows")
    return RawLog(signals, source, epoch_ns, (check,) if lost else ())


def write(log: RawLog, path: Path) -> None:
    """Write a log whose signals share one clock; units stand in the fields' metadata, the same bytes for the same log.

    A log with an epoch gets a UTC timestamp column, exact to 1 ns. LogError when the signals have different clocks or
    the file cannot be written.
    """
    import pyarrow as pa
    from pyarrow import parquet

    seconds = shared_clock(log, path)
    if log.epoch_ns is None:
        fields, columns = [pa.field("time", pa.float64(), metadata={"unit": "s"})], [pa.array(seconds)]
    else:
        ns = log.epoch_ns + np.round(seconds * 1e9).astype(np.int64)
        fields, columns = [pa.field("time", pa.timestamp("ns", "UTC"))], [pa.array(ns).cast(pa.timestamp("ns", "UTC"))]
    for signal in log.signals.values():
        fields.append(pa.field(signal.name, pa.float64(), metadata={"unit": signal.unit}))
        columns.append(pa.array(signal.values))
    body = io.BytesIO()
    parquet.write_table(pa.table(columns, schema=pa.schema(fields)), body, compression="zstd", row_group_size=1 << 17)
    save(path, body.getvalue())


def _time(path: Path, file: Any, schema: Any, time: TimeSource) -> tuple[str, Stamper]:
    import pyarrow as pa

    if time.column is not None:
        at = schema.names[find(path, schema.names, time.column)]
    else:
        dated = [f.name for f in schema if pa.types.is_timestamp(f.type)]
        named = [
            n for n in schema.names if unit_in_header(n)[0].lower() in ("time", "t", "timestamp", "stamp", "epoch")
        ]
        if not (dated or named):
            names = ", ".join(schema.names)
            raise LogError(f"{path}: no column looks like time; set [log] time.column to one of: {names}")
        at = (named or dated)[0]
    kind = schema.field(at).type
    if pa.types.is_timestamp(kind):
        return at, Stamper("date", "iso8601", time.zone, kind.tz is not None)
    samples = [str(x) for x in next(file.iter_batches(200, columns=[at])).column(0).to_pylist() if x is not None]
    unit = time.unit if "unit" in time.model_fields_set else guess_unit(samples, _unit(schema, at))
    if unit is None:
        raise LogError(f"{path}: column '{at}' holds no time; set [log] time.column")
    return at, stamper(unit, time.zone, samples)


def _wanted(path: Path, schema: Any, at: str, channels: Mapping[str, ChannelSource] | None) -> dict[str, str]:
    import pyarrow as pa

    if channels is None:
        numeric = (pa.types.is_floating, pa.types.is_integer, pa.types.is_boolean, pa.types.is_decimal)
        return {f.name: f.name for f in schema if f.name != at and any(test(f.type) for test in numeric)}
    found = {}
    for name, place in channels.items():
        if place.column is None:
            raise LogError(f"{path}: channel '{name}' asks for a topic, and this log has columns; write column = ...")
        found[name] = schema.names[find(path, schema.names, place.column)]
    return found


def _groups(
    file: Any, at: str, clock: Stamper, wanted: list[str], progress: Progress | None
) -> tuple[list[NDArray[Any]], list[list[Array]], int]:
    """Return stamps and values by row group, and how many rows had no stamp."""
    import pyarrow as pa

    stamps: list[NDArray[Any]] = []
    columns: list[list[Array]] = [[] for _ in wanted]
    lost = 0
    for group in range(file.num_row_groups):
        for batch in file.iter_batches(1 << 17, row_groups=[group], columns=list(dict.fromkeys([at, *wanted]))):
            found, ok = _stamps(batch.column(at), clock)
            lost += int((~ok).sum())
            stamps.append(found[ok])
            for kept, name in zip(columns, wanted, strict=True):
                values = batch.column(name).cast(pa.float64(), safe=False).to_numpy(zero_copy_only=False)
                kept.append(np.asarray(values, dtype=np.float64)[ok])
        if progress is not None:
            progress(group + 1, file.num_row_groups)
    return stamps, columns, lost


def _stamps(column: Any, clock: Stamper) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    import pyarrow as pa

    if pa.types.is_timestamp(column.type):
        return clock.of_arrow(column.cast(pa.timestamp("ns", column.type.tz)))
    ok = np.asarray(column.is_valid().to_numpy(zero_copy_only=False), dtype=np.bool_)
    if clock.kind == "epoch" and pa.types.is_integer(column.type):
        ns = column.fill_null(0).cast(pa.int64()).to_numpy(zero_copy_only=False) * 10 ** EPOCH[clock.unit]
        return ns, ok
    if clock.kind == "relative" and not pa.types.is_string(column.type):
        seconds = column.cast(pa.float64()).to_numpy(zero_copy_only=False) * RELATIVE[clock.unit]
        return seconds, np.isfinite(seconds)
    return clock.of_text([None if x is None else str(x) for x in column.to_pylist()])


def _unit(schema: Any, name: str) -> str | None:
    stored = (schema.field(name).metadata or {}).get(b"unit")
    return stored.decode("utf-8", "replace") if stored else unit_in_header(name)[1]
