"""The text reader. Truth: reading line by line in plain Python, stamps by the standard library, known files."""

from __future__ import annotations

import contextlib
import csv as plain
import gzip
import io
import zlib
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest
import zstandard

from mooringdx.config import ChannelSource, CsvOptions, TimeSource
from mooringdx.errors import ConfigError, LogError
from mooringdx.logs import format_of, read_log
from mooringdx.logs.csv import batches, read, time_columns, write
from mooringdx.logs.text_layout import NULLS, layout
from mooringdx.logs.text_stream import Tally, blocks
from mooringdx.types import Check, RawLog

DATA = Path(__file__).parents[2] / "shared" / "data"
reference = pytest.mark.reference
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the reference data folder is not beside the repository")


def put(folder: Path, body: bytes | str, name: str = "log.csv") -> Path:
    path = folder / name
    path.write_bytes(body if isinstance(body, bytes) else body.encode())
    return path


def everything(path: Path, **options: object) -> RawLog:
    return read(path, None, TimeSource(), CsvOptions.model_validate(options))


def check(log: RawLog, name: str) -> Check:
    return next(c for c in log.checks if c.name == name)


ROWS = [(0.0, 1.5, -2.25), (0.1, 2.5, 1e-3), (0.2, 3.5, 7.0)]

# Every file says ROWS.
DIALECTS = {
    "comma": "time,a,b\n0.0,1.5,-2.25\n0.1,2.5,1e-3\n0.2,3.5,7\n",
    "crlf": "time,a,b\r\n0.0,1.5,-2.25\r\n0.1,2.5,1e-3\r\n0.2,3.5,7\r\n",
    "cr": "time,a,b\r0.0,1.5,-2.25\r0.1,2.5,1e-3\r0.2,3.5,7\r",
    "no newline at the end": "time,a,b\n0.0,1.5,-2.25\n0.1,2.5,1e-3\n0.2,3.5,7",
    "semicolon": "time;a;b\n0.0;1.5;-2.25\n0.1;2.5;1e-3\n0.2;3.5;7\n",
    "decimal comma": "time;a;b\n0,0;1,5;-2,25\n0,1;2,5;1e-3\n0,2;3,5;7\n",
    "tab": "time\ta\tb\n0.0\t1.5\t-2.25\n0.1\t2.5\t1e-3\n0.2\t3.5\t7\n",
    "tab, decimal comma": "time\ta\tb\n0,0\t1,5\t-2,25\n0,1\t2,5\t1e-3\n0,2\t3,5\t7\n",
    "white space": "   time     a      b\n   0.0   1.5   -2.25  \n 0.1\t 2.5  1e-3\n   0.2 3.5 7\n",
    "unit row": "  time   a   b\n  (s)  (N)  (m)\n  0.0  1.5  -2.25\n  0.1  2.5  1e-3\n  0.2  3.5  7\n",
    "unit row, bare": "time,a,b\ns,N,m\n0.0,1.5,-2.25\n0.1,2.5,1e-3\n0.2,3.5,7\n",
    "comments": "# from the tank\n# run 7, calibrated\ntime,a,b\n0.0,1.5,-2.25\n# a remark\n0.1,2.5,1e-3\n0.2,3.5,7\n",
    "header in a comment": "% time,a,b\n0.0,1.5,-2.25\n0.1,2.5,1e-3\n0.2,3.5,7\n",
    "slashes": "// made by hand\ntime,a,b\n0.0,1.5,-2.25\n0.1,2.5,1e-3\n0.2,3.5,7\n",
    "rows before the header": "Test 12\nOperator: N. N.\n\ntime,a,b\n0.0,1.5,-2.25\n0.1,2.5,1e-3\n0.2,3.5,7\n",
    "quoted": '"time","a","b"\n"0.0","1.5","-2.25"\n"0.1","2.5","1e-3"\n"0.2","3.5","7"\n',
    "mark": "\ufefftime,a,b\n0.0,1.5,-2.25\n0.1,2.5,1e-3\n0.2,3.5,7\n",
    "empty lines": "time,a,b\n\n0.0,1.5,-2.25\n\n\n0.1,2.5,1e-3\n0.2,3.5,7\n\n",
    "delimiter at the end": "time,a,b,\n0.0,1.5,-2.25,\n0.1,2.5,1e-3,\n0.2,3.5,7,\n",
    "only in the data": "time,a,b\n0.0,1.5,-2.25,\n0.1,2.5,1e-3,\n0.2,3.5,7,\n",
    "plus and fortran": "time,a,b\n0.0,+1.5,-2.25D0\n0.1,+2.5,1d-3\n0.2,+3.5,0.7D+01\n",
}


