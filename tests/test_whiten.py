"""Whitening filter, compression, whiteness. Truth: scipy's filter, quadrature for N(0, 1), statsmodels, analytic."""

from __future__ import annotations

import json
from collections.abc import Callable

import numpy as np
import pytest
from colours import arma64, simulate
from scipy.integrate import quad
from scipy.signal import lfilter
from scipy.stats import norm

from mooringdx.config import Compression
from mooringdx.errors import FitError
from mooringdx.types import Fault, Grid, Residuals, Signatures
from mooringdx.whiten import (
    KINDS,
    Arma,
    Whitener,
    autocorrelation,
    compressed,
    fit_compression,
    fit_whitener,
    fixed_point,
    settling,
    whiteness,
)
from mooringdx.whiten.whitener import start_responses, whitened_column

N = 8000


def residuals(values: np.ndarray, valid: np.ndarray | None = None) -> Residuals:
    names = tuple(f"r{i}" for i in range(values.shape[1]))
    faults = (Fault("line_lost", "line_1"), Fault("sensor_fault", "tension_1", "bias"))
    matrix = np.arange(1.0, 2 * len(names) + 1).reshape(2, -1)
    signatures = Signatures(faults, names, matrix, ("N", "N"), np.full(2, np.nan), np.zeros(2))
    there = np.isfinite(values) if valid is None else valid
    return Residuals(names, ("N",) * len(names), Grid(0.0, 0.1, len(values)), values, there, signatures)


@pytest.fixture(scope="module")
def healthy() -> Residuals:
    ar, ma = arma64(1.5, 0.1)
    rng = np.random.default_rng(0)
    return residuals(np.stack([simulate(ar, ma, N, rng) * s + m for s, m in ((1.0, 3.0), (0.01, -2.0))], axis=1))


@pytest.fixture(scope="module")
def fitted(healthy: Residuals) -> dict[str, Whitener]:
    plain = fit_whitener([(healthy, slice(0, N))], "arma", (6, 4), peak_period=1.5)
    return {
        "none": fit_whitener([(healthy, slice(0, N))], "none"),
        "arma": plain,
        "arma+compression": compressed(plain, [(healthy, slice(0, N))]),
    }


@pytest.mark.parametrize("gaps", [[], [(100, 101), (140, 600), (1500, 1502)]])
def test_filter_equals_scipy_run_by_run(gaps: list[tuple[int, int]]) -> None:
    ar, ma = arma64(1.5, 0.1)
    values = simulate(ar, ma, 3000, np.random.default_rng(1))
    valid = np.ones(3000, bool)
    for a, b in gaps:
        valid[a:b] = False
    got, ok = whitened_column(np.where(valid, values, 0.0), valid, ar, ma, 2.0, 50)
    want = np.full(3000, np.nan)
    edges = np.flatnonzero(np.diff(valid.astype(int), prepend=0, append=0))
    for a, b in zip(edges[::2], edges[1::2], strict=True):
        if b - a > 50:
            numerator = np.convolve(values[a:b], np.r_[1.0, ar])[6 : b - a]
            zero = lfilter([1.0], np.r_[1.0, ma], numerator)  # as if the innovations before were zero
            unit = past_responses(ma, len(zero))  # and what each of them does
            prior = np.vstack([unit[:44], np.eye(4)])
            past = np.linalg.lstsq(prior, np.r_[-zero[:44], np.zeros(4)])[0]
            want[a + 50 : b] = 2.0 * (zero + unit @ past)[44:]
    np.testing.assert_allclose(got, want, atol=1e-9 * np.nanmax(np.abs(want)))
    np.testing.assert_array_equal(ok, np.isfinite(want))


