"""Walk the records of an MCAP file from front to back, past damage, with bounded memory.

An MCAP file is a magic number, then records of an opcode (1 byte), a length (8 bytes) and a body; a
chunk is a record that holds others, perhaps compressed. The index and the summary at the end are never
needed here, so that a file which was cut, or never closed, gives what it holds. Three rules:

- no number of the file is trusted before it was compared with the bytes that are left;
- where a record cannot be right, the walk goes on at the next place where *two* records follow each other;
- a chunk that does not decompress to its end gives the records before that end.

What this cannot see: a flipped bit inside an unchunked message, unless the writer stored a checksum of the
whole data section (few do), or the message no longer decodes.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, NamedTuple

from mooringdx.logs.mcap_chunks import NAMES, Layout, inflate, layout

if TYPE_CHECKING:
    from mcap.data_stream import ReadDataStream
    from mcap.records import McapRecord

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, STATISTICS, DATA_END = 1, 2, 3, 4, 5, 6, 11, 15
MESSAGE_HEAD = struct.Struct("<HIQQ")

_HEAD = struct.Struct("<BQ")
_SHORTEST = {1: 8, 2: 20, 3: 14, 4: 16, 5: 22, 6: 40, 7: 6, 8: 64, 9: 36, 10: 48, 11: 46, 12: 8, 13: 20, 14: 17, 15: 4}
_CANDIDATE = re.compile(rb"[\x01-\x0f][\x00-\xff]{4}\x00{4}", re.DOTALL)
_BLOCK = 1 << 20

Fetch = Callable[[int, int], bytes]


class Loss(NamedTuple):
    """Something that could not be read, or not be trusted.

    ``what``: "bytes" (skipped or cut), "chunk" (not decompressed to its end), "crc", "record" (its fields do not
    parse), "unknown" (a record type that the format does not define). ``offset``: in the file, that of the chunk for
    what stood in a compressed one. ``size``: bytes concerned.
    """

    what: str
    offset: int
    size: int
    detail: str


class Record(NamedTuple):
    """One record, its body not yet read. ``sound`` is false where a checksum or a decompression failed."""

    opcode: int
    offset: int
    start: int
    length: int
    fetch: Fetch
    sound: bool

    def body(self) -> bytes:
        """Return the body's bytes."""
        return self.fetch(self.start, self.length)


class _Region(NamedTuple):
    """A stretch of records: of the file (``base`` None), or a decompressed chunk that stood at ``base``."""

    fetch: Fetch
    start: int
    stop: int
    base: int | None
    sound: bool
    channels: set[int]

    def place(self, at: int) -> int:
        return at if self.base is None else self.base

    def loss(self, start: int, stop: int, detail: str) -> Loss:
        """Return the loss of a stretch; that inside a decompressed chunk is no stretch of the file."""
        if self.base is None:
            return Loss("bytes", start, stop - start, detail)
        return Loss("record", self.base, stop - start, f"{detail}, at byte {start} of the decompressed chunk")


def walk(handle: BinaryIO, size: int, losses: list[Loss], known: Iterable[int] = ()) -> Iterator[Record]:
    """Yield every record in the order of the file, those of a chunk in the place of the chunk.

    Parameters
    ----------
    handle : an opened binary file.
    size : bytes of the file.
    losses : what could not be read is appended here.
    known : channel ids in use; in a damaged stretch, a message is recognised by these and by those met before.
    """

    def fetch(offset: int, count: int) -> bytes:
        handle.seek(offset)
        return handle.read(count)

    channels = set(known)
    first = 0
    for record in _records(_Region(fetch, 0, size, None, True, channels), losses):
        if record.opcode == CHUNK:
            yield from _open_chunk(record, channels, losses)
            continue
        if record.opcode == HEADER:
            first = max(record.offset - len(MAGIC), 0)
        elif record.opcode == DATA_END:
            _check_section(record, first, losses)
        yield record


