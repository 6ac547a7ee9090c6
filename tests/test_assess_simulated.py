"""Truth: hand-made events with answers known in advance, published order-statistic ranks, brute force, small plans."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mooringdx.assess import run_plan, simulated_bank
from mooringdx.assess.simulated import Walked, make, seen
from mooringdx.assess.simulated_figures import quantile
from mooringdx.assess.simulated_plan import (
    Cell,
    Expect,
    drawn,
    load,
    merged,
    nested,
    rotated,
    round_vessel,
    seeds_of,
    weather_seed,
)
from mooringdx.assess.simulated_score import Answer, answers, cause_words, named, share_at
from mooringdx.assess.simulated_tables import calibration, confusion, fault_numbers, healthy_numbers, trap_numbers
from mooringdx.config import read_toml
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


def test_two_lost_lines_stand_as_far_apart_as_asked_and_go_round_together() -> None:
    two: dict[str, Any] = {"faults": [{"subject": "line_1"}, {"subject": "line_2"}]}
    for by in range(6):
        out = [f["subject"] for f in rotated(two, by, ("1", "2", "3", "4", "5", "6"), apart=3)["faults"]]
        assert out == [f"line_{1 + by % 6}", f"line_{1 + (by + 3) % 6}"]


def test_a_rotating_gust_comes_from_where_a_line_goes_to() -> None:
    model = read_toml(ROOT / "configs/vessels/fpso200.toml")
    traps = [{"mode": "push", "direction": 1.0}, {"mode": "sea_growth", "direction": None}]
    body: dict[str, Any] = {"model": model, "faults": [], "traps": traps}
    lines = round_vessel(body)
    assert lines == ("1", "5", "2", "6", "3", "7", "4", "8")  # anchors at 0, 45, ... 315 deg
    for by in range(8):
        first, second = rotated(body, by, lines)["traps"]
        assert (first["direction"], second["direction"]) == (pytest.approx(45.0 * by), None)


def test_no_two_logs_share_their_weather() -> None:
    found = {weather_seed(s, w, r) for s in range(200) for w in ("train", "a", "b", "c") for r in range(5)}
    assert len(found) == 200 * 4 * 5


def test_a_seed_draws_each_key_evenly_from_a_stream_of_its_own() -> None:
    limits = {"rig.inertia": (-0.07, 0.07), "sea.direction": (210.0, 240.0)}
    body: dict[str, Any] = {"rig": {"gain": 0.1}, "sea": {"direction": 1.0}}
    rows = [drawn(body, limits, seed) for seed in range(400)]
    inertia, direction = (np.array([r[a][b] for r in rows]) for a, b in (("rig", "inertia"), ("sea", "direction")))
    for values, (low, high) in ((inertia, limits["rig.inertia"]), (direction, limits["sea.direction"])):
        assert low <= values.min()
        assert values.max() <= high
        assert values.std() == pytest.approx((high - low) / np.sqrt(12.0), rel=0.08)
    assert abs(np.corrcoef(inertia, direction)[0, 1]) < 0.15
    assert rows[3]["rig"] == {"gain": 0.1, "inertia": drawn(body, {"rig.inertia": (-0.07, 0.07)}, 3)["rig"]["inertia"]}
    assert nested({"a.b": 1, "a.c": 2, "d": 3}) == {"a": {"b": 1, "c": 2}, "d": 3}


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
        assert job.scenarios[i]["rig"]["anchors"] == job.lesson(i).training["rig"]["anchors"]
        assert job.lesson(i).run.baseline.window[1] <= job.lesson(i).training["record"]["duration"]


def test_three_hundred_healthy_hours_follow_on_forty_fits() -> None:
    job = load(ROOT / "configs/plans/fang_cause.toml")
    at = next(i for i, cell in enumerate(job.plan.cells) if "healthy" in cell.name)
    cell = job.plan.cells[at]
    hours = job.scenarios[at]["record"]["duration"] * len(seeds_of(job.plan, cell)) * cell.repeat / 3600.0
    assert (hours, len(seeds_of(job.plan, cell))) == (300.0, 40)


FPSO = """
kind = "simulated"
run = "{root}/configs/runs/fpso_position.toml"
train = {{ scenario = "{root}/configs/scenarios/fpso_healthy.toml", duration = 4200.0 }}
seeds = [1, 1]
processes = 1
variant = {{ clock = {{ sample_time = 0.5 }} }}
both = {{ record = {{ sample_time = 0.5 }} }}
[[cells]]
name = "lost"
scenario = "{root}/configs/scenarios/fpso_healthy.toml"
both = {{ sea = {{ height = 1.5, peak_period = 6.0 }} }}
change = {{ record = {{ duration = 1500.0 }}, faults = [{{ kind = "line_lost", subject = "line_1", onset = 1200.0 }}] }}
subject = "rotate"
draw = {{ "rig.inertia" = [-0.07, 0.07] }}
score = {{ within = 300.0 }}
[[cells]]
name = "the same lesson"
scenario = "{root}/configs/scenarios/fpso_healthy.toml"
both = {{ sea = {{ height = 1.5, peak_period = 6.0 }} }}
change = {{ record = {{ duration = 700.0 }} }}
draw = {{ "rig.inertia" = [-0.07, 0.07] }}
[[cells]]
name = "another sea"
scenario = "{root}/configs/scenarios/fpso_healthy.toml"
train = {{ change = {{ sea = {{ height = 4.0 }} }} }}
change = {{ record = {{ duration = 700.0 }} }}
seeds = [2, 1]
"""


def fpso(folder: Path) -> Path:
    path = folder / "fpso.toml"
    path.write_text(FPSO.format(root=ROOT.as_posix()))
    return path


def test_cells_of_one_rig_and_sea_share_a_fit_and_their_training_is_that_rig(tmp_path: Path) -> None:
    job = load(fpso(tmp_path))
    assert job.lesson_of == (0, 0, 1)
    assert [x.training["sea"]["height"] for x in job.lessons] == [1.5, 4.0]
    assert [x.training["record"]["sample_time"] for x in job.lessons] == [0.5, 0.5]
    assert len({x.word for x in job.lessons} | {"train"}) == 3
    for seed in (1, 2):
        truth = make(job, 0, seed)[1]["scenario"]
        assert truth["rig"] == drawn(job.lessons[0].training, job.lessons[0].draw, seed)["rig"]
        assert truth["rig"]["inertia"] != 0.0


def test_a_bank_sees_the_channels_of_its_run_file_alone_and_finds_the_line(tmp_path: Path) -> None:
    job = load(fpso(tmp_path))
    log, _, _ = make(job, 0, 1)
    assert "tension_1" in log.signals
    assert set(seen(log, job.lesson(0).run).names) == set(job.lesson(0).run.channels)
    text, result = run_plan(fpso(tmp_path), tmp_path / "out")
    lost = result["cells"][0]
    assert [lost["bank"][key]["count"] for key in ("subject_led", "subject_right")] == [1, 1]
    assert 0.0 <= lost["bank"]["warned_after"]["50"]["value"] <= lost["bank"]["alarm_after"]["50"]["value"] <= 60.0
    assert lost["bank"]["hours_before"] == pytest.approx(1 / 3)
    assert "Alarms of a bank" in text
    assert result["cells"][1]["asked_per_hour"] is None


def banked(subject: str = "line_4", detected: float = 130.0, environment: float = 0.2, **rest: Any) -> Event:
    body: dict[str, Any] = {
        "evidence": {"detector": "onset_glr", "warning": detected - 10.0},
        "probability": 0.7,
        "cannot_tell": "a squall along the line",
        "rivals": (Rival("environment", "force", environment, ""),),
        "size": 0.9,
        "size_unit": "share of the line's pull",
        "size_interval": (0.8, 0.99),
    }
    return event("line_lost", subject, detected, **(body | rest))


def bank_row(*events: Event, lead: str = "line_4", **rest: Any) -> Answer:
    lines = ("1", "5", "2", "6", "3", "7", "4", "8")
    return only(*events, leading=(lead,) * len(events), lines=lines, **({"faults": [fault()]} | rest))


def test_what_a_bank_says_is_scored_at_its_warning_its_alarm_and_its_name() -> None:
    row = bank_row(banked(), lead="line_8")
    assert (row.warned_after, row.delay, row.subject_led, row.subject_right) == (20.0, 30.0, False, True)
    assert (row.size_covered, row.adjacent, row.named, row.named_in_time) == (False, None, "line_lost", True)
    assert (row.environment_probability, row.quiet_hours) == (0.2, pytest.approx(100.0 / 3600.0))
    assert bank_row(banked(size_interval=(0.8, 1.01))).size_covered
    assert [bank_row(banked(x)).adjacent for x in ("line_7", "line_8", "line_3")] == [True, True, False]
    assert bank_row(banked("line_7")).size_covered is None
    assert bank_row(banked(environment=0.75)).named == "cannot tell"
    assert bank_row(banked(detected=105.0)).warned_after == 0.0


def test_a_bank_that_misses_has_no_delay_and_its_quantiles_are_infinite() -> None:
    rows = [bank_row(banked(detected=130.0 + d)) for d in range(9)]
    figures = simulated_bank.fault_numbers([*rows, bank_row(), bank_row(banked(detected=99.0))])
    assert figures is not None
    assert figures["alarm_after"]["50"]["value"] == 35.0
    assert figures["alarm_after"]["99"]["value"] == math.inf
    assert figures["warned_after"]["90"]["value"] == math.inf
    assert (figures["subject_right"]["count"], figures["subject_right"]["n"]) == (9, 9)
    assert (figures["false_before"]["count"], figures["hours_before"]) == (1, pytest.approx(11 * 100.0 / 3600.0))
    assert simulated_bank.fault_numbers([only(event(), faults=[fault()])]) is None


def test_two_lines_are_both_named_or_not() -> None:
    both = [fault(), fault(onset=200.0, subject="line_5")]
    logs = [
        (banked(), banked("line_5", 230.0)),  # each in its turn
        (banked(detected=240.0), banked("line_5", 260.0)),  # both late
        (banked(), banked("line_7", 230.0)),  # the second wrong
        (banked(),),
    ]
    rows = []
    for seed, found in enumerate(logs):
        truth = walked(*found, faults=both, seed=seed, leading=("line_4",) * len(found))
        rows += answers(cell(within=150.0), truth)
    named_all = simulated_bank.every_named(rows)
    assert named_all is not None
    assert (named_all["count"], named_all["n"]) == (2, 4)
    assert simulated_bank.every_named(rows[:1]) is None


def test_a_trap_shows_how_likely_the_bank_held_the_environment() -> None:
    trap = [fault("environment", "environment", mode="push")]
    rows = [bank_row(*found, faults=(), traps=trap) for found in ((banked(),), (banked(environment=0.1),), (), ())]
    figures = simulated_bank.trap_numbers(rows)
    assert figures is not None
    assert (figures["alarms"]["count"], figures["alarms"]["n"], figures["rival"]["count"]) == (2, 4, 2)
    assert figures["probability"]["50"]["value"] == 0.1
    assert simulated_bank.trap_numbers([bank_row(faults=(), traps=trap)]) is None


@pytest.mark.parametrize("path", sorted((ROOT / "configs/plans").glob("position_*.toml")), ids=lambda p: p.stem)
def test_every_plan_of_the_fpso_can_be_carried_out(path: Path) -> None:
    job = load(path)
    for i, asked in enumerate(job.plan.cells):
        body, lesson = job.scenarios[i], job.lesson(i)
        assert seeds_of(job.plan, asked).start >= 201
        assert lesson.run.mooring.model == body["model"] == lesson.training["model"], asked.name
        assert lesson.run.clock.sample_time == body["record"]["sample_time"] == lesson.training["record"]["sample_time"]
        assert not lesson.training["faults"]
        assert not lesson.training["traps"]
        assert body["sea"] == lesson.training["sea"]
        assert "fpso_position" not in job.plan.run or not any(c.startswith("tension") for c in lesson.run.channels)
        assert ("misfit" in asked.name) == (body["rig"]["pull"] > 0.0) == ("rig.inertia" in asked.draw)


def test_the_fpso_is_healthy_for_as_many_hours_as_said() -> None:
    job = load(ROOT / "configs/plans/position_false_alarms.toml")
    hours = {}
    for i, c in enumerate(job.plan.cells):
        hours[c.name] = job.scenarios[i]["record"]["duration"] * len(seeds_of(job.plan, c)) * c.repeat / 3600.0
    assert list(hours.values()) == [2208.0, 2208.0, 1380.0, 552.0, 100.0]


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
