"""Truth: the demo's truth file, and the same log again with samples removed, in another format, a second time."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from mooringdx import baseline as learned
from mooringdx.baseline import Baseline
from mooringdx.config import RunConfig, load_run
from mooringdx.errors import ConfigError, FitError
from mooringdx.logs import read_log
from mooringdx.pipeline import detect, fit, prepare
from mooringdx.report import as_json
from mooringdx.results import detection_files, load_detection, write_files
from mooringdx.simulate import Scenario, load_scenario, simulate
from mooringdx.types import Detection, RawLog, Signal, replace

ROOT = Path(__file__).parents[1]
DEMO = ROOT / "configs/runs/demo.toml"
AZIMUTH = {f"line_{i}": 60.0 * i - 30.0 for i in range(1, 7)}


def read(path: Path, run: RunConfig) -> RawLog:
    return read_log(path, run.channels, run.log.time, run.log.csv)


@pytest.fixture(scope="module")
def run() -> RunConfig:
    return load_run(DEMO)


@pytest.fixture(scope="module")
def log(run: RunConfig) -> RawLog:
    return read(ROOT / "data/demo.csv", run)


@pytest.fixture(scope="module")
def baseline(run: RunConfig, log: RawLog) -> Baseline:
    return fit([prepare(log, run)], run)


@pytest.fixture(scope="module")
def detection(baseline: Baseline, log: RawLog, run: RunConfig) -> Detection:
    return detect(prepare(log, run), baseline, name="demo.csv")


@pytest.fixture(scope="module")
def truth() -> dict[str, object]:
    faults = json.loads((ROOT / "data/demo.truth.json").read_text())["faults"]
    assert len(faults) == 1
    return dict(faults[0])


def test_the_demo_names_the_lost_line(detection: Detection, truth: dict[str, object]) -> None:
    assert detection.verdict == "fault_found"
    (event,) = detection.events
    assert (event.kind, event.subject) == ("line_lost", truth["subject"])
    assert abs(event.onset - float(str(truth["onset"]))) < 5.0
    assert not event.rivals
    assert event.onset_interval[0] <= float(str(truth["onset"])) <= event.onset_interval[1]
    assert event.size_unit == "share of tension"
    assert event.size == pytest.approx(1.0, abs=0.02)  # 0.05 N of some 4 N still hang from the fairlead
    assert event.size_interval is not None
    assert event.size_interval[0] < event.size < event.size_interval[1]
    assert event.evidence["discrimination"] > 3.0
    assert event.evidence["log_likelihood_ratio"] > 0.0


def test_nothing_is_said_before_the_fault(
    detection: Detection, baseline: Baseline, log: RawLog, run: RunConfig
) -> None:
    """Causal: a log cut before the fault gives the same statistic and no event."""
    signals = {n: Signal(n, s.time[:12800], s.values[:12800], s.unit, s.source) for n, s in log.signals.items()}
    cut = detect(prepare(replace(log, signals=signals), run), baseline, name="cut")
    assert cut.verdict == "nothing_found"
    for short, whole in zip(cut.statistics, detection.statistics, strict=True):
        np.testing.assert_array_equal(short.values[:12700], whole.values[:12700])


def test_the_mcap_twin_says_the_same(detection: Detection, baseline: Baseline, run: RunConfig) -> None:
    body = run.model_dump(mode="json")
    body["channels"] = {n: {"topic": "/log", "field": n, "unit": c["unit"]} for n, c in body["channels"].items()}
    twin_run = RunConfig.model_validate(body)
    twin = detect(prepare(read(ROOT / "data/demo.mcap", twin_run), run), baseline, name="demo.mcap")
    (one,), (other,) = detection.events, twin.events
    assert (one.kind, one.subject) == (other.kind, other.subject)
    assert one.onset == pytest.approx(other.onset, abs=0.05)


def gappy(log: RawLog, seed: int) -> RawLog:
    """Return the log with 10 % of its samples gone, in gaps of 1 to 60 s at random places, on all signals at once."""
    rng = np.random.default_rng(seed)
    time = next(iter(log.signals.values())).time
    keep = np.ones(time.size, dtype=bool)
    while keep.mean() > 0.9:
        start, length = rng.uniform(time[0], time[-1]), rng.uniform(1.0, 60.0)
        keep &= (time < start) | (time >= start + length)
    signals = {n: Signal(n, s.time[keep], s.values[keep], s.unit, s.source) for n, s in log.signals.items()}
    return replace(log, signals=signals)


@pytest.mark.parametrize("seed", range(8))
def test_ten_per_cent_of_gaps_cost_the_detection_nothing(
    seed: int, log: RawLog, baseline: Baseline, run: RunConfig, truth: dict[str, object]
) -> None:
    """Found soon after the first sample that shows it; named, unless the window that names is itself mostly a gap."""
    onset = float(str(truth["onset"]))
    holed = gappy(log, seed)
    (event,) = detect(prepare(holed, run), baseline, name="gappy").events
    time = next(iter(holed.signals.values())).time
    seen = time[time >= onset][0]  # nothing can be found inside a gap
    assert event.detected - seen < 35.0
    if event.kind == "unknown":
        assert event.named is not None
        logged = np.sum((time >= event.detected) & (time < event.named)) * 0.1 / (event.named - event.detected)
        assert logged < 0.5
        assert "masked" in str(event.cannot_tell)
        return
    assert (event.kind, event.subject) == ("line_lost", truth["subject"])


@pytest.mark.parametrize(
    ("scenario", "named"),
    [("demo_healthy", []), ("demo_sensor_dead", [("sensor_fault", "tension_4", "dead")])],
)
def test_a_dead_gauge_is_not_a_lost_line_and_a_healthy_log_is_healthy(
    scenario: str, named: list[tuple[str, str, str]], baseline: Baseline, run: RunConfig
) -> None:
    made, _ = simulate(load_scenario(ROOT / f"configs/scenarios/{scenario}.toml"), 1)
    found = detect(prepare(made, run), baseline, name=scenario)
    assert [(e.kind, e.subject, e.mode) for e in found.events] == named
    assert found.verdict == ("fault_found" if named else "nothing_found")


def test_what_is_saved_comes_back(tmp_path: Path, detection: Detection, baseline: Baseline) -> None:
    files = detection_files(detection)
    write_files(tmp_path, {**files, **learned.save(baseline, [Path("demo.csv")], "mooringdx fit")})
    again = load_detection(tmp_path)
    assert again.events == detection.events
    assert as_json(again) == as_json(detection)
    np.testing.assert_allclose(again.channels.values, detection.channels.values, rtol=1e-6, atol=1e-7)
    assert bytes(detection_files(detection)["stages.parquet"]) == bytes(files["stages.parquet"])
    back = learned.load(tmp_path)
    assert learned.save(back, [Path("demo.csv")], "mooringdx fit") == learned.save(
        baseline, [Path("demo.csv")], "mooringdx fit"
    )


def test_a_second_detection_from_the_saved_baseline_is_the_same(
    tmp_path: Path, detection: Detection, baseline: Baseline, log: RawLog, run: RunConfig
) -> None:
    write_files(tmp_path, learned.save(baseline, [Path("demo.csv")], ""))
    second = detect(prepare(log, run), learned.load(tmp_path), name="demo.csv")
    assert as_json(second) == as_json(detection)


def changed(run: RunConfig, **parts: dict[str, object]) -> RunConfig:
    body = run.model_dump(mode="json")
    for name, values in parts.items():
        body[name] = {**(body[name] or {}), **values}
    return RunConfig.model_validate(body)


def wrong_windows() -> Iterator[tuple[dict[str, object], type[Exception], str]]:
    yield {"window": [60.0, 300.0]}, FitError, "more"
    yield {"window": [9000.0, 9900.0]}, ConfigError, "outside the log, which spans"


@pytest.mark.parametrize(("part", "error", "message"), list(wrong_windows()))
def test_a_window_that_cannot_carry_a_rate_is_refused(
    part: dict[str, object], error: type[Exception], message: str, log: RawLog, run: RunConfig
) -> None:
    short = changed(run, baseline=part, whitening={"order": "none"})
    with pytest.raises(error, match=message):
        fit([prepare(log, short)], short)


def test_extrapolate_accepts_the_short_window_and_marks_it(log: RawLog, run: RunConfig) -> None:
    short = changed(run, baseline={"window": [60.0, 360.0]}, whitening={"order": "none"})
    found = fit([prepare(log, short)], short, extrapolate=True)
    assert found.verdict == "invalid"
    events = detect(prepare(log, short), found, name="x").events
    assert all("extrapolated_threshold" in e.marks for e in events)
    assert any(e.subject == "line_4" for e in events)


def with_values(log: RawLog, changes: dict[str, tuple[float, float | None]]) -> RawLog:
    """Return the log with channels set to a value (or cut off: None) from a time on."""
    signals = dict(log.signals)
    for name, (start, value) in changes.items():
        s = signals[name]
        if value is None:
            keep = s.time < start
            signals[name] = Signal(name, s.time[keep], s.values[keep], s.unit, s.source)
        else:
            signals[name] = Signal(name, s.time, np.where(s.time >= start, value, s.values), s.unit, s.source)
    return replace(log, signals=signals)


def test_a_line_that_parts_while_a_gauge_stands_in_alarm_is_found(
    log: RawLog, baseline: Baseline, run: RunConfig
) -> None:
    """The gauge of line 2 goes wrong 55 s before line 4 parts: two events, the right ones, no more.

    The second comes while the forces still hold the change of the first, so that it may be named with its gauge.
    """
    rng = np.random.default_rng(4)
    s = log.signals["tension_2"]
    wrong = np.where(s.time >= 1265.0, s.values + 1.0 + 0.01 * rng.standard_normal(s.time.size), s.values)
    signals = {**log.signals, "tension_2": Signal("tension_2", s.time, wrong, s.unit, s.source)}
    first, second = detect(prepare(replace(log, signals=signals), run), baseline, name="two").events
    assert (first.kind, first.subject) == ("sensor_fault", "tension_2")
    named = {(second.kind, second.subject), *((r.kind, r.subject) for r in second.rivals)} - {("unknown", "line_4")}
    assert ("line_lost", "line_4") in named
    assert named <= {("line_lost", "line_4"), ("sensor_fault", "tension_4")}
    assert second.cannot_tell is not None or len(named) == 1
    assert second.onset_interval[0] <= 1320.0 <= second.onset_interval[1]
    assert "while_another_stands" in second.marks


def test_blind_is_not_quiet(log: RawLog, baseline: Baseline, run: RunConfig) -> None:
    """Without position nothing is judged from 1300 s on: the verdict may not be that nothing was found."""
    blind = with_values(log, {"north": (1300.0, None), "east": (1300.0, None), "heading": (1300.0, None)})
    found = detect(prepare(blind, run), baseline, name="blind")
    assert found.verdict == "cannot_be_judged"
    assert any(c.name == "watched to the end" and not c.passed for c in found.checks)


def test_a_window_past_the_log_and_a_line_without_its_channel_are_refused(log: RawLog, run: RunConfig) -> None:
    channels = [prepare(log, run)]
    with pytest.raises(ConfigError, match="reaches past the log"):
        fit(channels, changed(run, baseline={"window": [60.0, 9000.0]}))
    with pytest.raises(ConfigError, match="'line_9' has no channel 'tension_9'"):
        fit(channels, changed(run, mooring={"lines": ["line_4", "line_9"]}))


@pytest.mark.parametrize("kind", ["cusum", "glrt_unknown"])
def test_the_other_detectors_name_the_line_too(
    kind: str, log: RawLog, run: RunConfig, truth: dict[str, object]
) -> None:
    other = changed(run, detector={"kind": kind}, whitening={"order": "none"})
    (event,) = detect(prepare(log, other), fit([prepare(log, other)], other), name=kind).events
    assert (event.kind, event.subject) == ("line_lost", truth["subject"])
    assert abs(event.onset - float(str(truth["onset"]))) < 5.0


# --- model-free: no vessel, no forces -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def free(run: RunConfig) -> RunConfig:
    """The demo's run file without its vessel: learned residuals, and where a lost line would send the vessel."""
    names = {"north", "east", "heading", *(f"tension_{i}" for i in range(1, 7))}
    mooring = {"vessel": None, "model": {}, "lines": list(AZIMUTH), "azimuth": AZIMUTH}
    residuals, plain = {"use": ["learned", "position"]}, {"order": "none"}
    body = changed(run, mooring=mooring, residuals=residuals, whitening=plain).model_dump(mode="json")
    return RunConfig.model_validate(body | {"channels": {k: v for k, v in body["channels"].items() if k in names}})


