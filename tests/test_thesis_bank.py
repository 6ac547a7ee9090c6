"""Truth: Bayes by enumeration, sums by hand, a plain-numpy twin, and a bank that must name the line that is lost."""

from __future__ import annotations

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
from mooringdx.simulate.record import stream
from mooringdx.types import Array

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
