"""Truth: hand-made events with answers known in advance, published order-statistic ranks, brute force, small plans."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mooringdx.assess import run_plan
from mooringdx.assess.simulated import Cell, Expect, Walked, load, make, merged, rotated, seeds_of, weather_seed
from mooringdx.assess.simulated_score import Answer, answers, cause_words, named, share_at
from mooringdx.assess.simulated_tables import (
    calibration,
    confusion,
    fault_numbers,
    healthy_numbers,
    quantile,
    trap_numbers,
)
from mooringdx.errors import ConfigError
from mooringdx.types import Event, Rival

ROOT = Path(__file__).parents[1]


def event(kind: str = "line_lost", subject: str = "line_4", detected: float = 110.0, **rest: Any) -> Event:
    body: dict[str, Any] = {
        "named": detected + 15.0,
        "evidence": {"detector": "glrt (main branch), glrt (slow branch)"},
    }
    return Event(kind, subject, detected - 8.0, (detected - 12.0, detected - 4.0), detected, **(body | rest))


def fault(kind: str = "line_lost", subject: str = "line_4", onset: float = 100.0, **rest: Any) -> dict[str, Any]:
    return {
        "kind": kind,
        "subject": subject,
        "mode": None,
        "onset": onset,
        "end": None,
        "ramp": 0.0,
        "size": 1.0,
    } | rest


def walked(*events: Event, faults: Any = (), traps: Any = (), **rest: Any) -> Walked:
    truth = {"healthy_until": 100.0, "faults": list(faults), "traps": list(traps), "duration": 400.0}
    return Walked(
        **({"cell": 0, "seed": 3, "repeat": 0, "weather": 9, "hours": 0.5, "truth": truth, "events": events} | rest)
    )


def cell(**score: Any) -> Cell:
    return Cell(name="c", scenario="s.toml", score=Expect(**score))


def only(*events: Event, score: dict[str, Any] | None = None, **rest: Any) -> Answer:
    (row,) = answers(cell(**(score or {})), walked(*events, **rest))
    return row


def test_a_fault_is_answered_by_the_first_event_after_its_onset() -> None:
    row = only(
        event("environment", "force", 60.0), event(size=-3.6), event("sensor_fault", "tension_1", 150.0),
        faults=[fault()], score={"full": -4.0},
    )  # fmt: skip
    assert (row.found, row.delay, row.named, row.right) == (True, 10.0, "line_lost", True)
    assert (row.early, row.further, row.branch) == (1, 1, "glrt (main branch)")
    assert row.size_error == pytest.approx(-0.1)
    assert (row.onset_error, row.onset_covered) == (2.0, True)
    assert row.loss is None


def test_an_onset_outside_the_interval_is_not_covered() -> None:
    assert not only(event(detected=113.0), faults=[fault()]).onset_covered
    assert not only(event(detected=103.0), faults=[fault()]).onset_covered
    assert only(event(detected=112.0), faults=[fault()]).onset_covered


def test_a_late_alarm_and_a_standing_false_one_are_misses() -> None:
    late = only(event(detected=140.0), faults=[fault()], score={"within": 30.0})
    assert (late.found, late.delay, late.named, late.further) == (False, None, "nothing", 1)
    standing = only(event(detected=99.0), faults=[fault()])
    assert (standing.found, standing.early) == (False, 1)


@pytest.mark.parametrize(
    ("found", "kind", "subject"),
    [
        (event("line_lost", "line_5"), True, False),
        (event("sensor_fault", "tension_4"), False, True),
        (event("sensor_fault", "north"), False, False),
        (event("line_weakened", "line_4"), False, True),
        (event("unknown", "line_4"), False, True),
    ],
)
def test_kind_and_subject_are_judged_apart(found: Event, kind: bool, subject: bool) -> None:
    row = only(found, faults=[fault()])
    assert (row.kind_right, row.subject_right, row.right) == (kind, subject, False)


def test_an_event_that_leaves_two_kinds_level_cannot_tell() -> None:
    rival = (Rival("sensor_fault", "tension_4", 0.5, ""),)
    level = event(cannot_tell="line_4 lost or sensor tension_4 wrong", rivals=rival)
    assert named(level) == "cannot tell"
    assert not only(level, faults=[fault()]).right
    assert named(event(cannot_tell="line_4 or line_5", rivals=(Rival("line_lost", "line_5", 0.5, ""),))) == "line_lost"
    assert named(event(rivals=rival)) == "line_lost"
    assert named(event("unknown", "log")) == "cannot tell"


def test_a_leak_is_scored_by_what_was_lost_at_the_alarm() -> None:
    leak = fault("line_weakened", mode="buoyancy", ramp=200.0, size=0.8)
    assert [share_at(leak, t) for t in (90.0, 100.0, 150.0, 300.0, 900.0)] == pytest.approx([0.0, 0.0, 0.2, 0.8, 0.8])
    row = only(event("line_weakened", detected=150.0, size=0.42), faults=[leak], score={"full": 1.2})
    assert row.loss == pytest.approx(0.2)
    assert row.size_error == pytest.approx(0.35 - 0.8 * 80.0 / 200.0)  # sized two windows of 15 s after the alarm


def test_a_bias_is_sized_in_its_unit_and_a_dead_gauge_not_at_all() -> None:
    biased = event("sensor_fault", "tension_4", mode="bias", size=0.27)
    row = only(biased, faults=[fault("sensor_fault", "tension_4", mode="bias", size=0.3)])
    assert row.size_error == pytest.approx(-0.03)
    assert only(biased, faults=[fault("sensor_fault", "tension_4", mode="dead")]).size_error is None
    how = [only(biased, faults=[fault("sensor_fault", "tension_4")], score={"modes": [m]}) for m in ("dead", "bias")]
    assert [(r.right, r.mode_right) for r in how] == [(True, False), (True, True)]
    half = event("line_weakened", size=0.45, size_unit="share of the buoyancy")
    assert only(half, faults=[fault("line_weakened", size=0.5)]).size_error == pytest.approx(-0.05)


def test_a_name_is_as_late_as_its_cause_was_told() -> None:
    assert only(event(), faults=[fault()]).told_after == 25.0
    assert only(event(evidence={"cause_told": 131.0}), faults=[fault()]).told_after == 31.0


def test_the_size_of_a_wrong_channel_is_no_size_of_the_fault() -> None:
    assert only(event(subject="line_5", size=-4.0), faults=[fault()], score={"full": -4.0}).size_error is None
    assert only(event(size=-4.0), faults=[fault()], score={"full": -4.0}).size_error == 0.0


def test_two_faults_in_one_log_are_two_answers() -> None:
    both = [fault(onset=200.0, subject="line_5"), fault()]
    rows = answers(cell(), walked(event(), event(subject="line_5", detected=230.0), faults=both))
    assert [(r.subject, r.delay, r.right) for r in rows] == [("line_4", 10.0, True), ("line_5", 30.0, True)]
    rows = answers(cell(), walked(event(detected=205.0), faults=both))
    assert [(r.found, r.right) for r in rows] == [(False, None), (True, False)]


def test_a_trap_is_answered_by_silence_or_the_environment() -> None:
    trap = [fault("environment", "current", mode="current_step")]
    rival = (Rival("environment", "force", 0.2, ""),)
    rows = [
        only(traps=trap),
        only(event("environment", "force"), traps=trap),
        only(event(rivals=rival), traps=trap),
        only(event(), traps=trap),
    ]
    assert [(r.found, r.right, r.environment) for r in rows] == [
        (False, None, None), (True, True, True), (True, False, True), (True, False, False),
    ]  # fmt: skip
    figures = trap_numbers(rows, asked=1.0)
    assert (figures["without_any_event"]["count"], figures["fault_named"]["count"]) == (1, 2)
    assert (figures["environment_said"]["count"], figures["environment_said"]["n"]) == (2, 3)
    assert figures["runs_with_a_fault_event"]["count"] == 2
    assert (figures["faults"]["count"], figures["faults"]["per_hour"]) == (2, 1.0)
    later = fault("environment", "wind", onset=200.0, mode="wind")
    assert only(event("environment", "force"), traps=[later, *trap]).delay == 10.0


def test_false_alarms_are_counted_over_hours_beside_the_asked_rate() -> None:
    rows = [only(hours=50.0), only(event(), event("environment", "force"), hours=50.0)]
    assert [r.role for r in rows] == ["healthy", "healthy"]
    figures = healthy_numbers(rows, asked=0.01 / 3600.0)
    assert figures["hours"] == 100.0
    assert figures["all"]["per_hour"] == pytest.approx(0.02)
    assert figures["all"]["ratio"][0] == pytest.approx(2.0)
    assert figures["all"]["ratio"][2] == pytest.approx(7.2247, abs=1e-4)  # Garwood's upper limit of 2 events
    assert figures["faults"]["count"] == 1
    assert figures["logs_with_an_alarm"]["count"] == 1


def test_a_missed_fault_is_an_infinite_delay() -> None:
    rows = [only(event(detected=100.0 + d), faults=[fault()]) for d in (1.0, 2.0, 3.0)]
    figures = fault_numbers([*rows, only(faults=[fault()])])
    assert figures["found"]["count"] == 3
    assert (figures["delay"]["median"]["value"], figures["delay"]["90"]["value"]) == (2.0, math.inf)
    assert figures["delay"]["max"] == math.inf
    assert figures["right"]["n"] == 3


def test_quantiles_have_the_published_ranks() -> None:
    """Order-statistic 95 % limits of a median: ranks 14 and 27 of 40, 2 and 9 of 10 (any table of the sign test)."""
    of_40 = quantile(list(range(1, 41)), 0.5)
    assert (of_40["value"], of_40["low"], of_40["high"]) == (20.0, 14.0, 27.0)
    of_10 = quantile(list(range(1, 11)), 0.5)
    assert (of_10["low"], of_10["high"]) == (2.0, 9.0)
    assert quantile([1.0] * 10, 0.95)["high"] is None
    assert quantile([], 0.5)["value"] is None


def test_quantile_intervals_hold_as_often_as_they_say() -> None:
    rng = np.random.default_rng(5)
    held = [q["low"] <= 0.0 <= q["high"] for q in (quantile(x.tolist(), 0.5) for x in rng.standard_normal((400, 40)))]
    assert 0.93 <= np.mean(held) <= 0.99  # 0.9615 by theory


def test_calibration_of_two_gaussian_causes_is_what_it_promises() -> None:
    """Brute force: two causes d' apart, the likelier one named."""
    rng = np.random.default_rng(6)
    rows = []
    for d in (2.0, 3.1, 4.0, 6.0):
        for x in rng.standard_normal(300):
            said = "line_lost" if x > -d / 2.0 else "sensor_fault"
            body = {"detector": "", "discrimination": d}
            rows.append(only(event(said, "line_4", evidence=body, probability=0.9), faults=[fault()]))
    bins = calibration(rows)
    assert [b["n"] for b in bins] == [300, 300, 300, 300]
    for b, promised in zip(bins, (0.8413, 0.9394, 0.9772, 0.9987), strict=True):
        assert b["promised"] == pytest.approx(promised, abs=1e-4)
        assert b["right_of_named"]["low"] <= promised <= b["right_of_named"]["high"]
    wrong = [only(event(evidence={"discrimination": 5.0}), faults=[fault(subject="line_1")])] * 20
    assert calibration(wrong)[3]["right_of_named"]["share"] == 0.0
    level = event("unknown", "log", evidence={"discrimination": 1.0})
    assert calibration([only(level, faults=[fault()])])[0]["named_a_cause"] == 0


