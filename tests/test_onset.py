"""Truth: brute force (explicit matrices, quadrature), analytic (a noise-free plant feels a force), the simulator."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mooringdx.config import RunConfig, load_run
from mooringdx.errors import ConfigError
from mooringdx.hypotheses.onset.bank import (
    Beat,
    beat,
    empty,
    in_earth,
    information,
    mean_drift,
    odds_of,
    over,
    rig_of,
    tuned,
    weighed,
)
from mooringdx.hypotheses.onset.kernel import CUT, Odds, Slots, grown, line_pulls, together, walk
from mooringdx.hypotheses.onset.losses import losses, shares, weights
from mooringdx.hypotheses.onset.temper import tempers
from mooringdx.hypotheses.onset.verdict import runs, steady
from mooringdx.hypotheses.onset.walks import stretches
from mooringdx.hypotheses.onset_glr import OnsetGlr
from mooringdx.observers.kalman import Filter
from mooringdx.observers.matrices import Model, Noise, plant_of
from mooringdx.physics.frames import rotation
from mooringdx.physics.mooring import Mooring
from mooringdx.physics.rig import mooring_of
from mooringdx.physics.vessel import VesselModel, load_vessel
from mooringdx.pipeline import prepare
from mooringdx.residuals.training import Training
from mooringdx.simulate import Scenario, load_scenario, simulate
from mooringdx.simulate.record import stream
from mooringdx.types import Array, Channels, replace

CONFIGS = Path(__file__).parents[1] / "configs"
NOISE = Noise((6e10, 2e10, 1e13), (4e5, 4e5, 1e12), (0.015, 0.015, 6e-4), (0.005, 0.005, 5e-5), 0.9, 0.1)
QUICK = Beat(1.0, 2, 12, 40, (8, 16, 32), 24, 6, 6)
ONSET = 1500.0


def ship() -> VesselModel:
    return load_vessel(CONFIGS / "vessels" / "fpso200.toml")


def odds(times: Beat, temper: float = 2.0) -> Odds:
    return odds_of(
        times,
        1.0,
        np.full(8, 0.125),
        (3e-8, 1e-5, 1.6e-3),
        np.full(2, temper),
        1e10 * np.eye(2),
        np.diag([1.4e10, 0.5e10]),
    )


# The loops against explicit matrices


def wide(turn: Array) -> Array:
    """Return the turn of all earth-axes states of the filter."""
    out = np.eye(15)
    for i in (0, 6, 9, 12):
        out[i : i + 3, i : i + 3] = turn
    return out


def nearest(models: tuple[Model, ...], heading: float) -> tuple[Array, Array, Array, Array]:
    """Return F, G (body force), K and S of the model at ``heading``, turned to it, by matrices alone."""
    one = models[int(np.argmin([abs(heading - m.heading) for m in models]))]
    small = rotation(heading - one.heading)
    big = wide(small)
    return big @ one.F @ big.T, big @ one.G, big @ one.K @ small.T, small @ one.S @ small.T


def responses(models: tuple[Model, ...], headings: Array, seen: Array, span: tuple[int, int], middle: Array) -> Array:
    """Return the innovations of unit forces (north, east at ``middle``, moment) that act over ``span``, (n, 3, 3)."""
    d, out = np.zeros((15, 3)), np.zeros((len(headings), 3, 3))
    for k, heading in enumerate(headings):
        F, G, K, _ = nearest(models, heading)
        out[k] = d[:3] + d[12:]
        if seen[k]:
            d = d - K @ out[k]
        arm = rotation(heading)[:2, :2] @ middle
        forces = rotation(heading).T @ np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-arm[1], arm[0], 1.0]])
        d = F @ d + (G @ forces if span[0] <= k < span[1] else 0.0)
    return out


def evidence(models: tuple[Model, ...], headings: Array, errors: Array, rho: Array) -> tuple[Array, Array]:
    """Return z and Lam of a response."""
    z, lam = np.zeros(3), np.zeros((3, 3))
    for k, heading in enumerate(headings):
        if np.isfinite(errors[k]).all():
            inverse = np.linalg.inv(nearest(models, heading)[3])
            z += rho[k].T @ inverse @ errors[k]
            lam += rho[k].T @ inverse @ rho[k]
    return z, lam


def marginal(z: Array, lam: Array, cov: Array) -> float:
    """Return the log of the mean likelihood ratio over f ~ N(0, cov), by the Gaussian integral."""
    precision = np.linalg.inv(cov)
    a = lam + precision
    return float(
        0.5 * z @ np.linalg.solve(a, z) - 0.5 * np.linalg.slogdet(a)[1] + 0.5 * np.linalg.slogdet(precision)[1]
    )


def over_shares(z: Array, lam: Array, h: Array) -> float:
    """Return the log of the mean of exp(f'z - f'Lam f/2) over f ~ N(-h, 15 % along and 10 % across), by quadrature."""
    node = np.linspace(-9.0, 9.0, 181)
    along, across = np.meshgrid(node, node)
    side = np.array([-h[1], h[0], 0.0])
    flat = np.array([h[0], h[1], 0.0])
    f = -h + 0.15 * along[..., None] * flat + 0.10 * across[..., None] * side
    logs = f @ z - 0.5 * np.einsum("abi,ij,abj->ab", f, lam, f) - 0.5 * (along**2 + across**2)
    top = logs.max()
    return float(top + np.log(np.trapezoid(np.trapezoid(np.exp(logs - top), node), node) / (2.0 * np.pi)))


def walked(n: int) -> tuple[tuple[Model, ...], Array, Array, Slots, Array, Array, Odds, Any]:
    """Return models, places, innovations (with a gap) and what a walk over them leaves."""
    mooring = replace(mooring_of(ship()), fairleads=np.tile([30.0, 5.0], (8, 1)))
    rng = stream(3, "onset")
    place = np.column_stack([rng.normal(0.0, 3.0, (n, 2)), 3.9 + 0.2 * np.sin(0.05 * np.arange(n))])
    models = Filter(plant_of(ship().dynamics), NOISE, 1.0, mooring, (0.0, 0.0, 3.9)).models(place[:, 2])
    errors = rng.normal(0.0, 1.0, (n, 3)) * np.sqrt(np.diag(models[0].S)) * 3.0
    errors[n // 2 : n // 2 + 4] = np.nan
    slots, settled = empty(QUICK, 8), odds(QUICK)
    rig = rig_of(mooring)
    middle = mooring.fairleads.mean(axis=0)
    score, chance = np.full(n, np.nan), np.zeros((n, 11))
    rest = (tuned(models), rig, middle, settled, slots, score, chance, np.ones(n))
    walk(0, n, np.inf, QUICK.warm, errors, place, *rest)
    return models, place, errors, slots, score, chance, settled, (mooring, rig, middle)


def test_every_hypothesis_is_what_explicit_matrices_and_quadrature_give() -> None:
    n = 61
    models, place, errors, slots, score, chance, settled, (mooring, _, middle) = walked(n)
    seen, headings = np.isfinite(errors).all(axis=1), place[:, 2]
    group = in_earth(settled.group, headings[-1])
    turn = rotation(headings[-1])[:2, :2]
    assert group == pytest.approx(turn @ settled.group @ turn.T, rel=1e-12)
    logs = np.empty((slots.when.size, 12))
    weighed(n - 1, slots, settled, group, logs)
    old = [int(k) for k in sorted(slots.when) if 0 <= k < n - 1]
    ages = n - 1 - np.array(old)
    assert all(k % 8 == 0 for k in np.array(old)[ages > 12]), "old onsets are thinned to every fourth"
    assert ages.max() <= 40
    assert len(old) > 8
    for k in old:
        row = logs[list(slots.when).index(k)]
        z, lam = evidence(models, headings, errors, responses(models, headings, seen, (k, n), middle))
        prior = np.log(4.0) if n - 1 - k > 12 else 0.0
        horizontal, _, along = mooring.pulls(place[k])
        arms = (mooring.fairleads - middle) @ rotation(headings[k])[:2, :2].T
        for j in range(8):
            moment = arms[j, 0] * along[j, 1] - arms[j, 1] * along[j, 0]
            h = horizontal[j] * np.array([*along[j], moment])
            want = settled.line[j] + prior + over_shares(z / 2.0, lam / 2.0, h)
            assert row[j] == pytest.approx(want, rel=1e-9, abs=1e-7)
        want = settled.environment + prior + marginal(z[:2] / 2.0, lam[:2, :2] / 2.0, settled.step)
        assert row[8] == pytest.approx(want, rel=1e-9, abs=1e-9)
        for i, length in enumerate(QUICK.pulses):
            rho = responses(models, headings, seen, (k, k + length), middle)
            z, lam = evidence(models, headings, errors, rho)
            want = settled.pulse + prior + marginal(z[:2] / 2.0, lam[:2, :2] / 2.0, group)
            assert row[9 + i] == pytest.approx(want, rel=1e-9, abs=1e-9)
    worth = np.exp(logs[np.isfinite(logs[:, 0])])
    rest = 1.0 + worth[:, 8:].sum()
    assert score[-1] == pytest.approx(np.log(worth[:, :8].sum() / rest), rel=1e-9)
    assert chance[-1, 1:9] == pytest.approx(worth[:, :8].sum(axis=0) / (rest + worth[:, :8].sum()), rel=1e-9)
    assert chance[QUICK.warm :].sum(axis=1) == pytest.approx(1.0, rel=1e-12)


def twin(
    models: tuple[Model, ...], place: Array, errors: Array, mooring: Mooring, settled: Odds, times: Beat
) -> tuple[Array, Array]:
    """Return scores and probabilities by whole matrices, an onset at a time, with every term of every sum."""
    middle, lines = mooring.fairleads.mean(axis=0), len(mooring.names)
    score, chance = np.empty(len(place)), np.empty((len(place), lines + 3))
    change: dict[int, Array] = {}
    sums: dict[int, list[tuple[Array, Array]]] = {}
    pulls: dict[int, Array] = {}
    for k, (heading, e) in enumerate(zip(place[:, 2], errors, strict=True)):
        F, G, K, S = nearest(models, heading)
        inverse, rho = np.linalg.inv(S), {k0: d[:3] + d[12:] for k0, d in change.items()}
        if np.isfinite(e).all():
            for k0 in rho:
                for i, length in enumerate((0, *times.pulses)):
                    r = rho[k0] - rho[k0 + length] if length and k0 + length in rho else rho[k0]
                    z, lam = sums[k0][i]
                    sums[k0][i] = z + r.T @ inverse @ e, lam + r.T @ inverse @ r
                change[k0] = change[k0] - K @ rho[k0]
        turn = rotation(heading)
        worth = [[0.0], *([] for _ in range(lines + 2))]
        group = turn[:2, :2] @ settled.group @ turn[:2, :2].T
        for k0 in sums:
            prior = np.log(4.0) if k - k0 > times.fine_end else 0.0
            (z, lam), *groups = ((z / settled.temper[0], lam / settled.temper[0]) for z, lam in sums[k0])
            for j, h in enumerate(pulls[k0]):
                axes = np.array([[h[0], -h[1]], [h[1], h[0]]])
                cov = axes @ np.diag([settled.along**2, settled.across**2]) @ axes.T
                free = marginal((z + lam @ h)[:2], lam[:2, :2], cov)
                worth[1 + j].append(settled.line[j] + prior - h @ z - 0.5 * h @ lam @ h + free)
            worth[1 + lines].append(settled.environment + prior + marginal(z[:2], lam[:2, :2], settled.step))
            worth[2 + lines] += [settled.pulse + prior + marginal(z[:2], lam[:2, :2], group) for z, lam in groups]
        total = np.logaddexp.reduce([x for each in worth for x in each])
        logs = np.array([np.logaddexp.reduce(each) if each else -np.inf for each in worth])
        chance[k] = np.exp(logs - total)
        rest = np.logaddexp.reduce(logs[[0, lines + 1, lines + 2]])
        score[k] = np.logaddexp.reduce(logs[1 : lines + 1]) - rest
        for k0 in list(change):
            age = k + 1 - k0
            if age > times.end or (age > times.fine_end and k0 % (4 * times.fine)):
                del change[k0], sums[k0], pulls[k0]
        if k >= times.warm and k % times.fine == 0:
            change[k], sums[k] = np.zeros((15, 3)), [(np.zeros(3), np.zeros((3, 3)))] * 4
            horizontal, _, along = mooring.pulls(place[k])
            arms = (mooring.fairleads - middle) @ turn[:2, :2].T
            moment = arms[:, 0] * along[:, 1] - arms[:, 1] * along[:, 0]
            pulls[k] = horizontal[:, None] * np.column_stack([along, moment])
        arm = turn[:2, :2] @ middle
        forces = turn.T @ np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-arm[1], arm[0], 1.0]])
        change = {k0: F @ d + G @ forces for k0, d in change.items()}
    return score, chance


def test_the_walk_equals_its_plain_numpy_twin_at_every_sample() -> None:
    models, place, errors, _, score, chance, settled, (mooring, _, _) = walked(90)
    wanted, shares = twin(models, place, errors, mooring, settled, QUICK)
    began = QUICK.warm + 1
    np.testing.assert_array_equal(np.isfinite(score[began:]), True)
    np.testing.assert_allclose(score[began:], wanted[began:], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(chance[began:], shares[began:], rtol=1e-8, atol=1e-12)


def test_more_onsets_than_slots_are_refused() -> None:
    with pytest.raises(ValueError, match="80 at most"):
        empty(replace(QUICK, end=1000), 8)
    with pytest.raises(ValueError, match="multiple of 4"):
        empty(replace(QUICK, pulses=(8, 10, 32)), 8)


def test_a_force_that_a_noise_free_plant_feels_is_recovered() -> None:
    one = Filter(plant_of(ship().dynamics), NOISE, 1.0, mooring_of(ship()), (0.0, 0.0, 3.9)).model(3.9)
    force, x, hat = np.array([2.1e5, -1.3e5, 4e6]), np.zeros(15), np.zeros(15)
    z, lam = np.zeros(3), np.zeros((3, 3))
    inverse = np.linalg.inv(one.S)
    d, G = np.zeros((15, 3)), one.G @ rotation(3.9).T
    for k in range(200):
        e, rho = one.C @ (x - hat), one.C @ d
        z += rho.T @ inverse @ e
        lam += rho.T @ inverse @ rho
        hat = one.F @ (hat + one.K @ e)
        x = one.F @ x + (G @ force if k >= 20 else 0.0)
        d = one.F @ (d - one.K @ rho) + (G if k >= 20 else 0.0)
    assert np.linalg.solve(lam, z) == pytest.approx(force, rel=1e-6)
    assert information(one, np.zeros(2), 179) == pytest.approx(lam, rel=1e-9)


def test_a_group_that_has_not_ended_is_weighed_like_a_step() -> None:
    n = 61
    _, _, _, slots, _, _, settled, _ = walked(n)
    logs = np.empty((slots.when.size, 12))
    weighed(n - 1, slots, settled, settled.step, logs)
    young = (slots.when >= 0) & (slots.when > n - 1 - 8) & (slots.when < n - 1)
    assert young.sum() >= 3
    for i in range(3):
        assert logs[young, 9 + i] - settled.pulse == pytest.approx(logs[young, 8] - settled.environment, rel=1e-12)


def test_evidence_of_hundreds_of_nats_neither_overflows_nor_is_lost() -> None:
    logs = np.full((4, 12), -np.inf)
    logs[1, 2], logs[2, 8], logs[3, 9] = 2000.0, 1990.0, -3000.0
    row = np.empty(11)
    assert together(logs, row) == pytest.approx(10.0)
    assert row[3] == pytest.approx(1.0 / (1.0 + np.exp(-10.0)))
    assert row.sum() == pytest.approx(1.0)


def innovations(grown: float = 1.0) -> tuple[Any, Any, Any]:
    """White innovations as a filter expects them, or ``grown`` times as slow ones: (estimate, models, mooring)."""
    mooring = mooring_of(ship())
    filtering = Filter(plant_of(ship().dynamics), NOISE, 1.0, mooring, (0.0, 0.0, 3.9))
    models = filtering.models(np.full(9, 3.9))
    rng, n = stream(8, "white"), 16000
    quiet = filtering(np.tile([0.0, 0.0, 3.9], (40, 1)))
    at = int(np.argmin([abs(m.heading - 3.9) for m in models]))
    root = np.linalg.cholesky(models[at].S)
    white = rng.standard_normal((n, 3)) + np.repeat(rng.standard_normal((n // 200, 3)), 200, axis=0) * grown
    made = replace(quiet, innovation=white @ root.T, position=np.tile([0.0, 0.0, 3.9], (n, 1)))
    return made, models, mooring


def test_white_innovations_need_no_temper_at_any_age() -> None:
    times = beat(1.0, 1.0)
    temper, mean = tempers(*innovations(0.0), odds(times, 1.0), times, 1.0)
    assert mean == pytest.approx(1.0, abs=0.2)
    assert temper.shape == (181,)
    assert temper[4] == pytest.approx(1.0, abs=0.1)
    assert temper[-1] < 1.5


def test_slow_drift_is_tempered_the_more_the_longer_it_is_gathered() -> None:
    times = beat(1.0, 1.0)
    temper, _ = tempers(*innovations(0.12), odds(times, 1.0), times, 1.0)
    assert (np.diff(temper) >= 0.0).all()
    assert temper[2] < 1.3
    assert temper[24] > 1.5 * temper[2]


def test_a_short_record_keeps_the_temper_it_was_given() -> None:
    times = beat(1.0, 1.0)
    made, models, mooring = innovations(0.0)
    short = replace(made, innovation=made.innovation[:640], position=made.position[:640])
    temper, _ = tempers(short, models, mooring, odds(times, 1.0), times, 2.0)
    assert temper[-1] == pytest.approx(2.0, abs=0.3)


def test_the_prior_of_a_temper_counts_as_ten_stretches_of_its_age() -> None:
    times = beat(1.0, 1.0)
    made = innovations(0.0)
    low, high = (tempers(*made, odds(times, 1.0), times, prior)[0] for prior in (1.0, 51.0))
    for age in (4, 36, 180):
        stretches = 16000.0 / (5.0 * age)
        assert high[age] - low[age] == pytest.approx(10.0 * 50.0 / (10.0 + stretches), rel=0.1)
    assert low.min() >= 1.0


def test_evidence_is_divided_by_the_temper_of_its_age() -> None:
    times, (made, models, mooring) = beat(1.0, 1.0), innovations(0.0)
    flat = over(made, models, mooring, odds(times, 2.0), times, 1e9)
    grown = odds(times, 2.0)._replace(temper=np.where(np.arange(times.end + 1) < 100, 2.0, 3.0))
    steep = over(made, models, mooring, grown, times, 1e9)
    age = flat.named - flat.when
    young = (flat.when >= 0) & (age < 100) & (age > 0)
    old = (flat.when >= 0) & (age >= 100)
    assert (steep.logs[young, :9] == flat.logs[young, :9]).all()
    cooler = over(made, models, mooring, odds(times, 3.0), times, 1e9)
    assert (steep.logs[old, :9] == cooler.logs[old, :9]).all()


def test_pairs_and_parts_are_weighed_with_the_rate_of_all_breaks() -> None:
    lines = ("a", "b", "c")
    every = losses(lines, 0.1, (0.5,))
    assert [loss.name for loss in every[:4]] == [
        "line_lost a",
        "line_lost b",
        "line_lost c",
        "line_weakened a by 50 %",
    ]
    assert shares(every, lines)[3:].tolist() == [
        [0.5, 0, 0], [0, 0.5, 0], [0, 0, 0.5], [1, 1, 0], [1, 0, 1], [0, 1, 1]
    ]  # fmt: skip
    share = weights(every, 0.1)
    assert share[:3].sum() == pytest.approx(0.9)
    assert share[3:6].sum() == pytest.approx(0.9)
    assert share[6:].sum() == pytest.approx(0.1)


def test_a_steady_force_as_large_as_a_lost_line_is_pointed_at() -> None:
    pulls = np.array([[-4e5, 0.0], [0.0, -4e5]])
    like = steady(np.array([-3.5e5, 3e4]), pulls, ("line_1", "line_2"))
    assert not like.passed
    assert "line_1" in like.remedy
    assert steady(np.array([1e5, 1e5]), pulls, ("line_1", "line_2")).passed


def test_times_follow_the_scale_of_the_vessel() -> None:
    sea = beat(1.0, 1.0)
    assert (sea.fine, sea.fine_end, sea.end, sea.pulses) == (5, 180, 900, (20, 40, 80))
    assert (sea.confirm, sea.warm) == (60, 600)
    tank = beat(0.2, 6.06)
    assert tank.fine == 4
    assert tank.end * 0.2 * 6.06 == pytest.approx(900.0, rel=0.05)


def test_the_drift_behind_a_white_force_is_that_of_a_squared_envelope() -> None:
    """Brute force: a JONSWAP sea's squared envelope, its mean 1, has this intensity at the lowest frequencies."""
    from scipy.signal import welch

    from mooringdx.simulate.scenario import Sea
    from mooringdx.simulate.sea import draw_waves, squared_envelope
    from mooringdx.simulate.streams import streams

    waves = draw_waves(streams(5), 200_000, 0.5, Sea(height=1.0, peak_period=7.0))
    force = squared_envelope(waves)
    frequency, density = welch(force, 2.0, nperseg=2048)
    low = float(np.mean(density[(frequency > 0.001) & (frequency < 0.006)])) / 2.0  # two-sided
    found = mean_drift(replace(NOISE, force=(low, low, 1.0), frequency=2.0 * np.pi / 7.0))
    assert found == pytest.approx((float(force.mean()),) * 2, rel=0.12)


