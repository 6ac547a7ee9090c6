"""MCAP reader. Truth: published conformance vectors, recordings of other programs, the official writers, arithmetic."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.records import Message, MessageIndex
from mcap.serialization import stringify_record
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer

from mooringdx.config import ChannelSource, TimeSource
from mooringdx.errors import LogError
from mooringdx.logs import mcap_decode
from mooringdx.logs.mcap import read, records, write
from mooringdx.logs.mcap_ros import UndecodableError, check_definition
from mooringdx.types import LogSource, RawLog, Signal

DATA = Path(__file__).parents[2] / "shared" / "data"
reference = pytest.mark.reference
DAY_2023 = 1_700_000_000_000_000_000


def folder(name: str) -> Path:
    found = DATA / name
    if not found.is_dir():
        pytest.skip(f"reference data folder {name} is not beside the repository")
    return found


def place(topic: str, field: str, unit: str | None = None) -> ChannelSource:
    return ChannelSource(topic=topic, field=field, unit=unit)


def json_file(path: Path, messages: list[tuple[int, Any]], topic: str = "/pose", **options: Any) -> Path:
    """Write (log time, message) as JSON on one topic."""
    with path.open("wb") as handle:
        writer = Writer(handle, **options)
        writer.start()
        schema = writer.register_schema("pose", "jsonschema", b"{}")
        channel = writer.register_channel(topic, "json", schema)
        for number, (stamp, message) in enumerate(messages):
            body = message if isinstance(message, bytes) else json.dumps(message).encode()
            writer.add_message(channel, stamp, body, stamp + 5, number)
        writer.finish()
    return path


# ---- published: 416 conformance vectors --------------------------------------------------------------------------


def as_listed(entries: list[Any]) -> list[tuple[str, dict[str, Any]]]:
    return [(entry["type"], dict(map(tuple, entry["fields"]))) for entry in entries]


@reference
def test_every_conformance_vector_reads_as_its_json_says() -> None:
    vectors = sorted(folder("mcap_conformance").glob("*/*.mcap"))
    assert len(vectors) == 416
    for vector in vectors:
        losses: list[Any] = []
        found = [stringify_record(r) for r in records(vector, losses) if not isinstance(r, MessageIndex)]
        wanted = json.loads(vector.with_suffix(".json").read_text())["records"]
        assert as_listed(json.loads(json.dumps(found))) == as_listed(wanted), vector.name
        assert losses == [], vector.name


@reference
def test_message_indexes_point_at_their_messages() -> None:
    seen = 0
    for vector in sorted(folder("mcap_conformance").glob("TenMessages/*-mx*.mcap")):
        found = list(records(vector))
        stamps = [m.log_time for m in found if isinstance(m, Message)]
        listed = [stamp for index in found if isinstance(index, MessageIndex) for stamp, _ in index.records]
        if listed:
            assert sorted(listed) == sorted(stamps)
            seen += 1
    assert seen > 0


@reference
def test_conformance_vectors_as_logs_refuse_the_encoding_by_name() -> None:
    log = read(next(iter(sorted(folder("mcap_conformance").glob("OneMessage/*.mcap")))))
    assert not log.signals
    assert any(c.name == "mcap_encoding" and not c.passed and "'a'" in c.detail for c in log.checks)


# ---- another program: rosbag2 and solvcon recordings --------------------------------------------------------------

COUNTS = {
    "rosbag2_py__wbag_0": 1246,
    "rosbag2_py__wbag_1": 1240,
    "rosbag2_py__wbag_2": 1240,
    "rosbag2_py__wbag_3": 1240,
    "rosbag2_py__multiple_files_0": 1324,
    "rosbag2_py__multiple_files_1": 1324,
    "rosbag2_py__talker": 20,
}


@reference
def test_rosbag2_recordings_give_the_messages_of_the_reference_reader() -> None:
    paths = sorted(folder("mcap_rosbag2").glob("*.mcap"))
    assert len(paths) == 20
    for path in paths:
        found = [m for m in records(path) if isinstance(m, Message)]
        with path.open("rb") as handle:
            assert found == [m for m in StreamReader(handle).records if isinstance(m, Message)], path.name
        assert len(found) == COUNTS.get(path.stem, len(found))
        log = read(path)
        whole = {"mcap_end", "mcap_bytes_lost", "mcap_chunks_damaged", "mcap_records_damaged", "mcap_messages_missing"}
        assert {c.name for c in log.checks if c.passed} >= whole, path.name
        assert not [c for c in log.checks if c.name == "mcap_undecodable"], path.name


@reference
def test_rosbag2_unknown_encoding_is_refused_by_name() -> None:
    path = folder("mcap_rosbag2") / "rosbag2_tests__wrong_rmw_test_0.mcap"
    refused = [c for c in read(path).checks if c.name == "mcap_encoding"]
    assert {c.subject for c in refused} == {"/test_topic", "/array_topic"}
    assert all("wrong_format" in c.detail for c in refused)
    with pytest.raises(LogError, match="wrong_format"):
        read(path, {"x_a": place("/test_topic", "float64_value")})


@reference
def test_rosbag2_service_events_are_said_not_to_be_read(capfd: pytest.CaptureFixture[str]) -> None:
    log = read(folder("mcap_rosbag2") / "rosbag2_cpp__topics_and_services.mcap")
    assert any(c.name == "mcap_encoding" and "service" in c.detail for c in log.checks)
    assert "/parameter_events stamp.sec" in log.signals
    assert capfd.readouterr() == ("", "")


@reference
@pytest.mark.parametrize("kind", ["lz4", "zstd", "none", "unchunked"])
def test_solvcon_recordings_hold_the_same_104_messages(kind: str) -> None:
    path = folder("mcap_solvcon") / f"vehicle_{kind}.mcap"
    log = read(path)
    speed = log.signals["/vehicle/status longitudinal_speed"]
    brake = log.signals["/vehicle/status brake_active"]
    assert log.epoch_ns == DAY_2023
    assert speed.values.tolist() == [1.5 * i for i in range(96)]
    assert brake.values.tolist() == [i % 2 for i in range(96)]
    assert log.signals["/vehicle/imu ax"].values.tolist() == [12.0 * i for i in range(8)]
    assert log.signals["/vehicle/imu ay"].values.tolist() == [-12.0 * i for i in range(8)]
    assert np.all(log.signals["/vehicle/imu az"].values == 9.81)
    assert len([m for m in records(path) if isinstance(m, Message)]) == 104
    assert all(c.passed for c in log.checks)


# ---- the official writers: each decoder ---------------------------------------------------------------------------

POSE = {"header": {"stamp": {"sec": 1_700_000_000, "nsec": 250_000_000}}, "pose": {"position": {"x": 1.25, "y": -2.0}}}


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("indexed", [True, False])
def test_json_in_every_container(tmp_path: Path, compression: CompressionType, chunked: bool, indexed: bool) -> None:
    messages = [(DAY_2023 + i * 10**8, {"a": {"b": [i, -i]}, "on": i % 2 == 0, "note": "x"}) for i in range(50)]
    index = IndexType.ALL if indexed else IndexType.NONE
    options: dict[str, Any] = {"compression": compression, "use_chunking": chunked, "index_types": index}
    path = json_file(
        tmp_path / "a.mcap", messages, chunk_size=300, use_statistics=indexed, use_summary_offsets=indexed, **options
    )
    log = read(path, {"north": place("/pose", "a.b[1]", "m"), "x_on": place("/pose", "on")})
    assert log.epoch_ns == DAY_2023
    assert log.signals["north"].values.tolist() == [-i for i in range(50)]
    assert log.signals["north"].time.tolist() == [i / 10 for i in range(50)]
    assert log.signals["north"].unit == "m"
    assert log.signals["x_on"].unit == ""
    assert log.signals["x_on"].values.tolist() == [float(i % 2 == 0) for i in range(50)]
    assert set(read(path).signals) == {"/pose a.b[0]", "/pose a.b[1]", "/pose on"}
    assert all(c.passed for c in log.checks)


ROS2_TEXT = (
    "std_msgs/Header header\nfloat64[3] fixed\nfloat32[] loads\nPoint at\nPoint[] path\nuint8[4] raw\nstring note\n"
    + "=" * 80
    + "\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    + "=" * 80
    + "\nMSG: demo_msgs/Point\nfloat64 x\nint16 k\n"
)
COMMON = {"fixed": [1.0, 2.0, 3.0], "loads": [0.5, 1.5], "at": {"x": 7.5, "k": -3}, "path": [{"x": 1.0, "k": 1}]}
WANTED = {"fixed[2]": 3.0, "loads[1]": 1.5, "at.x": 7.5, "at.k": -3.0, "path[0].x": 1.0, "raw[3]": 4.0}


def check_wanted(path: Path, topic: str) -> None:
    log = read(path, {f"x_{i}": place(topic, name) for i, name in enumerate(WANTED)})
    for i, value in enumerate(WANTED.values()):
        assert log.signals[f"x_{i}"].values.tolist() == [value, value]
    every = read(path).signals
    assert {f"{topic} {name}" for name in WANTED} <= set(every)
    stamped = read(path, {"x_a": place(topic, "at.x")}, TimeSource(source="header", field="header.stamp"))
    assert stamped.signals["x_a"].time.tolist() == [0.25, 0.75]
    assert stamped.epoch_ns == DAY_2023


def test_ros2(tmp_path: Path) -> None:
    from mcap_ros2.writer import Writer as Ros2Writer

    path = tmp_path / "a.mcap"
    with path.open("wb") as handle:
        writer = Ros2Writer(handle)
        schema = writer.register_msgdef("demo_msgs/Load", ROS2_TEXT)
        for i in range(2):
            stamp = {"sec": 1_700_000_000, "nanosec": 250_000_000 + i * 500_000_000}
            message = {"header": {"stamp": stamp, "frame_id": "f"}, **COMMON, "raw": [1, 2, 3, 4], "note": "n"}
            writer.write_message("/load", schema, message, DAY_2023 + i * 10**9)
        writer.finish()
    check_wanted(path, "/load")


def test_ros1(tmp_path: Path) -> None:
    from mcap_ros1._vendor.genpy import Time
    from mcap_ros1._vendor.genpy.dynamic import generate_dynamic
    from mcap_ros1.writer import Writer as Ros1Writer

    text = ROS2_TEXT.replace("builtin_interfaces/Time stamp", "uint32 seq\ntime stamp")
    text = "# a comment\nint32 LIMIT=7 # a constant\nstring WORD=a#b\n" + text
    kinds = generate_dynamic("demo_msgs/Load", text)
    path = tmp_path / "a.mcap"
    with path.open("wb") as handle:
        writer = Ros1Writer(handle)
        for i in range(2):
            message = kinds["demo_msgs/Load"]()
            message.header.stamp = Time(1_700_000_000, 250_000_000 + i * 500_000_000)
            message.fixed, message.loads, message.raw = [1.0, 2.0, 3.0], [0.5, 1.5], b"\x01\x02\x03\x04"
            message.at.x, message.at.k = 7.5, -3
            message.path = [kinds["demo_msgs/Point"](1.0, 1)]
            writer.write_message("/load", message, DAY_2023 + i * 10**9)
        writer.finish()
    check_wanted(path, "/load")


BOX = "\n" + "=" * 80 + "\nMSG: a/C\n"


@pytest.mark.parametrize(
    "text",
    [
        'float64 x\n"""\nimport os',
        "float64 x; y",
        "float64[99999999] x",
        "float64 lambda",
        "C[] many" + BOX,
        "C[60000] many" + BOX + "float64[60000] x",
        "C one" + BOX + "C two",
    ],
)
def test_a_ros1_schema_cannot_carry_code(tmp_path: Path, text: str) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as handle:
        writer = Writer(handle)
        writer.start()
        schema = writer.register_schema("a/B", "ros1msg", text.encode())
        writer.add_message(writer.register_channel("/t", "ros1", schema), DAY_2023, bytes(8), DAY_2023)
        writer.finish()
    log = read(path)
    assert not log.signals
    assert any(c.name == "mcap_encoding" and not c.passed for c in log.checks)


