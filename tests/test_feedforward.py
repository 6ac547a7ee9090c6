"""Truth: analytic (a regular wave, a share of the force that is known by construction), plain numpy, the simulator."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mooringdx.config import RunConfig, load_run
from mooringdx.errors import ConfigError
from mooringdx.hypotheses.onset_glr import OnsetGlr
from mooringdx.observers.feedforward import (
    Feed,
    Ground,
    best_of,
    bridged,
    candidates,
    lagged,
    learned,
    removed,
    running_mean,
    squared,
    told,
    weigh,
)
from mooringdx.observers.kalman import Filter
from mooringdx.observers.matrices import Noise, plant_of
from mooringdx.physics.response import closed_form
from mooringdx.physics.rig import mooring_of
from mooringdx.physics.vessel import load_vessel
from mooringdx.pipeline import prepare
from mooringdx.residuals.training import Training
from mooringdx.simulate import Scenario, load_scenario, simulate
from mooringdx.simulate.record import stream
from mooringdx.simulate.sea import VERTICAL, Waves, draw_waves, elevation, first_order, slow_drift
from mooringdx.simulate.streams import streams
from mooringdx.types import Array, Channels, replace

CONFIGS = Path(__file__).parents[1] / "configs"
NOISE = Noise((6e10, 2e10, 1e13), (4e5, 4e5, 1e12), (0.015, 0.015, 6e-4), (0.005, 0.005, 5e-5), 0.9, 0.1)
PLACE = (0.0, 0.0, 3.9)


# The simulator's new sensors


def regular(omega: float, n: int, dt: float) -> Waves:
    """Return one wave of unit amplitude, its crest at the origin at time zero."""
    return Waves(np.array([omega]), np.zeros(1), np.ones((1, 1), dtype=np.complex128), 40, n, n)


def test_a_probe_ahead_sees_a_head_sea_earlier_by_its_phase_analytic() -> None:
    n, dt = 4000, 0.25
    omega = 40 * 2.0 * np.pi / (n * dt)
    time, k = dt * np.arange(n), omega**2 / 9.81
    waves = regular(omega, n, dt)
    for angle, ahead in ((np.pi, 0.0), (np.pi, 60.0), (0.0, 60.0), (2.0, -30.0)):
        want = np.cos(omega * time - k * ahead * np.cos(angle))
        assert elevation(waves, angle, ahead) == pytest.approx(want, abs=1e-9)


def test_heave_and_pitch_are_the_hulls_answer_to_a_regular_wave_analytic() -> None:
    n, dt = 4000, 0.25
    omega = 40 * 2.0 * np.pi / (n * dt)
    hull = load_vessel(CONFIGS / "vessels" / "fpso200.toml").hull
    answer = closed_form(hull, np.array([omega]), 2.5)[[2, 4], 0]
    phase = np.exp(1j * omega * dt * np.arange(n))
    moved = first_order(regular(omega, n, dt), hull, 2.5, np.zeros(1), VERTICAL)
    assert moved == pytest.approx((answer[:, None] * phase).real.T, abs=1e-9)


def test_the_square_of_the_elevation_is_the_drift_where_the_vessel_answers() -> None:
    """Brute force: below a fifth of the waves' frequency 16 zeta^2 and the squared envelope are one."""
    from mooringdx.simulate.scenario import Sea

    waves = draw_waves(streams(3), 20000, 0.5, Sea(height=2.5, peak_period=7.0))
    drift, square = slow_drift(waves)[:, 0], 16.0 * elevation(waves, np.pi, 0.0) ** 2
    spectra = [np.fft.rfft(x - x.mean()) for x in (drift, square)]
    low = 2.0 * np.pi * np.fft.rfftfreq(20000, 0.5) < 0.2 * 2.0 * np.pi / 7.0
    rest = np.sum(np.abs(spectra[0] - spectra[1])[low] ** 2) / np.sum(np.abs(spectra[0])[low] ** 2)
    assert rest < 0.01


def scenario(duration: float, **sensors: Any) -> Scenario:
    body = load_scenario(CONFIGS / "scenarios" / "fpso_wave_probe.toml").model_dump(mode="json")
    body["record"] |= {"duration": duration, "settle": 1500.0}
    body["sensors"] |= sensors
    body["faults"] = [{**fault, "onset": 1500.0} for fault in body["faults"] if 1500.0 < duration < 4000.0]
    return Scenario.model_validate(body)


