"""Damaged MCAP files. Truth: a brute-force list of where each record ends, and of what the writer put in."""

from __future__ import annotations

import contextlib
import json
import random
import struct
import time
import tracemalloc
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.records import Attachment, Channel, Chunk, Message, Schema
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import CompressionType, Writer

from mooringdx.config import ChannelSource
from mooringdx.errors import LogError
from mooringdx.logs.mcap import read, records
from mooringdx.logs.mcap_chunks import LARGEST, inflate
from mooringdx.logs.mcap_decode import decoder, leaves
from mooringdx.logs.mcap_records import MAGIC, Loss
from mooringdx.logs.mcap_ros import UndecodableError
from mooringdx.types import RawLog

DATA = Path(__file__).parents[2] / "shared" / "data"
SETS = ("mcap_conformance", "mcap_rosbag2", "mcap_solvcon")
EPOCH = 1_700_000_000_000_000_000
HEAD = struct.Struct("<BQ")


def sample(path: Path, n: int = 60, **options: Any) -> bytes:
    """Write n messages {"v": i} of differing length on two topics, 10 ms apart."""
    with path.open("wb") as handle:
        writer = Writer(handle, **{"chunk_size": 700, "compression": CompressionType.NONE, **options})
        writer.start()
        schema = writer.register_schema("v", "jsonschema", b'{"type":"object"}')
        ids = [writer.register_channel(topic, "json", schema) for topic in ("/a", "/b")]
        for i in range(n):
            body = json.dumps({"v": i, "note": "x" * (i % 7)}).encode()
            writer.add_message(ids[i % 2], EPOCH + i * 10**7, body, EPOCH, i)
        writer.finish()
    return path.read_bytes()


def spans(data: bytes, start: int = 8) -> Iterator[tuple[int, int, int]]:
    """Yield (opcode, first byte, end) of every record, by the book: the file must be whole."""
    at = start
    while at < len(data) and data[at : at + 8] != MAGIC:
        opcode, length = HEAD.unpack_from(data, at)
        yield opcode, at, at + 9 + length
        at += 9 + length


def message_ends(data: bytes) -> list[int]:
    """Return where each message ends, in the order of the file; one in a compressed chunk ends with its chunk."""
    ends = []
    for opcode, start, end in spans(data):
        if opcode == 5:
            ends.append(end)
        elif opcode == 6:
            fields = struct.unpack_from("<QQQII", data, start + 9)
            name = data[start + 41 : start + 41 + fields[4]].decode()
            body = start + 41 + fields[4] + 8
            size = int.from_bytes(data[body - 8 : body], "little")
            chunk = Chunk(name, data[body : body + size], 0, 0, 0, fields[2])
            stream, length = get_chunk_data_stream(chunk)
            inside = stream.read(length) if length else b""
            ends += [end if name else body + stop for kind, _, stop in spans(inside, 0) if kind == 5]
    return ends


def messages(path: Path, losses: list[Loss] | None = None) -> list[Message]:
    return [r for r in records(path, losses) if isinstance(r, Message)]


def values(log: RawLog, name: str) -> list[float]:
    return log.signals[name].values.tolist() if name in log.signals else []


def reference_files() -> list[Path]:
    if not all((DATA / name).is_dir() for name in SETS):
        pytest.skip("the MCAP reference data is not beside the repository")
    return [path for name in SETS for path in sorted((DATA / name).rglob("*.mcap"))]


# ---- brute force: of a file cut at byte b, every message whose record ends before b ------------------------------

CONTAINERS = [{"use_chunking": False}, *({"compression": kind} for kind in CompressionType)]