# On the simulator


def log_of(seed: int, duration: float, faults: tuple[tuple[str, float], ...] = (), **change: Any) -> Channels:
    """Return a log of the FPSO at Hs 2.5 m, two samples a second, positions, heading and thrust alone."""
    body = load_scenario(CONFIGS / "scenarios" / "fpso_line_lost.toml").model_dump(mode="json")
    body["record"] = {"duration": duration, "sample_time": 0.5, "settle": 1500.0}
    body["faults"] = [{"kind": "line_lost", "subject": line, "onset": onset} for line, onset in faults]
    log, _ = simulate(Scenario.model_validate(body | change), 1, seed)
    kept = {name: s for name, s in log.signals.items() if not name.startswith("tension")}
    return prepare(type(log)(kept, log.source), run_file())


def run_file(**bank: Any) -> RunConfig:
    run = load_run(CONFIGS / "runs" / "fpso_position.toml")
    clock = run.clock.model_copy(update={"sample_time": 0.5})
    return run.model_copy(update={"clock": clock, "bank": run.bank.model_copy(update=bank)})


@pytest.fixture(scope="module")
def bank() -> OnsetGlr:
    channels = log_of(100, 4200.0)
    return OnsetGlr.fit([Training(channels, (slice(0, channels.grid.n),))], run_file())


