"""The bytes of a text log in blocks of whole lines: plain, gzip or zstd, with bounded memory.

Whatever stands before a damage is handed on; what was lost is entered in a ``Tally``.
"""

from __future__ import annotations

import codecs
import hashlib
import re
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from mooringdx.errors import LogError
from mooringdx.types import LogSource

BLOCK = 4 << 20
GZIP = b"\x1f\x8b"
ZSTD = b"\x28\xb5\x2f\xfd"
_PIECE = 1 << 16
_ZSTD_PIECE = 1 << 10
_UTF16 = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
# NUL and all beyond ASCII cannot be part of a number or a stamp: the cell becomes unreadable, never another number.
_MARK = bytes(b if 0 < b < 128 else ord("?") for b in range(256))

Progress = Callable[[int, int], None]


@dataclass
class Tally:
    """What a text log lost on the way. Lines are counted from 1, as an editor shows them."""

    position: int = 0
    lines: int = 0
    rows: int = 0
    cut: str = ""
    ragged: int = 0
    ragged_first: tuple[int, str] | None = None
    late: int = 0
    late_first: tuple[int, str] | None = None
    missing: Counter[str] = field(default_factory=Counter)
    unreadable: Counter[str] = field(default_factory=Counter)
    examples: list[tuple[int, str, str]] = field(default_factory=list)

    def lose(self, count: int, line: int, text: str) -> None:
        """Enter ``count`` lines that have another number of columns, the first at ``line``."""
        self.ragged += count
        if self.ragged_first is None:
            self.ragged_first = (line, text[:60])


def identify(path: Path, form: str) -> LogSource:
    """Return where a log came from, with the sha256 of its bytes; LogError when it cannot be opened."""
    try:
        with path.open("rb") as handle:
            digest = hashlib.file_digest(handle, "sha256").hexdigest()
        return LogSource(path=str(path), format=form, bytes=path.stat().st_size, sha256=digest)
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}; give the path of a log file") from None


def chunks(path: Path, tally: Tally) -> Iterator[bytes]:
    """Yield the text of a file in pieces, decompressed, without byte-order mark, UTF-16 turned into UTF-8."""
    try:
        with path.open("rb") as handle:
            magic = handle.read(4)
            handle.seek(0)
            if magic.startswith(GZIP):
                yield from _decode(_gunzip(handle, tally))
            elif magic == ZSTD:
                yield from _decode(_unzstd(handle, tally))
            else:
                yield from _decode(_plain(handle, tally))
    except OSError as error:
        raise LogError(f"{path}: {error.strerror or error}; give the path of a log file") from None


def head(path: Path, size: int = _PIECE) -> bytes:
    """Return the first ``size`` bytes of text."""
    found = b""
    for chunk in chunks(path, Tally()):
        found += chunk
        if len(found) >= size:
            break
    return found[:size]


def blocks(path: Path, tally: Tally, newline: bytes = b"\n", size: int = BLOCK) -> Iterator[bytes]:
    """Yield blocks of whole lines, each of about ``size`` bytes, the last line closed even if the file does not.

    A line longer than a block is no line of a log: it is counted as lost and its memory is given back. The last line
    of a compressed stream that breaks off is lost too, because its last number may be cut.
    """
    parts: list[bytes] = []
    held, skipping = 0, False
    for piece in chunks(path, tally):
        chunk = piece if newline == b"\n" else piece.replace(newline, b"\n")
        if skipping:
            _, found, chunk = chunk.partition(b"\n")
            skipping = not found
        parts.append(chunk)
        held += len(chunk)
        if held < size:
            continue
        data = b"".join(parts)
        end = data.rfind(b"\n") + 1
        if end:
            yield data[:end]
        else:
            tally.lose(1, tally.lines + 1, f"{len(data)} bytes without a line end")
            skipping = True
        parts = [data[end:]] if end else []
        held = len(data) - end if end else 0
    data = b"".join(parts)
    end = data.rfind(b"\n") + 1 if tally.cut else len(data)
    if end:
        yield data[:end] if data[:end].endswith(b"\n") else data[:end] + b"\n"
    if data[end:]:
        tally.lose(1, tally.lines + 1, data[end:].decode("latin-1"))