@pytest.mark.parametrize("options", CONTAINERS, ids=["unchunked", "none", "lz4", "zstd"])
def test_a_file_cut_anywhere_gives_every_whole_message(tmp_path: Path, options: dict[str, Any]) -> None:
    whole = sample(tmp_path / "whole.mcap", 12, **{"chunk_size": 300, **options})
    truth, ends = messages(tmp_path / "whole.mcap"), message_ends(whole)
    assert len(truth) == len(ends) == 12
    cut = tmp_path / "cut.mcap"
    for b in range(8, len(whole), 3):
        cut.write_bytes(whole[:b])
        found = messages(cut)
        assert len(found) >= sum(end <= b for end in ends), b
        assert found == truth[: len(found)], b


@pytest.mark.reference
def test_reference_files_cut_at_random_bytes_give_every_whole_message(tmp_path: Path) -> None:
    rng = random.Random(1)
    files = [p for p in reference_files() if p.parent.name != "NoData"]
    cut = tmp_path / "cut.mcap"
    for path in rng.sample(files, 60) + [p for p in files if p.parent.name in SETS]:
        whole = path.read_bytes()
        truth, ends = messages(path), message_ends(whole)
        assert len(truth) == len(ends)
        for b in [rng.randrange(8, len(whole)) for _ in range(6)]:
            cut.write_bytes(whole[:b])
            found = messages(cut)
            assert len(found) >= sum(end <= b for end in ends), (path.name, b)
            assert found == truth[: len(found)], (path.name, b)
            assert not [c for c in read(cut).checks if c.name == "mcap_end" and c.passed], (path.name, b)


