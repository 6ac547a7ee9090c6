"""Walk an MCAP file once and keep the asked fields of its messages, with what could not be read."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mooringdx.config import ChannelSource, TimeSource
from mooringdx.errors import LogError
from mooringdx.logs import mcap_decode as decode
from mooringdx.logs.mcap_records import (
    CHANNEL,
    FOOTER,
    HEADER,
    MESSAGE,
    MESSAGE_HEAD,
    SCHEMA,
    STATISTICS,
    Loss,
    Record,
    parse,
    walk,
)
from mooringdx.logs.mcap_ros import UndecodableError

if TYPE_CHECKING:
    from mcap.records import Channel, Schema

DATED = 10**17
"""ns: a clock that reads less (before 1973) counts from its own start, not from 1970."""

HEADER_STAMP = "header.stamp"

_LATEST = 2**63
_MOST_FIELDS = 4096

Progress = Callable[[int, int], None]
Paths = Mapping[str, tuple[decode.Token, ...]]


@dataclass
class Stamps:
    """The stamps seen: how many with a date, without one, or impossible; the first with a date, ns."""

    dated: int = 0
    undated: int = 0
    impossible: int = 0
    first_sound: int = _LATEST
    first_doubtful: int = _LATEST

    def add(self, stamp: int, sound: bool) -> bool:
        """Count a stamp in ns and tell whether it can be kept."""
        if not 0 <= stamp < _LATEST:
            self.impossible += 1
            return False
        if stamp < DATED:
            self.undated += 1
            return True
        self.dated += 1
        if sound:
            self.first_sound = min(stamp, self.first_sound)
        else:
            self.first_doubtful = min(stamp, self.first_doubtful)
        return True

    @property
    def first(self) -> int | None:
        """The first stamp, when most stamps have a date; that of a damaged part only where nothing else is."""
        if self.dated <= self.undated:
            return None
        return self.first_sound if self.first_sound < _LATEST else self.first_doubtful


@dataclass
class Topic:
    """What was found on one topic. ``columns``: field path -> stamps in ns, values."""

    columns: dict[str, tuple[array[int], array[float]]] = field(default_factory=dict)
    decoded: int = 0
    failed: int = 0
    unstamped: int = 0
    out_of_order: int = 0
    latest: int = -1
    reason: str = ""
    refused: str = ""
    example: Any = None
    long: dict[str, int] = field(default_factory=dict)
    left_out: int = 0


@dataclass(frozen=True)
class _Plan:
    """How the messages of one channel are read; ``paths`` None keeps every numeric field."""

    topic: Topic
    decoder: decode.Decoder
    damage: tuple[type[BaseException], ...]
    paths: Paths | None


@dataclass
class Harvest:
    """What one walk gave. ``joined``: several files in one; ``mended``: a doubtful definition was replaced later."""

    topics: dict[str, Topic] = field(default_factory=dict)
    losses: list[Loss] = field(default_factory=list)
    channels: dict[int, Channel] = field(default_factory=dict)
    schemas: dict[int, Schema] = field(default_factory=dict)
    doubtful: set[tuple[int, int]] = field(default_factory=set)
    plans: dict[int, _Plan | None] = field(default_factory=dict)
    logged: Stamps = field(default_factory=Stamps)
    stamped: Stamps = field(default_factory=Stamps)
    orphans: Counter[int] = field(default_factory=Counter)
    messages: int = 0
    expected: int | None = None
    closed: bool = False
    joined: bool = False
    mended: bool = False


def harvest(
    path: Path, size: int, channels: Mapping[str, ChannelSource] | None, clock: TimeSource, progress: Progress | None
) -> Harvest:
    """Walk the file; a second time where it is damaged before its definitions (they stand in the summary again).

    Raises
    ------
    LogError : a channel has no topic, no field, or a field that is no path.
    OSError : the file cannot be read.
    """
    asked = None if channels is None else _asked(path, channels)
    found = _walk(path, size, asked, clock, progress, Harvest())
    skipped = any(loss.what in ("bytes", "record") for loss in found.losses)
    orphaned = any(_defined(number, found) for number in found.orphans)
    if not found.joined and found.channels and (skipped or orphaned or found.mended):
        found = _walk(path, size, asked, clock, progress, _seed(found))
    return found


def _seed(known: Harvest) -> Harvest:
    """Return the start of a second walk: the sound definitions of the first."""
    sure = {number: c for number, c in known.channels.items() if (CHANNEL, number) not in known.doubtful}
    schemas = {number: s for number, s in known.schemas.items() if (SCHEMA, number) not in known.doubtful}
    return Harvest(channels=sure, schemas=schemas, topics={channel.topic: Topic() for channel in sure.values()})


def _defined(number: int, known: Harvest) -> bool:
    channel = known.channels.get(number)
    return channel is not None and (channel.schema_id == 0 or channel.schema_id in known.schemas)


def _asked(path: Path, channels: Mapping[str, ChannelSource]) -> dict[str, Paths]:
    asked: dict[str, dict[str, tuple[decode.Token, ...]]] = {}
    for name, place in channels.items():
        if place.topic is None or place.field is None:
            raise LogError(f'{path}: channel {name} needs a topic and a field, such as "pose.position.x"')
        try:
            asked.setdefault(place.topic, {})[place.field] = decode.path(place.field)
        except ValueError as error:
            raise LogError(f"{path}: channel {name}: {error}") from None
    return dict(asked)


def _walk(
    path: Path,
    size: int,
    asked: Mapping[str, Paths] | None,
    clock: TimeSource,
    progress: Progress | None,
    found: Harvest,
) -> Harvest:
    told = 0
    with path.open("rb", buffering=1 << 20) as handle:
        for record in walk(handle, size, found.losses, tuple(found.channels)):
            if record.opcode == MESSAGE:
                _message(found, record, asked, clock)
            else:
                _define(found, record)
            if progress is not None and record.offset - told >= 1 << 20:
                told = record.offset
                progress(told, size)
    if progress is not None:
        progress(size, size)
    return found


def _define(found: Harvest, record: Record) -> None:
    """Take in a record that is no message. Within one file the first sound definition of an id holds."""
    if record.opcode == HEADER and found.closed:
        found.channels, found.schemas, found.plans, found.closed = {}, {}, {}, False
        found.doubtful.clear()
        found.joined = True
    elif record.opcode == FOOTER:
        found.closed = True
    elif record.opcode in (CHANNEL, SCHEMA, STATISTICS):
        parsed: Any = parse(record, found.losses)
        if parsed is None:
            return
        if record.opcode == STATISTICS:
            found.expected = (found.expected or 0) + parsed.message_count
            return
        table: dict[int, Any] = found.channels if record.opcode == CHANNEL else found.schemas
        key = (record.opcode, parsed.id)
        if parsed.id in table and (table[parsed.id] == parsed or key not in found.doubtful):
            return
        found.mended = found.mended or parsed.id in table
        table[parsed.id] = parsed
        (found.doubtful.discard if record.sound else found.doubtful.add)(key)
        if record.opcode == CHANNEL:
            found.topics.setdefault(parsed.topic, Topic())
            found.plans.pop(parsed.id, None)
        else:
            users = [number for number, channel in found.channels.items() if channel.schema_id == parsed.id]
            for number in users:
                found.plans.pop(number, None)


def _message(found: Harvest, record: Record, asked: Mapping[str, Paths] | None, clock: TimeSource) -> None:
    head = record.fetch(record.start, MESSAGE_HEAD.size)
    if len(head) < MESSAGE_HEAD.size:
        return
    number, _, log_time, publish_time = MESSAGE_HEAD.unpack(head)
    stamp = publish_time if clock.source == "publish_time" else log_time
    found.messages += 1
    possible = found.logged.add(stamp, record.sound)
    if number not in found.plans:
        channel = found.channels.get(number)
        schema = None if channel is None else found.schemas.get(channel.schema_id)
        if channel is None or (schema is None and channel.schema_id != 0):
            found.orphans[number] += 1
            return
        found.plans[number] = _plan(found, channel, schema, asked)
    plan = found.plans[number]
    if plan is None:
        return
    data = record.fetch(record.start + MESSAGE_HEAD.size, record.length - MESSAGE_HEAD.size)
    topic = plan.topic
    try:
        message = plan.decoder(data)
        values = _values(plan, message)
    except plan.damage as error:
        topic.failed += 1
        topic.reason = topic.reason or f"{type(error).__name__}: {error}"[:200]
        return
    topic.decoded += 1
    if topic.example is None and asked is not None:
        topic.example = message
    if clock.source == "header":
        header = _header_stamp(message, clock)
        possible = header is not None and found.stamped.add(header, record.sound)
        stamp = header if header is not None else 0
    if not possible:
        topic.unstamped += 1
        return
    topic.out_of_order += stamp < topic.latest
    topic.latest = max(stamp, topic.latest)
    for name, value in values:
        stamps, kept = topic.columns.setdefault(name, (array("q"), array("d")))
        stamps.append(stamp)
        kept.append(value)


def _plan(found: Harvest, channel: Channel, schema: Schema | None, asked: Mapping[str, Paths] | None) -> _Plan | None:
    topic = found.topics.setdefault(channel.topic, Topic())
    if asked is not None and channel.topic not in asked:
        return None
    try:
        decoder, damage = decode.decoder(channel, schema)
    except UndecodableError as error:
        topic.refused = str(error)
        return None
    return _Plan(topic, decoder, damage, None if asked is None else asked[channel.topic])


def _values(plan: _Plan, message: Any) -> list[tuple[str, float]]:
    """Return the wanted numbers of a message; a field that it does not have, or a text, is left out."""
    kept: list[tuple[str, float]] = []
    if plan.paths is not None:
        for name, tokens in plan.paths.items():
            try:
                value = decode.number(decode.follow(message, tokens))
            except LookupError:
                continue
            if value is not None:
                kept.append((name, value))
        return kept
    topic = plan.topic
    for name, leaf in decode.leaves(message):
        if isinstance(leaf, int):
            topic.long[name] = max(leaf, topic.long.get(name, 0))
        elif name in topic.columns or len(topic.columns) + len(kept) < _MOST_FIELDS:
            kept.append((name, leaf))
        else:
            topic.left_out += 1
    return kept


def _header_stamp(message: Any, clock: TimeSource) -> int | None:
    try:
        return decode.stamp_ns(decode.follow(message, decode.path(clock.field or HEADER_STAMP)), clock.unit)
    except (LookupError, ValueError, TypeError, OverflowError):
        return None