def past_responses(ma: np.ndarray, n: int) -> np.ndarray:
    """Return (n, q) by scipy: what unit innovations before the start do through 1/C, newest first."""
    q, out = len(ma), []
    for unknown in range(q):
        past = np.zeros(q)
        past[unknown] = 1.0  # lfilter's own order: newest first
        state = -np.array([sum(ma[j] * past[j - m] for j in range(m, q)) for m in range(q)])
        out.append(lfilter([1.0], np.r_[1.0, ma], np.zeros(n), zi=state)[0])
    return np.column_stack(out)


def test_settled_output_is_the_innovation_to_three_percent() -> None:
    """What generated the record is known: after `settling` samples the error's sd is 3 % of the innovation's."""
    ar, ma = arma64(1.5, 0.1)
    model = Arma(ar, ma, 0.0, 1.0)
    wait = settling(model)
    rng, error, blind = np.random.default_rng(2), [], []
    for _ in range(200):
        e = rng.standard_normal(wait + 2000)
        y = lfilter(np.r_[1.0, ma], np.r_[1.0, ar], e)[1900:]
        z, ok = whitened_column(y, np.ones(len(y), bool), ar, ma, 1.0, wait)
        assert ok[wait]
        assert not ok[wait - 1]
        error.append(z[wait] - e[1900 + wait])
        numerator = np.convolve(y, np.r_[1.0, ar])[6 : len(y)]
        blind.append(lfilter([1.0], np.r_[1.0, ma], numerator)[wait - 6] - e[1900 + wait])
    assert np.std(error) < 0.035
    assert np.std(error) < np.std(blind)
    assert settling(model, 30) == 30


def test_a_root_near_the_circle_does_not_haunt_the_start() -> None:
    """With 1/C ringing for 500 samples, the error after 304 is what the estimate leaves, not what zeros leave."""
    ma, ar = np.array([-0.998]), np.array([-0.9])
    rng, error, blind = np.random.default_rng(3), [], []
    for _ in range(200):
        e = rng.standard_normal(3000)
        y = lfilter(np.r_[1.0, ma], np.r_[1.0, ar], e)[2000:]
        z, _ = whitened_column(y, np.ones(len(y), bool), ar, ma, 1.0, 304)
        error.append(np.mean(z[304:456] - e[2304:2456]))
        numerator = np.convolve(y, np.r_[1.0, ar])[1 : len(y)]
        blind.append(np.mean(lfilter([1.0], np.r_[1.0, ma], numerator)[303:455] - e[2304:2456]))
    assert np.std(blind) > 0.4
    assert np.std(error) < 0.07