@pytest.fixture(scope="module")
def lost() -> Channels:
    return log_of(101, 2600.0, (("line_8", ONSET),))


def test_a_lost_line_is_found_named_dated_and_sized(bank: OnsetGlr, lost: Channels) -> None:
    posterior, events, checks = bank(lost)
    (event,) = events
    assert (event.kind, event.subject) == ("line_lost", "line_8")
    assert ONSET < event.evidence["warning"] <= event.detected < ONSET + 120.0
    assert event.named == event.detected + 60.0
    assert event.onset_interval[0] <= ONSET <= event.onset_interval[1]
    assert event.size_interval is not None
    assert event.size_interval[0] < 1.0 < event.size_interval[1]
    along = np.array([1.0, -1.0]) / np.sqrt(2.0)
    assert np.array(event.evidence["force"]) @ along == pytest.approx(-4.6e5, rel=0.3), "away from the anchor, H0"
    assert "squall" in str(event.cannot_tell)
    rivals = {(r.kind, r.subject): r.probability for r in event.rivals}
    at = int(np.searchsorted(posterior.time, event.named))
    assert posterior.probability.sum(axis=1) == pytest.approx(1.0)
    assert event.probability == pytest.approx(posterior.probability[at, 8])
    assert posterior.probability[-1, 8] > 0.95, "a line that was named stays lost, wave groups come and go"
    assert posterior.probability[-1, 0] == 0.0
    for j in range(1, 8):
        assert (posterior.probability[at, j] >= 0.05) == (("line_lost", f"line_{j}") in rivals)
    assert rivals["environment", "force"] == pytest.approx(posterior.probability[at, 9]), "never refuted by position"
    assert next(c for c in checks if c.name == "forces as learned").passed


