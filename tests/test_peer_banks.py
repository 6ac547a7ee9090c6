"""Truth: explicit matrices, another filter, Lyapunov's equation, sums by hand, and lines lost on the simulator."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov

from mooringdx.config import RunConfig, load_run, validate
from mooringdx.errors import ConfigError, FitError
from mooringdx.hypotheses import HYPOTHESES
from mooringdx.hypotheses.dht import FLOOR, dht
from mooringdx.hypotheses.mle import FORGETTING, mle
from mooringdx.hypotheses.onset_glr import OnsetGlr
from mooringdx.hypotheses.peers import Family, Peer, Thesis, ThesisFamily, thesis
from mooringdx.hypotheses.peers.family import TEMPER
from mooringdx.hypotheses.peers.kernel import Lines, Rule, Stack, weigh
from mooringdx.hypotheses.peers.taught import lived, root
from mooringdx.hypotheses.peers.verdict import crossed, events, held, odds, rivals
from mooringdx.observers.kalman import HEADING_STEP, Filter
from mooringdx.observers.matrices import Model, Noise, model, plant_of
from mooringdx.observers.passive import single_losses, watch
from mooringdx.physics.frames import rotation
from mooringdx.physics.mooring import Mooring
from mooringdx.physics.rig import mooring_of
from mooringdx.physics.vessel import load_vessel
from mooringdx.pipeline import detect, fit, prepare
from mooringdx.residuals.training import Training
from mooringdx.simulate import Scenario, load_scenario, simulate
from mooringdx.simulate.record import stream
from mooringdx.types import Array, Channels, replace

CONFIGS = Path(__file__).parents[1] / "configs"
NOISE = Noise((6e10, 2e10, 1e13), (4e5, 4e5, 1e12), (0.015, 0.015, 6e-4), (0.005, 0.005, 5e-5), 0.9, 0.1)
SHIP = load_vessel(CONFIGS / "vessels" / "fpso200.toml")
PLANT, PLACE, ONSET = plant_of(SHIP.dynamics), np.array([0.0, 0.0, 3.9]), 1500.0


# The loop over hypotheses


def rigs() -> tuple[Mooring, ...]:
    """Return lines at fairleads ahead of the middle: two lost in turn, and none."""
    whole = replace(mooring_of(SHIP), fairleads=np.tile([30.0, 5.0], (8, 1)))
    return whole.without(["line_2"]), whole.without(["line_7"]), whole


def bank(headings: Array) -> tuple[list[tuple[Model, ...]], Stack, Lines]:
    models = [Filter(PLANT, NOISE, 1.0, rig, (0.0, 0.0, 3.9)).models(headings) for rig in rigs()]

    def each(key: str) -> Array:
        return np.array([[getattr(one, key) for one in row] for row in models])

    spread = each("S")
    stack = Stack(
        np.array([one.heading for one in models[0]]), each("F"), each("G"), each("K"), np.linalg.inv(spread),
        np.linalg.slogdet(spread)[1], each("stiffness"),
    )  # fmt: skip
    whole = rigs()[-1]
    shares = single_losses(8)[[1, 6, 8]]
    return models, stack, Lines(whole.fairleads, whole.anchors, whole.start, whole.step, whole.horizontal, shares)


def record(n: int) -> tuple[Array, Array, Array]:
    rng = stream(3, "peers")
    turned = 3.9 + 0.15 * np.sin(0.05 * np.arange(n))
    measured = np.column_stack([np.cumsum(rng.normal(0.0, 0.3, (n, 2)), axis=0), turned])
    measured[n // 2 : n // 2 + 3] = np.nan
    return measured, rng.normal(0.0, 1e5, (n, 3)), rng.normal(0.0, 1e5, (n, 3))


def turn_of(angle: float) -> Array:
    """Return the turn of all earth-axes states."""
    out = np.eye(15)
    for i in (0, 6, 9, 12):
        out[i : i + 2, i : i + 2] = rotation(angle)[:2, :2]
    return out


def by_hand(measured: Array, body: Array, earth: Array, start: Array, rule: Rule) -> tuple[Array, Array]:
    """Return what the kernel must return, by explicit matrices and densities."""
    models, stack, _ = bank(measured[:, 2])
    x, p = np.zeros((3, 15)), start.copy()
    x[:, :3], x[:, 6:9] = measured[0], [1e4, -2e4, 1e6]
    out = []
    for k, y in enumerate(measured):
        if rule.transition.size:
            joint = rule.transition * p[:, None]
            p = joint.sum(axis=0)
            x = (joint.T @ x) / p[:, None] if rule.mixed else x
        for i, rig in enumerate(rigs()):
            one = models[i][int(np.clip(round((x[i, 2] - stack.headings[0]) / HEADING_STEP), 0, len(models[i]) - 1))]
            T = turn_of(x[i, 2] - one.heading)
            back = T[:3, :3].T
            if np.isfinite(y).all():
                e = back @ (y - one.C @ x[i])
                density = np.exp(-0.5 * e @ np.linalg.solve(one.S, e)) / np.sqrt(np.linalg.det(one.S))
                p[i] *= density**rule.power
                x[i] = x[i] + T @ one.K @ e
            pull = T[:3, :3].T @ (rig.force(x[i, :3]) + earth[k])
            inner = T.T @ x[i]
            u = body[k] + rotation(one.heading).T @ (pull + one.stiffness @ inner[:3])
            x[i] = T @ (one.F @ inner + one.G @ u)
        p = np.maximum(p / p.sum(), rule.floor)
        p = start.copy() if k < rule.quiet else p / p.sum()
        out.append(p.copy())
    return np.array(out), x


@pytest.mark.parametrize("mixed", [False, True])
def test_the_kernel_is_what_explicit_matrices_and_densities_give(mixed: bool) -> None:
    measured, body, earth = record(60)
    _, stack, lines = bank(measured[:, 2])
    pi = np.array([[0.98, 0.0, 0.02], [0.0, 0.97, 0.03], [0.01, 0.02, 0.97]]) if mixed else np.zeros((0, 0))
    rule = Rule(pi, mixed, 1e-4, 0.02, 5)
    start = np.array([0.1, 0.2, 0.7])
    got = weigh(measured, body, earth, np.array([1e4, -2e4, 1e6]), start, stack, lines, rule)
    want = by_hand(measured, body, earth, start, rule)
    np.testing.assert_allclose(got[0], want[0], rtol=1e-7, atol=1e-12)
    np.testing.assert_allclose(got[1], want[1], rtol=1e-7, atol=1e-9)
    assert (want[0].max(axis=0) - want[0].min(axis=0) > 0.05).all(), "the probabilities move"


def test_without_mixing_every_hypothesis_is_a_kalman_filter_of_its_own() -> None:
    measured, body, _ = record(80)
    _, stack, lines = bank(measured[:, 2])
    rule = Rule(np.zeros((0, 0)), False, 1e-9, 1.0, 0)
    _, last = weigh(measured, body, np.zeros((80, 3)), np.ones(3), np.full(3, 1 / 3), stack, lines, rule)
    for i, rig in enumerate(rigs()):
        alone = Filter(PLANT, NOISE, 1.0, rig, (0.0, 0.0, 3.9))(measured, body, bias=np.ones(3))
        np.testing.assert_allclose(last[i], alone.final, rtol=1e-9, atol=1e-9)


# Alarms


def test_a_line_must_win_for_as_long_as_asked() -> None:
    none, choice = 2, np.full(100, 2)
    choice[10:14] = 0
    choice[30:50] = 1
    choice[35:37] = 2
    choice[60:90] = 0
    alarms = held(choice, 5, none)
    assert [(a.line, a.since, a.first, a.until) for a in alarms] == [(1, 30, 34, 54), (0, 60, 64, 94)]
    assert held(np.zeros(3, dtype=np.int64), 5, none) == ()
    (standing,) = held(np.r_[np.full(9, 2), np.zeros(9, dtype=np.int64)], 5, none)
    assert standing.until is None


def test_odds_that_cross_alarm_once_until_they_have_sunk() -> None:
    p = np.tile([0.001, 0.001, 0.998], (60, 1))
    p[8:20] = [0.1, 0.2, 0.7]
    p[10:12] = [0.2, 0.5, 0.3]
    p[14:20] = [0.6, 0.3, 0.1]
    p[50:] = [0.9, 0.0, 0.1]
    assert odds(p)[10] == pytest.approx(np.log(0.7 / 0.3))
    first, second = crossed(p, 0.0, -3.0, 6)
    assert (first.line, first.since, first.first, first.named, first.until) == (0, 8, 10, 16, 20)
    assert (second.line, second.since, second.first, second.named, second.until) == (0, 50, 50, 56, None)
    assert crossed(p, 9.0, -3.0, 6) == ()


def test_an_event_says_when_who_and_what_else_it_may_be() -> None:
    p = np.tile([0.001, 0.001, 0.998], (60, 1))
    p[50:] = [0.7, 0.06, 0.24]
    found = events(crossed(p, 0.0, -3.0, 6), p, ("line_1", "line_2"), (100.0, 2.0), "imm", 30.0, 0.0)
    (event,) = found
    assert (event.subject, event.onset, event.detected, event.named) == ("line_1", 200.0, 200.0, 212.0)
    assert event.onset_interval == (170.0, 200.0)
    assert event.probability == pytest.approx(0.7)
    assert [(r.kind, r.subject) for r in event.rivals] == [("environment", "force"), ("line_lost", "line_2")]
    assert event.cannot_tell is not None
    assert "onset_glr" in event.cannot_tell
    assert rivals(np.array([0.97, 0.02, 0.01]), 0, ("line_1", "line_2")) == ()


# Covariances that are learned


def test_the_simulated_plant_has_the_second_moments_of_lyapunovs_equation() -> None:
    rng, n = stream(5, "plant"), 400_000
    short = replace(NOISE, bias=(4e7, 4e7, 1e14))
    lines = mooring_of(SHIP).without(["line_3"])
    one = model(PLANT, short, 1.0, 3.9, lines.stiffness(PLACE))
    assert root(one, PLANT) @ root(one, PLANT).T == pytest.approx(one.Q, rel=1e-9, abs=1e-12 * np.abs(one.Q).max())
    measured, force = lived(PLANT, short, lines, PLACE, 1.0, rng.standard_normal((n, 15)), rng.standard_normal((n, 3)))
    moment = PLANT.inertia[2, 2]
    f = np.array(one.F)
    f[:, 2] -= one.G[:, 2] * moment * 0.05**2
    f[:, 5] -= one.G[:, 2] * moment * 2.0 * 0.8 * 0.05
    f[6:9] *= np.exp(-1.0 / 1000.0)
    q = np.array(one.Q)  # the noise of b enters after its decay
    p = solve_discrete_lyapunov(f, q)
    want = one.C @ p @ one.C.T + one.R
    got = (measured - PLACE).T @ (measured - PLACE) / n
    np.testing.assert_allclose(np.diag(got), np.diag(want), rtol=0.15)
    held_there = rotation(3.9) @ force.mean(axis=0) + lines.force(PLACE)
    assert np.hypot(*held_there[:2]) == pytest.approx(0.0, abs=1e-6 * np.hypot(*lines.force(PLACE)[:2]))


# On the simulator


def log_of(seed: int, duration: float, line: str | None = None, **change: Any) -> Channels:
    body = load_scenario(CONFIGS / "scenarios" / "fpso_line_lost.toml").model_dump(mode="json")
    body["record"] = {"duration": duration, "sample_time": 0.5, "settle": 1500.0}
    body["sea"] |= {"height": 1.5, "peak_period": 6.0}
    body["faults"] = [] if line is None else [{"kind": "line_lost", "subject": line, "onset": ONSET}]
    log, _ = simulate(Scenario.model_validate(body | change), 1, seed)
    kept = {name: s for name, s in log.signals.items() if not name.startswith("tension")}
    return prepare(type(log)(kept, log.source), run_file("imm"))


def run_file(word: str, **change: Any) -> RunConfig:
    body = load_run(CONFIGS / "runs" / "fpso_position.toml").model_dump(mode="json")
    body["clock"]["sample_time"] = 0.5
    return RunConfig.model_validate(body | {"bank": {"use": [word], **change}})


STILL = {"current": {"speed": 0.0}}


@pytest.fixture(scope="module")
def learned() -> tuple[OnsetGlr, list[Training]]:
    channels = log_of(90, 4200.0)
    training = [Training(channels, (slice(0, channels.grid.n),))]
    return OnsetGlr.fit(training, run_file("onset_glr")), training


@pytest.fixture(scope="module")
def lost() -> Channels:
    return log_of(91, 2200.0, "line_8")


def peer(learned: tuple[OnsetGlr, list[Training]], word: str, **change: Any) -> Peer:
    return Family(word).upon(*learned, run_file(word, **change))


def reference(learned: tuple[OnsetGlr, list[Training]], word: Any, **change: Any) -> Thesis:
    return ThesisFamily(word).upon(*learned, run_file(word, thesis=change))


def test_every_word_is_registered_once() -> None:
    words = [HYPOTHESES[w].word for w in (*TEMPER, "thesis_dht", "thesis_mle")]
    assert words == [*TEMPER, "thesis_dht", "thesis_mle"]


@pytest.mark.parametrize(("word", "limit"), [("imm", 60.0), ("shared_bias", 90.0), ("live_bias", 400.0)])
def test_a_lost_line_is_found_and_named(
    learned: tuple[OnsetGlr, list[Training]], lost: Channels, word: str, limit: float
) -> None:
    one = peer(learned, word)
    assert one.temper == TEMPER[word]
    posterior, found, checks = one(lost)
    assert posterior.probability.sum(axis=1) == pytest.approx(1.0)
    event = found[0]
    assert (event.kind, event.subject) == ("line_lost", "line_8")
    assert ONSET < event.detected < ONSET + limit
    assert [c.passed for c in checks] == [False], "a check says that this bank is there to compare with"
    cut = 2 * 1600
    part = replace(lost, grid=replace(lost.grid, n=cut), values=lost.values[:cut], valid=lost.valid[:cut])
    assert one(part)[0].probability == pytest.approx(posterior.probability[:cut], rel=1e-6, abs=1e-9)


def test_a_steady_current_of_half_a_line_is_a_loss_only_where_no_bias_takes_it_up(
    learned: tuple[OnsetGlr, list[Training]],
) -> None:
    """Towards line 8 with 0.22 MN: 0.48 of a line's pull."""
    healthy = log_of(92, 2400.0)
    assert peer(learned, "no_bias")(healthy)[1] != ()
    for word in ("imm", "shared_bias", "live_bias"):
        assert peer(learned, word)(healthy)[1] == ()


