"""The starter run file: it loads as it stands, its mapping reads the log, and every guess carries its reason."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

from mooringdx.config import CsvOptions, RunConfig, TimeSource, load_run
from mooringdx.logs import read_log
from mooringdx.logs.starter import guess, starter
from mooringdx.logs.survey import survey
from mooringdx.types import LogSource, RawLog, Signal

DATA = Path(__file__).parents[2] / "shared" / "data"


def made(
    tmp_path: Path, rate: float = 10.0, span: float = 600.0, vessel: str | None = None, **units: str
) -> tuple[str, RunConfig]:
    t = np.arange(0.0, span, 1.0 / rate)
    signals = {n: Signal(n, t, np.sin(t + k), u) for k, (n, u) in enumerate(units.items())}
    log = RawLog(signals, LogSource("a.csv", "csv", 0, ""))
    text = starter(tmp_path / "a.csv", survey(log), vessel, ["line_1"] if vessel else [], out=tmp_path / "run.toml")
    (tmp_path / "run.toml").write_text(text, encoding="utf-8")
    return text, load_run(tmp_path / "run.toml")


def test_a_vessel_on_lines(tmp_path: Path) -> None:
    text, run = made(tmp_path, x="m", y="m", psi="deg", T1="kN", T2="kN", T3="kN", cabin="degC")
    assert run.log.path == "a.csv"
    assert set(run.channels) == {"north", "east", "heading", "tension_1", "tension_2", "tension_3"}
    assert run.channels["tension_2"].column == "T2"
    assert run.channels["tension_2"].unit == "kN"
    assert run.clock.sample_time == pytest.approx(0.1)
    assert run.mooring.lines == ["line_1", "line_2", "line_3"]
    assert run.residuals.use == ["learned", "position"]
    assert run.baseline is not None
    assert run.baseline.window == (0.0, pytest.approx(359.94))
    assert "# x_cabin = " in text
    mapping = text[text.index("[channels]") : text.index("[clock]")].splitlines()[1:]
    assert all("# guess: " in line for line in mapping if line)
    assert "CHECK IT" in text


def test_tensions_only_have_no_position_residual_and_fast_logs_are_slowed(tmp_path: Path) -> None:
    _, run = made(tmp_path, rate=200.0, span=30.0, Tension_SB="N", Tension_PS="N")
    assert run.residuals.use == ["learned"]
    assert run.mooring.lines == ["line_SB", "line_PS"]
    assert run.clock.sample_time == 0.05


@pytest.mark.parametrize("place", [{"x": "m", "y": "m"}, {"lat": "deg", "lon": "deg"}])
def test_a_vessel_without_tensions_is_watched_by_position_alone(place: dict[str, str], tmp_path: Path) -> None:
    text, run = made(tmp_path, vessel="fpso200", psi="deg", **place)
    assert run.residuals.use == []
    assert run.bank.use == ["onset_glr"]
    assert run.baseline is not None
    assert "No tension was recognised" in text
    later = text.replace('# [residuals]\n# use = ["tension"', '[residuals]\nuse = ["tension"')  # as the comment says
    assert tomllib.loads(later)["residuals"]["use"] == ["tension", "force_balance"]


@pytest.mark.parametrize("more", [{"psi": "deg", "T1": "kN"}, {"roll": "deg"}])
def test_a_vessel_with_tensions_or_without_heading_is_not(more: dict[str, str], tmp_path: Path) -> None:
    _, run = made(tmp_path, vessel="fpso200", x="m", y="m", **more)
    assert run.residuals.use == ["tension", "force_balance"]
    assert run.bank.use == []


def test_daily_positions_go_to_the_bank(tmp_path: Path) -> None:
    _, run = made(tmp_path, rate=1 / 86400, span=86400.0 * 300, lat="deg", lon="deg")
    assert set(run.channels) == {"latitude", "longitude"}
    assert run.bank.use == ["adrift"]
    assert run.clock.sample_time == 86400.0
    assert run.clock.max_gap == 129600.0
    assert run.baseline is None


def test_nothing_known_still_gives_a_run_file_of_free_channels(tmp_path: Path) -> None:
    _, run = made(tmp_path, **{"alpha": "m", 'be"ta #1': "N"})
    assert set(run.channels) == {"x_alpha", "x_be_ta_1"}
    assert run.channels["x_be_ta_1"].column == 'be"ta #1'


def test_what_never_changes_or_has_no_number_is_only_a_comment() -> None:
    t = np.arange(100.0)
    values = {"roll": np.zeros(100), "pitch": np.full(100, np.nan), "heading": np.sin(t), "t": t}
    log = RawLog({n: Signal(n, t, v, "") for n, v in values.items()}, LogSource("a", "csv", 0, ""))
    choices = guess(survey(log))
    assert [n for n, c in choices.items() if c.used] == ["heading"]
    assert "never changes" in choices["roll"].reason
    assert "no number" in choices["pitch"].reason


@pytest.mark.reference
@pytest.mark.parametrize(
    ("place", "channels"),
    [
        ("flume/3101_3.csv.gz", {"sway", "heave", "roll", "tension_SB", "tension_PS", "wave_elevation_1", "accel_y"}),
        ("moordyn_oc4_mhkit/Test.MD.out", {"tension_1", "tension_2", "tension_3"}),
        ("tao/0n110w.csv", {"north", "east"}),
        ("mcap_solvcon/vehicle_zstd.mcap", {"accel_x", "accel_y"}),
    ],
)
def test_real_logs_are_read_by_their_own_starter(place: str, channels: set[str], tmp_path: Path) -> None:
    path = DATA / place
    if not path.exists():
        pytest.skip(f"needs {place} of the reference data folder beside the repository")
    text = starter(path, survey(read_log(path, None, TimeSource(), CsvOptions())))
    (tmp_path / "run.toml").write_text(text, encoding="utf-8")
    run = load_run(tmp_path / "run.toml")
    assert channels <= set(run.channels)
    log = read_log(path, run.channels, run.log.time, run.log.csv)
    assert set(log.signals) == set(run.channels)
    assert tomllib.loads(text)["log"]["path"] == path.resolve().as_posix()