@pytest.fixture(scope="module")
def loose(free: RunConfig) -> RawLog:
    """The demo with its thrusters off, so that a lost line moves the vessel."""
    body = load_scenario(ROOT / "configs/scenarios/demo.toml").model_dump() | {"control": {"kind": "none"}}
    made, _ = simulate(Scenario.model_validate(body), 1)
    return replace(made, signals={n: s for n, s in made.signals.items() if n in free.channels})


@pytest.mark.parametrize("declared", [True, False])
def test_without_a_vessel_the_motion_tells_the_line_from_its_gauge(
    declared: bool, loose: RawLog, free: RunConfig, truth: dict[str, object]
) -> None:
    """How much of the line went is uncertain without its statics; that it is the line, and which one, is not."""
    bare = free if declared else changed(free, mooring={"lines": [], "azimuth": {}})
    channels = prepare(loose, bare)
    (event,) = detect(channels, fit([channels], bare), name="bare").events
    assert event.kind in ("line_lost", "line_weakened")
    assert event.subject == truth["subject"]
    assert not event.rivals
    assert abs(event.onset - float(str(truth["onset"]))) < 5.0


def test_a_line_and_its_gauge_are_one_class_without_motion(log: RawLog, free: RunConfig) -> None:
    """Learned residuals alone see a parted line and its dead gauge alike: both are named, with what would tell them."""
    alone = changed(free, residuals={"use": ["learned"]})
    rng = np.random.default_rng(8)
    s = log.signals["tension_4"]
    dead = np.where(s.time >= 1265.0, 0.02 * rng.standard_normal(s.time.size), s.values)
    signals = {n: Signal(n, x.time[:13100], x.values[:13100], x.unit, x.source) for n, x in log.signals.items()}
    signals["tension_4"] = Signal("tension_4", s.time[:13100], dead[:13100], s.unit, s.source)
    baseline = fit([prepare(log, alone)], alone)
    (event,) = detect(prepare(replace(log, signals=signals), alone), baseline, name="dead").events
    named = {(event.kind, event.subject), *((r.kind, r.subject) for r in event.rivals)}
    assert {("sensor_fault", "tension_4"), ("line_lost", "line_4")} <= named
    assert event.probability == pytest.approx(0.5, abs=0.01)
    assert event.cannot_tell is not None
    assert "position" in event.cannot_tell


def test_without_the_thrust_no_line_is_told_from_its_gauge(run: RunConfig, log: RawLog) -> None:
    """A controller answers a lost line by itself, so the forces would turn the names round."""
    kept = {n: s for n, s in log.signals.items() if not n.startswith("thrust_")}
    plain = changed(run, whitening={"order": "none"})
    blind = RunConfig.model_validate(
        plain.model_dump(mode="json") | {"channels": {n: c for n, c in plain.channels.items() if n in kept}}
    )
    channels = prepare(replace(log, signals=kept), blind)
    (event,) = detect(channels, fit([channels], blind), name="no thrust").events
    assert (event.kind, event.subject) == ("unknown", "line_4")
    assert {(r.kind, r.subject) for r in event.rivals} >= {("line_lost", "line_4"), ("sensor_fault", "tension_4")}
    assert "not logged" in str(event.cannot_tell)