def clean(block: bytes, delimiter: bytes, comment: bytes | None) -> bytes:
    r"""Return a block as the parser wants it: one delimiter, ``\\n``, ASCII, no comments; the count of lines stays."""
    if b"\r" in block:
        block = block.replace(b"\r\n", b"\n").replace(b"\r", b"?")
    if not block.isascii() or b"\0" in block:
        block = block.translate(_MARK)
    if comment is not None and comment in block:
        block = re.sub(rb"(?m)^[ \t]*" + re.escape(comment) + rb"[^\n]*", b"", block)
    if delimiter == b" ":
        block = _squeeze(block)
    if b'"' in block:
        block = _mend_quotes(block, delimiter)
    return block


def _squeeze(block: bytes) -> bytes:
    block = block.replace(b"\t", b" ")
    for run in (16, 8, 4, 2, 2, 2):
        block = block.replace(b" " * run, b" ")
    while b"  " in block:
        block = block.replace(b"  ", b" ")
    block = block.replace(b"\n ", b"\n").replace(b" \n", b"\n")
    return block[1:] if block.startswith(b" ") else block


def _mend_quotes(block: bytes, delimiter: bytes) -> bytes:
    d = re.escape(delimiter)
    cell = rb'(?>"[^"\n]*+"|[^"\n' + d + rb"]*+)"
    line = cell + rb"(?>" + d + cell + rb")*+\n"
    if re.fullmatch(rb"(?>" + line + rb")*+", block):
        return block
    whole = re.compile(line)
    lines = block.splitlines(keepends=True)
    return b"".join(x if whole.fullmatch(x) else x.replace(b'"', b"?") for x in lines)


def _plain(handle: IO[bytes], tally: Tally) -> Iterator[bytes]:
    while chunk := handle.read(BLOCK):
        tally.position += len(chunk)
        yield chunk


def _gunzip(handle: IO[bytes], tally: Tally) -> Iterator[bytes]:
    engine = zlib.decompressobj(31)
    while piece := handle.read(_PIECE):
        tally.position += len(piece)
        while piece:
            if engine.eof:
                if not piece.startswith(GZIP[: len(piece)]):
                    tally.cut = f"after the gzip stream stand {len(piece)} bytes or more that are none" * bool(
                        piece.strip(b"\0")
                    )
                    return
                engine = zlib.decompressobj(31)
            before = engine.copy()
            try:
                text = engine.decompress(piece)
            except zlib.error as error:
                yield _salvage(before, piece)
                tally.cut = f"the gzip stream is damaged before byte {tally.position} ({str(error).split(': ')[-1]})"
                return
            yield text
            piece = engine.unused_data if engine.eof else b""
    if not engine.eof:
        tally.cut = f"the gzip stream breaks off at byte {tally.position}"


def _salvage(engine: zlib._Decompress, piece: bytes) -> bytes:
    """Return what can be decompressed before the damage, by halving the piece down to one byte."""
    found, step = [], len(piece)
    while step and piece:
        trial = engine.copy()
        try:
            found.append(trial.decompress(piece[:step]))
        except zlib.error:
            step //= 2
            continue
        engine, piece = trial, piece[step:]
    return b"".join(found)


def _unzstd(handle: IO[bytes], tally: Tally) -> Iterator[bytes]:
    import zstandard

    engine, begun = zstandard.ZstdDecompressor().decompressobj(), False
    while rest := handle.read(_ZSTD_PIECE):
        tally.position += len(rest)
        while rest:
            try:
                text = engine.decompress(rest)
            except zstandard.ZstdError as error:
                tally.cut = f"the zstd stream is damaged before byte {tally.position} ({str(error).split(': ')[-1]})"
                return
            yield text
            rest, begun = engine.unused_data, not engine.eof
            if engine.eof:
                engine = zstandard.ZstdDecompressor().decompressobj()
    if begun:
        tally.cut = f"the zstd stream breaks off at byte {tally.position}"


def _decode(pieces: Iterator[bytes]) -> Iterator[bytes]:
    first = b""
    for piece in pieces:
        first += piece
        if len(first) >= 4:
            break
    if first.startswith(_UTF16):
        decoder = codecs.getincrementaldecoder("utf-16")(errors="replace")
        yield decoder.decode(first).encode()
        for piece in pieces:
            yield decoder.decode(piece).encode()
        return
    yield first.removeprefix(codecs.BOM_UTF8)
    yield from pieces
