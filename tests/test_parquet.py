"""The Parquet reader. Truth: the table that was written, the text twin, and pandas' own writer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet as arrow

from mooringdx.config import ChannelSource, CsvOptions, TimeSource
from mooringdx.errors import LogError
from mooringdx.logs import WRITERS, format_of, read_log
from mooringdx.logs.parquet import read, write
from mooringdx.types import LogSource, RawLog, Signal

NS0 = 1741931999123456789


def table(folder: Path, **columns: object) -> Path:
    path = folder / "log.parquet"
    arrow.write_table(pa.table(columns), path, row_group_size=64)
    return path


def test_row_groups_are_joined_and_columns_pruned(tmp_path: Path) -> None:
    t, a = np.arange(1000) * 0.1, np.random.default_rng(0).normal(size=1000)
    path = table(tmp_path, time=t, **{"T1 [kN]": a, "n": np.arange(1000), "state": ["on"] * 1000})
    log = read(path, None, TimeSource())
    assert list(log.signals) == ["T1 [kN]", "n"]
    np.testing.assert_array_equal(log.signals["T1 [kN]"].values, a)
    np.testing.assert_array_equal(log.signals["n"].time, t)
    assert log.signals["n"].time is log.signals["T1 [kN]"].time
    seen: list[tuple[int, int]] = []
    channels = {"tension_1": ChannelSource(column="T1")}
    log = read_log(path, channels, TimeSource(), CsvOptions(), lambda done, whole: seen.append((done, whole)))
    np.testing.assert_allclose(log.signals["tension_1"].values, a * 1e3)
    assert seen[-1] == (16, 16)


@pytest.mark.parametrize(("unit", "step"), [("s", 10**9), ("ms", 10**6), ("us", 10**3), ("ns", 1)])
@pytest.mark.parametrize("zone", [None, "UTC", "Europe/Oslo"])
def test_timestamps_are_exact(tmp_path: Path, unit: str, step: int, zone: str | None) -> None:
    counts = np.array([NS0 // step, NS0 // step + 1, NS0 // step + 90])
    path = table(tmp_path, when=pa.array(counts).cast(pa.timestamp(unit, zone)), a=[1, 2, 3])
    log = read(path, None, TimeSource())
    assert log.epoch_ns == int(counts[0]) * step
    np.testing.assert_array_equal(log.signals["a"].time, (counts - counts[0]) * step / 1e9)


def test_epochs_in_integers_and_rows_without_time(tmp_path: Path) -> None:
    path = table(tmp_path, stamp=pa.array([NS0, None, NS0 + 5]), a=[1.0, 2.0, None])
    log = read(path, None, TimeSource(column="stamp", unit="epoch_ns"))
    assert log.epoch_ns == NS0
    np.testing.assert_array_equal(log.signals["a"].values, [1.0, np.nan])
    assert log.checks[0].value == 1.0


def test_write_then_read_gives_the_same(tmp_path: Path) -> None:
    time = np.arange(500) * 0.1
    signals = {n: Signal(n, time, np.sin(time + i), "kN") for i, n in enumerate(("a", "b"))}
    for epoch in (None, NS0):
        log = RawLog(signals, LogSource("x", "csv", 0, ""), epoch)
        path = tmp_path / "out.parquet"
        WRITERS["parquet"](log, path)
        first = path.read_bytes()
        write(log, path)
        assert path.read_bytes() == first
        again = read(path, None, TimeSource())
        assert again.epoch_ns == epoch
        assert again.signals["b"].unit == "kN"
        np.testing.assert_array_equal(again.signals["b"].values, signals["b"].values)
        np.testing.assert_allclose(again.signals["b"].time, time, atol=1e-9, rtol=0)


def test_the_first_bytes_tell_the_format(tmp_path: Path) -> None:
    path = table(tmp_path, time=[0.0, 1.0], a=[1.0, 2.0])
    bare = tmp_path / "recording"
    bare.write_bytes(path.read_bytes())
    assert format_of(bare) == "parquet"


def test_refusals_are_one_sentence(tmp_path: Path) -> None:
    path = table(tmp_path, time=[0.0, 1.0], a=[1.0, 2.0])
    with pytest.raises(LogError, match="no column 'b'"):
        read(path, {"x_b": ChannelSource(column="b")}, TimeSource())
    body = path.read_bytes()
    for damaged in (body[: len(body) // 2], b"PAR1" + b"\0" * 200 + b"PAR1", b""):
        path.write_bytes(damaged)
        with pytest.raises(LogError, match="cannot be read as Parquet"):
            read(path, None, TimeSource())
    one = Signal("a", np.arange(3.0), np.zeros(3), "m")
    two = Signal("b", np.arange(3.0) + 0.5, np.zeros(3), "m")
    with pytest.raises(LogError, match="different clocks"):
        write(RawLog({"a": one, "b": two}, LogSource("x", "mcap", 0, "")), path)