def test_the_shared_bias_is_a_mean_that_is_late(learned: tuple[OnsetGlr, list[Training]], lost: Channels) -> None:
    one = peer(learned, "shared_bias", peers={"memory": 300.0, "delay": 60.0})
    base = learned[0]
    eta, force = base.inputs(lost)
    bias = Filter(base.plant, base.noise, base.step, base.mooring, base.place)(eta, force, bias=base.bias).bias
    got = one._shared(eta, force)
    np.testing.assert_allclose(got[900], bias[541:841].mean(axis=0), rtol=1e-9)
    np.testing.assert_allclose(got[10], base.bias, rtol=1e-9)
    assert one.temper == 4.0
    assert peer(learned, "shared_bias", peers={"temper": 7.0}).temper == 7.0


def test_imm_passes_on_the_rate_of_the_priors(learned: tuple[OnsetGlr, list[Training]]) -> None:
    pi = peer(learned, "imm", line_rate="8/year").rule.transition
    np.testing.assert_allclose(pi.sum(axis=1), 1.0)
    fast = replace(peer(learned, "imm"), base=replace(learned[0], rates=(8e-4, 1.0, 1.0)))
    np.testing.assert_allclose(fast.rule.transition[-1, :-1], 1e-4 * learned[0].step)
    np.testing.assert_allclose(fast.rule.transition[:-1, -1], 1e-4 * learned[0].step)
    assert peer(learned, "live_bias").rule.transition.size == 0