@pytest.mark.parametrize("text", DIALECTS.values(), ids=DIALECTS.keys())
def test_dialects(tmp_path: Path, text: str) -> None:
    log = everything(put(tmp_path, text))
    np.testing.assert_array_equal(log.signals["a"].time, [r[0] for r in ROWS])
    np.testing.assert_array_equal(log.signals["a"].values, [r[1] for r in ROWS])
    np.testing.assert_array_equal(log.signals["b"].values, [r[2] for r in ROWS])
    assert log.signals["a"].time is log.signals["b"].time
    assert all(c.passed for c in log.checks)


def test_utf16_latin1_and_no_header(tmp_path: Path) -> None:
    log = everything(put(tmp_path, DIALECTS["comma"].encode("utf-16")))
    np.testing.assert_array_equal(log.signals["b"].values, [r[2] for r in ROWS])
    log = everything(put(tmp_path, "time;Höhe [m];psi [°]\n0;1;2\n1;2;3\n2;3;4\n".encode("latin-1")))
    assert [(s.name, s.unit) for s in log.signals.values()] == [("Höhe [m]", "m"), ("psi [°]", "°")]
    log = everything(put(tmp_path, "0,1,2\n1,2,3\n2,5,4\n3,1,1\n"))
    assert list(log.signals) == ["column_2", "column_3"]
    np.testing.assert_array_equal(log.signals["column_2"].time, [0, 1, 2, 3])


def test_the_user_may_say_how_it_is_written(tmp_path: Path) -> None:
    path = put(tmp_path, "1;2;3\nt;a;b\n4;5;6\n0;1,5;2\n1;2,5;3\n")
    log = everything(path, delimiter=";", decimal=",", skip_rows=1, header_row=0)
    np.testing.assert_array_equal(log.signals["a"].values, [5.0, 1.5, 2.5])


@pytest.mark.parametrize("packed", ["gz", "zst", "two gz members"])
def test_compressed(tmp_path: Path, packed: str) -> None:
    body = DIALECTS["comma"].encode()
    if packed == "zst":
        path = put(tmp_path, zstandard.compress(body), "log.csv.zst")
    elif packed == "gz":
        path = put(tmp_path, gzip.compress(body), "log.csv.gz")
    else:
        path = put(tmp_path, gzip.compress(body[:30]) + gzip.compress(body[30:]), "log.csv.gz")
    assert format_of(path) == "csv"
    log = everything(path)
    np.testing.assert_array_equal(log.signals["b"].values, [r[2] for r in ROWS])
    assert all(c.passed for c in log.checks)


INSTANTS = ["2025-03-14T05:59:59.123456789+00:00", "2025-03-14T06:00:00+00:00", "2025-03-14T23:59:59.5+00:00"]
NS = [1741931999123456789, 1741932000000000000, 1741996799500000000]


@pytest.mark.parametrize(
    ("stamps", "zone", "unit"),
    [
        (["1741931999.123456789", "1741932000", "1741996799.5"], None, "epoch_s"),
        (["1741931999123.456789", "1741932000000", "1741996799500"], None, "epoch_ms"),
        (["1741931999123456.789", "1741932000000000", "1741996799500000"], None, "epoch_us"),
        ([str(x) for x in NS], None, "epoch_ns"),
        (["2025-03-14T05:59:59.123456789Z", "2025-03-14T06:00:00Z", "2025-03-14T23:59:59.5Z"], None, "iso8601"),
        (["2025-03-14 06:59:59.123456789+01:00", "2025-03-14T06:00Z", "2025-03-14 23:59:59.5Z"], None, "iso8601"),
        (["2025-03-14 06:59:59.123456789", "2025-03-14 07:00", "2025-03-15 00:59:59.5"], "Europe/Oslo", "iso8601"),
        (["2025-03-14 03:29:59.123456789", "2025-03-14 03:30:00", "2025-03-14 21:29:59.5"], "-02:30", "iso8601"),
        (["14.03.2025 05:59:59.123456789", "14.03.2025 06:00:00", "14.03.2025 23:59:59.5"], "UTC", "iso8601"),
        (["03/14/2025 05:59:59.123456789 AM", "03/14/2025 6:00 AM", "03/14/2025 11:59:59.5 PM"], "UTC", "iso8601"),
        (["14-Mar-2025 05:59:59.123456789", "14-Mar-2025 06:00:00", "14-Mar-2025 23:59:59.5"], "UTC", "iso8601"),
    ],
)  # fmt: skip
def test_instants_are_exact(tmp_path: Path, stamps: list[str], zone: str | None, unit: str) -> None:
    # Truth: the standard library, for the two stamps that it can hold, and the digits as written.
    assert round(datetime.fromisoformat(INSTANTS[1]).timestamp()) * 10**9 == NS[1]
    path = put(tmp_path, "stamp,a\n" + "".join(f"{x},{i}\n" for i, x in enumerate(stamps)))
    for given in (TimeSource(zone=zone), TimeSource(column="stamp", unit=unit, zone=zone)):
        log = read(path, None, given, CsvOptions())
        assert log.epoch_ns == NS[0]
        np.testing.assert_array_equal(log.signals["a"].time, (np.array(NS) - NS[0]) / 1e9)