def test_a_probe_changes_nothing_else_of_a_log() -> None:
    silent = {"logged": False}
    with_probe = simulate(scenario(60.0), 1)[0].signals
    without, truth = simulate(scenario(60.0, wave=silent, motion=silent), 1)
    assert set(with_probe) - set(without.signals) == {"wave_elevation_1", "heave", "pitch"}
    for name, signal in without.signals.items():
        assert np.array_equal(signal.values, with_probe[name].values)
    assert not {"wave", "motion"} & set(truth["scenario"]["sensors"]), "older truths keep their bytes"
    assert [with_probe[name].unit for name in ("wave_elevation_1", "heave", "pitch")] == ["m", "m", "deg"]


# From squares to a force


def test_running_mean_and_bridge_are_what_plain_loops_give() -> None:
    rng = stream(1, "means")
    values = rng.normal(2.0, 1.0, (60, 2))
    values[20:30, 0] = np.nan
    mean, bridge = running_mean(values, 8.0), bridged(values, np.array([5.0, 6.0]), 8.0)
    for j in range(2):
        seen, slow, start = 0, 0.0, float([5.0, 6.0][j])
        for k in range(60):
            if np.isfinite(values[k, j]):
                seen += 1
                slow += (values[k, j] - slow) / min(seen, 8)
                start += (values[k, j] - start) / 8.0
                assert bridge[k, j] == values[k, j]
            else:
                assert bridge[k, j] == pytest.approx(start)
            assert mean[k, j] == pytest.approx(slow)


def test_squares_forget_an_offset_and_average_what_is_there() -> None:
    values = 3.0 + np.tile([[1.0], [-1.0]], (400, 1))
    values[:200:4] = np.nan
    square = squared(values, 0.5, 100.0, 4)
    assert square.shape == (200, 1)
    assert square[100:] == pytest.approx(1.0, abs=0.02)
    values[40:44] = np.nan
    assert np.isnan(squared(values, 0.5, 100.0, 4)[10])
    assert np.array_equal(lagged(np.arange(4.0)[:, None], 2)[:, 0], [0.0, 0.0, 0.0, 1.0])


def test_a_force_is_its_gain_times_late_squares_about_their_mean_analytic() -> None:
    feed = Feed(
        "wave envelope", ("a",), 2.0, np.array([1.0]), np.array([[3.0], [5.0], [7.0]]), (0.9,) * 3, (True, False, True)
    )
    squares = np.array([[2.0], [np.nan], [1.0], [1.0]])
    force = feed.force(squares, 1.0, 4.0)
    assert force[:, 1] == pytest.approx(0.0)
    assert force[:, 0] == pytest.approx([0.0, 0.0, 3.0, 0.75])
    assert force[:, 2] == pytest.approx([0.0, 0.0, 7.0, 1.75])


def ground(share: float, lag: int, n: int = 3600) -> tuple[Ground, Array]:
    """Return a record of the filter's own law, ``share`` of whose surge force is a square ``lag`` s old, and it."""
    ship = load_vessel(CONFIGS / "vessels" / "fpso200.toml")
    filtering = Filter(plant_of(ship.dynamics), NOISE, 1.0, mooring_of(ship), PLACE)
    rest = replace(NOISE, force=(6e10 * (1.0 - share), *NOISE.force[1:]))
    one = replace(filtering, noise=rest).model(PLACE[2])
    rng = stream(4, "known share")
    square = rng.standard_normal((n, 1)) ** 2
    force = np.zeros((n, 3))
    force[:, :1] = np.sqrt(6e10 * share / 2.0) * (lagged(square, lag) - 1.0)
    shocks = rng.standard_normal((n, 15)) @ np.linalg.cholesky(one.Q + 1e-18 * np.diag(np.diag(one.Q))).T
    x, measured, steered = np.zeros(15), np.empty((n, 3)), np.zeros((n, 3))
    for k in range(n):
        measured[k] = x[:3] + x[12:] + rng.standard_normal(3) * np.sqrt(np.diag(one.R)) + PLACE
        steered[k, 2] = -1.1e9 * x[2] - 3.5e10 * x[5]
        x = one.F @ x + one.G @ (force[k] + steered[k]) + shocks[k]
    return Ground(filtering, measured, steered, np.zeros(3), 600), square


@pytest.mark.parametrize(("share", "lag", "on"), [(0.92, 7, True), (0.45, 0, False)])
def test_the_share_that_is_known_by_construction_is_found_and_decides(share: float, lag: int, on: bool) -> None:
    """Analytic: the force's intensity is the sum of the two, and so R^2 the share."""
    record, square = ground(share, lag)
    feed = weigh(record, "wave envelope", ("wave_elevation_1",), square, range(0, 12))
    assert feed.explained[0] == pytest.approx(share, abs=0.04 if on else 0.13)
    assert abs(feed.explained[1]) < 0.1
    assert feed.on == (on, False, False)
    assert feed.gain[0, 0] == pytest.approx(np.sqrt(6e10 * share / 2.0), rel=0.15)
    if on:
        assert feed.lag == lag
    noise = stream(9, "other").standard_normal(square.shape) ** 2
    if not on:
        assert max(weigh(record, "x", ("x",), noise, (0,)).explained[:2]) < 0.1, "what is not the drift explains none"
        wrong = np.zeros((len(square), 3))
        wrong[:, 0] = -feed.gain[0, 0] * (square[:, 0] - 1.0)
        assert removed(record, wrong)[0] < -0.5, "the wrong sign adds three times what it should have taken"