@pytest.mark.parametrize("word", ["thesis_dht", "thesis_mle"])
@pytest.mark.parametrize("covariance", ["simulated", "no_fault"])
def test_the_thesis_finds_a_line_in_still_water(
    learned: tuple[OnsetGlr, list[Training]], word: str, covariance: str
) -> None:
    one = reference(learned, word, covariance=covariance)
    posterior, found, checks = one(log_of(93, 2200.0, "line_7", **STILL))
    assert posterior.probability.sum(axis=1) == pytest.approx(1.0)
    late = [e for e in found if e.detected > ONSET]
    assert [e.subject for e in found if e.detected < ONSET] == []
    assert late[0].subject == "line_7"
    assert late[0].detected - late[0].onset == pytest.approx(20.0, abs=1.0)
    assert late[0].detected < ONSET + 200.0
    rows = {c.name: c for c in checks}
    assert ("simulation" in rows["error covariance"].detail) == (covariance == "simulated")
    assert not rows["a bank to compare with"].passed
    assert "onset_glr" in rows["a bank to compare with"].remedy


def test_a_current_of_half_a_line_raises_the_banner_and_still_water_does_not(
    learned: tuple[OnsetGlr, list[Training]],
) -> None:
    one = reference(learned, "thesis_dht", covariance="no_fault")
    rows = []
    for change in ({}, STILL):
        check = next(c for c in one(log_of(94, 2400.0, **change))[2] if c.name == "unexplained force")
        rows.append(check)
    assert [c.passed for c in rows] == [False, True]
    assert rows[0].value == pytest.approx(0.5, abs=0.15), "0.48 of a line's pull"