def test_date_and_time_in_two_columns(tmp_path: Path) -> None:
    path = put(tmp_path, "Date;Time;a\n14.03.2025;05:59:59,25;1,5\n14.03.2025;06:00:00;2,5\n15.03.2025;00:00;3\n")
    for given in (TimeSource(zone="UTC"), TimeSource(column="Time", date_column="Date", zone="UTC")):
        log = read(path, None, given, CsvOptions())
        assert log.epoch_ns == 1741931999250000000
        np.testing.assert_array_equal(log.signals["a"].time, [0.0, 0.75, 64800.75])
        np.testing.assert_array_equal(log.signals["a"].values, [1.5, 2.5, 3.0])


def test_time_of_day_runs_over_midnight(tmp_path: Path) -> None:
    path = put(tmp_path, "time,a\n23:59:59.5,1\n00:00:00.5,2\n12:00:00,3\n23:59:59,4\n00:00:01,5\n")
    log = everything(path)
    np.testing.assert_array_equal(log.signals["a"].time, [86399.5, 86400.5, 129600.0, 172799.0, 172801.0])
    assert log.epoch_ns is None


@pytest.mark.parametrize(("header", "factor"), [("t [ms]", 1e-3), ("time_min", 1.0), ("t (us)", 1e-6), ("t [h]", 3600)])
def test_relative_units_stand_in_the_header(tmp_path: Path, header: str, factor: float) -> None:
    log = everything(put(tmp_path, f"{header},a\n5,1\n10,2\n20,3\n"))
    np.testing.assert_allclose(log.signals["a"].time, np.array([5, 10, 20]) * factor, rtol=1e-15)


def test_what_was_assumed_is_said(tmp_path: Path) -> None:
    log = everything(put(tmp_path, "time,a\n03/04/2025 06:00:00,1\n03/04/2025 06:00:01,2\n"))
    assert not check(log, "time zone").passed
    assert not check(log, "date order").passed
    assert log.epoch_ns == 1743660000 * 10**9


def test_bad_cells_are_masked_and_counted(tmp_path: Path) -> None:
    body = "time,a,b\n0,1,x\n1,NaN,2\n2,,3\n3,-,4\n4,#N/A,5\n5,1.2.3,6\n6,9999,7\n7, 8 ,9\n"
    log = everything(put(tmp_path, body))
    np.testing.assert_array_equal(log.signals["a"].values, [1, np.nan, np.nan, np.nan, np.nan, np.nan, 9999, 8])
    np.testing.assert_array_equal(log.signals["b"].values, [np.nan, 2, 3, 4, 5, 6, 7, 9])
    assert check(log, "cells empty").value == 4
    row = check(log, "cells unreadable")
    assert row.value == 2
    assert "line 7 a '1.2.3'" in row.detail
    assert "line 2 b 'x'" in row.detail


def test_lost_lines_are_counted_with_the_first(tmp_path: Path) -> None:
    body = "time,a,b\n0,1,2\n1,2\n\n2,3,4,5\n3,4,5\nnoon,5,6\n4,5,6\n5,6"
    log = everything(put(tmp_path, body))
    np.testing.assert_array_equal(log.signals["a"].time, [0, 3, 4])
    assert check(log, "rows left out").value == 3
    assert "first line 3: '1,2'" in check(log, "rows left out").detail
    assert "first line 7: 'noon,5,6'" in check(log, "stamps unreadable").detail