def test_a_healthy_log_with_a_wandering_current_raises_nothing(bank: OnsetGlr) -> None:
    posterior, events, _ = bank(log_of(102, 7200.0))
    assert events == ()
    assert posterior.time.size == posterior.probability.shape[0]
    assert posterior.time[0] == pytest.approx(600.0, abs=3.0), "nothing is judged in the warm-up"


def test_what_is_said_does_not_hang_on_what_comes_after(bank: OnsetGlr, lost: Channels) -> None:
    cut = 2 * 1540
    part = replace(lost, grid=replace(lost.grid, n=cut), values=lost.values[:cut], valid=lost.valid[:cut])
    whole, early = bank(lost)[0].probability, bank(part)[0].probability
    assert early == pytest.approx(whole[: len(early)], rel=1e-9, abs=1e-12)


def test_after_a_named_line_the_watch_goes_on_without_it(bank: OnsetGlr) -> None:
    _, events, _ = bank(log_of(103, 4200.0, (("line_2", ONSET), ("line_4", 3000.0))))
    assert [e.subject for e in events] == ["line_2", "line_4"]
    assert 3000.0 < events[1].detected < 3300.0


def test_a_gap_is_bridged_and_makes_no_alarm(bank: OnsetGlr, lost: Channels) -> None:
    valid = np.array(lost.valid)
    valid[2 * 1200 : 2 * 1260] = False
    _, events, _ = bank(replace(lost, valid=valid))
    assert [e.subject for e in events] == ["line_8"]


