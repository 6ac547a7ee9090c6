"""Write a log as MCAP: JSON messages with a JSON schema, zstd chunks, the same bytes for the same log."""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mooringdx.errors import LogError
from mooringdx.types import RawLog, Signal

if TYPE_CHECKING:
    from mcap.writer import Writer

_LAST_NS = 2**63


def write(log: RawLog, path: Path) -> None:
    """Write the signals of a log as an MCAP file, one message a stamp.

    Signals that share their stamps become the fields of one topic: "/log", or "/log/1", "/log/2", ... where there are
    several clocks, in the order of the log. A value that is not finite becomes null. Units stand in the schema.
    Stamps are rounded to 1 ns; a log without a date is stamped with its own clock.

    Parameters
    ----------
    log : the log.
    path : the file; it is written under another name first, then renamed.

    Raises
    ------
    LogError : the log cannot be stamped (time before zero), or the file cannot be written.
    """
    from mcap.writer import CompressionType, Writer

    groups = _groups(log)
    stamps = [_stamps(group[0], log.epoch_ns, path) for group in groups]
    part = path.with_name(path.name + ".part")
    try:
        with part.open("wb") as handle:
            writer = Writer(handle, compression=CompressionType.ZSTD)
            writer.start(profile="", library="mooringdx")
            topics = ["/log"] if len(groups) == 1 else [f"/log/{i + 1}" for i in range(len(groups))]
            ids = [_register(writer, topic, group) for topic, group in zip(topics, groups, strict=True)]
            for stamp, which, row in _merged(stamps):
                writer.add_message(ids[which], stamp, _body(groups[which], row), stamp, row)
            writer.finish()
        os.replace(part, path)
    except OSError as error:
        raise LogError(f"{path}: cannot be written: {error.strerror or error}") from None


def _groups(log: RawLog) -> list[list[Signal]]:
    """Return the signals grouped by equal stamps, in the order of the log."""
    groups: dict[bytes, list[Signal]] = {}
    for signal in log.signals.values():
        groups.setdefault(signal.time.tobytes(), []).append(signal)
    return list(groups.values())


def _stamps(signal: Signal, epoch_ns: int | None, path: Path) -> list[int]:
    if not np.all(np.isfinite(signal.time)):
        raise LogError(f"{path}: signal {signal.name} has stamps that are no numbers; leave those samples out")
    stamps = [(epoch_ns or 0) + round(t * 1e9) for t in signal.time.tolist()]
    if stamps and (min(stamps) < 0 or max(stamps) >= _LAST_NS):
        raise LogError(f"{path}: signal {signal.name} has a time that MCAP cannot hold; it must be in 1970 to 2262")
    return stamps


def _register(writer: Writer, topic: str, group: list[Signal]) -> int:
    properties = {s.name: {"type": ["number", "null"], "unit": s.unit} for s in group}
    schema = {"type": "object", "title": topic, "properties": properties}
    body = json.dumps(schema, separators=(",", ":")).encode()
    number = writer.register_schema(name=topic, encoding="jsonschema", data=body)
    return int(writer.register_channel(topic=topic, message_encoding="json", schema_id=number))


def _merged(stamps: list[list[int]]) -> list[tuple[int, int, int]]:
    """Return (stamp, group, row) in the order of the stamps."""
    return sorted((stamp, which, row) for which, group in enumerate(stamps) for row, stamp in enumerate(group))


def _body(group: list[Signal], row: int) -> bytes:
    values = {s.name: float(s.values[row]) for s in group}
    known = {name: value if math.isfinite(value) else None for name, value in values.items()}
    return json.dumps(known, separators=(",", ":")).encode()
