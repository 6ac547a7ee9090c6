"""The simulator: its log does what its scenario says, by the laws that it names."""

from __future__ import annotations

from pathlib import Path

import pytest

from mooringdx.simulate import Scenario, load_scenario, simulate

SCENARIOS = Path(__file__).parents[1] / "configs" / "scenarios"


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_scenario_loads_and_runs(path: Path) -> None:
    body = load_scenario(path).model_dump(exclude_unset=True)
    body["record"] = {**body.get("record", {}), "duration": 20.0, "settle": 5.0}
    body["faults"] = [{**fault, "onset": 10.0} for fault in body.get("faults", [])]
    log, truth = simulate(Scenario.model_validate(body), 1)
    assert len(log.signals) >= 3
    assert len(truth["faults"]) == len(body["faults"])