@pytest.mark.parametrize(("speed", "lines"), [(25.6, ["line_7"]), (16.0, [])])
def test_a_sudden_squall_as_large_as_a_line_is_taken_for_it_and_the_event_says_so(
    bank: OnsetGlr, speed: float, lines: list[str]
) -> None:
    """A limit, stated: 700 N/(m/s)2 at 25.6 m/s is the pull of line 7, which lies ahead; at 16 m/s it is 39 % of it."""
    trap = {"mode": "squall", "onset": ONSET, "ramp": 20.0, "size": speed, "direction": 225.0}
    unseen = {"logged": False, "noise": 0.0, "quantum": 0.0}
    made = load_scenario(CONFIGS / "scenarios" / "fpso_line_lost.toml").model_dump(mode="json")["sensors"]
    _, events, _ = bank(log_of(104, 2600.0, traps=[trap], sensors=made | {"wind": unseen}))
    assert [e.subject for e in events] == lines
    assert all(e.cannot_tell is not None and "squall" in e.cannot_tell for e in events)


def test_an_alarm_that_sinks_is_told_as_cleared(bank: OnsetGlr, lost: Channels) -> None:
    eager = replace(bank, alarm=-9.0, warning=-8.5)
    events = eager(lost)[1]
    assert any(e.cleared is not None for e in events)
    assert events[-1].subject == "line_8"
    assert runs(np.array([np.nan, 1.0, 2.0, -1.0, 3.0]), 0.5) == [(1, 3), (4, 5)]