def test_confusion_counts_each_truth_by_what_it_was_called() -> None:
    dead = [fault("sensor_fault", "tension_4", mode="dead")]
    rows = [only(event(), faults=[fault()]), only(faults=[fault()]), only(event(), faults=dead)]
    table = confusion(rows)
    assert table["line parted"]["named"]["line_lost"] == 1
    assert table["line parted"]["named"]["nothing"] == 1
    assert table["sensor dead"]["named"]["line_lost"] == 1
    assert (table["line parted"]["right"]["count"], table["sensor dead"]["right"]["count"]) == (1, 0)
    assert cause_words(fault("line_weakened", mode="buoyancy")) == "buoyancy lost"


def test_changes_lie_over_tables_and_lists_of_tables() -> None:
    body = {"sea": {"height": 1, "period": 2}, "faults": [{"kind": "a", "size": 1}, {"kind": "b"}], "x": [1, 2]}
    out = merged(body, {"sea": {"height": 3}, "faults": [{"size": 9}], "x": [5], "new": 1})
    assert out == {
        "sea": {"height": 3, "period": 2}, "faults": [{"kind": "a", "size": 9}, {"kind": "b"}], "x": [5], "new": 1,
    }  # fmt: skip
    assert merged(body, {"faults": []})["faults"] == []
    assert body["sea"] == {"height": 1, "period": 2}


