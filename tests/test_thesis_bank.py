"""Truth: Bayes by enumeration, sums by hand, a plain-numpy twin, and a bank that must name the line that is lost."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from mooringdx.errors import FitError
from mooringdx.hypotheses.dht import covariance, dht
from mooringdx.hypotheses.mle import mle
from mooringdx.hypotheses.thesis_bank import MEASUREMENT, ThesisBank, own_covariance
from mooringdx.observers.matrices import plant_of
from mooringdx.observers.passive import passive
from mooringdx.physics.rig import mooring_of
from mooringdx.physics.vessel import load_vessel
from mooringdx.reproduce.position_cases import (
    BENCHES,
    CASES,
    Score,
    fit_bank,
    held_from,
    moved,
    said,
    scenario,
    score,
    trial,
)
from mooringdx.reproduce.position_table import Row, claims, table
from mooringdx.reproduce.position_thesis import pages
from mooringdx.simulate.record import stream
from mooringdx.simulate.scenario import Scenario, load_scenario
from mooringdx.types import Array

SCENARIO = Path(__file__).parents[1] / "configs" / "scenarios" / "thesis_none.toml"
VESSEL = Path(__file__).parents[1] / "configs" / "vessels" / "fpso200.toml"


def draws(n: int, h: int) -> tuple[Array, Array]:
    rng = stream(3, "innovations")
    root = rng.standard_normal((h, 3, 3)) + 2.0 * np.eye(3)
    return rng.standard_normal((n, h, 3)), root @ root.transpose(0, 2, 1)


def density(e: Array, s: Array) -> float:
    return float(np.exp(-0.5 * e @ np.linalg.solve(s, e)) / np.sqrt((2.0 * np.pi) ** 3 * np.linalg.det(s)))


def test_dht_is_bayes_by_enumeration() -> None:
    e, s = draws(12, 4)
    joint = np.array([[density(e[k, i], s[i]) for i in range(4)] for k in range(12)]).cumprod(axis=0)
    start = np.array([0.1, 0.2, 0.3, 0.4])
    want = joint * start
    got = dht(e, s, floor=0.0, start=start)
    np.testing.assert_allclose(got, want / want.sum(axis=1, keepdims=True), rtol=1e-10)


def test_dht_floor_and_transition_by_hand() -> None:
    e, s = draws(30, 3)
    pi = np.array([[0.98, 0.01, 0.01], [0.02, 0.97, 0.01], [0.0, 0.0, 1.0]])
    p = np.full(3, 1.0 / 3.0)
    for k in range(30):
        p = pi.T @ p
        p = p * np.array([density(e[k, i], s[i]) ** 0.5 for i in range(3)])
        p = np.maximum(p / p.sum(), 1e-3)
        p = p / p.sum()
    np.testing.assert_allclose(dht(e, s, floor=1e-3, temper=2.0, transition=pi)[-1], p, rtol=1e-9)


def test_dht_survives_innovations_whose_likelihoods_underflow() -> None:
    e = np.zeros((50, 2, 3))
    e[:, 1] = 1e3
    p = dht(e, np.stack([np.eye(3)] * 2))
    np.testing.assert_allclose(p[-1], [1.0, 1e-9], rtol=1e-6)
    e[:, 0], e[:, 1] = 1e3, 0.0
    assert dht(e, np.stack([np.eye(3)] * 2), start=p[-1])[0, 1] > 0.999, "a floor lets it change its mind"


def test_mle_forgets_recursively_and_as_printed_never() -> None:
    e, s = draws(200, 3)
    cost = 0.5 * np.array(
        [[np.log(np.linalg.det(s[i])) + e[k, i] @ np.linalg.solve(s[i], e[k, i]) for i in range(3)] for k in range(200)]
    )
    power = 0.9 ** np.arange(200)[::-1]
    np.testing.assert_allclose(mle(e, s, 0.9)[-1], power @ cost, rtol=1e-9)
    np.testing.assert_allclose(mle(e, s, 0.9, "printed")[-1], 0.9 * cost[:-1].sum(axis=0) + cost[-1], rtol=1e-9)


def test_mle_and_dht_go_on_where_they_stopped() -> None:
    e, s = draws(200, 3)
    cost, p = mle(e, s, 0.9), dht(e, s)
    np.testing.assert_allclose(mle(e[120:], s, 0.9, start=cost[119]), cost[120:], rtol=1e-12)
    np.testing.assert_allclose(dht(e[120:], s, start=p[119]), p[120:], rtol=1e-9)
    e[120] = np.nan
    np.testing.assert_array_equal(mle(e[120:], s, 0.9, start=cost[119])[0], cost[119])


def test_a_gap_changes_nothing() -> None:
    e, s = draws(40, 3)
    gap = np.insert(e, 20, np.nan, axis=0)
    np.testing.assert_array_equal(dht(gap, s)[20], dht(e, s)[19])
    np.testing.assert_array_equal(dht(gap, s)[-1], dht(e, s)[-1])
    np.testing.assert_array_equal(mle(gap, s)[20], mle(e, s)[19])
    np.testing.assert_array_equal(mle(gap, s)[-1], mle(e, s)[-1])


def test_covariance_printed_takes_the_mean_out_and_counts_noise_twice() -> None:
    rng = stream(5, "errors")
    e = rng.standard_normal((4000, 3)) * [1.0, 2.0, 0.1] + [0.0, 3.0, 0.0]
    np.testing.assert_allclose(np.diag(covariance(e, "printed", np.array([1.0, 1.0, 1.0]))), [2, 5, 1.01], rtol=0.1)
    np.testing.assert_allclose(np.diag(covariance(e)), [1, 13, 0.01], rtol=0.1)
    with pytest.raises(FitError, match="9 samples"):
        covariance(e[:9])


def test_the_bank_names_the_line_that_is_missing() -> None:
    """A vessel held by seven lines, moved as its own observer's model says, with noise: no wave, no drift."""
    ship = load_vessel(VESSEL)
    lines, observer = mooring_of(ship), passive(plant_of(ship.dynamics), 0.9)
    rng = stream(1, "bank")
    noise = np.sqrt(MEASUREMENT) * [1.0, 1.0, 0.1] * rng.standard_normal((4000, 3))
    place, zero = np.array([0.0, 0.0, -2.36]), np.zeros((4000, 3))
    covariances = []
    for i in range(9):
        rig = lines.without([f"line_{i + 1}"]) if i < 8 else lines
        thrust = np.tile(-np.array(rig.force(place)), (4000, 1))
        c, s = np.cos(place[2]), np.sin(place[2])
        thrust[:, :2] = thrust[:, :2] @ np.array([[c, -s], [s, c]])
        covariances.append(own_covariance(observer, lines, i, place + noise, thrust, 0.1))
        if i == 5:
            lost = thrust
    bank = ThesisBank(observer, lines, np.array(covariances))
    said = bank(place + noise, lost, 0.1)
    assert bank.hypotheses[int(said.most_probable[-1])] == "line_6"
    assert bank.hypotheses[int(said.most_likely[-1])] == "line_6"
    whole = bank(place + noise, zero, 0.1)
    assert bank.hypotheses[int(whole.most_probable[-1])] == "none"
    np.testing.assert_allclose(said.probability.sum(axis=1), 1.0)