def test_a_wrong_length_of_an_array_without_numbers_does_not_run_for_hours() -> None:
    text = "UUID[] ids\nfloat64 x" + BOX.replace("a/C", "unique_identifier_msgs/UUID") + "uint8[16] uuid"
    with pytest.raises(UndecodableError, match="UUID"):
        check_definition(text)
    check_definition(text.replace("uint8[16] uuid", "uint8[16] uuid\nint32 number"))
    check_definition(text.replace("UUID[] ids", "UUID id\nfloat64[36] covariance 0.0\nint32 MOST=5"))


def protobuf_class() -> Callable[..., Any]:
    from google.protobuf import descriptor_pb2, timestamp_pb2
    from google.protobuf.descriptor_pool import DescriptorPool
    from google.protobuf.message_factory import GetMessageClass

    kinds = descriptor_pb2.FieldDescriptorProto
    file = descriptor_pb2.FileDescriptorProto(name="demo.proto", package="demo", syntax="proto3")
    file.dependency.append("google/protobuf/timestamp.proto")

    def add(message: Any, number: int, name: str, kind: int, of: str = "", many: bool = False) -> Any:
        label = kinds.LABEL_REPEATED if many else kinds.LABEL_OPTIONAL
        return message.field.add(name=name, number=number, type=kind, label=label, type_name=of or None)

    point, head, load = (file.message_type.add(name=name) for name in ("Point", "Header", "Load"))
    add(point, 1, "x", kinds.TYPE_DOUBLE)
    add(point, 2, "k", kinds.TYPE_SINT32)
    add(head, 1, "stamp", kinds.TYPE_MESSAGE, ".google.protobuf.Timestamp")
    add(load, 1, "header", kinds.TYPE_MESSAGE, ".demo.Header")
    add(load, 2, "fixed", kinds.TYPE_DOUBLE, many=True)
    add(load, 3, "loads", kinds.TYPE_FLOAT, many=True)
    add(load, 4, "at", kinds.TYPE_MESSAGE, ".demo.Point")
    add(load, 5, "path", kinds.TYPE_MESSAGE, ".demo.Point", many=True)
    add(load, 6, "raw", kinds.TYPE_BYTES)
    maybe = add(load, 7, "maybe", kinds.TYPE_DOUBLE)
    load.oneof_decl.add(name="_maybe")
    maybe.oneof_index, maybe.proto3_optional = 0, True
    pool = DescriptorPool()
    pool.AddSerializedFile(timestamp_pb2.DESCRIPTOR.serialized_pb)
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName("demo.Load"))


