"""Read MCAP logs: JSON, ROS 1, ROS 2 (CDR) and protobuf messages, whole, cut or damaged.

The file is read from front to back with the memory of one chunk and the asked signals; its index and its
summary are not needed. What could not be read becomes check rows, never a traceback.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from mooringdx.config import ChannelSource, TimeSource
from mooringdx.errors import LogError
from mooringdx.logs import mcap_decode as decode
from mooringdx.logs.mcap_harvest import (
    DATED,
    HEADER_STAMP,
    Harvest,
    Progress,
    Topic,
    harvest,
)
from mooringdx.logs.mcap_records import MAGIC, records
from mooringdx.logs.mcap_write import write
from mooringdx.registry import did_you_mean
from mooringdx.types import Check, LogSource, RawLog, Signal

__all__ = ["read", "records", "write"]

_DAY = 86400 * 10**9


def read(
    path: Path,
    channels: Mapping[str, ChannelSource] | None = None,
    time: TimeSource | None = None,
    progress: Progress | None = None,
) -> RawLog:
    """Read an MCAP file; of a damaged one, everything that can be read.

    Parameters
    ----------
    path : the file.
    channels : name -> topic, field path such as ``pose.position.x`` or ``tensions.data[3]``, and unit. None gives every
        numeric field of every topic as a signal named "topic field.path" (arrays of up to 16 elements spelled out).
    time : log time (the default), publish time, or the stamp at a field ("header.stamp" when not named).
    progress : called with (bytes read, bytes of the file).

    Returns
    -------
    The signals in the units of the file, each sorted by its stamps: s since the first stamp of the log, or as
    logged where the clock counts from its own start; what was lost, as checks.

    Raises
    ------
    LogError : no such file, not an MCAP file, or an asked topic or field is not in it.
    """
    clock = TimeSource() if time is None else time
    try:
        size = path.stat().st_size
        found = harvest(path, size, channels, clock, progress)
        with path.open("rb") as handle:
            begins = handle.read(len(MAGIC)) == MAGIC
            handle.seek(max(size - len(MAGIC), 0))
            found.closed = found.closed and handle.read() == MAGIC
            handle.seek(0)
            digest = hashlib.file_digest(handle, "sha256").hexdigest()
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}; give the path of an MCAP file") from None
    if not (begins or found.messages or found.channels):
        raise LogError(f"{path}: not an MCAP file: it does not begin with the MCAP signature and no record can be read")
    epoch_ns = _epoch(found, clock)
    signals, dropped = _signals(path, found, channels, epoch_ns)
    checks = (*_file_checks(path, found, size), *_topic_checks(found, dropped, clock))
    source = LogSource(path=str(path), format="mcap", bytes=size, sha256=digest)
    return RawLog(signals=signals, source=source, epoch_ns=epoch_ns, checks=checks)


def _epoch(found: Harvest, clock: TimeSource) -> int | None:
    """Return the instant of time zero, ns: the first stamp of the whole log, whichever channels were asked for.

    Header stamps are known of decoded messages only, so that there the first log time counts when it is near them.
    """
    if clock.source != "header":
        return found.logged.first
    stamped, logged = found.stamped.first, found.logged.first
    if stamped is None or logged is None or abs(stamped - logged) > _DAY:
        return stamped
    return logged


def _signals(
    path: Path, found: Harvest, channels: Mapping[str, ChannelSource] | None, epoch_ns: int | None
) -> tuple[dict[str, Signal], Counter[str]]:
    """Return the signals, and per topic how many samples were left out for a stamp without a date among dated ones."""
    if channels is None:
        wanted = [
            (f"{topic} {name}", topic, name, "") for topic in found.topics for name in found.topics[topic].columns
        ]
    else:
        wanted = []
        for channel, place in channels.items():
            topic, name = place.topic or "", place.field or ""
            _check_asked(path, found, channel, topic, name)
            wanted.append((channel, topic, name, place.unit or ""))
    signals: dict[str, Signal] = {}
    dropped: Counter[str] = Counter()
    for channel, topic, name, unit in wanted:
        stamps, values = (np.array(column) for column in found.topics[topic].columns[name])
        keep = (stamps >= DATED) == (epoch_ns is not None)
        dropped[topic] = max(dropped[topic], int(np.count_nonzero(~keep)))
        order = np.argsort(stamps[keep], kind="stable")
        seconds = (stamps[keep][order] - (epoch_ns or 0)) / 1e9
        signals[channel] = Signal(channel, seconds, values[keep][order], unit, f"{topic} {name}")
    return signals, dropped


def _check_asked(path: Path, found: Harvest, channel: str, name: str, field: str) -> None:
    """Raise a LogError where an asked field gave nothing."""
    damage = " (the file is damaged: see the checks)" if found.losses or not found.closed else ""
    topic = found.topics.get(name)
    what = f"{path}: channel {channel}:"
    if topic is None:
        raise LogError(f"{what} no topic '{name}'{damage}{did_you_mean(name, found.topics) if found.topics else ''}")
    if topic.columns.get(field):
        return
    if topic.refused and not topic.decoded:
        raise LogError(f"{what} topic '{name}': {topic.refused}")
    if not topic.decoded:
        why = f"; {topic.failed} could not be decoded ({topic.reason})" if topic.failed else ""
        raise LogError(f"{what} no message of topic '{name}' could be read{why}{damage}")
    if topic.unstamped == topic.decoded:
        raise LogError(f"{what} the messages of topic '{name}' have no stamp where the time source says; use log_time")
    fields = list(dict.fromkeys(leaf for leaf, _ in decode.leaves(topic.example)))
    raise LogError(f"{what} topic '{name}' has no number at '{field}'{did_you_mean(field, fields)}")


def _row(name: str, subject: str, count: float, detail: str, remedy: str, unit: str = "") -> Check:
    return Check(
        name, subject, count == 0, detail, value=float(count), limit=0.0, unit=unit, remedy=remedy if count else ""
    )


def _file_checks(path: Path, found: Harvest, size: int) -> list[Check]:
    def lost(*kinds: str) -> tuple[int, int, str]:
        rows = [loss for loss in found.losses if loss.what in kinds]
        first = f"; first at byte {rows[0].offset}: {rows[0].detail}" if rows else ""
        return len(rows), sum(loss.size for loss in rows), first

    subject = path.name
    places, skipped, where = lost("bytes")
    chunks, chunk_bytes, chunk_where = lost("chunk", "crc")
    damaged, _, damaged_where = lost("record")
    unknown, _, unknown_where = lost("unknown")
    copy = "copy the log from the recorder again"
    end = (
        "complete"
        if found.closed
        else "the file was cut or never closed: no footer; every whole record before was read"
    )
    rows = [
        Check("mcap_end", subject, found.closed, end, remedy="" if found.closed else copy),
        _row("mcap_bytes_lost", subject, skipped, f"{skipped} of {size} bytes in {places} places{where}", copy, "B"),
        _row("mcap_chunks_damaged", subject, chunks, f"{chunks} chunks, {chunk_bytes} bytes{chunk_where}", copy),
        _row("mcap_records_damaged", subject, damaged, f"{damaged} records{damaged_where}", copy),
    ]
    if unknown:
        detail = f"{unknown} records of a type that the format does not define were skipped{unknown_where}"
        rows.append(
            _row("mcap_unknown_records", subject, unknown, detail, "none, when the recorder writes its own types")
        )
    if found.expected is not None:
        missing = found.expected - found.messages
        detail = f"{found.messages} messages were read, the file's own statistics count {found.expected}"
        rows.append(_row("mcap_messages_missing", subject, missing, detail, copy))
    orphans = sum(found.orphans.values())
    if orphans:
        detail = (
            f"{orphans} messages belong to channels {sorted(found.orphans)[:8]}, whose definition is not in the file"
        )
        rows.append(_row("mcap_messages_undefined", subject, orphans, detail, copy))
    if found.logged.impossible:
        detail = f"{found.logged.impossible} messages are stamped after the year 2262 and were left out"
        rows.append(_row("mcap_stamps_impossible", subject, found.logged.impossible, detail, copy))
    return rows


def _topic_checks(found: Harvest, dropped: Mapping[str, int], clock: TimeSource) -> list[Check]:
    rows: list[Check] = []
    stamp = clock.field or HEADER_STAMP if clock.source == "header" else clock.source
    for name, topic in found.topics.items():
        if topic.refused:
            rows.append(
                Check(
                    "mcap_encoding",
                    name,
                    False,
                    topic.refused,
                    remedy="none, unless a channel is needed from this topic",
                )
            )
        if topic.decoded or topic.failed:
            detail = (
                f"{topic.out_of_order} of {topic.decoded} messages are stamped before an earlier one; sorted by stamp"
            )
            rows.append(_row("mcap_out_of_order", name, topic.out_of_order, detail, "none needed"))
        counts = {
            "mcap_undecodable": (topic.failed, f"messages could not be decoded (first: {topic.reason})"),
            "mcap_unstamped": (topic.unstamped, f"messages have no usable stamp at '{stamp}' and were left out"),
            "mcap_undated": (
                dropped.get(name, 0),
                "samples carry a stamp of another clock than most and were left out",
            ),
            "mcap_fields_left_out": (topic.left_out, "values stand in fields beyond the first 4096 and were left out"),
        }
        rows.extend(_row(key, name, n, f"{n} {what}", "see the recorder") for key, (n, what) in counts.items() if n)
        rows.extend(_long_arrays(name, topic))
    return rows


def _long_arrays(name: str, topic: Topic) -> list[Check]:
    """Return a row for each array that was too long to become signals: no defect, but said."""
    what = f"is longer than {decode.LONGEST_ARRAY} and was not spelled out; ask for an element by name, such as"
    return [
        Check("mcap_long_array", f"{name} {field}", True, f"this array {what} '{field}[0]'", value=float(length))
        for field, length in topic.long.items()
    ]