def test_a_cut_inside_a_compressed_chunk_gives_what_decompresses(tmp_path: Path) -> None:
    rng = random.Random(2)
    for kind in (CompressionType.ZSTD, CompressionType.LZ4):
        path = tmp_path / "a.mcap"
        with path.open("wb") as handle:
            writer = Writer(handle, compression=kind, chunk_size=1 << 23)
            writer.start()
            channel = writer.register_channel("/a", "json", 0)
            for i in range(400):
                body = json.dumps({"v": i, "noise": rng.randbytes(5000).hex()}).encode()
                writer.add_message(channel, EPOCH + i, body, EPOCH)
            writer.finish()
        whole = path.read_bytes()
        path.write_bytes(whole[: len(whole) * 3 // 4])
        found = values(read(path), "/a v")
        assert len(found) >= 100, kind
        assert found == list(range(len(found)))


def test_a_cut_log_says_so(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    whole = sample(path, 60)
    path.write_bytes(whole[: len(whole) // 2])
    rows = {c.name: c for c in read(path).checks}
    assert not rows["mcap_end"].passed
    assert not rows["mcap_bytes_lost"].passed
    assert "cut" in rows["mcap_end"].detail


# ---- brute force: one damaged place loses that place only -----------------------------------------------------------


def chunk_starts(data: bytes) -> list[tuple[int, int]]:
    return [(start, end) for opcode, start, end in spans(data) if opcode == 6]


def test_a_damaged_chunk_loses_at_most_itself(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    rng = random.Random(3)
    for kind in CompressionType:
        whole = sample(path, 200, compression=kind)
        counts = {m.sequence: end for m, end in zip(messages(path), message_ends(whole), strict=True)}
        for start, end in chunk_starts(whole)[1:]:
            bad = bytearray(whole)
            for at in rng.sample(range(start + 9, end), 3):
                bad[at] ^= 1 << rng.randrange(8)
            path.write_bytes(bad)
            losses: list[Loss] = []
            found = {m.sequence for m in messages(path, losses)}
            assert {n for n, stop in counts.items() if not start < stop <= end} <= found, (kind, start)
            assert losses, (kind, start)


def test_a_wrong_checksum_is_said_and_the_messages_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    whole = sample(path, 60)
    start, _ = chunk_starts(whole)[1]
    bad = bytearray(whole)
    bad[start + 9 + 24] ^= 1
    path.write_bytes(bad)
    log = read(path)
    assert values(log, "/a v") == list(range(0, 60, 2))
    (row,) = (c for c in log.checks if c.name == "mcap_chunks_damaged")
    assert (row.value, row.passed) == (1.0, False)
    assert "checksum" in row.detail
    assert str(start) in row.detail


def test_the_checksum_of_the_data_section_is_compared(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    whole = bytearray(sample(path, 9, use_chunking=False))
    (at,) = (start for opcode, start, _ in spans(whole) if opcode == 15)
    struct.pack_into("<I", whole, at + 9, zlib.crc32(whole[:at]))
    path.write_bytes(whole)
    assert all(c.passed for c in read(path).checks)
    whole[whole.index(b'{"v": 4') + 6] = ord("5")
    path.write_bytes(whole)
    assert [c.name for c in read(path).checks if not c.passed] == ["mcap_chunks_damaged"]


@pytest.mark.parametrize("length", [0, 1, 21, 23, 50, 300, 2**20, 2**32 + 7, 2**60, 2**64 - 1])
@pytest.mark.parametrize("kind", [None, CompressionType.NONE, CompressionType.ZSTD])
def test_a_wrong_length_costs_that_record_and_no_memory(
    tmp_path: Path, length: int, kind: CompressionType | None
) -> None:
    """A length may claim anything; the walk finds the next record again."""
    path = tmp_path / "a.mcap"
    chunked = kind is not None
    whole = sample(path, 60, use_chunking=chunked, compression=kind or CompressionType.NONE)
    wanted = 6 if chunked else 5
    starts = [start for opcode, start, _ in spans(whole) if opcode == wanted]
    bad = bytearray(whole)
    struct.pack_into("<Q", bad, starts[2] + 1, length)
    path.write_bytes(bad)
    tracemalloc.start()
    losses: list[Loss] = []
    found = [m.sequence for m in messages(path, losses)]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 40 << 20
    lost = set(range(60)) - set(found)
    assert lost <= ({2} if not chunked else set()), (length, lost)
    if not chunked:
        assert losses


def test_definitions_in_a_lost_first_chunk_are_taken_from_the_summary(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    whole = sample(path, 60, compression=CompressionType.ZSTD)
    start, end = chunk_starts(whole)[0]
    path.write_bytes(whole[: start + 60] + bytes(end - start - 60) + whole[end:])
    log = read(path, {"north": ChannelSource(topic="/a", field="v")})
    found = values(log, "north")
    assert found == list(range(int(found[0]), 60, 2))
    assert len(found) > 20
    rows = {c.name: c for c in log.checks}
    assert rows["mcap_messages_missing"].value == 60 - len(found) - len(values(read(path), "/b v"))


def test_definitions_that_were_overwritten_before_the_first_message(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    whole = sample(path, 60, use_chunking=False)
    channels = [(start, end) for opcode, start, end in spans(whole) if opcode == 4][:2]
    start, end = channels[0][0], channels[1][1]
    path.write_bytes(whole[:start] + bytes(end - start) + whole[end:])
    assert values(read(path), "/a v") == list(range(0, 60, 2))


def test_a_damaged_topic_name_is_taken_from_the_summary(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    whole = bytearray(sample(path, 60))
    whole[whole.index(b"/a")] ^= 4
    path.write_bytes(whole)
    log = read(path)
    assert set(log.signals) == {"/a v", "/b v"}
    assert values(log, "/a v") == list(range(0, 60, 2))
    assert not all(c.passed for c in log.checks)


def test_a_damaged_compression_name(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    whole = sample(path, 60, compression=CompressionType.ZSTD)
    at = chunk_starts(whole)[1][0] + 9 + 32
    assert whole[at : at + 4] == b"zstd"
    path.write_bytes(whole[:at] + b"zsud" + whole[at + 4 :])
    assert values(read(path), "/a v") == list(range(0, 60, 2))


def test_a_file_without_its_first_bytes_is_still_read(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    whole = sample(path, 60)
    path.write_bytes(bytes(20) + whole[20:])
    assert values(read(path), "/a v") == list(range(0, 60, 2))


def test_zeros_at_the_end_and_data_after_the_summary(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    whole = sample(path, 60)
    path.write_bytes(whole + bytes(5 << 20))
    begun = time.perf_counter()
    log = read(path)
    assert time.perf_counter() - begun < 2.0
    assert values(log, "/a v") == list(range(0, 60, 2))
    rows = {c.name: c for c in log.checks}
    assert rows["mcap_bytes_lost"].value == 5 << 20
    path.write_bytes(whole[:-40] + b"\x00" * 40 + sample(tmp_path / "b.mcap", 20))
    assert len(messages(path)) == 80


def test_an_attachment_does_not_disturb(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    inner = sample(tmp_path / "b.mcap", 5)
    with path.open("wb") as handle:
        writer = Writer(handle)
        writer.start()
        writer.add_attachment(0, 0, "inner.mcap", "x", inner)
        channel = writer.register_channel("/a", "json", 0)
        writer.add_message(channel, EPOCH, b'{"v":7}', EPOCH)
        writer.finish()
    assert [r.data for r in records(path) if isinstance(r, Attachment)] == [inner]
    assert values(read(path), "/a v") == [7.0]


# ---- bounds ---------------------------------------------------------------------------------------------------------


def test_a_decompression_bomb_stops_at_the_bound() -> None:
    import zstandard

    bomb = zstandard.ZstdCompressor().compress(bytes(LARGEST + (64 << 20)))
    assert len(bomb) < 1 << 20
    out, problem = inflate("zstd", bomb)
    assert len(out) <= LARGEST
    assert "beyond" in problem


@pytest.mark.parametrize("name", ["zstd", "lz4"])
def test_inflate_gives_the_bytes_before_the_fault(name: str) -> None:
    import lz4.frame
    import zstandard

    body = np.random.default_rng(1).integers(0, 40, 600_000, dtype=np.uint8).tobytes()
    packed = zstandard.compress(body) if name == "zstd" else lz4.frame.compress(body)
    assert inflate(name, packed) == (body, "")
    bad = bytearray(packed)
    bad[len(bad) * 2 // 3 :] = b"\xff" * len(bad[len(bad) * 2 // 3 :])
    out, problem = inflate(name, bytes(bad))
    assert problem
    assert len(out) > len(body) // 3
    sure = len(out) - (1 << 17)  # the block that holds the fault may end in noise
    assert out[:sure] == body[:sure]
    assert inflate(name, b"")[0] == b""
    assert inflate(name, b"not compressed at all")[0] == b""


# ---- seeded: 250 damaged copies of the reference sets ------------------------------------------------------------


def damaged(data: bytes, rng: random.Random) -> bytes:
    """Cut, flip bits, overwrite, remove or insert a stretch: one to three of them."""
    bad = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 3))):
        kind, at = rng.randrange(5), rng.randrange(len(bad))
        if kind == 0:
            del bad[max(at, 1) :]
        elif kind == 1:
            for _ in range(rng.choice((1, 1, 3, 30))):
                bad[rng.randrange(len(bad))] ^= 1 << rng.randrange(8)
        elif kind == 2:
            stop = min(len(bad), at + rng.randrange(1, 200))
            bad[at:stop] = rng.choice((bytes(stop - at), rng.randbytes(stop - at)))
        elif kind == 3 and len(bad) > 300:
            del bad[at : at + rng.randrange(1, 200)]
        else:
            bad[at:at] = rng.randbytes(rng.randrange(1, 100))
    return bytes(bad)


def read_or_log_error(path: Path, channels: dict[str, ChannelSource] | None = None) -> RawLog | None:
    begun = time.perf_counter()
    try:
        log = read(path, channels)
    except LogError:
        return None
    assert time.perf_counter() - begun < 20.0
    return log


@pytest.mark.reference
def test_250_damaged_copies_give_a_log_or_a_log_error(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    rng = random.Random(20250314)
    files = reference_files()
    real = [path for path in files if path.parent.name in SETS]
    path = tmp_path / "damaged.mcap"
    told = 0
    for number in range(250):
        source = rng.choice(real if number % 4 else files)
        path.write_bytes(damaged(source.read_bytes(), rng))
        log = read_or_log_error(path)
        told += log is None or any(not c.passed for c in log.checks)
        signals = list(read(source).signals)[:3] if number % 2 else []
        if signals:
            asked = {
                f"x_{i}": ChannelSource(topic=s.split(" ")[0], field=s.split(" ")[1]) for i, s in enumerate(signals)
            }
            read_or_log_error(path, asked)
    assert told >= 225, "nearly every damage is noticed; what is not hit a byte without a checksum"
    assert capfd.readouterr() == ("", "")


@pytest.mark.slow
@pytest.mark.reference
def test_3000_more_damaged_copies(tmp_path: Path) -> None:
    rng = random.Random(7)
    real = [path for path in reference_files() if path.parent.name in SETS]
    for _ in range(3000):
        path = tmp_path / "damaged.mcap"
        path.write_bytes(damaged(rng.choice(real).read_bytes(), rng))
        read_or_log_error(path)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.sampled_from(CONTAINERS),
    st.lists(st.tuples(st.integers(0, 2500), st.integers(0, 255)), min_size=1, max_size=12),
    st.integers(0, 3000),
)
def test_any_overwritten_bytes(tmp_path: Path, options: dict[str, Any], edits: list[tuple[int, int]], cut: int) -> None:
    path = tmp_path / "a.mcap"
    data = bytearray(sample(path, 20, **options))
    for at, byte in edits:
        data[at % len(data)] = byte
    path.write_bytes(data[: max(cut, 1)])
    read_or_log_error(path)


DEFINITION = (
    "std_msgs/Header header\nfloat64[3] a\nint16[] b\nstring s\nP p\nP[] ps\n" + "=" * 80 + "\nMSG: std_msgs/Header\n"
    "uint32 seq\nstring frame_id\n" + "=" * 80 + "\nMSG: demo/P\nuint8[4] raw\nfloat32 x\n"
)


def schemas() -> list[tuple[str, str, bytes]]:
    from google.protobuf import struct_pb2
    from google.protobuf.descriptor_pb2 import FileDescriptorSet

    described = FileDescriptorSet()
    struct_pb2.DESCRIPTOR.CopyToProto(described.file.add())
    text = DEFINITION.encode()
    return [
        ("ros1", "ros1msg", text),
        ("cdr", "ros2msg", text),
        ("protobuf", "protobuf", described.SerializeToString()),
    ]


EDITS = st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 255)), max_size=6)


@settings(max_examples=250, deadline=None)
@given(st.sampled_from(schemas()), EDITS, st.integers(0, 10**6), st.binary(max_size=120))
def test_any_edited_schema_and_any_payload(
    kind: tuple[str, str, bytes], edits: list[tuple[int, int]], cut: int, payload: bytes
) -> None:
    encoding, name, whole = kind
    body = bytearray(whole)
    for at, byte in edits:
        body[at % len(body)] = byte
    body = body[: len(body) - cut % (4 * len(body))] if cut % 4 == 0 else body
    title = "google.protobuf.Value" if encoding == "protobuf" else "demo/M"
    schema = Schema(id=1, data=bytes(body), encoding=name, name=title)
    channel = Channel(id=1, topic="/t", message_encoding=encoding, metadata={}, schema_id=1)
    try:
        decode, damage = decoder(channel, schema)
    except UndecodableError:
        return
    with contextlib.suppress(*damage):
        list(leaves(decode(b"\0\1\0\0" + payload)))


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=400), st.booleans())
def test_any_bytes_at_all(tmp_path: Path, body: bytes, magic: bool) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(MAGIC * magic + body)
    read_or_log_error(path)
