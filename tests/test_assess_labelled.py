"""Truth: measured flume runs with real sensor faults, labelled by the redundancy of two gauges and a camera."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from mooringdx.assess import run_plan
from mooringdx.assess.labelled import Expected
from mooringdx.types import Event, Rival

ROOT = Path(__file__).parents[1]
FLUME = ROOT.parent / "shared/data/flume"


def event(subject: str, *rivals: str, detected: float = 10.0) -> Event:
    others = tuple(Rival("sensor_fault", r, 0.4, "") for r in rivals)
    return Event("sensor_fault", subject, 9.0, (8.0, 10.0), detected, mode="bias", size=1.9, rivals=others)


def test_an_expected_event_is_met_only_by_the_right_name_in_time() -> None:
    asked = Expected("tension_SB", rivals=("tension_PS",), onset=9.0, within=2.0)
    assert asked.met_by(event("tension_SB"))
    assert asked.met_by(event("tension_SB", "tension_PS"))
    assert not asked.met_by(event("tension_PS", "tension_SB"))
    assert not asked.met_by(event("tension_SB", "camera"))
    assert not asked.met_by(event("tension_SB", detected=11.5))
    assert not Expected("tension_SB", mode="stuck").met_by(event("tension_SB"))
    assert Expected("tension_SB", size=1.8, size_within=0.2).met_by(event("tension_SB"))
    assert not Expected("tension_SB", size=1.6, size_within=0.2).met_by(event("tension_SB"))


@pytest.mark.reference
def test_the_flume_runs_are_all_right_and_every_bias_is_found_and_named(tmp_path: Path) -> None:
    text = (ROOT / "configs/plans/flume.toml").read_text().split("[[variants]]")[0]
    runs = (ROOT / "configs/runs").as_posix()
    (tmp_path / "plan.toml").write_text(text.replace("../runs", runs))
    printed, result = run_plan(tmp_path / "plan.toml", tmp_path / "out", FLUME)
    (only,) = result["variants"]
    assert len(only["logs"]) == 10
    assert [row["log"] for row in only["logs"] if not row["right"]] == []
    assert len(only["injected"]) == 20
    for row in only["injected"]:
        assert row["found"], row
        assert row["named_alone"], row
        assert row["before"] == 0, row
    assert "20 of 20 (95 %: 0.83 to 1.00)" in printed
    assert json.loads((tmp_path / "out/assess.json").read_text())[0]["variant"] == "as configured"