def base() -> Scenario:
    return load_scenario(SCENARIO)


def test_shared_noise_is_one_stream_on_all_axes() -> None:
    """By subtraction: the same seed without noise gives the true place."""
    plan = scenario(base(), CASES[0], duration=400.0)
    quiet = plan.sensors.position.model_copy(update={"noise": 0.0})
    calm = plan.sensors.model_copy(update={"position": quiet, "heading": quiet})
    clean = trial(plan.model_copy(update={"sensors": calm}), 5, shared=True).measured
    noise = trial(plan, 5, shared=True).measured - clean
    np.testing.assert_allclose(noise[:, 0], noise[:, 1], atol=1e-12)
    np.testing.assert_allclose(noise[:, 2], np.radians(0.405) / 0.0707 * noise[:, 0], atol=1e-12)
    own = trial(plan, 5, shared=False).measured - clean
    assert abs(np.corrcoef(own.T) - np.eye(3)).max() < 0.05
    np.testing.assert_allclose(own.std(axis=0), noise.std(axis=0), rtol=0.1)


def test_the_current_pushes_with_the_asked_share_of_a_line_towards_line_8() -> None:
    plan = scenario(base(), CASES[7])
    ship, speed = plan.typed(), plan.current.speed
    drag = ship.dynamics.damping[1] * speed + 0.5 * 1025.0 * 0.8 * 12.0 * 200.0 * speed**2
    one = float(mooring_of(ship).pulls(np.zeros(3))[0][7])
    assert drag == pytest.approx(0.36 * one, rel=1e-9)
    still, pushed = (trial(scenario(base(), c, 600.0), 2, shared=False).true[-1, :2] for c in (CASES[0], CASES[1]))
    towards = (pushed - still) / np.hypot(*(pushed - still))
    np.testing.assert_allclose(towards, [np.sqrt(0.5), -np.sqrt(0.5)], atol=0.1)