def test_a_column_of_text_is_no_signal(tmp_path: Path) -> None:
    log = everything(put(tmp_path, "time,state,a\n0,on,1\n1,off,2\n2,on,3\n"))
    assert list(log.signals) == ["a"]
    assert check(log, "columns of text").detail == "not read: state"


def test_mapping_units_and_names(tmp_path: Path) -> None:
    path = put(tmp_path, "t,T1 [kN],psi,lat,lon,u\n0,1,90,60,5,3\n1,2,180,60.001,5,4\n")
    channels = {
        "tension_1": ChannelSource(column="T1"),
        "heading": ChannelSource(column="psi", unit="deg"),
        "latitude": ChannelSource(column="lat"),
        "longitude": ChannelSource(column="lon"),
        "x_voltage": ChannelSource(column="u", unit="mV", scale=2.0, offset=1.0),
    }
    log = read_log(path, channels, TimeSource(), CsvOptions())
    assert {n: s.unit for n, s in log.signals.items()} == {
        "tension_1": "N", "heading": "rad", "x_voltage": "V", "north": "m", "east": "m"}  # fmt: skip
    np.testing.assert_allclose(log.signals["tension_1"].values, [1e3, 2e3])
    np.testing.assert_allclose(log.signals["heading"].values, [np.pi / 2, np.pi])
    np.testing.assert_allclose(log.signals["x_voltage"].values, [7e-3, 9e-3])
    assert np.diff(log.signals["north"].values)[0] == pytest.approx(111.4, abs=0.1)
    assert len({id(s.time) for s in log.signals.values()}) == 1
    assert "local origin" in {c.name for c in log.checks}


def test_another_unit_than_the_header_is_said(tmp_path: Path) -> None:
    path = put(tmp_path, "t,T1 [kN],T2\n0,1,1\n1,2,1\n")
    channels = {"tension_1": ChannelSource(column="T1 [kN]", unit="N"), "tension_2": ChannelSource(column="T2")}
    log = read_log(path, channels, TimeSource(), CsvOptions())
    assert not check(log, "unit differs").passed
    assert check(log, "unit assumed").subject == "tension_2"


def test_refusals_are_one_sentence(tmp_path: Path) -> None:
    path = put(tmp_path, "t,T1 [kN],T2 [kN]\n0,1,1\n1,2,1\n")
    with pytest.raises(
        LogError, match=r"log\.csv: no column 'T3'; did you mean 'T[12] \[kN\]'\? the columns are: t, T1 \[kN\], T2"
    ):
        read_log(path, {"tension_3": ChannelSource(column="T3")}, TimeSource(), CsvOptions())
    with pytest.raises(ConfigError, match="did you mean 'tension_<line>'"):
        read_log(path, {"tensin_3": ChannelSource(column="T1")}, TimeSource(), CsvOptions())
    with pytest.raises(ConfigError, match=r"log\.csv: channel 'north': unit 'kN' is not of the dimension"):
        read_log(path, {"north": ChannelSource(column="T1")}, TimeSource(), CsvOptions())
    with pytest.raises(LogError, match="no column 'clock'"):
        read(path, None, TimeSource(column="clock"), CsvOptions())
    with pytest.raises(ConfigError, match="unknown time unit 'iso'; did you mean 'iso8601'"):
        read(path, None, TimeSource(column="t", unit="iso"), CsvOptions())
    with pytest.raises(LogError, match="no line can be read with 't' as time in 'iso8601'"):
        read(path, None, TimeSource(column="t", unit="iso8601"), CsvOptions())
    with pytest.raises(LogError, match="No such file"):
        everything(tmp_path / "none.csv")
    for body in (
        b'a,"b\rc",d\n' * 9,
        b"",
        b"\0" * 5000,
        b"only words\nand more\n",
        b"\x1f\x8bjunk",
        bytes(range(256)) * 40,
    ):
        with pytest.raises(LogError):
            everything(put(tmp_path, body))


def test_blocks_of_any_size_give_the_same_lines(tmp_path: Path) -> None:
    body = b"".join(b"%d,%d\n" % (i, i * i) for i in range(500))
    path = put(tmp_path, body)
    for size in (1, 7, 64, 1000, 1 << 20):
        found = list(blocks(path, Tally(), size=size)) if size > 16 else [body]
        assert b"".join(found) == body
        assert all(x.endswith(b"\n") for x in found)