def test_protobuf(tmp_path: Path) -> None:
    from mcap_protobuf.writer import Writer as ProtobufWriter

    load = protobuf_class()
    path = tmp_path / "a.mcap"
    with path.open("wb") as handle:
        writer = ProtobufWriter(handle)
        for i in range(2):
            message = load(raw=b"\x01\x02\x03\x04", **COMMON)
            message.header.stamp.seconds, message.header.stamp.nanos = 1_700_000_000, 250_000_000 + i * 500_000_000
            writer.write_message("/load", message, DAY_2023 + i * 10**9, DAY_2023)
        writer.finish()
    check_wanted(path, "/load")
    unset = read(path, {"x_m": place("/load", "maybe")}).signals["x_m"]
    assert np.isnan(unset.values).all(), "an optional number that was never set is missing, not zero"


# ---- analytic: time, order, paths -----------------------------------------------------------------------------------


def test_messages_out_of_order_are_sorted_stably_and_counted(tmp_path: Path) -> None:
    stamps = [0, 2, 1, 3, 3, 5, 4, 7, 8, 9]
    path = json_file(tmp_path / "a.mcap", [(DAY_2023 + t, {"v": i}) for i, t in enumerate(stamps)])
    log = read(path, {"north": place("/pose", "v")})
    assert log.signals["north"].values.tolist() == [0, 2, 1, 3, 4, 6, 5, 7, 8, 9]
    assert np.array_equal(log.signals["north"].time, np.sort(stamps) / 1e9)
    many = json_file(tmp_path / "b.mcap", [(DAY_2023 + i % 3, {"v": i}) for i in range(300)])
    assert read(many).signals["/pose v"].values.tolist() == [i for k in range(3) for i in range(k, 300, 3)]
    (row,) = (c for c in log.checks if c.name == "mcap_out_of_order")
    assert (row.value, row.passed) == (2.0, False)