def test_the_bank_survives_json(bank: OnsetGlr, lost: Channels) -> None:
    again = OnsetGlr.from_dict(json.loads(json.dumps(bank.to_dict())))
    assert again(lost)[1:] == bank(lost)[1:]


def test_observability_is_the_rate_and_falls_with_the_sea(bank: OnsetGlr) -> None:
    rows = bank.observability()
    horizontal, _, along = bank.mooring.pulls(np.asarray(bank.place))
    turn = rotation(bank.place[2])[:2, :2]
    u = turn.T @ along[7]
    white = u[0] ** 2 * bank.noise.force[0] + u[1] ** 2 * bank.noise.force[1]
    assert rows["line_8"]["r"] == pytest.approx(horizontal[7] ** 2 / (2.0 * white))
    assert all(row["observable"] for row in rows.values())
    rough = replace(bank, noise=replace(bank.noise, force=tuple(40.0 * x for x in bank.noise.force)))
    blind = rough.observability()
    assert blind["line_7"]["r"] == pytest.approx(rows["line_7"]["r"] / 40.0)
    assert not blind["line_7"]["observable"]
    assert "not observable in this sea" in blind["line_7"]["sentence"]


def test_the_priors_of_the_run_file_are_used() -> None:
    settled = odds(beat(1.0, 1.0))
    assert settled.line == pytest.approx(np.log(3e-8 * 5.0 / 8.0))
    assert settled.pulse == pytest.approx(np.log(1.6e-3 * 5.0 / 3.0))