def test_a_trial_starts_where_the_thesis_starts_and_goes_away_from_the_lost_line() -> None:
    record = trial(scenario(base(), CASES[4], duration=500.0), 1, shared=False)
    np.testing.assert_allclose(record.true[0], [2.0, 2.0, np.radians(-135.0)])
    np.testing.assert_allclose(record.true[2900, :2], 0.0, atol=1.5)
    assert (record.true[-1, :2] > 5.0).all(), "line 7 lies south-west"
    far, left = moved(record, 300.0)
    assert far == pytest.approx(float(np.hypot(*(record.true[-1] - record.true[3000])[:2])), rel=0.05)
    assert 0.9 < left <= 1.0
    assert moved(record, 500.0) == (0.0, 0.0)


def test_delay_and_shares_by_hand() -> None:
    right = np.zeros(1000, dtype=bool)
    right[100:250] = True
    right[400:] = True
    assert held_from(right, 0.1) == 400
    assert held_from(right, 0.1, hold=15.0) == 100
    assert held_from(right[:390], 0.1) is None
    time = 0.1 * np.arange(10000)
    choice = np.where(time < 420.0, 8, 5)
    choice[1500:1600] = 5
    bank = ThesisBank(passive(plant_of(base().typed().dynamics), 0.9), mooring_of(base().typed()), np.zeros((9, 3, 3)))
    got = score(bank, choice, CASES[2], time)
    assert got.delay == pytest.approx(20.0)
    assert got.before == pytest.approx(1.0 - 10.0 / 300.0)
    assert got.late == 1.0
    none = score(bank, choice, CASES[0], time)
    assert none.switches == pytest.approx(3.0)
    assert none.settled == 0.0


@pytest.fixture(scope="module")
def short() -> ThesisBank:
    return fit_bank(base(), BENCHES[0], 1, duration=1500.0)


def test_a_bank_of_short_records_finds_line_6(short: ThesisBank) -> None:
    record = trial(scenario(base(), CASES[2]), 3, shared=True)
    weighed = said(short, record)
    for choice in (weighed.most_probable, weighed.most_likely):
        got = score(short, choice, CASES[2], record.time)
        assert got.delay is not None
        assert got.delay < 90.0
        assert got.before > 0.9


def test_the_page_shows_every_number_of_its_table(short: ThesisBank) -> None:
    """Made-up scores: each must stand in the page and in the JSON, and the verdicts must follow from them."""
    rows = []
    for b, bench in enumerate(BENCHES):
        for c, case in enumerate(CASES):
            found = {m: tuple(Score(10.0 * b + c + k, 0.9, 0.8, 7.0, 3.0) for k in range(3)) for m in ("dht", "mle")}
            rows.append(Row(case, bench, found, 5.0, 0.7))
    made = pages(base(), rows, short, claims(rows), 1)
    text, body = made["index.html"].decode(), json.loads(made["claims.json"])
    assert text.count("45 s (3 of 3); right 90 % before, 80 % late") == 2
    assert [r["dht"]["delay"] for r in body["table"] if r["case"] == "line 7"] == [5.0, 15.0, 25.0, 35.0, 45.0]
    verdict = {c["paper"][:24]: c["verdict"] for c in body["claims"]}
    assert len(verdict) == 9
    assert verdict["Detection usually occurs"] == "holds"
    assert verdict["Both methods quickly con"] == "does not hold"
    assert sum(name.endswith(".png") for name in made) == 6
    assert made == pages(base(), rows, short, claims(rows), 1), "same input, same bytes"


@pytest.mark.slow
def test_independent_noise_with_old_covariances_breaks_the_bank() -> None:
    """The thesis, section 6.3: the finding that voids its results, on this twin."""
    found, _ = table(base(), 2, records=2)
    old, new = (
        next(r.mean("dht", "before") for r in found if r.bench is BENCHES[b] and r.case.name == "none + current")
        for b in (1, 0)
    )
    assert old < 0.5 < new