def test_each_axis_is_fed_by_the_one_that_explains_it_best() -> None:
    wave = Feed("wave envelope", ("a",), 0.0, np.ones(1), np.ones((3, 1)), (0.95, 0.1, 0.0), (True, False, False))
    motion = Feed("heave and pitch", ("b",), 0.0, np.ones(1), np.ones((3, 1)), (0.85, 0.9, 0.1), (True, True, False))
    assert [f.on for f in best_of([wave, motion])] == [(True, False, False), (False, True, False)]
    assert [f.on for f in best_of([wave, motion], always=True)] == [(True, False, False), (False, True, True)]
    assert [row[1] for row in candidates(("pitch", "north", "wave_elevation_2"))] == [("wave_elevation_2",), ("pitch",)]
    assert "surge 0.95 on, sway 0.10 off" in wave.sentence


def test_a_dead_channel_is_no_candidate_and_a_silent_one_fails_its_check() -> None:
    assert learned(ground(0.5, 0, 700)[0], ("heave",), lambda names: np.zeros((700, len(names))), 1.0) == ()
    feed = Feed("wave envelope", ("a",), 0.0, np.ones(1), np.ones((3, 1)), (0.95, 0.1, 0.0), (True, False, False))
    rows = told([feed], (0.3, 0.0, 0.0), [np.full((50, 1), 1e-4)])
    assert [(row.name, row.passed) for row in rows] == [
        ("feed-forward", True), ("feed-forward", True), ("fed channels", False)
    ]  # fmt: skip
    gaps = np.ones((50, 1))
    gaps[:10] = np.nan
    assert told([feed], None, [gaps])[-1].value == pytest.approx(0.2)
    assert told([feed], None, [np.ones((50, 1))])[-1].passed


# On the simulator


def run_file() -> RunConfig:
    return load_run(CONFIGS / "runs" / "fpso_position_waves.toml")


@pytest.fixture(scope="module")
def bank() -> OnsetGlr:
    channels = prepare(simulate(scenario(4200.0), 1, 100)[0], run_file())
    return OnsetGlr.fit([Training(channels, (slice(0, channels.grid.n),))], run_file())


@pytest.fixture(scope="module")
def lost() -> Channels:
    return prepare(simulate(scenario(2100.0), 1, 101)[0], run_file())


def test_a_bow_probe_makes_the_drift_known_and_a_lost_line_quick(bank: OnsetGlr, lost: Channels) -> None:
    wave, motion = bank.feeds
    assert wave.on[0]
    assert not any(motion.on), "a 200 m hull hardly heaves in 7 s waves"
    assert -wave.gain[0, 0] / 16.0 == pytest.approx(1.5e4, rel=0.1), "the vessel file's drift coefficient"
    assert wave.lag == pytest.approx(100.0 / (9.81 / (2.0 * 2.0 * np.pi / 7.0)), abs=3.0), "at the group's speed"
    assert bank.drift[0] < 0.4 * 1.5e4 * 2.5**2, "of the mean drift force little is left unknown"
    _, events, rows = bank(lost)
    assert [e.subject for e in events] == ["line_7"]
    assert 1500.0 < events[0].detected < 1550.0
    said = {row.subject: row for row in rows if row.name == "feed-forward"}
    assert said["wave envelope"].value is not None
    assert said["wave envelope"].value > 0.8 > (said["heave and pitch"].value or 0.0)


def test_a_gap_of_the_probe_makes_no_alarm_and_a_missing_probe_is_asked_for(bank: OnsetGlr, lost: Channels) -> None:
    valid = np.array(lost.valid)
    valid[2 * 900 : 2 * 1020, lost.names.index("wave_elevation_1")] = False
    _, events, rows = bank(replace(lost, valid=valid))
    assert [e.subject for e in events] == ["line_7"]
    assert not next(row for row in rows if row.name == "fed channels").passed
    names = tuple("x_wave" if name == "wave_elevation_1" else name for name in lost.names)
    with pytest.raises(ConfigError, match="wave_elevation_1"):
        bank(replace(lost, names=names))


def test_a_fed_bank_survives_json(bank: OnsetGlr, lost: Channels) -> None:
    again = OnsetGlr.from_dict(json.loads(json.dumps(bank.to_dict())))
    assert again(lost)[1:] == bank(lost)[1:]