@pytest.mark.parametrize("word", ["thesis_dht", "thesis_mle"])
def test_blocks_change_nothing(
    learned: tuple[OnsetGlr, list[Training]], lost: Channels, word: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The whole record in one: observers, DHT and MLE called once."""
    one = reference(learned, word, covariance="no_fault")
    eta, force = one.inputs(lost)
    eta[1000:1010] = np.nan
    whole = watch(one.observer(), one.base.mooring, single_losses(8), eta, force, 0.5)
    if word == "thesis_dht":
        want = dht(whole.innovation, one.covariances, FLOOR["text"])
    else:
        cost = mle(whole.innovation, one.covariances, FORGETTING["text"] ** 5)
        want = np.exp(cost.min(axis=1)[:, None] - cost)
        want /= want.sum(axis=1, keepdims=True)
    monkeypatch.setattr(thesis, "_BLOCK", 333)
    np.testing.assert_allclose(one.weighed(eta, force), want, rtol=1e-9, atol=1e-12)


def test_no_fault_covariances_are_second_moments_about_zero_for_all_alike(
    learned: tuple[OnsetGlr, list[Training]],
) -> None:
    one = reference(learned, "thesis_dht", covariance="no_fault")
    eta, force = one.inputs(learned[1][0].channels)
    error = watch(one.observer(), one.base.mooring, np.ones((1, 8)), eta, force, 0.5).innovation[1200:, 0]
    for s in one.covariances:
        np.testing.assert_allclose(s, error.T @ error / len(error), rtol=1e-9)


def test_both_survive_json(learned: tuple[OnsetGlr, list[Training]], lost: Channels) -> None:
    for one in (peer(learned, "imm"), reference(learned, "thesis_mle", covariance="no_fault", equations="mended")):
        again = HYPOTHESES[one.word].from_dict(json.loads(json.dumps(one.to_dict())))
        assert again(lost)[1:] == one(lost)[1:]


def test_samples_too_far_apart_for_the_observer_are_told(learned: tuple[OnsetGlr, list[Training]]) -> None:
    base, training = learned
    coarse = replace(base, noise=replace(base.noise, frequency=9.0))
    with pytest.raises(FitError, match="sample_time"):
        ThesisFamily("thesis_dht").upon(coarse, training, run_file("thesis_dht"))


def test_a_run_file_fits_stores_and_detects_with_it(
    learned: tuple[OnsetGlr, list[Training]], lost: Channels, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(OnsetGlr, "fit", lambda *_: learned[0])  # what it identifies is told elsewhere
    run = run_file("thesis_dht", thesis={"covariance": "no_fault"})
    body = run.model_dump(mode="json")
    body["baseline"] = {"window": [0.0, 1400.0]}
    run = RunConfig.model_validate(body)
    learns = fit([lost], run)
    assert set(learns.banks) == {"thesis_dht"}
    found = detect(lost, learns, name="lost")
    assert found.posteriors[0].bank == "thesis_dht"
    assert {"error covariance", "unexplained force"} <= {c.name for c in found.checks}


def test_a_channel_that_was_there_is_asked_for(learned: tuple[OnsetGlr, list[Training]], lost: Channels) -> None:
    bare = replace(lost, names=tuple("x_thrust" if name == "thrust_sway" else name for name in lost.names))
    for one in (peer(learned, "imm"), reference(learned, "thesis_dht", covariance="no_fault")):
        with pytest.raises(ConfigError, match=f"{one.word}.*thrust_sway"):
            one(bare)


def test_words_that_are_not_known_are_refused() -> None:
    body = run_file("thesis_dht").model_dump(mode="json")
    body["bank"]["thesis"]["covariance"] = "guessed"
    with pytest.raises(ConfigError, match="simulated"):
        validate(RunConfig, body, Path("a.toml"))