def test_start_responses_equal_scipy() -> None:
    ma = arma64(1.5, 0.1)[1]
    np.testing.assert_allclose(start_responses(ma, 80), past_responses(ma, 80), atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_contract(kind: str, healthy: Residuals, fitted: dict[str, Whitener]) -> None:
    whitener = fitted[kind]
    values, valid = healthy.values.copy(), healthy.valid.copy()
    values[2000:2010, 0] = np.nan
    valid[4000, 1] = False
    holed = residuals(values, valid)
    kept = values.copy()
    z = whitener(holed)
    np.testing.assert_array_equal(holed.values, kept)
    np.testing.assert_array_equal(np.isfinite(z.values), z.valid)
    assert not z.valid[2000:2010, 0].any()
    assert not z.valid[4000, 1]
    assert z.valid[-1].all()
    prefix = whitener(residuals(values[:5000], valid[:5000]))
    np.testing.assert_array_equal(prefix.values, z.values[:5000])
    if kind != "none":
        assert not z.valid[2010 : 2010 + whitener.settle[0], 0].any()
        assert z.valid[2010 + whitener.settle[0], 0]
    back = Whitener.from_dict(json.loads(json.dumps(whitener.to_dict())))
    np.testing.assert_array_equal(back(holed).values, z.values)
    assert back.to_dict() == whitener.to_dict()
    spread = np.nanstd(z.values, axis=0)
    np.testing.assert_allclose(spread, 0.536 if kind == "arma+compression" else 1.0, rtol=0.02)


@pytest.mark.parametrize("kind", KINDS)
def test_small_step_becomes_the_mapped_signature(kind: str, healthy: Residuals, fitted: dict[str, Whitener]) -> None:
    """A step of 0.5 settled whitened units on both residuals; the mean output moves by size x signature."""
    whitener = fitted[kind]
    plain = whitener.uncompressed()
    size = 0.5 / plain.gain
    unit = Signatures(
        (Fault("line_lost", "line_1"),), healthy.names, size[None, :], ("N",), np.full(1, np.nan), np.zeros(1)
    )
    before, after = whitener(healthy).values, whitener(residuals(healthy.values + size)).values
    moved = np.nanmean(after[1000:] - before[1000:], axis=0)
    np.testing.assert_allclose(moved, whitener.mapped(unit).matrix[0], rtol=0.08 if whitener.compression else 1e-9)
    if kind != "none":
        step = np.where(np.arange(N) >= 4000, 1.0, 0.0)[:, None] * size
        answer = plain(residuals(healthy.values + step)).values - plain(healthy).values
        np.testing.assert_allclose(answer[4000:4300], plain.step_response(300) * size, atol=1e-9)


def test_start_keeps_the_orders_and_other_names_are_refused(healthy: Residuals, fitted: dict[str, Whitener]) -> None:
    again = fit_whitener([(healthy, slice(0, 6000))], start=fitted["arma"])
    assert [m.order for m in again.models] == [(6, 4), (6, 4)]
    assert again.models[0].n == 6000 - 256
    with pytest.raises(FitError, match="got r0"):
        fitted["arma"](residuals(healthy.values[:, :1]))
    with pytest.raises(FitError, match="residual r1: the no-fault samples are constant"):
        fit_whitener([(residuals(np.stack([healthy.values[:, 0], np.full(N, 2.0)], 1)), slice(0, N))])


def gaussian(f: Callable[[float, float], float], k: float, s: float) -> float:
    """Expectation of f(|x|) over N(0, 1) by quadrature; f is given x and the knee k s."""
    return 2.0 * float(quad(lambda x: f(x, k * s) * norm.pdf(x), 0.0, 12.0)[0])


def test_fixed_point_of_the_normal_law() -> None:
    """N(0, 1), k = 3, against quadrature: s 0.536, bound 1.61, slope 0.525, efficiency 0.957, kurtosis -1.23."""
    x = norm.ppf((np.arange(400_000) + 0.5) / 400_000)
    law = fit_compression([x], "fang", 3.0)
    s = float(law.scale[0])
    assert abs(s - 0.536) < 5e-4
    assert abs(float(law.bound[0]) - 1.61) < 5e-3
    assert abs(float(law.slope[0]) - 0.525) < 5e-4
    variance = gaussian(lambda u, b: (u / (1 + u / b)) ** 2, 3.0, s)
    slope = gaussian(lambda u, b: (1 + u / b) ** -2, 3.0, s)
    np.testing.assert_allclose(variance, s**2, rtol=1e-4)
    np.testing.assert_allclose(law.slope[0], slope, rtol=1e-4)
    assert abs(slope**2 / variance - 0.957) < 5e-4
    z = law(x)
    assert np.abs(z).max() < law.bound[0]
    assert abs(np.mean(z**4) / np.mean(z**2) ** 2 - 3.0 + 1.23) < 0.01


@pytest.mark.parametrize("k", [1.05, 1.5, 3.0, 10.0])
def test_fixed_point_equals_the_plain_iteration(k: float) -> None:
    x = np.random.default_rng(3).standard_t(4, 3000)
    s = float(x.std())
    for _ in range(4000):
        s = float((x / (1 + np.abs(x) / (k * s))).std())
    np.testing.assert_allclose(fixed_point(x, k), s, rtol=1e-6)


def test_no_fixed_point_below_its_existence_limit() -> None:
    x = np.random.default_rng(4).standard_normal(1000)
    with pytest.raises(FitError, match="raise k"):
        fixed_point(x, 1.0 / float(np.sign(x).std()) - 1e-6)
    with pytest.raises(FitError, match="raise k"):
        fixed_point(np.abs(x), 3.0)


def test_huber_clip_of_the_normal_law() -> None:
    x = norm.ppf((np.arange(100_000) + 0.5) / 100_000)
    law = fit_compression([x], "huber", 3.0)
    np.testing.assert_allclose(law.scale, 1.0, rtol=1e-4)
    np.testing.assert_allclose(law.slope, norm.cdf(3.0) - norm.cdf(-3.0), atol=1e-4)
    np.testing.assert_array_equal(law(x), np.clip(x, -law.bound, law.bound))


def test_compression_of_the_run_file_is_taken(healthy: Residuals, fitted: dict[str, Whitener]) -> None:
    pieces = [(healthy, slice(0, N))]
    law = compressed(fitted["arma"], pieces, Compression(kind="huber", k=2.0)).compression
    assert law is not None
    assert (law.kind, law.k) == ("huber", 2.0)
    assert compressed(fitted["arma"], pieces, Compression(kind="none")) is fitted["arma"]


def test_whitening_whitens_the_wave_colour(healthy: Residuals, fitted: dict[str, Whitener]) -> None:
    before = whiteness([healthy.values[:, 0]], lags=30)
    after = whiteness([fitted["arma"](healthy).values[:, 0]], lags=30)
    assert before.ljung_box > 1.0
    assert before.max_acf > 0.8
    assert after.ljung_box < 0.01
    assert after.max_acf < 0.05
    assert 0.4 < after.window_ratio < 2.0


def test_autocorrelation_equals_direct_sums() -> None:
    rng = np.random.default_rng(5)
    x = rng.standard_normal(500)
    y = x - x.mean()
    want = np.array([y[: 500 - lag] @ y[lag:] for lag in range(41)]) / (y @ y)
    np.testing.assert_allclose(autocorrelation([x], 40), want, atol=1e-9)
    x[100:130] = np.nan
    two = [x[:300], x[300:]]
    there = [np.isfinite(s) for s in two]
    mean = np.nanmean(x)
    sums = np.zeros(41)
    pairs = np.zeros(41)
    for s, ok in zip(two, there, strict=True):
        c = np.where(ok, s - mean, 0.0)
        for lag in range(41):
            sums[lag] += c[: len(c) - lag] @ c[lag:]
            pairs[lag] += (ok[: len(c) - lag] & ok[lag:]).sum()
    n = sum(ok.sum() for ok in there)
    want = sums * (n - np.arange(41)) / pairs / sums[0]
    np.testing.assert_allclose(autocorrelation(two, 40), want, atol=1e-9)


def test_ljung_box_equals_statsmodels() -> None:
    from statsmodels.stats.diagnostic import acorr_ljungbox

    x = simulate(np.array([-0.2]), np.zeros(0), 1500, np.random.default_rng(6))
    got = whiteness([x], lags=20, window=50)
    want = acorr_ljungbox(x, lags=[20])
    np.testing.assert_allclose(got.ljung_box * 1500, want["lb_stat"].iloc[0], rtol=1e-9)
    np.testing.assert_allclose(got.p_value, want["lb_pvalue"].iloc[0], rtol=1e-9)


def test_window_ratio_and_kurtosis_are_those_of_the_law() -> None:
    """AR(1) with coefficient 0.5: M var(mean)/var tends to (1 + a)/(1 - a) = 3; uniform noise has kurtosis -1.2."""
    rng = np.random.default_rng(7)
    x = simulate(np.array([-0.5]), np.zeros(0), 400_000, rng)
    np.testing.assert_allclose(whiteness([x], window=200).window_ratio, 3.0 - 4.0 / 200, rtol=0.1)
    np.testing.assert_allclose(whiteness([rng.uniform(size=200_000)]).excess_kurtosis, -1.2, atol=0.02)