def records(path: Path, losses: list[Loss] | None = None) -> Iterator[McapRecord]:
    """Yield every record as the ``mcap`` package's dataclass, in the order of the file, chunks opened.

    Parameters
    ----------
    path : the file.
    losses : what could not be read is appended here, when given.

    Raises
    ------
    OSError : the file cannot be opened or read.
    """
    found = [] if losses is None else losses
    with path.open("rb", buffering=_BLOCK) as handle:
        for record in walk(handle, path.stat().st_size, found):
            parsed = parse(record, found)
            if parsed is not None:
                yield parsed


def parse(record: Record, losses: list[Loss]) -> McapRecord | None:
    """Return a record's fields, or None (and a Loss) where they do not parse or its type is unknown."""
    from mcap import records as kinds

    body = record.body()
    try:
        if record.opcode == MESSAGE:
            channel_id, sequence, log_time, publish_time = MESSAGE_HEAD.unpack_from(body)
            return kinds.Message(channel_id, log_time, body[MESSAGE_HEAD.size :], publish_time, sequence)
        if record.opcode not in NAMES:
            losses.append(Loss("unknown", record.offset, record.length, f"record type {record.opcode}"))
            return None
        kind = getattr(kinds, NAMES[record.opcode])
        parsed: McapRecord = kind.read(_exact()(BytesIO(body)))
    except (EOFError, struct.error, UnicodeDecodeError) as error:
        what = f"{NAMES[record.opcode]} record: {error or 'its fields are longer than itself'}"
        losses.append(Loss("record", record.offset, record.length, what))
        return None
    return parsed


@cache
def _exact() -> type[ReadDataStream]:
    """Return a stream that refuses a short read, which the package's own lets pass."""
    from mcap.data_stream import ReadDataStream

    class Exact(ReadDataStream):
        def read(self, length: int) -> bytes:
            data = self._stream.read(length)
            self._count += len(data)
            if len(data) != length:
                raise EOFError
            return data

    return Exact


def _records(region: _Region, losses: list[Loss]) -> Iterator[Record]:
    at, resume = region.start, None
    while at < region.stop:
        head = region.fetch(at, 9)
        if head[:8] == MAGIC:
            at += 8
            continue
        length = _length(region, at, head)
        if length is None:
            cut = _is_cut_chunk(region, at, head)
            found = None if cut else resume if resume is not None and resume > at else _resync(region, at + 1)
            stop = region.stop if found is None else found
            if cut:
                yield Record(CHUNK, at, at + 9, stop - at - 9, region.fetch, False)
            else:
                losses.append(region.loss(at, stop, "no record can be read here"))
            at = stop
            continue
        end, sound = at + 9 + length, region.sound
        if head[0] == MESSAGE and not _begins(region, end):
            resume = _resync(region, at + 1)
            if resume is not None and resume < end:
                losses.append(region.loss(at, resume, "a record's length is wrong"))
                at = resume
                continue
            sound = sound and resume is None
        if head[0] == CHANNEL:
            region.channels.add(int.from_bytes(region.fetch(at + 9, 2), "little"))
        yield Record(head[0], region.place(at), at + 9, length, region.fetch, sound)
        at = end


def _length(region: _Region, at: int, head: bytes) -> int | None:
    """Return the length of the record at ``at``, mended where a chunk's own fields prove it, or None."""
    if len(head) < 9:
        return None
    opcode, length = _HEAD.unpack(head)
    fits = opcode != 0 and _SHORTEST.get(opcode, 0) <= length <= region.stop - at - 9
    if opcode == CHUNK and (not fits or not _begins(region, at + 9 + length)):
        own = layout(region.fetch(at + 9, 64))
        if own is not None and _begins(region, at + 9 + own.start + own.size):
            return own.start + own.size
    return int(length) if fits else None


def _begins(region: _Region, at: int) -> bool:
    """Tell whether a record, the closing magic or the end of the region stands at ``at``."""
    if at >= region.stop - 8:
        return at <= region.stop
    head = region.fetch(at, 9)
    if len(head) < 9 or head[:8] == MAGIC:
        return True
    opcode, length = _HEAD.unpack(head)
    return opcode != 0 and bool(_SHORTEST.get(opcode, 0) <= length <= region.stop - at - 9)