def test_what_the_bank_needs_is_asked_for(bank: OnsetGlr, lost: Channels) -> None:
    training = [Training(lost, (slice(0, 2000),))]
    bare = run_file().model_copy(update={"mooring": run_file().mooring.model_copy(update={"model": {}})})
    with pytest.raises(ConfigError, match="vessel"):
        OnsetGlr.fit(training, bare)
    names = tuple("x_heading" if name == "heading" else name for name in lost.names)
    with pytest.raises(ConfigError, match="heading"):
        bank(replace(lost, names=names))
    names = tuple("x_thrust" if name == "thrust_sway" else name for name in lost.names)
    with pytest.raises(ConfigError, match="thrust_sway"):
        bank(replace(lost, names=names))


def test_an_alarm_stops_the_walk_a_minute_later(bank: OnsetGlr, lost: Channels) -> None:
    mooring = bank.mooring
    filtering = Filter(bank.plant, bank.noise, bank.step, mooring, bank.place)
    eta, force = bank.inputs(lost)
    models = filtering.models(eta[:, 2])
    trace = over(filtering(eta, force, bias=bank.bias, models=models), models, mooring, bank.odds, bank.beat, 0.0)
    assert trace.named == trace.alarm + bank.beat.confirm
    assert trace.score[trace.alarm] >= 0.0 > trace.score[trace.alarm - 1]
    assert np.isnan(trace.score[trace.named + 1 :]).all()
    rig = rig_of(mooring)
    pulls = line_pulls(np.array([3.0, -2.0, 3.9]), rig, np.zeros(2))
    assert pulls.sum(axis=0) == pytest.approx(mooring.force(np.array([3.0, -2.0, 3.9])), rel=1e-9, abs=1e-3)


