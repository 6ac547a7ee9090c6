"""Open an MCAP chunk: read its fields, decompress it up to the first fault, with bounded memory."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

NAMES = {
    1: "Header",
    2: "Footer",
    3: "Schema",
    4: "Channel",
    6: "Chunk",
    7: "MessageIndex",
    8: "ChunkIndex",
    9: "Attachment",
    10: "AttachmentIndex",
    11: "Statistics",
    12: "Metadata",
    13: "MetadataIndex",
    14: "SummaryOffset",
    15: "DataEnd",
}

LARGEST = 1 << 28
"""Bytes at most that one compressed chunk may become: a few bytes can claim, or even give, terabytes."""

_FIELDS = struct.Struct("<QQQII")
_MAGICS = {b"\x28\xb5\x2f\xfd": "zstd", b"\x04\x22\x4d\x18": "lz4"}
_STEP, _SMALL_STEP = 1 << 20, 1 << 10


class Layout(NamedTuple):
    """A chunk's fields. ``start``: where its records begin in the body, ``size``: how many bytes, as stored."""

    compression: str
    start: int
    size: int
    uncompressed: int
    crc: int


def layout(body: bytes) -> Layout | None:
    """Return the fields of the chunk whose body begins with ``body`` (64 bytes), or None where they make no sense.

    A compression name that is no known one is replaced by what the compressed bytes say of themselves.
    """
    if len(body) < _FIELDS.size + 8:
        return None
    _, _, uncompressed, crc, count = _FIELDS.unpack_from(body)
    for letters in dict.fromkeys((count, 4, 3)):
        start = _FIELDS.size + letters + 8
        if letters > 16 or start > len(body):
            continue
        name = body[_FIELDS.size : start - 8].decode("utf-8", errors="replace")
        own = _MAGICS.get(body[start : start + 4])
        if name not in ("", "zstd", "lz4"):
            name = own or "?"
        if name != "?" and (letters == count or own is not None):
            return Layout(name, start, int.from_bytes(body[start - 8 : start], "little"), uncompressed, crc)
    return None


def inflate(compression: str, data: bytes) -> tuple[bytes, str]:
    """Return the decompressed bytes up to the first fault, and what the fault was ("" for none).

    At most ``LARGEST`` bytes are made, whatever the data claim.
    """
    out, problem = _collect(_pieces(compression, data, _STEP))
    if problem and problem != _TOO_LARGE:
        out, problem = _collect(_pieces(compression, data, _SMALL_STEP))
    return out, problem


_TOO_LARGE = f"it grows beyond {LARGEST >> 20} MiB"


def _collect(pieces: Iterator[bytes]) -> tuple[bytes, str]:
    from zstandard import ZstdError

    found: list[bytes] = []
    total = 0
    try:
        for piece in pieces:
            total += len(piece)
            if total > LARGEST:
                return b"".join(found), _TOO_LARGE
            found.append(piece)
    except (ZstdError, RuntimeError, EOFError, ValueError, MemoryError) as error:
        return b"".join(found), f"it does not decompress ({error})"
    return b"".join(found), ""


def _pieces(compression: str, data: bytes, step: int) -> Iterator[bytes]:
    if compression == "zstd":
        import zstandard

        with zstandard.ZstdDecompressor().stream_reader(data) as stream:
            while piece := stream.read(step):
                yield piece
        return
    import lz4.frame

    frame = lz4.frame.LZ4FrameDecompressor()
    piece = frame.decompress(data, max_length=step)
    while piece:
        yield piece
        if frame.eof:
            return
        piece = frame.decompress(b"", max_length=step)