def test_rotation_goes_round_the_vessel_and_leaves_other_sensors() -> None:
    body = {"faults": [{"subject": "line_5"}, {"subject": "tension_6"}, {"subject": "heading"}]}
    out = rotated(body, 2, ("1", "2", "3", "4", "5", "6"))
    assert [f["subject"] for f in out["faults"]] == ["line_1", "tension_2", "heading"]


def test_no_two_logs_share_their_weather() -> None:
    drawn = {weather_seed(s, w, r) for s in range(200) for w in ("train", "a", "b", "c") for r in range(5)}
    assert len(drawn) == 200 * 4 * 5


PLAN = """
kind = "simulated"
run = "{root}/configs/runs/demo.toml"
train = {{ scenario = "{root}/configs/scenarios/demo_healthy.toml", duration = 720, window = [60.0, 700.0] }}
seeds = [1, 2]
processes = {processes}
[[cells]]
name = "line parted"
scenario = "{root}/configs/scenarios/demo.toml"
subject = "rotate"
change = {{ record = {{ duration = 200 }}, faults = [{{ onset = 120 }}] }}
variant = {{ whitening = {{ order = "none" }} }}
score = {{ within = 30 }}
[[cells]]
name = "healthy"
scenario = "{root}/configs/scenarios/demo_healthy.toml"
change = {{ record = {{ duration = 200 }} }}
variant = {{ whitening = {{ order = "none" }} }}
seeds = [2, 1]
repeat = 2
"""