def test_a_line_without_end_does_not_fill_the_memory(tmp_path: Path) -> None:
    body = b"time,a\n0,1\n1,2\n" + b"\0" * (9 << 20) + b"\n2,3\n3,4\n"
    log = everything(put(tmp_path, body))
    np.testing.assert_array_equal(log.signals["a"].time, [0, 1, 2, 3])
    assert check(log, "rows left out").value == 1


def test_batches_are_bounded_and_join_to_the_whole(tmp_path: Path) -> None:
    n = 400_000
    body = b"time,a\n" + b"".join(b"%d.5,%d.25\n" % (i, i % 1000) for i in range(n))
    path = put(tmp_path, body)
    how = layout(path, CsvOptions())
    found = list(batches(path, how, time_columns(path, how, TimeSource()), [1], Tally()))
    assert len(found) > 1
    np.testing.assert_array_equal(np.concatenate([b.stamps for b in found]), np.arange(n) + 0.5)
    np.testing.assert_array_equal(np.concatenate([b.values[0] for b in found]), np.arange(n) % 1000 + 0.25)


def test_write_then_read_gives_the_same(tmp_path: Path) -> None:
    log = everything(put(tmp_path, "time,a [kN],b\n" + "".join(f"{x!r},{1 / (x + 3)!r},\n" for x in range(9))))
    for name in ("out.csv", "out.csv.gz"):
        write(log, tmp_path / name)
        first = (tmp_path / name).read_bytes()
        write(log, tmp_path / name)
        assert (tmp_path / name).read_bytes() == first
        again = everything(tmp_path / name)
        np.testing.assert_array_equal(again.signals["a [kN] [kN]"].values, log.signals["a [kN]"].values)
        assert np.isnan(again.signals["b"].values).all()


# Damage -------------------------------------------------------------------------------------------------------------


def truth(body: bytes, header: bytes) -> list[tuple[float, float, float]] | None:
    """Read line by line in plain Python: the lines of three cells whose first is a number. None: the header is gone."""
    lines = body.split(b"\n")
    if not lines or lines[0] != header:
        return None
    rows = []
    for line in lines[1:]:
        text = line.removesuffix(b"\r").decode("latin-1")
        try:
            cells = next(plain.reader(io.StringIO(text), strict=True)) if '"' in text else text.split(",")
        except plain.Error:
            cells = text.split(",")
        if len(cells) != 3:
            continue
        stamp = parse(cells[0])
        if np.isfinite(stamp):
            rows.append((stamp, parse(cells[1]), parse(cells[2])))
    return rows


def parse(cell: str) -> float:
    if cell.strip() in NULLS or "_" in cell or "\r" in cell or not cell.isascii():
        return np.nan
    for text in (cell, cell.replace("d", "e").replace("D", "e")):
        try:
            return float(text)
        except ValueError:
            continue
    return np.nan


def damage(rng: np.random.Generator, body: bytes) -> bytes:
    data = bytearray(body)
    kind = rng.integers(5)
    if kind == 0:
        return bytes(data[: rng.integers(len(data))])
    if kind == 1:
        for at in rng.integers(0, len(data), rng.integers(1, 40)):
            data[at] ^= 1 << int(rng.integers(8))
        return bytes(data)
    if kind == 2:
        lines = bytes(data).split(b"\n")
        keep = rng.random(len(lines)) > 0.1
        keep[0] = True
        return b"\n".join(x for x, k in zip(lines, keep, strict=True) if k)
    if kind == 3:
        at, n = int(rng.integers(len(data))), int(rng.integers(1, 400))
        data[at : at + n] = b"\0" * len(data[at : at + n])
        return bytes(data)
    for at in sorted(rng.integers(0, len(data), 5), reverse=True):
        del data[at : at + int(rng.integers(1, 30))]
    return bytes(data)


def healthy(rng: np.random.Generator, n: int = 300) -> bytes:
    rows = "".join(f"{0.1 * i:.1f},{a:.4f},{b:.3e}\n" for i, (a, b) in enumerate(rng.normal(0, 50, (n, 2))))
    return b"time,a [m],b [kN]\n" + rows.encode()


def assert_every_whole_line(path: Path, body: bytes) -> str:
    rows = truth(body, b"time,a [m],b [kN]")
    if rows is None or len(rows) < 3:
        with contextlib.suppress(LogError):
            everything(path)
        return "little left"
    log = everything(path)
    got = np.column_stack([log.signals["a [m]"].time, log.signals["a [m]"].values, log.signals["b [kN]"].values])
    np.testing.assert_array_equal(got, np.array(rows).reshape(-1, 3))
    return "read"


