"""Truth: two Gaussian hypotheses, whose error rate and index are known in closed form, and seeded draws of them."""

import numpy as np
import pytest
from scipy.stats import binomtest, norm

from mooringdx import cause

COVARIANCE = np.array([[4.0, 1.0, 0.2], [1.0, 3.0, -0.5], [0.2, -0.5, 2.0]])
TOWARD = np.array([0.8, -0.6, 0.3])
EXACT = np.zeros(3)


def judged(size, truth, rng, error=EXACT):
    """Return the judgement of one draw: ``truth`` +1 a line, -1 its sensor, 0 the environment across it."""
    line, sensor = 0.5 * size * TOWARD, -0.5 * size * TOWARD
    across = np.array([6.0, 8.0, 0.0]) * 2.0 if truth == 0 else np.zeros(3)
    mean = across if truth == 0 else line if truth > 0 else sensor
    change = rng.multivariate_normal(mean, COVARIANCE)
    return cause.judge(change, COVARIANCE, line, sensor, error)


def test_index_is_the_deflection_of_the_two_hypotheses():
    size = 7.0
    found = cause.judge(np.zeros(3), COVARIANCE, 0.5 * size * TOWARD, -0.5 * size * TOWARD, EXACT)
    assert found.index == pytest.approx(size * np.sqrt(TOWARD @ np.linalg.solve(COVARIANCE, TOWARD)), rel=1e-12)
    assert found.probability == pytest.approx(norm.cdf(found.index / 2.0))
    assert found.score == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("index", [3.3, 4.0, 5.0])
def test_share_right_is_the_printed_probability(index):
    rng = np.random.default_rng(3)
    size = index / np.sqrt(TOWARD @ np.linalg.solve(COVARIANCE, TOWARD))
    scores = np.array([judged(size, t, rng).score * t for t in (1, -1) for _ in range(2000)])
    right = int((scores > 0).sum())
    low, high = binomtest(right, scores.size).proportion_ci(0.999)
    assert low <= norm.cdf(index / 2.0) <= high


def test_below_the_least_index_no_cause_is_named():
    rng = np.random.default_rng(4)
    size = 2.9 / np.sqrt(TOWARD @ np.linalg.solve(COVARIANCE, TOWARD))
    assert {judged(size, t, rng).verdict for t in (1, -1) for _ in range(50)} == {"untold"}


def test_the_gate_trips_for_one_in_a_hundred_and_for_a_force_across_the_line():
    rng = np.random.default_rng(5)
    size = 6.0 / np.sqrt(TOWARD @ np.linalg.solve(COVARIANCE, TOWARD))
    trips = sum(judged(size, t, rng).gate > 1.0 for t in (1, -1) for _ in range(2000))
    low, high = binomtest(trips, 4000).proportion_ci(0.999)
    assert low <= 0.01 <= high
    assert all(judged(size, 0, rng).verdict == "untold" for _ in range(20))


def test_learned_covariance_is_that_of_the_means():
    rng = np.random.default_rng(6)
    window, settle, n = 40, 10, 60_000
    noise = rng.multivariate_normal(np.zeros(3), COVARIANCE, n)
    found = cause.learn([(noise, np.ones(noise.shape, bool))], window, settle)
    expected = 2.0 * COVARIANCE / window
    assert np.allclose(found.near, expected, rtol=0.15, atol=0.15 * expected.max())
    assert np.allclose(found.far, expected, rtol=0.15, atol=0.15 * expected.max())
    holes = np.ones(noise.shape, bool)
    holes[1000:2000] = False
    assert np.all(np.isfinite(cause.learn([(noise, holes)], window, settle).near))
    assert cause.learn([(noise[:100], np.ones((100, 3), bool))], window, settle) is None