def written(folder: Path, processes: int = 1, change: tuple[str, str] = ("", "")) -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / "plan.toml"
    path.write_text(PLAN.format(root=ROOT.as_posix(), processes=processes).replace(*change))
    return path


def test_a_plan_finds_parted_lines_and_writes_every_log(tmp_path: Path) -> None:
    seen: list[tuple[int, int]] = []
    text, result = run_plan(written(tmp_path), tmp_path / "out", progress=lambda done, all_: seen.append((done, all_)))
    parted, healthy = result["cells"]
    assert seen == [(1, 2), (2, 2)]
    assert (parted["n"], parted["found"]["count"], parted["subject_right"]["count"]) == (2, 2, 2)
    assert (healthy["role"], healthy["n"]) == ("healthy", 2)
    assert 0.03 < healthy["hours"] / 2 < 200 / 3600
    assert "2/2 [0.16, 1.00]" in text
    rows = (tmp_path / "out/runs.csv").read_text().splitlines()
    assert len(rows) == 5
    assert [row.split(",")[7] for row in rows[1:3]] == ["line_5", "line_6"]  # line 4, moved on by the seed
    assert json.loads((tmp_path / "out/assess.json").read_text())["cells"][0]["name"] == "line parted"


@pytest.mark.parametrize("path", sorted((ROOT / "configs/plans").glob("fang_*.toml")), ids=lambda p: p.stem)
def test_every_plan_of_the_model_basin_can_be_carried_out(path: Path) -> None:
    job = load(path)
    for i, asked in enumerate(job.plan.cells):
        faults, traps = job.scenarios[i]["faults"], job.scenarios[i]["traps"]
        healthy = "healthy" in asked.name
        assert healthy == (not faults and not traps), asked.name
        assert job.scenarios[i]["rig"]["anchors"] == job.training["rig"]["anchors"]
        assert job.runs[job.variant_of[i]].baseline.window[1] <= job.training["record"]["duration"]


def test_three_hundred_healthy_hours_follow_on_forty_fits() -> None:
    job = load(ROOT / "configs/plans/fang_cause.toml")
    at = next(i for i, cell in enumerate(job.plan.cells) if "healthy" in cell.name)
    cell = job.plan.cells[at]
    hours = job.scenarios[at]["record"]["duration"] * len(seeds_of(job.plan, cell)) * cell.repeat / 3600.0
    assert (hours, len(seeds_of(job.plan, cell))) == (300.0, 40)


@pytest.mark.slow
def test_processes_do_not_change_a_byte(tmp_path: Path) -> None:
    for count in (1, 2):
        run_plan(written(tmp_path / f"p{count}", count), tmp_path / f"out{count}")
    first, second = ((tmp_path / f"out{n}/runs.csv").read_bytes() for n in (1, 2))
    assert first == second


def test_a_log_can_be_made_again_and_shares_nothing_with_another_seed(tmp_path: Path) -> None:
    job = load(written(tmp_path))
    first, again, other = (make(job, 0, seed)[0].signals["north"].values for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert abs(np.corrcoef(np.diff(first), np.diff(other))[0, 1]) < 0.2


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("repeat", "repeats"), "unknown key 'repeats'"),
        (('"healthy"', '"line parted"'), "two cells are named 'line parted'"),
        (("onset = 120", "onset = 500"), "demo.toml"),
        (('order = "none"', 'order = "nine"'), "plan.toml"),
    ],
)
def test_a_wrong_plan_is_refused_before_anything_runs(tmp_path: Path, change: tuple[str, str], says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        load(written(tmp_path, change=change))


def test_a_training_log_that_cannot_be_fitted_is_said_not_scored(tmp_path: Path) -> None:
    path = written(tmp_path, change=("window = [60.0, 700.0]", "window = [60.0, 75.0]"))
    text, result = run_plan(path, tmp_path / "out")
    assert result["cells"][0]["n"] == 0
    assert [r["seed"] for r in result["cells"][0]["refused"]] == [1, 2]
    assert "Not scored: the training log was refused" in text
