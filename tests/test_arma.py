"""ARMA identification. Truth: scipy, central differences, known coefficients, statsmodels' exact likelihood."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from colours import arma64, simulate
from scipy.signal import lfilter

from mooringdx.errors import FitError
from mooringdx.whiten import ORDERS, Arma, fit_arma, step_response
from mooringdx.whiten.search import inside, projected
from mooringdx.whiten.squares import Runs, conditional_squares, lagged_gram

AR42 = np.real(np.poly([0.9 * np.exp(0.6j), 0.9 * np.exp(-0.6j), 0.7 * np.exp(1.8j), 0.7 * np.exp(-1.8j)]))[1:]
MA42 = np.real(np.poly([0.6 * np.exp(2.5j), 0.6 * np.exp(-2.5j)]))[1:]


def runs_of(*pieces: np.ndarray, drop: int) -> Runs:
    length = np.array([len(x) for x in pieces])
    stop = np.cumsum(length)
    drops = np.full(len(pieces), drop)
    return Runs(np.concatenate(pieces), stop - length, stop, drops, int((length - drops).sum()))


def innovations_by_scipy(y: np.ndarray, ar: np.ndarray, ma: np.ndarray) -> np.ndarray:
    """The conditional innovations: F r from the p-th sample on, divided by C from rest."""
    numerator = np.convolve(y, np.r_[1.0, ar])[len(ar) : len(y)]
    return np.r_[np.zeros(len(ar)), lfilter([1.0], np.r_[1.0, ma], numerator)]


@pytest.mark.parametrize(("p", "q"), [(1, 0), (2, 1), (4, 2), (6, 4), (10, 8)])
def test_sum_gradient_and_gram_equal_scipy(p: int, q: int) -> None:
    rng = np.random.default_rng(p)
    ar = projected(p, rng.normal(0, 0.4, p + q))[:p]
    ma = projected(p, rng.normal(0, 0.4, p + q))[p:]
    pieces = [rng.standard_normal(n) for n in (700, 301, 128 + p)]
    drop = p + 13
    squares, columns, scored = 0.0, [], []
    for y in pieces:
        e = innovations_by_scipy(y, ar, ma)
        divide = np.r_[1.0, ma]
        jac = [np.r_[np.zeros(p), lfilter([1.0], divide, y[p - i : len(y) - i])] for i in range(1, p + 1)]
        w = lfilter([1.0], divide, -e)
        jac += [np.r_[np.zeros(j), w[: len(y) - j]] for j in range(1, q + 1)]
        columns.append(np.array(jac)[:, drop:])
        scored.append(e[drop:])
        squares += float(e[drop:] @ e[drop:])
    jacobian, e = np.concatenate(columns, axis=1), np.concatenate(scored)
    runs = runs_of(*pieces, drop=drop)
    got = conditional_squares(runs.values, runs.start, runs.stop, runs.drop, ar, ma)
    np.testing.assert_allclose(got[0], squares, rtol=1e-9)
    np.testing.assert_allclose(got[1], jacobian @ e, rtol=1e-9, atol=1e-9 * np.abs(jacobian @ e).max())
    np.testing.assert_allclose(got[2], jacobian @ jacobian.T, rtol=1e-9, atol=1e-9 * np.abs(got[2]).max())


def test_gradient_equals_central_differences() -> None:
    rng = np.random.default_rng(3)
    y = simulate(AR42, MA42, 900, rng)
    runs = runs_of(y[:500], y[500:], drop=20)
    theta = np.r_[AR42, MA42] + rng.normal(0, 0.01, 6)

    def squares(x: np.ndarray) -> float:
        return float(conditional_squares(runs.values, runs.start, runs.stop, runs.drop, x[:4], x[4:])[0])

    slope = conditional_squares(runs.values, runs.start, runs.stop, runs.drop, theta[:4], theta[4:])[1]
    step = 1e-6 * np.eye(6)
    numeric = [(squares(theta + d) - squares(theta - d)) / 2e-6 for d in step]
    np.testing.assert_allclose(2.0 * slope, numeric, rtol=1e-5, atol=1e-4)


def test_lagged_gram_equals_the_product_of_the_lagged_matrix() -> None:
    rng = np.random.default_rng(4)
    pieces = [np.cumsum(rng.standard_normal(n)) for n in (200, 90, 12)]
    lags = 12
    want = np.zeros((lags + 1, lags + 1))
    for y in pieces:
        if len(y) > lags:
            x = np.stack([y[lags - i : len(y) - i] for i in range(lags + 1)])
            want += x @ x.T
    runs = runs_of(*pieces, drop=0)
    np.testing.assert_allclose(lagged_gram(runs.values, runs.start, runs.stop, lags), want, rtol=1e-9)


def test_inside_agrees_with_the_roots() -> None:
    rng = np.random.default_rng(5)
    seen = set()
    for _ in range(500):
        n = int(rng.integers(1, 9))
        coefficients = rng.normal(0, 0.6, n)
        largest = float(np.abs(np.roots(np.r_[1.0, coefficients])).max())
        if abs(largest - 0.998) > 1e-6:
            seen.add(largest < 0.998)
            assert inside(coefficients, 0.998) == (largest < 0.998)
    assert seen == {True, False}


def test_reflection_keeps_the_shape_of_the_spectrum() -> None:
    ma = np.real(np.poly([1.25, 0.5]))[1:]
    fixed = projected(0, ma)
    np.testing.assert_allclose(np.sort(np.roots(np.r_[1.0, fixed])), [0.5, 0.8], rtol=1e-12)
    z = np.exp(-1j * np.linspace(0, np.pi, 50))
    ratio = np.abs(np.polyval(np.r_[1.0, ma][::-1], z)) / np.abs(np.polyval(np.r_[1.0, fixed][::-1], z))
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-12)


@pytest.mark.slow
def test_known_coefficients_of_arma42_come_back() -> None:
    outside = 0
    for seed in range(20):
        model = fit_arma([simulate(AR42, MA42, 10_000, np.random.default_rng(seed))], (4, 2))
        error = np.r_[model.ar - AR42, model.ma - MA42] / model.standard_errors
        outside += int((np.abs(error) > 3.0).sum())
    assert outside <= 2


def test_standard_errors_are_those_of_the_fisher_matrix() -> None:
    """AR(1): the variance of the coefficient is (1 - a^2)/n, analytic."""
    model = fit_arma([simulate(np.array([-0.8]), np.zeros(0), 40_000, np.random.default_rng(1))], (1, 0))
    np.testing.assert_allclose(model.standard_errors[0], np.sqrt((1 - 0.64) / 40_000), rtol=0.03)
    assert abs(model.ar[0] + 0.8) < 4 * model.standard_errors[0]
    np.testing.assert_allclose(model.sd, 1.0, rtol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ar", "ma", "n"),
    [(AR42, MA42, 3000), (*arma64(1.5, 0.1), 5000), (*arma64(9.0, 1.0), 3000)],
    ids=["42", "wave", "1Hz"],
)
def test_likelihood_against_statsmodels_optimum_from_ours(ar: np.ndarray, ma: np.ndarray, n: int) -> None:
    from statsmodels.tsa.arima.estimators.innovations import innovations_mle
    from statsmodels.tsa.innovations.arma_innovations import arma_innovations

    record = simulate(ar, ma, n, np.random.default_rng(11))
    k = np.arange(n)
    record = record - np.polyval(np.polyfit(k, record, 1), k)
    model = fit_arma([record], (len(ar), len(ma)))

    def exact(a: np.ndarray, c: np.ndarray) -> float:
        e, v = arma_innovations(record, -a, c.copy(), sigma2=1.0)
        return float(-0.5 * (n * np.log(2 * np.pi * np.mean(e**2 / v)) + np.sum(np.log(v)) + n))

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        given = np.r_[-model.ar, model.ma, model.sd**2]
        order = (len(ar), 0, len(ma))
        found, _ = innovations_mle(record, order=order, demean=False, start_params=given, enforce_invertibility=False)
    behind = exact(-found.ar_params, found.ma_params) - exact(model.ar, model.ma)
    assert behind <= 0.5


def test_wave_colour_is_found_by_bic_and_leaves_the_side_valley() -> None:
    """Seed 102 is one on which the regressions end with a pair idling at the highest frequency (35 units lower)."""
    ar, ma = arma64(1.5, 0.1)
    record = simulate(ar, ma, 10_000, np.random.default_rng(102))
    fitted = fit_arma([record], (6, 4))
    true = fit_arma([record], (6, 4), start=Arma(ar, ma, 0.0, 1.0))
    assert fitted.loglik > true.loglik - 0.1
    best = fit_arma([record])
    assert best.order == (6, 4)
    assert best.bic <= fitted.bic + 0.5


def test_scale_shift_and_trend_change_only_what_they_should() -> None:
    record = simulate(AR42, MA42, 3000, np.random.default_rng(6))
    a = fit_arma([record], (4, 2))
    b = fit_arma([1e-6 * record + 5.0 + 1e-9 * np.arange(3000)], (4, 2))
    np.testing.assert_allclose(b.ar, a.ar, atol=1e-6)
    np.testing.assert_allclose(b.sd, 1e-6 * a.sd, rtol=1e-6)
    np.testing.assert_allclose(b.mean, (1e-6 * record + 5.0 + 1e-9 * np.arange(3000)).mean(), rtol=1e-12)


def test_pieces_split_by_gaps_give_about_the_same_as_the_whole() -> None:
    record = simulate(AR42, MA42, 20_000, np.random.default_rng(7))
    holed = record.copy()
    holed[5000:5100] = np.nan
    holed[12_345] = np.nan
    kept = holed.copy()
    whole, split = fit_arma([record], (4, 2)), fit_arma([holed[:15_000], holed[15_000:]], (4, 2))
    assert np.all(np.abs(split.ar - whole.ar) < whole.standard_errors[:4])
    assert split.n < whole.n
    np.testing.assert_array_equal(holed, kept)


def test_long_record_is_ordered_on_a_stretch_and_refitted_on_all() -> None:
    model = fit_arma([simulate(AR42, MA42, 150_000, np.random.default_rng(8))], (4, 2))
    assert model.n == 150_000 - 256
    assert np.all(np.abs(model.ar - AR42) < 4 * model.standard_errors[:4])


def test_short_record_is_given_fewer_orders() -> None:
    model = fit_arma([simulate(AR42, MA42, 250, np.random.default_rng(9))])
    assert model.order in ORDERS[:4]


@pytest.mark.parametrize(
    ("record", "order", "words"),
    [
        (np.full(5000, 3.7), "bic", "constant"),
        (np.full(5000, np.nan), "bic", "too few"),
        (np.random.default_rng(0).standard_normal(40), (4, 2), "too few"),
        (np.sin(0.3 * np.arange(5000)), "bic", "last digit"),
        (np.random.default_rng(0).standard_normal(4000), (10, 9), "not allowed"),
    ],
)
def test_refusals_name_the_remedy(record: np.ndarray, order: object, words: str) -> None:
    with pytest.raises(FitError, match=words):
        fit_arma([record], order)


def test_step_response_equals_scipy_and_settles_at_the_dc_gain() -> None:
    model = Arma(*arma64(1.5, 0.1), mean=0.0, sd=1.0)
    want = lfilter(np.r_[1.0, model.ar], np.r_[1.0, model.ma], np.ones(2000))
    got = step_response(model, 2000)
    np.testing.assert_allclose(got, want, atol=1e-9)
    np.testing.assert_allclose(got[-1], model.dc_gain, atol=1e-6)