def test_250_damaged_files_give_every_whole_line(tmp_path: Path) -> None:
    outcomes = []
    for seed in range(250):
        rng = np.random.default_rng(seed)
        body = damage(rng, healthy(rng))
        outcomes.append(assert_every_whole_line(put(tmp_path, body, f"{seed}.csv"), body))
    assert outcomes.count("read") > 180


def inflated(packed: bytes) -> tuple[bytes, bool]:
    """Decompress byte by byte; what came before the first error, and whether the stream is whole."""
    engine, found = zlib.decompressobj(31), b""
    for i in range(len(packed)):
        try:
            found += engine.decompress(packed[i : i + 1])
        except zlib.error:
            return found, False
    return found, engine.eof


def test_100_damaged_gzip_files_give_every_whole_line(tmp_path: Path) -> None:
    outcomes = []
    for seed in range(100):
        rng = np.random.default_rng(1000 + seed)
        packed = bytearray(gzip.compress(healthy(rng), mtime=0))
        if seed % 2:
            del packed[int(rng.integers(20, len(packed))) :]
        else:
            packed[int(rng.integers(10, len(packed)))] ^= 1 << int(rng.integers(8))
        body, whole = inflated(bytes(packed))
        body = body if whole else body[: body.rfind(b"\n") + 1]
        path = put(tmp_path, bytes(packed), f"{seed}.csv.gz")
        outcomes.append(assert_every_whole_line(path, body))
        if outcomes[-1] == "read" and not whole:
            assert not check(everything(path), "file damaged").passed
    assert outcomes.count("read") > 60


def test_a_cut_zstd_file_gives_its_first_blocks(tmp_path: Path) -> None:
    body = healthy(np.random.default_rng(5), 40_000)
    packed = zstandard.compress(body)
    log = everything(put(tmp_path, packed[: len(packed) // 2], "cut.csv.zst"))
    n = log.signals["a [m]"].time.size
    assert n > 10_000
    assert not check(log, "file damaged").passed
    np.testing.assert_array_equal(log.signals["a [m]"].time, [float(f"{0.1 * i:.1f}") for i in range(n)])


# Measured files -----------------------------------------------------------------------------------------------------


@reference
@needs_data
@pytest.mark.parametrize("run", ["3101_3", "3031_2"])
def test_flume_runs_read_as_plain_python_reads_them(run: str) -> None:
    path = DATA / "flume" / f"{run}.csv.gz"
    log = everything(path)
    with gzip.open(path, "rt") as handle:
        names, *rows = list(plain.reader(handle))
    values = np.array(rows, dtype=np.float64)
    assert len(log.signals) == 15
    for name, signal in log.signals.items():
        np.testing.assert_array_equal(signal.values, values[:, names.index(name)])
        np.testing.assert_array_equal(signal.time, values[:, 0])
    assert all(c.passed for c in log.checks)


@reference
@needs_data
def test_tao_days_and_gaps() -> None:
    channels = {"north": ChannelSource(column="north_km"), "east": ChannelSource(column="east_km", unit="km")}
    log = read_log(DATA / "tao" / "0n110w.csv", channels, TimeSource(column="time", unit="iso8601"), CsvOptions())
    with (DATA / "tao" / "0n110w.csv").open() as handle:
        rows = list(plain.DictReader(handle))
    assert log.epoch_ns == round(datetime.fromisoformat(rows[0]["time"]).timestamp()) * 10**9
    np.testing.assert_array_equal(log.signals["north"].time, [float(r["t_s"]) for r in rows])
    np.testing.assert_allclose(
        log.signals["north"].values, [float(r["north_km"] or "nan") * 1e3 for r in rows], rtol=1e-14
    )


@reference
@needs_data
def test_moordyn_output() -> None:
    path = DATA / "moordyn_oc4_mhkit" / "Test.MD.out"
    log = everything(path)
    values = np.loadtxt(path, skiprows=2)
    assert [s.unit for s in log.signals.values()] == ["N"] * 6
    for i, signal in enumerate(log.signals.values()):
        np.testing.assert_array_equal(signal.time, values[:, 0])
        np.testing.assert_array_equal(signal.values, values[:, i + 1])
