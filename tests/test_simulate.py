"""The small simulator against analysis, quadrature, another integrator, and plain numpy."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp, trapezoid
from scipy.optimize import fsolve

from mooringdx.errors import ConfigError
from mooringdx.simulate import Scenario, load_scenario, save_log, simulate
from mooringdx.simulate.record import stream
from mooringdx.simulate.rig import drift_about, tension, tensions
from mooringdx.simulate.scenario import Failure
from mooringdx.simulate.sea import GRAVITY, hull_answer, jonswap, wander, waves

SCENARIOS = Path(__file__).parents[1] / "configs" / "scenarios"
DATA = Path(__file__).parents[1] / "data"
ONSET = 1320.0


@pytest.fixture(scope="module")
def logs() -> dict[str, Any]:
    names = ("demo", "demo_healthy", "demo_sensor_dead")
    return {name: simulate(load_scenario(SCENARIOS / f"{name}.toml"), 1) for name in names}


def rig() -> tuple[np.ndarray, np.ndarray, float, np.ndarray, float]:
    azimuths = np.radians(30.0 + 60.0 * np.arange(6))
    outwards = np.column_stack([np.cos(azimuths), np.sin(azimuths)])
    fairleads = 0.3 * outwards * np.array([1.0, 0.7])
    return fairleads, fairleads + 12.0 * outwards, 12.0, np.array([4.0, 8.64, 4.0, 20.0]), 0.625


def plain_slope(state, load, current, holds, mass, damping, fairleads, anchors, rest, spring, share):
    """The equation of motion with matrices, all lines at once."""
    c, s = np.cos(state[2]), np.sin(state[2])
    turn = np.array([[c, -s], [s, c]])
    arms = fairleads @ turn.T
    velocity = turn @ state[3:5]
    towards = anchors - state[:2] - arms
    distance = np.linalg.norm(towards, axis=1)
    unit = towards / distance[:, None]
    moving = velocity + state[5] * np.column_stack([-arms[:, 1], arms[:, 0]])
    rate = -(unit * moving).sum(axis=1)
    pull = spring[0] + spring[1] * (distance - rest) + spring[2] * rate + spring[3] * rate * np.abs(rate)
    force = (holds * share * np.maximum(pull, 0.0))[:, None] * unit
    body = turn.T @ (load[:2] + force.sum(axis=0)) - damping[:2] * (state[3:5] - turn.T @ current)
    moment = load[2] + (arms[:, 0] * force[:, 1] - arms[:, 1] * force[:, 0]).sum() - damping[2] * state[5]
    return np.array([*velocity, state[5], *(body / mass[:2]), moment / mass[2]])


MASS, DAMPING = np.array([80.0, 140.0, 32.0]), np.array([6.0, 20.0, 8.0])


def test_spectrum_has_the_asked_height_and_peak_analytic() -> None:
    omega = np.linspace(0.0, 20.0, 20001)
    density = jonswap(omega, 0.06, 1.5, 3.3)
    assert 4.0 * np.sqrt(trapezoid(density, omega)) == pytest.approx(0.06, rel=1e-6)
    assert omega[density.argmax()] == pytest.approx(2 * np.pi / 1.5, abs=2e-3)


def test_peakedness_one_is_bretschneider_analytic() -> None:
    omega = np.linspace(0.0, 20.0, 20001)
    ratio = omega[2500:12000] * 1.5 / (2 * np.pi)
    bare = ratio**-5 * np.exp(-1.25 * ratio**-4)
    density = jonswap(omega, 0.06, 1.5, 1.0)[2500:12000]
    np.testing.assert_allclose(density / density.max(), bare / bare.max(), rtol=1e-9)


@pytest.mark.parametrize("heading", [0.3, 1.2, 2.9, -1.9])
def test_hull_averages_the_orbit_quadrature(heading: float) -> None:
    omega, length, draught = np.array([3.0, 4.2, 6.5]), 1.974, 0.153
    answer = hull_answer(omega, heading, length, draught)
    for i, w in enumerate(omega):
        k = w**2 / GRAVITY
        a = k * np.cos(heading)
        half = length / 2
        deep = quad(np.exp, -k * draught, 0.0)[0] / (k * draught)
        mean = quad(np.cos, -a * half, a * half)[0] / (a * length)
        first = quad(lambda u: u * np.sin(u), -a * half, a * half)[0] / a**2 * 12.0 / length**3
        assert answer[0, i] == pytest.approx(-1j * np.cos(heading) * deep * mean, rel=1e-9)
        assert answer[1, i] == pytest.approx(-1j * np.sin(heading) * deep * mean, rel=1e-9)
        assert answer[2, i] == pytest.approx(-np.sin(heading) * deep * first, rel=1e-9)


def test_a_point_follows_the_orbit_whose_variance_is_the_elevations_analytic() -> None:
    motion, envelope = waves(np.random.default_rng(3), 40000, 0.1, (0.06, 1.5, 3.3), 2.0, 0.35, (1e-6, 1e-6))
    assert 4.0 * np.sqrt(motion[:, 0].var() + motion[:, 1].var()) == pytest.approx(0.06, rel=0.06)
    assert envelope.mean() == pytest.approx(1.0, rel=1e-12)
    assert envelope.var() == pytest.approx(1.0, rel=0.15)  # the squared envelope of a Gaussian process is exponential


def test_waves_do_not_repeat_within_the_record() -> None:
    surge = waves(np.random.default_rng(4), 30000, 0.1, (0.06, 1.5, 3.3), 2.9, 0.35, (1.974, 0.153))[0][:, 0]
    padded = np.fft.rfft(surge, 2 * surge.size)
    lag = np.fft.irfft(np.abs(padded) ** 2)[: surge.size // 2]
    assert np.abs(lag[600:]).max() < 0.2 * lag[0]


def test_wander_has_the_asked_spread_and_memory_analytic() -> None:
    x = wander(np.random.default_rng(5), 400000, 0.1, 0.3, 6.0)
    assert x.std() == pytest.approx(0.3, rel=0.05)
    assert np.mean(x[60:] * x[:-60]) / x.var() == pytest.approx(np.exp(-1.0), abs=0.04)


def test_tension_never_pushes_and_is_linear_in_between_analytic() -> None:
    spring = rig()[3]
    assert tension(-1.0, 0.0, spring) == 0.0
    assert tension(0.1, 0.0, spring) == pytest.approx(4.864)
    assert tension(0.0, -0.1, spring) == pytest.approx(4.0 - 0.4 - 0.2)


def test_integration_equals_its_plain_twin() -> None:
    rng = np.random.default_rng(6)
    loads, currents = rng.normal(0.0, 1.0, (200, 3)), rng.normal(0.0, 0.05, (200, 2))
    holds = np.ones((200, 6))
    holds[90:, 3] = 0.0
    args = (MASS, DAMPING, *rig())
    got = drift_about(loads, currents, holds, 0.1, 0.4, *args)
    state = np.array([0.0, 0.0, 0.4, 0.0, 0.0, 0.0])
    for k in range(199):
        load, flow = loads[k : k + 2], currents[k : k + 2]
        a = plain_slope(state, load[0], flow[0], holds[k], *args)
        b = plain_slope(state + 0.05 * a, load.mean(axis=0), flow.mean(axis=0), holds[k], *args)
        c = plain_slope(state + 0.05 * b, load.mean(axis=0), flow.mean(axis=0), holds[k], *args)
        d = plain_slope(state + 0.1 * c, load[1], flow[1], holds[k], *args)
        state = state + 0.1 / 6.0 * (a + 2 * b + 2 * c + d)
        np.testing.assert_allclose(got[k + 1], state[:3], rtol=1e-9, atol=1e-12)


def test_integration_agrees_with_another_integrator() -> None:
    time = 0.1 * np.arange(600)
    loads = np.column_stack([0.5 * np.sin(0.5 * time), 0.4 * np.cos(0.3 * time), 0.1 * np.sin(0.2 * time)])
    currents = np.column_stack([0.03 + 0.01 * np.sin(0.1 * time), -0.02 * np.ones(600)])
    args = (MASS, DAMPING, *rig())
    got = drift_about(loads, currents, np.ones((600, 6)), 0.1, 0.0, *args)

    def rhs(t: float, state: np.ndarray) -> np.ndarray:
        load = np.array([np.interp(t, time, column) for column in loads.T])
        flow = np.array([np.interp(t, time, column) for column in currents.T])
        return plain_slope(state, load, flow, np.ones(6), *args)

    other = solve_ivp(rhs, (0.0, time[-1]), np.zeros(6), t_eval=time, rtol=1e-8, atol=1e-10, max_step=0.1)
    np.testing.assert_allclose(got, other.y[:3].T, atol=1e-6)


def test_a_steady_load_is_held_where_the_forces_balance() -> None:
    load, hold = np.array([0.5, -0.3, 0.05]), np.array([1.0, 1.0, 1.0, 0.0, 1.0, 1.0])
    args = (MASS, DAMPING, *rig())
    n = 20000
    path = drift_about(np.tile(load, (n, 1)), np.zeros((n, 2)), np.tile(hold, (n, 1)), 0.1, 0.0, *args)

    def unbalanced(place: np.ndarray) -> np.ndarray:
        return plain_slope(np.array([*place, 0.0, 0.0, 0.0]), load, np.zeros(2), hold, *args)[3:]

    np.testing.assert_allclose(path[-1], fsolve(unbalanced, path[-1] * 0.5), atol=1e-6)


def test_the_surge_period_is_about_thirteen_seconds() -> None:
    scenario = Scenario.model_validate(
        {"sea": {"height": 1e-6, "drift_force": 0.0}, "wind": {"speed": 0.0}, "current": {"speed": 0.0, "sd": 0.0}}
    )
    stiffness = 0.0
    mooring = scenario.mooring
    for line in mooring.lines:
        c = np.cos(np.radians(line.azimuth))
        sideways = mooring.pretension / mooring.anchor_distance * (1.0 - c**2)
        stiffness += mooring.horizontal_share * (mooring.stiffness * c**2 + sideways)
    assert 2 * np.pi * np.sqrt(scenario.vessel.mass[0] / stiffness) == pytest.approx(13.0, rel=0.06)


def test_logged_tension_is_the_spring_law_on_the_whole_motion_plain_twin() -> None:
    rng = np.random.default_rng(8)
    motion = np.cumsum(rng.normal(0.0, 0.002, (300, 3)), axis=0)
    holds = np.ones((300, 6))
    holds[200:, 1] = 0.0
    fairleads, anchors, rest, spring, _ = rig()
    got = tensions(motion, 0.1, holds, 0.05, fairleads, anchors, rest, spring)
    c, s = np.cos(motion[:, 2])[:, None], np.sin(motion[:, 2])[:, None]
    north = motion[:, :1] + c * fairleads[:, 0] - s * fairleads[:, 1]
    east = motion[:, 1:2] + s * fairleads[:, 0] + c * fairleads[:, 1]
    distance = np.hypot(anchors[:, 0] - north, anchors[:, 1] - east)
    rate = np.gradient(distance, 0.1, axis=0)
    pull = np.maximum(0.0, spring[0] + spring[1] * (distance - rest) + spring[2] * rate + spring[3] * rate * abs(rate))
    np.testing.assert_allclose(got, np.where(holds > 0, pull, 0.05), rtol=1e-9, atol=1e-12)


def test_before_the_fault_the_record_is_the_healthy_one(logs: dict[str, Any]) -> None:
    healthy = logs["demo_healthy"][0].signals
    for name in ("demo", "demo_sensor_dead"):
        for key, signal in logs[name][0].signals.items():
            before = signal.time < ONSET - 0.2
            np.testing.assert_array_equal(signal.values[before], healthy[key].values[before])


def test_a_lost_line_hangs_slack_and_the_vessel_moves_away_from_its_anchor(logs: dict[str, Any]) -> None:
    lost, healthy = logs["demo"][0].signals, logs["demo_healthy"][0].signals
    after = lost["tension_4"].time >= ONSET
    assert lost["tension_4"].values[after].mean() == pytest.approx(0.05, abs=0.002)
    assert lost["tension_4"].values[after].std() == pytest.approx(0.02, rel=0.1)
    late = lost["north"].time > ONSET + 60.0
    shift = np.array([np.mean(lost[a].values[late] - healthy[a].values[late]) for a in ("north", "east")])
    away = -np.array([np.cos(np.radians(210.0)), np.sin(np.radians(210.0))])
    assert shift @ away > 0.15
    assert lost["tension_1"].values[late].mean() < healthy["tension_1"].values[late].mean() - 1.0


def test_a_dead_gauge_reads_its_noise_and_nothing_else_changes(logs: dict[str, Any]) -> None:
    dead, healthy = logs["demo_sensor_dead"][0].signals, logs["demo_healthy"][0].signals
    after = dead["tension_4"].time >= ONSET
    assert abs(dead["tension_4"].values[after].mean()) < 0.002
    for key, signal in dead.items():
        if key != "tension_4":
            np.testing.assert_array_equal(signal.values, healthy[key].values)


def test_every_axis_has_a_stream_of_its_own() -> None:
    names = [
        "waves",
        "wind",
        "current",
        *(f"noise {a}" for a in ("north", "east", "heading", "tension_1", "tension_2")),
    ]
    draws = np.array([stream(1, name).standard_normal(5000) for name in names])
    off = np.corrcoef(draws) - np.eye(len(names))
    assert np.abs(off).max() < 4.0 / np.sqrt(5000)
    np.testing.assert_array_equal(draws[0], stream(1, "waves").standard_normal(5000))


def test_sensor_noise_is_independent_between_axes() -> None:
    still: dict[str, Any] = {"sea": {"height": 1e-9, "drift_force": 0.0}, "wind": {"speed": 0.0}}
    still |= {"current": {"speed": 0.0, "sd": 0.0}, "record": {"duration": 1000.0}}
    signals = simulate(Scenario.model_validate(still), 2)[0].signals
    values = np.array([s.values for s in signals.values()])
    assert np.abs(np.corrcoef(values) - np.eye(len(values))).max() < 4.0 / np.sqrt(values.shape[1])
    np.testing.assert_allclose(values.std(axis=1), [0.001, 0.001, 0.05] + 6 * [0.02], rtol=0.05)


def test_the_seed_decides_everything() -> None:
    scenario = Scenario.model_validate({"record": {"duration": 60.0}})
    first, again, other = (simulate(scenario, seed)[0].signals for seed in (7, 7, 8))
    for key in first:
        np.testing.assert_array_equal(first[key].values, again[key].values)
        assert np.any(first[key].values != other[key].values)


def test_the_clock_starts_at_zero_and_keeps_its_step(logs: dict[str, Any]) -> None:
    for signal in logs["demo"][0].signals.values():
        np.testing.assert_array_equal(signal.time, np.round(0.1 * np.arange(15000), 6))


@pytest.mark.parametrize("ending", ["csv", "mcap"])
def test_the_stored_logs_are_what_the_simulator_makes(logs: dict[str, Any], tmp_path: Path, ending: str) -> None:
    sums = dict(reversed(line.split()) for line in (DATA / "SHA256SUMS").read_text().splitlines())
    stored = (DATA / f"demo.{ending}").read_bytes()
    assert hashlib.sha256(stored).hexdigest() == sums[f"demo.{ending}"]
    assert len(stored) <= 2_000_000
    made = tmp_path / f"demo.{ending}"
    save_log(logs["demo"][0], made)
    assert made.read_bytes() == stored, "make the logs anew with `make data`, and say so in the changelog"


def test_the_stored_truth_is_the_simulators(logs: dict[str, Any]) -> None:
    assert json.loads((DATA / "demo.truth.json").read_text()) == json.loads(json.dumps(logs["demo"][1]))


def test_an_unknown_ending_is_one_sentence(logs: dict[str, Any], tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="unknown log format 'xyz'"):
        save_log(logs["demo"][0], tmp_path / "demo.xyz")


def test_truth_says_what_was_put_in(logs: dict[str, Any]) -> None:
    truth = logs["demo"][1]
    assert truth["healthy_until"] == ONSET
    assert [(f["kind"], f["subject"], f["onset"]) for f in truth["faults"]] == [("line_lost", "line_4", ONSET)]
    assert truth["traps"] == []
    assert truth["conditions"]["wave_height"] == 0.06
    assert logs["demo_healthy"][1]["faults"] == []
    assert logs["demo_healthy"][1]["healthy_until"] == 1500.0
    assert logs["demo_sensor_dead"][1]["faults"][0]["mode"] == "dead"


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_scenario_loads(path: Path) -> None:
    assert load_scenario(path).record.duration > 0.0


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[sea]\nheigth = 1.0", "did you mean 'height'"),
        ('[[faults]]\nkind = "line_lost"\nsubject = "line_7"\nonset = 10.0', "unknown subject 'line_7'"),
        ('[[faults]]\nkind = "line_lost"\nsubject = "line_1"\nonset = 1e9', "after the record's end"),
        ('[[faults]]\nkind = "sensor_fault"\nsubject = "tension_1"\nonset = 1.0', 'needs mode = "dead"'),
    ],
)
def test_a_wrong_scenario_is_one_sentence(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "x.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=says) as caught:
        load_scenario(path)
    assert "\n" not in str(caught.value)


def test_a_lost_line_has_no_mode() -> None:
    with pytest.raises(ValueError, match="has no mode"):
        Failure(kind="line_lost", subject="line_1", onset=1.0, mode="dead")
