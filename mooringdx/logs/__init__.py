"""Logs: one format a file, all giving a ``RawLog``; units are converted to SI here, once, for every format."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mooringdx.channels import entry, is_unit, si_unit_of, to_local, to_si, unit_in_header
from mooringdx.config import ChannelSource, CsvOptions, TimeSource
from mooringdx.errors import ConfigError, LogError
from mooringdx.registry import resolve
from mooringdx.types import Check, RawLog, Signal, replace

if TYPE_CHECKING:
    from mooringdx.logs.text_stream import Progress


Channels = Mapping[str, ChannelSource]


def _read_csv(
    path: Path, channels: Channels | None, time: TimeSource, csv: CsvOptions, progress: Progress | None
) -> RawLog:
    from mooringdx.logs.csv import read

    return read(path, channels, time, csv, progress)


def _read_parquet(
    path: Path, channels: Channels | None, time: TimeSource, _: CsvOptions, progress: Progress | None
) -> RawLog:
    from mooringdx.logs.parquet import read

    return read(path, channels, time, progress)


def _read_mcap(
    path: Path, channels: Channels | None, time: TimeSource, _: CsvOptions, progress: Progress | None
) -> RawLog:
    from mooringdx.logs.mcap import read

    return read(path, channels, time, progress)


def _write_csv(log: RawLog, path: Path) -> None:
    from mooringdx.logs.csv import write

    write(log, path)


def _write_parquet(log: RawLog, path: Path) -> None:
    from mooringdx.logs.parquet import write

    write(log, path)


def _write_mcap(log: RawLog, path: Path) -> None:
    from mooringdx.logs.mcap import write

    write(log, path)


READERS: dict[str, Callable[..., RawLog]] = {"csv": _read_csv, "parquet": _read_parquet, "mcap": _read_mcap}
WRITERS: dict[str, Callable[[RawLog, Path], None]] = {
    "csv": _write_csv,
    "parquet": _write_parquet,
    "mcap": _write_mcap,
}

_SUFFIXES = {
    ".csv": "csv",
    ".txt": "csv",
    ".tsv": "csv",
    ".dat": "csv",
    ".out": "csv",
    ".asc": "csv",
    ".parquet": "parquet",
    ".pq": "parquet",
    ".mcap": "mcap",
}
_MAGIC = {b"PAR1": "parquet", b"\x89MCAP0": "mcap", b"\x1f\x8b": "csv", b"\x28\xb5\x2f\xfd": "csv"}


def format_of(path: Path) -> str:
    """Return csv, parquet or mcap: by the ending (also .csv.gz, .csv.zst), else by the first bytes."""
    endings = [x.lower() for x in path.suffixes if x.lower() not in (".gz", ".zst")]
    if endings and endings[-1] in _SUFFIXES:
        return _SUFFIXES[endings[-1]]
    try:
        with path.open("rb") as handle:
            first = handle.read(8)
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}; give the path of a log file") from None
    return next((form for magic, form in _MAGIC.items() if first.startswith(magic)), "csv")


def read_log(
    path: Path,
    channels: Channels | None,
    time: TimeSource,
    csv: CsvOptions,
    progress: Progress | None = None,
) -> RawLog:
    """Read a log of any format, in SI.

    Parameters
    ----------
    path : the file; a damaged one gives what can be read.
    channels : catalogue name -> where it stands; only these are read, converted to SI and named so. Latitude and
        longitude become north and east (m) unless these are mapped too. None reads every numeric column or field
        under its own name in its own unit.
    time : where the time stands.
    csv : how a text log is written.
    progress : called with (done, whole) in bytes or row groups.

    Returns
    -------
    The signals, and what was lost or assumed as checks. Signals of one clock share one time array.

    Raises
    ------
    LogError : the file, or a column, topic or field that was asked for, cannot be read.
    ConfigError : a channel name is not in the catalogue, or its unit is none or of another dimension.
    """
    for name in channels or ():
        entry(name)
    log = resolve(format_of(path), READERS, "log format")(path, channels, time, csv, progress)
    if channels is None:
        return log
    checks = list(log.checks)
    signals = {}
    for name in channels:
        signals[name] = _to_si(path, log.signals[name], channels[name], checks)
    if {"latitude", "longitude"} <= signals.keys() and not {"north", "east"} & signals.keys():
        signals = _localised(path, signals, checks)
    return replace(log, signals=signals, checks=tuple(checks))


def in_si(log: RawLog) -> RawLog:
    """Return a log whose signals have catalogue names with all values in SI, as `read_log` gives it from a file."""
    signals = {}
    for name, signal in log.signals.items():
        row = entry(name)
        unit = row.unit or si_unit_of(signal.unit)
        if signal.unit != unit:
            signal = replace(signal, values=to_si(signal.values, signal.unit or unit, name), unit=unit)
        signals[name] = signal
    return replace(log, signals=signals)


def _to_si(path: Path, signal: Signal, place: ChannelSource, checks: list[Check]) -> Signal:
    row = entry(signal.name)
    unit = place.unit or signal.unit
    header = unit_in_header(signal.source)[1]
    if not unit:
        unit = row.assumed or row.unit or "1"
        remedy = f'write unit = "{unit}", or the right one, in [channels]'
        detail = f"the log states no unit; {unit} is taken"
        checks.append(Check("unit assumed", signal.name, False, detail, remedy=remedy))
    elif place.unit and header and not _same(place.unit, header, signal.name):
        detail = f"column '{signal.source}' states {header}, the run file says {place.unit}, which is taken"
        checks.append(Check("unit differs", signal.name, False, detail, remedy="correct unit in [channels]"))
    values = signal.values
    if place.scale != 1.0 or place.offset != 0.0:
        values = values * place.scale + place.offset
    try:
        return Signal(
            signal.name, signal.time, to_si(values, unit, signal.name), row.unit or si_unit_of(unit), signal.source
        )
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None


def _same(one: str, other: str, name: str) -> bool:
    if not (is_unit(one) and is_unit(other)):
        return one == other
    probe = np.ones(1)
    try:
        return bool(np.allclose(to_si(probe, one, name), to_si(probe, other, name)))
    except ConfigError:
        return False


def _localised(path: Path, signals: dict[str, Signal], checks: list[Check]) -> dict[str, Signal]:
    """Return the signals with latitude and longitude turned into north and east."""
    lat, lon = signals["latitude"], signals["longitude"]
    if not np.array_equal(lat.time, lon.time):
        raise LogError(f"{path}: latitude and longitude have different stamps; take both from one message")
    north, east, origin = to_local(lat.values, lon.values)
    place = f"{math.degrees(origin[0]):.6f} N {math.degrees(origin[1]):.6f} E"
    checks.append(Check("local origin", "north, east", True, f"north and east are metres from {place} (WGS 84)"))
    kept = {name: s for name, s in signals.items() if name not in ("latitude", "longitude")}
    kept["north"] = Signal("north", lat.time, north, "m", lat.source)
    kept["east"] = Signal("east", lat.time, east, "m", lon.source)
    return kept