def without_fixes(log: Channels, start: float, stop: float) -> Channels:
    """Return a log whose position and heading are missing for a while."""
    rows = log.grid.window((start, stop))
    columns = [log.names.index(name) for name in ("north", "east", "heading")]
    values, valid = log.values.copy(), log.valid.copy()
    values[rows, columns[0] : columns[-1] + 1], valid[rows, columns[0] : columns[-1] + 1] = np.nan, False
    assert columns == [0, 1, 2]
    return replace(log, values=values, valid=valid)


@pytest.mark.parametrize("length", [30.0, 150.0, 700.0])
def test_a_gap_in_a_healthy_log_is_no_lost_line(bank: OnsetGlr, length: float) -> None:
    posterior, events, _ = bank(without_fixes(log_of(102, 7200.0), 3000.0, 3000.0 + length))
    assert events == ()
    judged = (posterior.time >= 3000.0) & (posterior.time < 3000.0 + length)
    assert judged.any() == (length < 60.0), "nothing is judged in a long gap"


def test_a_line_lost_in_a_gap_is_told_with_the_gap_as_its_interval(bank: OnsetGlr, lost: Channels) -> None:
    _, events, checks = bank(without_fixes(lost, ONSET - 100.0, ONSET + 20.0))
    (event,) = [e for e in events if e.kind != "environment"]
    assert (event.kind, event.subject) == ("unknown", "line_8")
    assert event.onset_interval == pytest.approx((ONSET - 100.0, ONSET + 20.0), abs=2.0)
    assert [r.kind for r in event.rivals] == ["line_lost", "environment"]
    assert not next(c for c in checks if c.name == "steady force" and not c.passed).passed


def test_stretches_lie_between_long_gaps() -> None:
    eta = np.zeros((100, 3))
    eta[10:13], eta[40:60, 1], eta[98:] = np.nan, np.nan, np.nan
    assert stretches(eta, 5) == (slice(0, 40), slice(60, 98))
    assert stretches(np.full((9, 3), np.nan), 5) == ()


def test_the_mean_of_cut_terms_gives_their_size_back() -> None:
    for size in (2.5, 4.0, 8.0):
        assert grown(size * (1.0 - np.exp(-CUT / size))) == pytest.approx(size, rel=1e-3)
    assert grown(1.1) == 1.0


@pytest.mark.parametrize(("factor", "least", "most"), [(1.0, 1.0, 1.3), (2.0, 3.0, 6.0)])
def test_a_rougher_sea_divides_the_evidence_by_its_power(factor: float, least: float, most: float) -> None:
    times, (made, models, mooring) = beat(1.0, 1.0), innovations(0.0)
    rough = replace(made, innovation=made.innovation * factor)
    settled = odds(times, 1.0)
    trace = over(rough, models, mooring, settled, times, 1e9)
    assert least <= trace.rise[-1] <= most
    late = settled._replace(memory=0.0)
    never = over(rough, models, mooring, late, times, 1e9)
    assert (never.rise == 1.0).all()
    cooler = late._replace(temper=settled.temper * trace.rise[-1], group=settled.group * trace.rise[-1])
    again = over(rough, models, mooring, cooler, times, 1e9)
    assert trace.logs == pytest.approx(again.logs, rel=1e-9, abs=1e-9)
    assert trace.score[-1] == pytest.approx(again.score[-1], rel=1e-9)