def test_time_is_relative_where_the_clock_has_no_date(tmp_path: Path) -> None:
    path = json_file(tmp_path / "a.mcap", [(5 * 10**9, {"v": 1}), (6 * 10**9, {"v": 2})])
    log = read(path, {"north": place("/pose", "v")})
    assert log.epoch_ns is None
    assert log.signals["north"].time.tolist() == [5.0, 6.0]
    published = read(path, {"north": place("/pose", "v")}, TimeSource(source="publish_time"))
    assert published.signals["north"].time.tolist() == [5.000000005, 6.000000005]


def test_stamps_of_another_clock_are_left_out_and_said(tmp_path: Path) -> None:
    stamps = [DAY_2023, 0, DAY_2023 + 10**9, DAY_2023 + 2 * 10**9, 2**64 - 10]
    path = json_file(tmp_path / "a.mcap", [(t, {"v": i}) for i, t in enumerate(stamps[:4])])
    log = read(path)
    assert log.epoch_ns == DAY_2023
    assert log.signals["/pose v"].values.tolist() == [0, 2, 3]
    assert any(c.name == "mcap_undated" and c.value == 1 for c in log.checks)


def test_an_epoch_does_not_depend_on_what_was_asked(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as handle:
        writer = Writer(handle)
        writer.start()
        ids = [writer.register_channel(topic, "json", 0) for topic in ("/a", "/b")]
        for i, channel in enumerate(ids):
            writer.add_message(channel, DAY_2023 + i * 10**9, b'{"v":1}', DAY_2023)
        writer.finish()
    assert read(path, {"north": place("/b", "v")}).signals["north"].time.tolist() == [1.0]
    assert read(path).signals["/b v"].time.tolist() == [1.0]


@pytest.mark.parametrize(
    ("stamp", "unit", "wanted"),
    [
        ({"sec": 1, "nanosec": 2}, "s", 1_000_000_002),
        ({"seconds": 1, "nanos": 2}, "s", 1_000_000_002),
        (1_700_000_000_123_456_789, "epoch_ns", 1_700_000_000_123_456_789),
        (1_700_000_000_123, "ms", 1_700_000_000_123_000_000),
        (1.5, "s", 1_500_000_000),
        ("2023-11-14T22:13:20.5Z", "s", 1_700_000_000_500_000_000),
    ],
)
def test_header_stamps(stamp: Any, unit: str, wanted: int) -> None:
    assert mcap_decode.stamp_ns(stamp, unit) == wanted


def test_header_stamp_missing_is_an_error_when_asked_for(tmp_path: Path) -> None:
    path = json_file(tmp_path / "a.mcap", [(DAY_2023, {"v": 1})])
    with pytest.raises(LogError, match="have no stamp"):
        read(path, {"north": place("/pose", "v")}, TimeSource(source="header"))
    assert any(c.name == "mcap_unstamped" for c in read(path, None, TimeSource(source="header")).checks)


@given(st.lists(st.one_of(st.integers(0, 99), st.text("abcxyz_", min_size=1, max_size=5)), min_size=1, max_size=6))
def test_a_path_is_its_tokens(tokens: list[str | int]) -> None:
    text = "".join(f"[{t}]" if isinstance(t, int) else f".{t}" for t in tokens).removeprefix(".")
    assert mcap_decode.path(text) == tuple(tokens)


NUMBERS = st.one_of(st.floats(allow_nan=False), st.integers(-(2**53), 2**53), st.booleans())
TREES = st.recursive(
    NUMBERS,
    lambda inner: st.one_of(
        st.dictionaries(st.text("abc", min_size=1, max_size=3), inner, max_size=4), st.lists(inner, max_size=5)
    ),
    max_leaves=20,
)


@given(TREES)
def test_every_leaf_stands_at_its_path(tree: Any) -> None:
    for name, value in mcap_decode.leaves(tree):
        if name:
            assert mcap_decode.number(mcap_decode.follow(tree, mcap_decode.path(name))) == value


def test_null_is_a_missing_sample_and_long_arrays_are_only_counted(tmp_path: Path) -> None:
    path = json_file(tmp_path / "a.mcap", [(DAY_2023, {"v": None, "scan": list(range(17)), "few": [1] * 16})])
    log = read(path)
    assert math.isnan(log.signals["/pose v"].values[0])
    assert {name for name in log.signals if "scan" in name} == set()
    assert len([name for name in log.signals if "few" in name]) == 16
    assert any(c.name == "mcap_long_array" and c.value == 17 for c in log.checks)
    assert read(path, {"north": place("/pose", "scan[16]")}).signals["north"].values.tolist() == [16.0]


# ---- errors say what is allowed ---------------------------------------------------------------------------------


def test_errors_name_what_is_there(tmp_path: Path) -> None:
    path = json_file(tmp_path / "a.mcap", [(DAY_2023, {"position": {"x": 1.0}, "note": "text"})])
    with pytest.raises(LogError, match=r"no topic '/poes'; did you mean '/pose'\?"):
        read(path, {"north": place("/poes", "x")})
    with pytest.raises(LogError, match=r"no number at 'position\.X'.*position\.x"):
        read(path, {"north": place("/pose", "position.X")})
    with pytest.raises(LogError, match="no number at 'note'"):
        read(path, {"north": place("/pose", "note")})
    with pytest.raises(LogError, match="not a field path"):
        read(path, {"north": place("/pose", "a[")})
    with pytest.raises(LogError, match="topic and a field"):
        read(path, {"north": ChannelSource(column="x")})


def test_files_that_are_no_mcap(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="No such file"):
        read(tmp_path / "none.mcap")
    with pytest.raises(LogError, match="directory"):
        read(tmp_path)
    for body in (b"", b"time,north\n0,1\n", bytes(1000)):
        (tmp_path / "a.mcap").write_bytes(body)
        with pytest.raises(LogError, match="not an MCAP file"):
            read(tmp_path / "a.mcap")


def test_progress_ends_at_the_size(tmp_path: Path) -> None:
    path = json_file(tmp_path / "a.mcap", [(DAY_2023 + i, {"v": "x" * 1000}) for i in range(3000)], use_chunking=False)
    told: list[tuple[int, int]] = []
    read(path, None, None, lambda done, of: told.append((done, of)))
    assert len(told) >= 3
    assert told == sorted(told)
    assert told[-1] == (path.stat().st_size, path.stat().st_size)


def test_two_files_one_after_the_other(tmp_path: Path) -> None:
    """Another program: joining files with cat; ids begin anew in the second."""
    one = json_file(tmp_path / "1.mcap", [(DAY_2023, {"v": 1})]).read_bytes()
    two = json_file(tmp_path / "1.mcap", [(DAY_2023 + 10**9, {"v": 2})], topic="/pont").read_bytes()
    (tmp_path / "2.mcap").write_bytes(one + two)
    log = read(tmp_path / "2.mcap")
    assert {name: signal.values.tolist() for name, signal in log.signals.items()} == {
        "/pose v": [1.0],
        "/pont v": [2.0],
    }
    assert all(c.passed for c in log.checks)


# ---- the writer -----------------------------------------------------------------------------------------------------


def a_log(epoch_ns: int | None, columns: dict[str, tuple[list[float], list[float]]]) -> RawLog:
    signals = {name: Signal(name, np.array(t), np.array(v), "m") for name, (t, v) in columns.items()}
    return RawLog(signals=signals, source=LogSource("x", "csv", 0, ""), epoch_ns=epoch_ns)


@settings(max_examples=25, deadline=None)
@given(st.lists(st.floats(-1e300, 1e300), min_size=1, max_size=40), st.booleans(), st.booleans())
def test_a_written_log_reads_back(
    tmp_path_factory: pytest.TempPathFactory, values: list[float], dated: bool, two: bool
) -> None:
    path = tmp_path_factory.mktemp("w") / "log.mcap"
    time = [i / 8 for i in range(len(values))]
    columns = {"north": (time, values), "east": (time, [-v for v in values])}
    if two:
        columns["heading"] = ([t + 1 / 16 for t in time], values)
    log = a_log(DAY_2023 if dated else None, columns)
    write(log, path)
    topics = {"north": "/log/1" if two else "/log", "east": "/log/1" if two else "/log", "heading": "/log/2"}
    back = read(path, {name: place(topics[name], name, "m") for name in columns})
    assert back.epoch_ns == log.epoch_ns
    assert all(c.passed for c in back.checks)
    for name, signal in log.signals.items():
        assert np.array_equal(back.signals[name].values, signal.values)
        assert np.array_equal(back.signals[name].time, signal.time)


def test_the_writer_gives_the_same_bytes_and_keeps_gaps(tmp_path: Path) -> None:
    log = a_log(DAY_2023, {"north": ([0.0, 0.1, 0.2], [1.0, math.nan, 3.0])})
    write(log, tmp_path / "a.mcap")
    write(log, tmp_path / "b.mcap")
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    assert [p.name for p in sorted(tmp_path.iterdir())] == ["a.mcap", "b.mcap"]
    bodies = [r.data for r in records(tmp_path / "a.mcap") if isinstance(r, Message)]
    assert bodies == [b'{"north":1.0}', b'{"north":null}', b'{"north":3.0}']
    back = read(tmp_path / "a.mcap", {"north": place("/log", "north")}).signals["north"]
    assert np.array_equal(back.values, [1.0, math.nan, 3.0], equal_nan=True)
    with pytest.raises(LogError, match="cannot hold"):
        write(a_log(None, {"north": ([-1.0], [1.0])}), tmp_path / "c.mcap")
    with pytest.raises(LogError, match="cannot be written"):
        write(log, tmp_path / "no" / "c.mcap")


def test_a_payload_that_does_not_decode_is_counted_not_raised(tmp_path: Path) -> None:
    deep = b"[" * 100_000
    path = json_file(
        tmp_path / "a.mcap", [(DAY_2023, b"{"), (DAY_2023, deep), (DAY_2023, b"\xff"), (DAY_2023, {"v": 1})]
    )
    log = read(path)
    assert log.signals["/pose v"].values.tolist() == [1.0]
    (row,) = (c for c in log.checks if c.name == "mcap_undecodable")
    assert row.value == 3


def test_big_endian_cdr() -> None:
    from mcap.records import Channel, Schema

    channel = Channel(id=1, topic="/t", message_encoding="cdr", metadata={}, schema_id=1)
    schema = Schema(id=1, data=b"float64 x\nint16 k\n", encoding="ros2msg", name="a/B")
    decode, _ = mcap_decode.decoder(channel, schema)
    found = dict(mcap_decode.leaves(decode(b"\0\0\0\0" + struct.pack(">dh", 2.5, -7))))
    assert found == {"x": 2.5, "k": -7.0}
