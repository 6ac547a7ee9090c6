"""Levels against the theory of Gaussian noise, brute force, and counted rates."""

from __future__ import annotations

import numpy as np
import pytest
from cases import noise, whitened
from numpy.testing import assert_allclose
from scipy.special import gammainccinv
from scipy.stats import weibull_min

from mooringdx.detectors import Glrt
from mooringdx.detectors.design import Design
from mooringdx.detectors.reference import Reference
from mooringdx.errors import FitError
from mooringdx.threshold import (
    count_alarms,
    crossfit,
    drift_ratio,
    fit_threshold,
    fold_slices,
    predicted_threshold,
    smallest_fault,
)
from mooringdx.threshold.fit import judge
from mooringdx.threshold.tails import cluster_law, count_clusters, exponential, power_law, quantile, weibull

WINDOW, TS = 50, 0.1


def white_statistic(n, lines, seed, window=WINDOW):
    """Return g (n, lines) of white noise, plain numpy; NaN before the first full window."""
    z = np.random.default_rng(seed).standard_normal((n, lines))
    total = np.concatenate([np.zeros((1, lines)), np.cumsum(z, axis=0)])
    g = np.full((n, lines), np.nan)
    g[window - 1 :] = (total[window:] - total[:-window]) ** 2 / (2 * window)
    return g


def bins(quantiles):
    """Return log-spaced bins and weights of a law given by its quantile function."""
    x = np.geomspace(1e-8, 200.0, 3000)
    values = quantiles((np.arange(200_000) + 0.5) / 200_000)
    edges = np.concatenate([[0.0], np.sqrt(x[1:] * x[:-1]), [np.inf]])
    return x, np.histogram(values, edges)[0][None].astype(float)


# ---- tail laws: analytic


@pytest.mark.parametrize("dof", [1, 2, 6])
@pytest.mark.parametrize("shape", [0.7, 1.0, 1.3])
def test_power_law_recovers_its_own(dof, shape):
    x, w = bins(lambda p: gammainccinv(0.5 * dof, 1 - p) ** (1 / shape))
    law = power_law(x, w, dof)
    assert law.parameters["shape"][0] == pytest.approx(shape, rel=0.01)
    at = gammainccinv(0.5 * dof, 1e-7) ** (1 / shape)
    assert law.log_tail(np.array([[at]]))[0, 0] == pytest.approx(np.log(1e-7), rel=0.02)


def test_weibull_and_exponential_recover_their_own():
    x, w = bins(lambda p: weibull_min.ppf(p, 0.8, scale=1.7))
    law = weibull(x, w)
    assert law.parameters["shape"][0] == pytest.approx(0.8, rel=0.01)
    assert law.parameters["scale"][0] == pytest.approx(1.7, rel=0.01)
    x, w = bins(lambda p: -np.log1p(-p) * 0.6)
    assert_allclose(exponential(x, w).log_tail(np.array([[6.0]])), -10.0, rtol=0.02)


def test_weibull_equals_another_program():
    values = weibull_min.rvs(0.63, scale=0.4, size=4000, random_state=1)
    law = weibull(np.sort(values), np.ones((1, 4000)))
    c, _, scale = weibull_min.fit(values, floc=0)
    assert law.parameters["shape"][0] == pytest.approx(c, rel=1e-3)
    assert law.parameters["scale"][0] == pytest.approx(scale, rel=1e-3)


def test_rows_are_fitted_independently():
    x, w = bins(lambda p: gammainccinv(0.5, 1 - p))
    both = np.concatenate([w, w * (x > 0.01)])
    for law in (lambda x, w: power_law(x, w, 1), weibull, exponential):
        together = law(x, both).log_tail(np.full((2, 1), 8.0))
        alone = [law(x, row[None]).log_tail(np.full((1, 1), 8.0))[0] for row in both]
        assert_allclose(together, alone, rtol=1e-9)
    assert_allclose(quantile(x, w, 0.5), gammainccinv(0.5, 0.5), rtol=0.02)


# ---- clusters and counting: brute force


