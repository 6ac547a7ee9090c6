"""Detectors against plain numpy twins, theory, and the contract that all of them keep."""

from __future__ import annotations

import numpy as np
import pytest
from cases import CASES, DIRECTIONS, FOLLOWING, LINES, MIX, SIGN, WINDOW, design, noise, whitened

from mooringdx.detectors import DETECTORS, Cusum, Glrt, GlrtUnknown
from mooringdx.detectors.covariance import covariance_of_means, window_means
from mooringdx.detectors.reference import LEAST_SD, Reference
from mooringdx.errors import FitError

ALL = [*CASES.items(), *FOLLOWING.items()]
IDS = [*CASES, *(f"{name} following" for name in FOLLOWING)]


def gappy(n, seed=0):
    """Noise with a step, and gaps: one sample, a channel for long, all channels at once."""
    rng = np.random.default_rng(seed)
    z = noise(n, seed)
    z[n // 2 : n // 2 + 300] += 1.5 * DIRECTIONS[0]
    valid = rng.random(z.shape) > 0.02
    valid[200:330, 1] = False
    valid[500:570] = False
    return np.where(valid, z, np.nan), valid


# ---- twins: the same statistic in plain numpy, straight from the definition


class Follower:
    """The reference, one sample at a time, and what holds it."""

    def __init__(self, reference, z, valid):
        self.reference, self.z, self.valid = reference, z, valid
        self.mean, self.power = reference.mean.copy(), reference.sd**2
        self.since, self.held = reference.guard + 1, 0

    def change(self, k):
        gain = self.reference.sd / np.maximum(np.sqrt(self.power), LEAST_SD * self.reference.sd)
        return np.where(self.valid[k], (np.nan_to_num(self.z[k]) - self.mean) * gain, 0.0)

    def step(self, k, alarm):
        """Return (held, restarted) after sample k."""
        r = self.reference
        if r.tau is None:
            return False, False
        self.since = 0 if alarm else self.since + 1
        held = self.since <= r.guard
        self.held = self.held + 1 if held else 0
        if self.held >= (r.max_hold or 6 * round(r.tau)):
            for i in range(len(r.mean)):
                part = slice(max(0, k + 1 - round(r.tau)), k + 1)
                last = self.z[part, i][self.valid[part, i]]
                if len(last) > 1:
                    self.mean[i], self.power[i] = last.mean(), last.var()
            self.since, self.held = r.guard + 1, 0
            return held, True
        old = k - r.guard
        if not held and old >= 0:
            ok, a = self.valid[old], 1.0 / r.tau
            self.mean[ok] += a * (self.z[old, ok] - self.mean[ok])
            self.power[ok] += a * ((self.z[old, ok] - self.mean[ok]) ** 2 - self.power[ok])
        return held, False


def twin_window(detector, z, valid, pooled):
    d = detector.design
    f = 1 if pooled else len(d.labels)
    follower, history = Follower(d.reference, z, valid), []
    out, frozen = np.full((len(z), f), np.nan), np.zeros(len(z), bool)
    for k in range(len(z)):
        history = [*history, (follower.change(k), valid[k])][-d.window :]
        if len(history) == d.window:
            out[k] = twin_value(d, np.array([h[0] for h in history]), np.array([h[1] for h in history]), pooled)
        alarm = bool((out[k] > d.levels(f)).any())
        frozen[k], restarted = follower.step(k, alarm)
        history = [] if restarted else history
    return out, frozen


def twin_value(d, change, ok, pooled):
    count = ok.sum(axis=0)
    use = 2 * count >= d.window
    if not use.any():
        return np.nan
    x = change.sum(axis=0)[use] / np.sqrt(count[use])
    inverse = np.linalg.inv(d.covariance[np.ix_(use, use)])
    if pooled:
        return x @ inverse @ x / 2
    values = []
    for gamma, sign in zip(d.directions, d.sign, strict=True):
        a = gamma[use] * np.sqrt(count[use])
        energy, top = a @ inverse @ a, a @ inverse @ x
        values.append(np.nan if energy == 0 else 0.0 if top * sign < 0 else top**2 / (2 * energy))
    return values


def twin_cusum(detector, z, valid):
    d = detector.design
    f = len(d.labels)
    follower = Follower(d.reference, z, valid)
    sums, out, frozen = np.zeros((2, f)), np.zeros((len(z), f)), np.zeros(len(z), bool)
    shifts = d.directions * detector.sizes[:, None]
    for k in range(len(z)):
        use, change = valid[k], follower.change(k)
        inverse = np.zeros_like(d.covariance)
        if use.any():
            inverse[np.ix_(use, use)] = np.linalg.inv(d.covariance[np.ix_(use, use)])
        score, half = shifts @ inverse @ change, 0.5 * np.einsum("fr,rs,fs->f", shifts, inverse, shifts)
        sums = np.minimum(np.maximum(sums + np.array([score, -score]) - half, 0.0), 2 * d.levels(f))
        sums[0, d.sign < 0] = 0.0
        sums[1, d.sign > 0] = 0.0
        out[k] = sums.max(axis=0)
        alarm = bool((out[k] > d.levels(f)).any())
        recent = valid[max(0, k + 1 - d.window) : k + 1].any(axis=1)
        if 2 * recent.sum() < len(recent):
            out[k], sums, alarm = np.nan, np.zeros((2, f)), False
        frozen[k], restarted = follower.step(k, alarm)
        sums = np.zeros((2, f)) if restarted else sums
    return out, frozen


def twin(detector, z, valid):
    if isinstance(detector, Cusum):
        return twin_cusum(detector, z, valid)
    return twin_window(detector, z, valid, isinstance(detector, GlrtUnknown))


@pytest.mark.parametrize("name", DETECTORS)
@pytest.mark.parametrize("memory", [None, 300.0])
@pytest.mark.parametrize("max_hold", [0, 150])
def test_kernel_equals_the_numpy_twin(name, memory, max_hold):
    z, valid = gappy(1400)
    made = design(memory=memory, level=np.array(8.0), mean=np.array([0.1, -0.2, 0.05]))
    reference = Reference(made.reference.mean, made.reference.sd, memory, made.reference.guard, max_hold)
    detector = DETECTORS[name](type(made)(**{**vars(made), "reference": reference}))
    result = detector(whitened(z, valid))
    values, frozen = twin(detector, z, valid)
    np.testing.assert_allclose(result.values, values, rtol=1e-9, atol=1e-9)
    if memory is None:
        assert result.frozen is None
    else:
        assert frozen.any()
        np.testing.assert_array_equal(result.frozen, frozen)


def test_a_long_record_of_large_offsets_keeps_its_digits():
    # brute force: with a mean of 1e6 the running sum alone would lose seven digits over 20,000 samples
    z = noise(20_000) + 1e6
    detector = Glrt(design(mean=np.full(LINES, 1e6)))
    direct = twin_value(detector.design, z[-WINDOW:] - 1e6, np.ones((WINDOW, LINES), bool), False)
    np.testing.assert_allclose(detector(whitened(z)).values[-1], direct, rtol=1e-6)


# ---- the contract of the family


@pytest.mark.parametrize(("name", "detector"), ALL, ids=IDS)
def test_causal_and_deterministic_under_cutting(name, detector):
    z, valid = gappy(1000)
    whole = detector(whitened(z, valid)).values
    for stop in (1, WINDOW - 1, WINDOW, 517, 999):
        np.testing.assert_array_equal(detector(whitened(z[:stop], valid[:stop])).values, whole[:stop])


@pytest.mark.parametrize(("name", "detector"), ALL, ids=IDS)
def test_input_unmutated_and_output_locked(name, detector):
    z, valid = gappy(300)
    before = z.copy(), valid.copy()
    result = detector(whitened(z, valid))
    np.testing.assert_array_equal(z, before[0])
    np.testing.assert_array_equal(valid, before[1])
    assert not result.values.flags.writeable
    assert result.values.shape == (300, len(result.labels))


@pytest.mark.parametrize("name", DETECTORS)
def test_invariant_to_mixing_the_residuals(name):
    # analytic: z -> A z, Gamma -> A Gamma, Q -> A Q A' leaves every likelihood ratio as it was
    a = np.array([[2.0, 1.0, 0.0], [0.0, -1.5, 0.7], [0.3, 0.0, 5.0]])
    z = noise(500)
    plain = DETECTORS[name](design())
    mixed = DETECTORS[name](design(covariance=a @ MIX @ MIX.T @ a.T, directions=DIRECTIONS @ a.T))
    np.testing.assert_allclose(mixed(whitened(z @ a.T)).values, plain(whitened(z)).values, rtol=1e-8, atol=1e-9)


@pytest.mark.parametrize(("name", "detector"), ALL, ids=IDS)
def test_quiet_on_healthy_data_and_growing_after_a_step(name, detector):
    z = noise(6000, seed=3)
    assert np.nanmax(detector(whitened(z)).values) < 16.0
    z[3000:] += 0.8 * DIRECTIONS[2]
    values = detector(whitened(z)).values
    column = min(2, values.shape[1] - 1)
    assert values[3000 - 1, column] < values[3000 + WINDOW // 2, column] < values[3000 + WINDOW - 1, column]
    assert values[3000 + WINDOW - 1, column] > 8.0
    if values.shape[1] > 1:
        assert values[3000 + WINDOW - 1, column] == values[3000 + WINDOW - 1].max()  # a capped sum may tie


@pytest.mark.parametrize(("name", "detector"), ALL, ids=IDS)
def test_no_verdict_from_a_window_that_is_mostly_masked(name, detector):
    z, valid = noise(400), np.ones((400, LINES), bool)
    valid[200 : 200 + WINDOW] = False
    values = detector(whitened(z, valid)).values
    assert np.isnan(values[200 + WINDOW // 2 + 1 : 200 + WINDOW]).all()
    assert np.isfinite(values[200 + 2 * WINDOW :]).all()


# ---- theory


def test_means_are_those_of_the_chi_square():
    z = noise(400_000, seed=5)
    g = np.nanmean(Glrt(design())(whitened(z)).values, axis=0)
    np.testing.assert_allclose(g, np.where(SIGN == 0, 0.5, 0.25), rtol=0.05)
    assert np.nanmean(GlrtUnknown(design())(whitened(z)).values) == pytest.approx(LINES / 2, rel=0.05)


def test_the_wrong_sign_is_not_that_fault():
    z = noise(200)
    z[100:] -= 2.0 * DIRECTIONS[2]
    values = Glrt(design())(whitened(z)).values
    assert values[-1, 2] == 0.0
    assert values[-1, 0] > 0.0


def test_with_a_channel_masked_the_rest_still_decide():
    # analytic: fault 3 moves residual 2 alone, so without residual 2 it cannot be judged; fault 0 still can
    z, valid = noise(200), np.ones((200, LINES), bool)
    z[100:] += 3.0 * DIRECTIONS[0]
    valid[:, 2] = False
    values = Glrt(design())(whitened(np.where(valid, z, np.nan), valid)).values
    assert np.isnan(values[-1, 3])
    assert values[-1, 0] > 20.0


def test_cusum_designed_for_too_much_is_blind_to_bounded_residuals():
    z = np.clip(noise(2000, seed=2), -1.6, 1.6)
    z[1000:] = 1.6
    assert Cusum(design(covariance=np.eye(LINES)), 4.0)(whitened(z)).values[-1, 0] == 0.0
    assert Cusum(design(covariance=np.eye(LINES)), 0.5)(whitened(z)).values[-1, 0] > 100.0


def test_a_following_reference_takes_up_a_step_only_after_the_alarm_has_stood_too_long():
    z = noise(40_000, seed=1)
    z[5000:] += 1.0 * DIRECTIONS[0]
    held = Glrt(design(memory=1000.0, level=np.array(13.0)))(whitened(z))
    assert held.frozen[5100:10_900].all()
    assert np.isnan(held.values[11_100:11_200]).any() or np.isnan(held.values[10_900:11_400]).any()
    assert not held.frozen[12_000:].any()
    free = Glrt(design(memory=1000.0))(whitened(z)).values
    assert np.nanmean(free[9000:, 0]) < 1.0


# ---- covariance of window means


def test_covariance_of_means_of_white_noise_is_its_own():
    segments = [(noise(60_000, seed), np.ones((60_000, LINES), bool)) for seed in range(3)]
    truth = MIX @ MIX.T * (1 + 0.01 * np.eye(LINES))
    np.testing.assert_allclose(covariance_of_means(segments, WINDOW), truth, atol=0.06)


def test_covariance_about_zero_counts_the_offsets_of_runs():
    segments = [(noise(8000, seed) + 1.0 - 2.0 * seed, np.ones((8000, LINES), bool)) for seed in range(2)]
    about_zero = covariance_of_means(segments, WINDOW, "zero")
    assert np.diagonal(about_zero) == pytest.approx(np.diagonal(MIX @ MIX.T) + WINDOW, rel=0.1)


def test_few_windows_shrink_the_correlations_and_not_the_variances():
    z = np.random.default_rng(0).standard_normal((12 * WINDOW, LINES))
    q = covariance_of_means([(z, np.ones(z.shape, bool))], WINDOW)
    raw = WINDOW * np.cov(window_means([(z, np.ones(z.shape, bool))], WINDOW)[0].T)
    np.testing.assert_allclose(np.diagonal(q), 1.01 * np.diagonal(raw))
    off = ~np.eye(LINES, dtype=bool)
    assert (np.abs(q[off]) < np.abs(raw[off])).all()


def test_too_few_windows_and_a_dead_residual_are_refused():
    z = noise(2 * WINDOW)
    with pytest.raises(FitError, match="2 whole detector windows"):
        covariance_of_means([(z, np.ones(z.shape, bool))], WINDOW)
    z = noise(20 * WINDOW)
    z[:, 1] = 0.0
    with pytest.raises(FitError, match="does not move"):
        covariance_of_means([(z, np.ones(z.shape, bool))], WINDOW)


def test_shapes_that_do_not_agree_are_refused():
    with pytest.raises(ValueError, match="do not agree"):
        design(covariance=np.eye(2), sd=np.ones(LINES))
    with pytest.raises(ValueError, match="not all positive"):
        Cusum(design(), -1.0)