def _resync(region: _Region, at: int) -> int | None:
    """Return the next place where a record of a known type is followed by another, or None."""
    while at < region.stop - 8:
        data = region.fetch(at, _BLOCK + 8)
        magic = data.find(MAGIC)
        hit = _CANDIDATE.search(data)
        while hit is not None:
            if 0 <= magic < hit.start():
                break
            if _fits(region, at + hit.start()):
                return at + hit.start()
            hit = _CANDIDATE.search(data, hit.start() + 1)
        if magic >= 0:
            return at + magic
        if len(data) <= 8:
            return None
        at += len(data) - 8
    return None


def _fits(region: _Region, at: int) -> bool:
    """Tell whether the bytes at ``at`` are a record of a known type whose fields agree with its length."""
    opcode, length = _HEAD.unpack(region.fetch(at, 9))
    if not _SHORTEST[opcode] <= length <= region.stop - at - 9 or not _begins(region, at + 9 + length):
        return False
    start = region.fetch(at + 9, 64)
    if opcode == MESSAGE:
        return int.from_bytes(start[:2], "little") in region.channels
    if opcode == CHUNK:
        own = layout(start)
        return own is not None and own.start + own.size <= length
    return length <= _BLOCK and parse(Record(opcode, at, at + 9, length, region.fetch, True), []) is not None


def _is_cut_chunk(region: _Region, at: int, head: bytes) -> bool:
    """Tell whether a chunk runs beyond the end of the file: its two lengths agree on that."""
    own = layout(region.fetch(at + 9, 64)) if len(head) == 9 and head[0] == CHUNK and region.base is None else None
    length = int.from_bytes(head[1:], "little")
    return own is not None and length > region.stop - at - 9 and 0 <= length - own.start - own.size <= 16


def _open_chunk(record: Record, channels: set[int], losses: list[Loss]) -> Iterator[Record]:
    own = layout(record.fetch(record.start, 64))
    if own is None or own.start > record.length:
        detail = "a chunk's header cannot be read, nor what compresses it"
        losses.append(Loss("chunk", record.offset, record.length, detail))
        return
    start, size = record.start + own.start, min(own.size, record.length - own.start)
    if own.compression == "":
        sound = record.sound and _same_crc(record.fetch, start, size, own, record.offset, losses)
        region = _Region(record.fetch, start, start + size, None, sound, channels)
    else:
        data, problem = inflate(own.compression, record.fetch(start, size))
        if problem or len(data) < own.uncompressed:
            detail = f"{problem or 'it ends early'}; {len(data)} of {own.uncompressed} bytes were read"
            losses.append(Loss("chunk", record.offset, record.length, detail))
            sound = False
        else:
            sound = record.sound and _same_crc(_window(data), 0, len(data), own, record.offset, losses)
        region = _Region(_window(data), 0, len(data), record.offset, sound, channels)
    yield from _records(region, losses)


def _window(data: bytes) -> Fetch:
    return lambda offset, count: data[offset : offset + count]


def _same_crc(fetch: Fetch, start: int, size: int, own: Layout, offset: int, losses: list[Loss]) -> bool:
    if own.crc in (0, _crc(fetch, start, start + size)):
        return True
    losses.append(Loss("crc", offset, size, "the chunk's checksum is wrong"))
    return False


def _check_section(record: Record, first: int, losses: list[Loss]) -> None:
    """Compare the data section with its stored checksum; most writers store none."""
    stored = int.from_bytes(record.fetch(record.start, 4), "little")
    if stored and stored != _crc(record.fetch, first, record.offset):
        losses.append(Loss("crc", first, record.offset - first, "the data section's checksum is wrong"))


def _crc(fetch: Fetch, start: int, stop: int) -> int:
    crc = 0
    for at in range(start, stop, _BLOCK):
        crc = zlib.crc32(fetch(at, min(_BLOCK, stop - at)), crc)
    return crc