def test_clusters_by_hand():
    values = np.array([0, 2, 2, 0, 2, 0, 0, 0, 2.0])
    assert count_clusters(values, 1.0, 1) == (4, 3)
    assert count_clusters(values, 1.0, 2) == (4, 2)
    assert count_clusters(values, 1.0, 4) == (4, 1)


def test_alarms_by_hand():
    ratio = np.array([0, 1.2, 0.8, 1.2, 0, 0, 1.5, 0, 0, 0, np.nan, 2.0])
    assert count_alarms(ratio, 0.7, 0) == 3
    assert count_alarms(ratio, 0.7, 2) == 2
    assert count_alarms(ratio, 0.7, 4) == 1


@pytest.mark.parametrize("window", [20, 150])
def test_cluster_length_of_white_noise_follows_the_law(window):
    g = white_statistic(4_000_000, 1, 2, window)[window:, 0]
    for level in (3.4, 5.4):
        above, clusters = count_clusters(g, level, window)
        assert above / clusters == pytest.approx(cluster_law(np.array([level]), window)[0], rel=0.15)


# ---- folds


def test_folds_cover_everything_once():
    for n in (5, 17, 36_000):
        cut = fold_slices(n)
        assert [c.start for c in cut] == [0, *[c.stop for c in cut][:-1]]
        assert cut[-1].stop == n
        assert len(cut) == 5


def test_crossfit_tries_every_sample_once_on_what_was_learned_elsewhere():
    lengths = [70, 30]
    seen = []

    def fit_fold(train):
        learned = {(i, k) for i, rows in train for k in range(rows.start, rows.stop)}

        def apply(i, rows):
            tried = [(i, k) for k in range(rows.start, rows.stop)]
            assert not learned & set(tried)
            assert len(learned) == 80
            seen.extend(tried)
            return np.array(tried, dtype=float)

        return apply

    held = crossfit(lengths, fit_fold)
    assert sorted(seen) == [(0, k) for k in range(70)] + [(1, k) for k in range(30)]
    assert sum(len(h) for h in held) == 100


# ---- drift flag: Monte Carlo


def test_drift_flag_is_a_one_per_cent_test_and_sees_drift():
    rng = np.random.default_rng(4)
    n, ok = 150 * 240, np.ones((150 * 240, 6), bool)
    steady = [drift_ratio([(rng.standard_normal((n, 6)), ok)], 150) for _ in range(60)]
    assert sum(r > 1.2 for r in steady) <= 3
    assert np.median(steady) > 0.6
    slow = np.sqrt(np.linspace(0, 1, n))[:, None] * np.array([1.0, 0, 0, 0, 0, 0])
    assert drift_ratio([(rng.standard_normal((n, 6)) + slow, ok)], 150) > 1.2


def test_offsets_between_runs_are_not_drift_and_short_records_are_not_judged():
    rng = np.random.default_rng(5)
    runs = [(rng.standard_normal((36_000, 2)) + 5 * i, np.ones((36_000, 2), bool)) for i in range(3)]
    assert drift_ratio(runs, 150) < 1.2
    assert np.isnan(drift_ratio([(runs[0][0][:1500], runs[0][1][:1500])], 150))


# ---- the level


