"""Scoring adrift or moved: intervals against SciPy's laws, rules by hand, a made site, and the measured one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mooringdx.assess import PLANS, run_plan
from mooringdx.assess.adrift import PlainRule, plain_rule, read_labels
from mooringdx.assess.intervals import binomial, poisson
from mooringdx.errors import ConfigError, LogError

ROOT = Path(__file__).parents[1]
PLAN = ROOT / "configs/plans/tao.toml"
TAO = Path(__file__).parents[2] / "shared" / "data" / "tao"


@pytest.mark.parametrize(("count", "n"), [(0, 36), (1, 36), (6, 6), (17, 40)])
def test_binomial_interval_against_scipy_stats(count: int, n: int) -> None:
    from scipy.stats import binomtest

    truth = binomtest(count, n).proportion_ci(0.95, "exact")
    assert binomial(count, n) == pytest.approx((truth.low, truth.high), abs=1e-10)


def test_poisson_interval_against_the_law_itself() -> None:
    from scipy.stats import poisson as law

    low, high = poisson(5, 2.0)
    assert law.sf(4, 2 * low) == pytest.approx(0.025, abs=1e-9)
    assert law.cdf(5, 2 * high) == pytest.approx(0.025, abs=1e-9)
    assert poisson(0, 10.0)[0] == 0.0
    assert poisson(0, 10.0)[1] == pytest.approx(-np.log(0.025) / 10.0)


def test_plain_rule_and_circle_by_hand() -> None:
    """60 still days, then 5 km a day: beyond 8 km on the second day, three quick moves on the third."""
    day = np.arange(70.0)
    north = np.concatenate([np.zeros(60), 5000.0 * np.arange(1, 11)])
    plain, circle = plain_rule(day, north, np.zeros(70), PlainRule())
    assert np.flatnonzero(circle)[0] == 61
    assert np.flatnonzero(plain)[0] == 62
    step = np.concatenate([np.zeros(60), np.full(10, 20e3)])
    plain, circle = plain_rule(day, step, np.zeros(70), PlainRule())
    assert not plain.any()
    assert np.flatnonzero(circle)[0] == 60


def made_site(folder: Path) -> Path:
    """A site of 300 days: a redeployment on day 100, a break-away on day 200; labelled so."""
    days = 300
    draw = [np.random.default_rng(s).normal(0.0, 0.5, days) for s in np.random.SeedSequence(3).spawn(2)]
    north, east = draw[0].copy(), draw[1].copy()
    north[100:] += 12.0
    east[200:] += 20.0 * np.arange(1, 101)
    dates = np.datetime64("2001-01-01") + np.arange(days)
    rows = [f"{d}T12:00:00Z,{n:.3f},{e:.3f}" for d, n, e in zip(dates, north, east, strict=True)]
    (folder / "site.csv").write_text("\n".join(["time,north_km,east_km", *rows]) + "\n")
    (folder / "events.csv").write_text(
        "site,last_day_inside,first_day_outside,last_day_of_drift_segment,label\n"
        f"site,{dates[99]},{dates[100]},,moved_step_redeployment\n"
        f"site,{dates[199]},{dates[200]},{dates[299]},adrift\n"
    )
    plan = folder / "plan.toml"
    run = (ROOT / "configs/runs/tao.toml").as_posix()
    plan.write_text(
        f'kind = "adrift"\nrun = "{run}"\ntruth = "events.csv"\n[[sites]]\nname = "site"\nlog = "site.csv"\n'
    )
    return plan


def test_a_made_site_is_scored_as_made(tmp_path: Path) -> None:
    text, result = run_plan(made_site(tmp_path), tmp_path / "out", tmp_path)
    (site,) = result["sites"]
    assert site["confusion"]["adrift"]["mooring_lost"]["count"] == 1
    assert site["confusion"]["moved and holding (redeployed)"]["moved"]["count"] == 1
    assert site["redeployed_called_lost"]["count"] == 0
    assert site["other_warnings"]["count"] == 0
    assert site["fixed_circle"]["redeployed"]["count"] == 1
    assert site["plain_rule"]["redeployed"]["count"] == 0
    assert site["buoy_years"] == pytest.approx(300 / 365.25)
    first = {row["label"]: row for row in result["labels"]}
    assert first["adrift"]["warned"] == 0
    assert 1 <= first["adrift"]["not_holding"] <= 3
    assert first["moved_step_redeployment"]["moved"] <= 2
    assert "labels are kinematic" in text
    assert json.loads((tmp_path / "out/assess.json").read_text())["sites"] == json.loads(json.dumps(result["sites"]))
    assert (tmp_path / "out/assess.md").read_text().startswith("# Adrift or moved")
    assert (tmp_path / "out/figures/site.png").read_bytes().startswith(b"\x89PNG")


def test_the_same_plan_gives_the_same_bytes(tmp_path: Path) -> None:
    plan = made_site(tmp_path)
    for name in ("a", "b"):
        run_plan(plan, tmp_path / name, tmp_path)
    first = sorted(p.relative_to(tmp_path / "a") for p in (tmp_path / "a").rglob("*.*"))
    assert len(first) == 3
    for name in first:
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name


def test_an_unlabelled_break_away_is_listed_with_its_track(tmp_path: Path) -> None:
    plan = made_site(tmp_path)
    labels = (tmp_path / "events.csv").read_text().splitlines()
    (tmp_path / "events.csv").write_text("\n".join(labels[:2]) + "\n")
    text, result = run_plan(plan, tmp_path / "out", tmp_path)
    (alarm,) = result["other_failure_alarms"]
    assert "2001-07-20" in alarm["title"]
    assert alarm["title"] in text
    assert (tmp_path / "out/figures/site_alarm_1.png").exists()
    assert result["together"]["other_alarms"]["count"] == 1


def test_wrong_plans_and_labels_are_one_sentence(tmp_path: Path) -> None:
    plan = made_site(tmp_path)
    body = plan.read_text()
    plan.write_text(body.replace('kind = "adrift"', 'kind = "adrfit"'))
    with pytest.raises(ConfigError, match="did you mean 'adrift'"):
        run_plan(plan, tmp_path / "out", tmp_path)
    plan.write_text(body.replace("truth =", "truht ="))
    with pytest.raises(ConfigError, match="did you mean 'truth'"):
        run_plan(plan, tmp_path / "out", tmp_path)
    plan.write_text(body)
    with pytest.raises(LogError, match="--data"):
        read_labels(tmp_path / "none.csv", "site")
    (tmp_path / "events.csv").write_text("site,label\nsite,adrift\n")
    with pytest.raises(LogError, match="not a table of labels"):
        read_labels(tmp_path / "events.csv", "site")
    assert "adrift" in PLANS


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    if not TAO.exists():
        pytest.skip(f"no reference data at {TAO}")
    return run_plan(PLAN, tmp_path_factory.mktemp("tao"), TAO)[1]


@pytest.mark.reference
def test_measured_tracks_meet_what_was_asked(measured: dict[str, Any]) -> None:
    """Truth: the labels of 61.7 buoy-years at two sites, 0n110w tuned on, 0n155w not."""
    both = measured["together"]
    assert both["buoy_years"] == pytest.approx(61.7, abs=0.05)
    assert (both["warning_by_day_1"]["count"], both["warning_by_day_1"]["n"]) == (6, 6)
    assert both["other_warnings"]["per_year"] <= 0.8
    assert both["not_holding_adrift"]["count"] == 6
    assert both["not_holding_days"]["median"] <= 2
    assert both["not_holding_days"]["worst"] <= 4
    assert (both["not_holding_dragged"]["count"], both["dragged_later_held"]["count"]) == (2, 2)
    assert both["redeployed_called_lost"]["n"] == 36
    assert both["redeployed_called_lost"]["count"] <= 1
    assert both["redeployed_moved_by_day_3"]["count"] >= 34
    assert both["other_alarms"]["count"] <= 3
    assert len(measured["other_failure_alarms"]) == both["other_alarms"]["count"]
    assert both["brier_day_2"]["value"] <= 0.03


@pytest.mark.reference
def test_the_site_that_was_not_tuned_on_stands_by_itself(measured: dict[str, Any]) -> None:
    tuned, unseen = measured["sites"]
    assert (tuned["tuned_on"], unseen["tuned_on"]) == (True, False)
    assert unseen["sites"] == ["0n155w"]
    assert unseen["not_holding_adrift"]["count"] == unseen["not_holding_adrift"]["n"] == 1
    assert unseen["redeployed_called_lost"]["count"] == 0
    assert unseen["other_warnings"]["per_year"] <= 0.8
    assert unseen["brier_day_2"]["value"] <= 0.03


@pytest.mark.reference
def test_peers_give_what_is_known_of_them(measured: dict[str, Any]) -> None:
    """The plain rule finds 6 of 6 with a median of two days; the circle calls every redeployment a failure."""
    both = measured["together"]
    assert both["plain_rule"]["adrift"]["count"] == 6
    assert both["plain_rule"]["days"]["median"] == 2
    assert both["plain_rule"]["redeployed"]["count"] == 0
    assert both["fixed_circle"]["redeployed"]["count"] == 36