def fitted(n=36_000, lines=4, seed=0, **more):
    folds = [white_statistic(n // 5, lines, [seed, i]) for i in range(5)]
    options = {"samples": n, "drift_ratio": 1.0, **more}
    rate = options.pop("rate", 1 / 7200)
    return fit_threshold("main", folds, WINDOW, TS, rate, options.pop("assurance", 0.9), **options)


def true_rate(level, lines, window=WINDOW):
    """Return the rate of white Gaussian noise by theory, 1/s."""
    from scipy.stats import chi2

    return lines * chi2.sf(2 * level, 1) / (TS * cluster_law(np.array([level]), window)[0])


def test_the_level_holds_the_asked_rate_with_the_asked_assurance():
    # theory: the rate of white noise above each fitted level; 24 fits of one hour. The draws of the noise
    # variance, which is exact here, only make the level safer.
    fits = [fitted(seed=s) for s in range(24)]
    ratio = np.array([true_rate(t.scaled_level, 4) / t.asked_rate for t in fits])
    assert (ratio <= 1.0).sum() >= 20
    assert ratio.max() < 3.0
    assert np.median(ratio) > 0.15
    covered = [t.rate_interval[0] <= true_rate(t.scaled_level, 4) <= t.rate_interval[1] for t in fits]
    assert sum(covered) >= 20
    central = np.array([t.central_rate / true_rate(t.scaled_level, 4) for t in fits])
    assert 0.5 < np.median(central) < 2.0


def test_one_sided_faults_raise_half_the_alarms():
    two = [white_statistic(20_000, 2, [7, i]) for i in range(5)]
    one = []
    for i in range(5):
        z = np.random.default_rng([7, i]).standard_normal((20_000, 2))
        total = np.concatenate([np.zeros((1, 2)), np.cumsum(z, axis=0)])
        g = np.full((20_000, 2), np.nan)
        moved = total[WINDOW:] - total[:-WINDOW]
        g[WINDOW - 1 :] = np.where(moved > 0, moved**2 / (2 * WINDOW), 0.0)
        one.append(g)
    options = {"samples": 100_000, "drift_ratio": 1.0}
    both = fit_threshold("main", two, WINDOW, TS, 1e-4, 0.5, **options)
    half = fit_threshold("main", one, WINDOW, TS, 2e-4 / 4, 0.5, **options)
    assert half.scaled_level == pytest.approx(both.scaled_level, rel=0.12)
    assert_allclose(half.scale, both.scale, rtol=0.15)


def test_lines_of_other_scale_get_their_own_level():
    folds = [white_statistic(8000, 2, i) * np.array([1.0, 5.0]) for i in range(5)]
    t = fit_threshold("main", folds, WINDOW, TS, 1e-4, samples=40_000, drift_ratio=1.0)
    assert t.level[1] / t.level[0] == pytest.approx(5.0, rel=0.2)
    assert_allclose(t.level, t.scale * t.scaled_level)


def test_a_rarer_alarm_or_more_assurance_asks_a_higher_level():
    base = fitted()
    assert fitted(rate=1 / 72_000).scaled_level > base.scaled_level
    assert fitted(assurance=0.5).scaled_level < base.scaled_level
    assert base.scaled_interval[0] < base.scaled_level < 1.05 * base.scaled_interval[1]
    assert base.tail["weibull_level"] > 1.4 * base.tail["central_level"]
    assert fitted().scaled_level == base.scaled_level


def test_verdicts_name_their_reason():
    assert judge(36_000, 150, 0.1, 1.0, True, 1 / 30_000)[0] == "supported"
    verdict, reason = judge(36_000, 150, 0.1, 1.0, True, 1 / 86_400)
    assert (verdict, "24 times" in reason) == ("extrapolated", True)
    verdict, reason = judge(3700, 150, 0.1, 1.0, True, 1 / 86_400)
    assert (verdict, "230 s more" in reason) == ("invalid", True)
    verdict, reason = judge(36_000, 150, 0.1, 3.0, False, 1 / 30_000)
    assert (verdict, "drift" in reason) == ("invalid", True)
    assert judge(36_000, 150, 0.1, 3.0, True, 1 / 30_000)[0] == "supported"


def test_nothing_held_back_is_refused():
    with pytest.raises(FitError, match="lengthen the no-fault window"):
        fit_threshold("main", [np.full((100, 2), np.nan)], WINDOW, TS, 1e-4, samples=100, drift_ratio=1.0)


# ---- the slow channel: theory against counts


def test_predicted_level_holds_over_errors_of_mean_and_variance():
    # Monte Carlo of the thing itself, short windows for speed: fit mean and sd on n samples, count on fresh noise
    window, n, rate = 200, 2000, 1 / 600.0
    t = predicted_threshold("slow", np.zeros(1), window, 10, TS, rate, samples=n, drift_ratio=1.0)
    assert t.tail["asked_level"] < 0.5 * 5.0**2
    level = t.tail["asked_level"]
    rng = np.random.default_rng(3)
    fine = 0
    for _ in range(60):
        train, fresh = rng.standard_normal(n), rng.standard_normal(200_000)
        means = train.reshape(-1, 10).mean(axis=1)
        total = np.concatenate([[0.0], np.cumsum(fresh - train.mean())])
        g = (total[window:] - total[:-window]) ** 2 / (2 * window * 10 * means.var(ddof=1))
        fine += count_clusters(g, level, 2 * window)[1] / (200_000 * TS) <= rate
    assert fine >= 48
    assert t.level[0] == 12.5


def test_predicted_level_rises_with_drift_and_lines_and_falls_for_one_sign():
    def level(sign, ratio=1.0):
        return predicted_threshold("slow", np.array(sign), 6000, 150, TS, 1e-8, samples=36_000, drift_ratio=ratio)

    asked = [level(sign).tail["asked_level"] for sign in ([0.0] * 6, [0.0], [1.0])]
    assert asked[0] > asked[1] > asked[2]
    assert level([0.0], 2.0).scaled_level == pytest.approx(2 * level([0.0]).scaled_level)


# ---- the smallest fault: Monte Carlo against the closed form


def test_smallest_fault_is_found_and_named_as_often_as_it_says():
    directions = np.array([[1.0, 0.0], [0.8, 0.6]])
    covariance = np.array([[1.0, 0.2], [0.2, 0.5]])
    level, scale = np.full(2, 13.0), np.ones(2)
    small = smallest_fault(directions, np.zeros(2), covariance, WINDOW, level, scale)
    rng, factor = np.random.default_rng(1), np.linalg.cholesky(covariance / WINDOW)
    inverse = np.linalg.inv(covariance)
    energy = np.einsum("fr,rs,fs->f", directions, inverse, directions)

    def statistic(size):
        mean = size * directions[0] + rng.standard_normal((20_000, 2)) @ factor.T
        return WINDOW / 2 * (mean @ inverse @ directions.T) ** 2 / energy

    assert (statistic(small.found[0])[:, 0] > 13.0).mean() == pytest.approx(0.95, abs=0.01)
    g = statistic(small.named[0])
    assert (g[:, 0] - g[:, 1] > np.log(20)).mean() == pytest.approx(0.95, abs=0.015)
    assert (small.rival == [1, 0]).all()


def test_coinciding_directions_are_never_told_apart_unless_by_sign():
    same = np.array([[1.0, 0.0], [2.0, 0.0]])
    args = np.eye(2), WINDOW, np.full(2, 13.0), np.ones(2)
    assert np.isinf(smallest_fault(same, np.zeros(2), *args).named).all()
    assert np.isfinite(smallest_fault(same, np.array([1.0, -1.0]), *args).named).all()
    assert np.isfinite(smallest_fault(same, np.zeros(2), *args).needed).all()
    assert np.isinf(smallest_fault(np.array([[0.0, 0.0], [1.0, 0.0]]), np.zeros(2), *args).found[0])


# ---- the whole on coloured noise


@pytest.mark.slow
def test_counted_alarms_stay_at_the_asked_rate():
    # Monte Carlo: 8 fits on half an hour of three mixed white channels, asked four an hour, 25 h counted each
    rate, high = 4 / 3600, 0
    for seed in range(8):
        z = noise(18_000, [seed, 0])
        signatures = whitened(z).signatures
        q = np.cov(z.T)
        reference = Reference(z.mean(axis=0), z.std(axis=0), 2000.0, 2 * WINDOW)
        detector = Glrt(Design.of(signatures, q, WINDOW, reference))
        held = [detector(whitened(z[rows])).values for rows in fold_slices(len(z))]
        t = fit_threshold("main", held, WINDOW, TS, rate, samples=len(z), drift_ratio=1.0)
        fresh = Glrt(Design.of(signatures, q, WINDOW, reference, t.level))(whitened(noise(900_000, [seed, 1]))).values
        alarms = count_alarms(np.fmax.reduce(fresh / t.level, axis=1), 0.7, 2 * WINDOW)
        high += alarms > rate * 90_000
        assert alarms <= 3 * rate * 90_000
    assert high <= 2
