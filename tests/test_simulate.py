"""The simulator: its log does what its scenario says, by the laws that it names."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mooringdx.errors import ConfigError
from mooringdx.physics.mooring import Mooring, equilibrium
from mooringdx.physics.response import closed_form
from mooringdx.physics.rig import fault_tables, mooring_of, neutral, sliding
from mooringdx.physics.vessel import VesselModel, load_vessel
from mooringdx.physics.waves import density
from mooringdx.simulate import Scenario, load_scenario, save_log, simulate
from mooringdx.simulate.faults import Failure, Trap, grown
from mooringdx.simulate.plant import command, run, slope, tensions
from mooringdx.simulate.record import stream
from mooringdx.simulate.rig import NEVER, Rig, draw_rig
from mooringdx.simulate.scenario import Sea, Sensor
from mooringdx.simulate.sea import draw_waves, first_order, record, squared_envelope
from mooringdx.simulate.sensors import read
from mooringdx.simulate.streams import streams, wander
from mooringdx.simulate.weather import draw_weather
from mooringdx.types import Array, RawLog

ROOT = Path(__file__).parents[1]
SCENARIOS, DATA = ROOT / "configs" / "scenarios", ROOT / "data"
ONSET = 1320.0
CALM: dict[str, Any] = {"sea": {"height": 0.0}, "wind": {"speed": 0.0}, "current": {"speed": 0.0, "sd": 0.0}}
FLAT = np.zeros(1)
DEMO = ("demo", "demo_healthy", "demo_sensor_dead")


@pytest.fixture(scope="module")
def logs() -> dict[str, Any]:
    return {name: simulate(load_scenario(SCENARIOS / f"{name}.toml"), 1) for name in DEMO}


@pytest.fixture(scope="module")
def tank() -> VesselModel:
    return load_vessel(ROOT / "configs" / "vessels" / "cybership3.toml")


def scenario(**parts: Any) -> Scenario:
    return Scenario.model_validate({"record": {"duration": 60.0, "settle": 20.0}, **parts})


def rig_of(duration: float = 60.0, **parts: Any) -> Rig:
    return draw_rig(scenario(**parts), streams(1), 0.1 * np.arange(round(10 * duration)))


def ran(rig: Rig, loads: Array, first: Array | None = None, dt: float = 0.1) -> tuple[Array, Array, Array]:
    first = rig.rest if first is None else first
    return run(first, loads, rig.levels, rig.effect, rig.misread, dt, rig.substeps, rig.hull, rig.lines, rig.loop)


def column(made: tuple[RawLog, Any], name: str) -> Array:
    return made[0].signals[name].values


# --- the sea -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("height", "period", "dt"), [(0.06, 1.5, 0.1), (2.5, 7.0, 0.5)])
def test_three_hours_of_sea_have_the_asked_height_monte_carlo(height: float, period: float, dt: float) -> None:
    sea, found = Sea(height=height, peak_period=period, spread=10.0), []
    for seed in range(20):
        waves = draw_waves(streams(seed), round(10800.0 / dt), dt, sea)
        found.append(4.0 * record(waves, waves.amplitude.sum(axis=0)).std())
    assert np.mean(found) == pytest.approx(height, rel=0.015)


def test_a_record_is_its_sum_of_cosines_brute_force() -> None:
    waves = draw_waves(streams(3), 301, 0.1, Sea())
    time = 0.1 * np.arange(301)
    by_hand = (waves.amplitude[0][:, None] * np.exp(1j * np.outer(waves.omega, time))).sum(axis=0)
    np.testing.assert_allclose(record(waves, waves.amplitude[0]), by_hand.real, atol=1e-12)
    np.testing.assert_allclose(squared_envelope(waves), 8.0 * np.abs(by_hand) ** 2, atol=1e-12)


def test_slow_drift_has_mean_squared_height_and_an_exponential_law_analytic() -> None:
    values = squared_envelope(draw_waves(streams(4), 200_000, 0.1, Sea()))
    assert values.mean() == pytest.approx(0.06**2, rel=0.03)
    assert values.std() == pytest.approx(0.06**2, rel=0.06)


def test_waves_do_not_repeat_within_the_record() -> None:
    waves = draw_waves(streams(4), 30_000, 0.1, Sea())
    surge = record(waves, waves.amplitude[0])
    lag = np.fft.irfft(np.abs(np.fft.rfft(surge, 2 * surge.size)) ** 2)[: surge.size // 2]
    assert np.abs(lag[600:]).max() < 0.2 * lag[0]


def test_first_order_motion_has_the_variance_of_spectrum_times_answer_quadrature(tank: VesselModel) -> None:
    angle = np.radians(195.0)
    moved = first_order(draw_waves(streams(5), 200_000, 0.1, Sea()), tank.hull, angle, FLAT)
    omega = np.linspace(0.5, 40.0, 40_000)
    spectrum = density("jonswap", omega, 0.06, 1.5, 3.3)
    for i, row in enumerate((0, 1, 5)):
        wanted = np.trapezoid(spectrum * np.abs(closed_form(tank.hull, omega, angle)[row]) ** 2, omega)
        assert moved[:, i].std() == pytest.approx(np.sqrt(wanted), rel=0.03)


def test_a_turned_sea_is_the_sea_from_there(tank: VesselModel) -> None:
    waves = draw_waves(streams(6), 2000, 0.1, Sea())
    turn = np.radians(40.0) * np.clip((np.arange(2000) - 500) / 500, 0.0, 1.0)
    turned = first_order(waves, tank.hull, 3.4, turn)
    np.testing.assert_allclose(turned[:500], first_order(waves, tank.hull, 3.4, FLAT)[:500], atol=1e-12)
    there = first_order(waves, tank.hull, 3.4 + np.radians(40.0), FLAT)
    np.testing.assert_allclose(turned[1000:], there[1000:], atol=1e-12)


def test_between_two_headings_of_the_turn_the_blend_is_close_to_the_answer_itself(tank: VesselModel) -> None:
    waves = draw_waves(streams(6), 5000, 0.1, Sea())
    half = np.radians(7.5)  # furthest from the nodes at 0 and 15 deg
    turn = np.concatenate([np.full(4999, half), [2 * half]])
    blend = first_order(waves, tank.hull, 3.4, turn)[:4999]
    exact = first_order(waves, tank.hull, 3.4 + half, FLAT)[:4999]
    assert np.all((blend - exact).std(axis=0) < 0.05 * exact.std(axis=0))


def test_wander_has_the_asked_spread_and_memory_analytic() -> None:
    x = wander(np.random.default_rng(5), 400_000, 0.1, 0.3, 6.0)
    assert x.std() == pytest.approx(0.3, rel=0.05)
    assert np.mean(x[60:] * x[:-60]) / x.var() == pytest.approx(np.exp(-1.0), abs=0.04)


def test_wander_equals_its_plain_twin() -> None:
    rng = np.random.default_rng(7)
    keep = np.exp(-0.1 / 6.0)
    shocks = rng.standard_normal(50) * np.sqrt(1.0 - keep**2)
    level, plain = 0.0, []
    shocks[0] = rng.standard_normal()
    for shock in shocks:
        level = keep * level + shock
        plain.append(0.3 * level)
    np.testing.assert_allclose(wander(np.random.default_rng(7), 50, 0.1, 0.3, 6.0), plain, rtol=1e-12)


def test_weather_grows_turns_and_starts_as_asked_analytic() -> None:
    time = 0.1 * np.arange(-100, 1000)
    traps = [{"mode": "sea_growth", "onset": 50.0, "size": 2.0}, {"mode": "sea_turn", "onset": 50.0, "size": 90.0}]
    plain, changed, late = (
        draw_weather(scenario(**x), streams(1), time)
        for x in ({}, {"traps": traps}, {"sea": {"start": 20.0}, "record": {"duration": 100.0}})
    )
    push, turned = plain.loads[:, :2], changed.loads[:, :2]
    after = time > 50.05
    np.testing.assert_allclose(turned[~after][:-1], push[~after][:-1], rtol=1e-12)
    quarter = 4.0 * np.column_stack([-push[:, 1], push[:, 0]])  # twice the height, a quarter turn clockwise
    np.testing.assert_allclose(turned[after], quarter[after], atol=1e-12)
    assert not late.loads[time < 20.0, :2].any()
    np.testing.assert_allclose(late.loads[time > 23.05], plain.loads[time > 23.05], rtol=1e-12)
    towards = np.arctan2(plain.loads[:, 1], plain.loads[:, 0])  # waves from 15 deg go to 195 deg
    np.testing.assert_allclose(np.degrees(towards) % 360.0, 195.0)


# --- the plant -----------------------------------------------------------------------------------------------------


def plain_slope(state: Array, load: Array, thrust: Array, mooring: Mooring, vessel: VesselModel) -> Array:
    """The equation of motion with matrices, the lines by the physics room."""
    c, s = np.cos(state[2]), np.sin(state[2])
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    d = vessel.dynamics
    inertia = np.diag(d.inertia)
    inertia[1, 2] = inertia[2, 1] = d.coupling
    relative = state[3:] - turn.T @ np.array([load[4], load[5], 0.0])
    force = turn.T @ mooring.force(state[:3]) + thrust - np.array(d.damping) * relative
    for part, a, b in ((vessel.drift, *load[:2]), (vessel.wind, *load[2:4])):
        size, angle = np.hypot(a, b), np.arctan2(b, a) - state[2]
        force += size * np.array([part.surge * np.cos(angle), part.sway * np.sin(angle), part.yaw * np.sin(2 * angle)])
    x = vessel.hull.length * np.linspace(-0.4375, 0.4375, 8)
    local = relative[1] + x * relative[2]
    drag = 0.5 * 1025.0 * d.cross_flow * vessel.hull.draught * vessel.hull.length / 8 * local * np.abs(local)
    force -= np.array([0.0, drag.sum(), (x * drag).sum()])
    return np.concatenate([turn @ state[3:], np.linalg.solve(inertia, force)])


@pytest.mark.parametrize("name", ["cybership3", "fpso200"])
def test_slope_equals_its_plain_twin(name: str) -> None:
    rig = rig_of(vessel=name)
    rng = np.random.default_rng(6)
    scale = 1.0 if name == "cybership3" else 20.0
    for _ in range(20):
        state = rng.normal(0.0, 1.0, 6) * np.array([0.1, 0.1, 0.5, 0.05, 0.05, 0.01]) * scale
        load, thrust = rng.normal(0.0, 0.1, 6) * scale, rng.normal(0.0, 1.0, 3) * scale
        got = slope(state, 0, load, thrust, np.zeros(8), np.zeros(8), rig.hull, rig.lines)
        wanted = plain_slope(state, load, thrust, mooring_of(rig.vessel), rig.vessel)
        np.testing.assert_allclose(got, wanted, rtol=1e-9, atol=1e-9 * np.abs(wanted).max())


def test_a_run_under_control_equals_its_plain_twin(tank: VesselModel) -> None:
    rig, rng, dt = rig_of(), np.random.default_rng(6), 0.1
    loads = np.cumsum(rng.normal(0.0, 0.003, (200, 6)), axis=0)
    path, logged, _ = ran(rig, loads)
    assert rig.substeps == 1
    mooring, loop = mooring_of(tank), rig.loop
    state, sums, given = np.array([*rig.rest, 0.0, 0.0, 0.0]), np.zeros(3), np.zeros(3)
    for k in range(199):
        c, s = np.cos(state[2]), np.sin(state[2])
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        error = state[:3] - loop.set_point
        asked = -(loop.proportional * (turn.T @ error) + loop.integral * (turn.T @ sums) + loop.derivative * state[3:])
        wanted = np.clip(asked, -loop.limit, loop.limit)
        sums = sums + dt * (error + turn @ ((asked - wanted) / loop.proportional))
        after = wanted + (given - wanted) * np.exp(-dt / 0.5)
        force, given = 0.5 * (given + after), after
        mid = 0.5 * (loads[k] + loads[k + 1])
        a = plain_slope(state, loads[k], force, mooring, tank)
        b = plain_slope(state + 0.05 * a, mid, force, mooring, tank)
        c4 = plain_slope(state + 0.05 * b, mid, force, mooring, tank)
        d = plain_slope(state + 0.1 * c4, loads[k + 1], force, mooring, tank)
        state = state + 0.1 / 6.0 * (a + 2 * b + 2 * c4 + d)
        np.testing.assert_allclose(path[k + 1], state[:3], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(logged[k + 1], given, rtol=1e-9, atol=1e-12)


def test_integration_agrees_with_another_integrator(tank: VesselModel) -> None:
    rig, mooring = rig_of(control={"kind": "none"}), mooring_of(tank)
    time = 0.1 * np.arange(600)
    loads = np.zeros((600, 6))
    loads[:, 0], loads[:, 1] = 0.004 * np.sin(0.5 * time), 0.003 * np.cos(0.3 * time)
    loads[:, 4], loads[:, 5] = 0.03 + 0.01 * np.sin(0.1 * time), -0.02
    path = ran(rig, loads)[0]

    def rhs(t: float, state: Array) -> Array:
        return plain_slope(state, np.array([np.interp(t, time, x) for x in loads.T]), np.zeros(3), mooring, tank)

    first = np.array([*rig.rest, 0.0, 0.0, 0.0])
    other = solve_ivp(rhs, (0.0, time[-1]), first, t_eval=time, rtol=1e-8, atol=1e-10, max_step=0.1)
    np.testing.assert_allclose(path, other.y[:3].T, atol=5e-6)


def test_a_steady_load_is_held_where_the_physics_room_finds_the_equilibrium() -> None:
    rig = rig_of(2000.0, vessel="fpso200", control={"kind": "none"})
    loads = np.zeros((40_000, 6))
    loads[:, 0], loads[:, 5] = 6.0, 0.05
    path = ran(rig, loads, dt=1.0)[0]
    d = rig.vessel
    drag = 0.5 * 1025.0 * d.dynamics.cross_flow * d.hull.draught * d.hull.length * 0.05**2
    load = np.array([d.drift.surge * 6.0, d.dynamics.damping[1] * 0.05 + drag, 0.0])
    found = equilibrium(mooring_of(d), load, neutral(d)[1])
    np.testing.assert_allclose(path[-1, :2], found[:2], atol=1e-4)
    assert path[-1, 0] > 5.0


def test_the_integral_brings_the_vessel_back_and_carries_the_load(tank: VesselModel) -> None:
    rig = rig_of(600.0)
    loads = np.zeros((6000, 6))
    loads[:, 0] = 0.06**2
    path, logged, _ = ran(rig, loads)
    np.testing.assert_allclose(path[-1], rig.rest, atol=1e-4)
    assert logged[-1, 0] == pytest.approx(-tank.drift.surge * 0.06**2, rel=1e-3)


def test_a_limited_command_does_not_wind_up() -> None:
    loop = rig_of().loop
    place, sums = loop.set_point + np.array([5.0, 0.0, 0.0]), np.zeros(3)
    for _ in range(5000):
        assert command(place, np.zeros(3), sums, 0.1, loop)[0] == -loop.limit[0]
    assert abs(sums[0]) <= 1.01 * loop.limit[0] / loop.integral[0]


def test_the_surge_period_is_that_of_inertia_and_lines(tank: VesselModel) -> None:
    rig = rig_of(200.0, control={"kind": "none"})
    path = ran(rig, np.zeros((2000, 6)), rig.rest + np.array([0.05, 0.0, 0.0]))[0][:, 0] - rig.rest[0]
    crossings = np.flatnonzero((path[:-1] > 0.0) != (path[1:] > 0.0))
    stiffness = mooring_of(tank).stiffness(rig.rest)[0, 0]
    assert 0.2 * np.diff(crossings)[:6].mean() == pytest.approx(2 * np.pi * np.sqrt(80.0 / stiffness), rel=0.03)
    assert 2 * np.pi * np.sqrt(80.0 / stiffness) == pytest.approx(13.0, rel=0.1)


def test_tensions_equal_their_plain_twin(tank: VesselModel) -> None:
    faults = [
        {"kind": "line_lost", "subject": "line_2", "onset": 20.0},
        {"kind": "line_weakened", "subject": "line_5", "mode": "buoyancy", "onset": 10.0, "ramp": 15.0, "size": 1.2},
    ]
    rig = rig_of(30.0, faults=faults)
    motion = rig.rest + np.cumsum(np.random.default_rng(8).normal(0.0, 0.002, (300, 3)), axis=0)
    dragged = np.full((1, 6), 0.01)
    got = tensions(motion, 0.1, rig.levels, dragged, rig.lines)
    system = mooring_of(tank)
    grid = system.start + system.step * np.arange(system.tension.shape[1])
    c, s = np.cos(motion[:, 2])[:, None], np.sin(motion[:, 2])[:, None]
    f, a = system.fairleads, system.anchors
    distance = np.hypot(
        a[:, 0] - motion[:, :1] - c * f[:, 0] + s * f[:, 1], a[:, 1] - motion[:, 1:2] - s * f[:, 0] - c * f[:, 1]
    )
    rate = np.gradient(distance, 0.1, axis=0)
    static = np.column_stack([np.interp(distance[:, j] - 0.01, grid, system.tension[j]) for j in range(6)])
    share = np.clip((0.1 * np.arange(300) - 10.0) / 15.0, 0.0, 1.0)
    for k in range(300):
        at = [np.interp(distance[k, 4] - 0.01, grid, row) for row in rig.lines.tension[4]]
        static[k, 4] = np.interp(share[k], np.linspace(0.0, 1.0, len(at)), at)
    wanted = np.maximum(0.0, static + 4.0 * rate + 20.0 * rate * np.abs(rate))
    wanted[200:, 1] = 0.05
    np.testing.assert_allclose(got, wanted, rtol=1e-9, atol=1e-9)


def test_a_leaking_line_is_the_line_of_that_leak(tank: VesselModel) -> None:
    fault = {"kind": "line_weakened", "subject": "line_5", "mode": "buoyancy", "onset": 10.0, "ramp": 15.0, "size": 1.2}
    rig = rig_of(30.0, faults=[fault])
    distance = neutral(tank)[0][0] + np.linspace(-0.5, 0.5, 11)
    lines = rig.lines
    grid = lines.start[4] + lines.step[4] * np.arange(lines.tension.shape[2])
    level = rig.levels[175, 4]  # half-way
    assert level == 0.5 * (lines.tension.shape[1] - 1)
    for mine, table in zip((lines.horizontal, lines.tension), fault_tables(tank, "buoyancy", [0.6]), strict=True):
        got, wanted = (np.interp(distance, grid, row) for row in (mine[4, int(level)], table[0]))
        np.testing.assert_allclose(got, wanted, atol=3e-3)


def test_a_dragging_end_never_holds_more_than_it_slides_at_brute_force(tank: VesselModel) -> None:
    rig = rig_of(300.0, control={"kind": "none"}, faults=[
        {"kind": "line_parted_low", "subject": "line_4", "onset": 50.0, "size": 0.4}])  # fmt: skip
    loads = np.zeros((3000, 6))
    loads[1500:, 0] = 0.02  # pushes away from anchor 4
    path, _, dragged = ran(rig, loads)
    system, limit = mooring_of(tank), sliding(tank, 0.6)
    grid = system.start + system.step * np.arange(system.tension.shape[1])
    furthest = np.interp(limit, system.horizontal[3], grid)
    far = 0.0
    for k in range(3000):
        arm = 0.85 * np.array([np.cos(path[k, 2]), np.sin(path[k, 2])])
        distance = np.hypot(*(system.anchors[3] - path[k, :2] - arm))
        if k >= 500:
            far = max(far, distance - furthest)
            assert np.interp(distance - far, grid, system.horizontal[3]) <= limit * (1.0 + 1e-9)
        assert dragged[k, 3] == pytest.approx(far, abs=1e-9)
    assert far > 0.1
    assert not dragged[:, [0, 1, 2, 4, 5]].any()


def test_within_a_sample_a_dragging_line_pulls_its_sliding_force_at_most(tank: VesselModel) -> None:
    rig = rig_of(faults=[{"kind": "line_parted_low", "subject": "line_4", "onset": 0.0, "size": 0.4}])
    state = np.array([*rig.rest, 0.0, 0.0, 0.0]) + np.array([0.2, 0.1, 0.0, 0.0, 0.0, 0.0])
    got = slope(state, 0, np.zeros(6), np.zeros(3), np.zeros(6), np.zeros(6), rig.hull, rig.lines)
    intact = mooring_of(tank)
    capped = np.minimum(intact.horizontal[3], sliding(tank, 0.6))
    mooring = intact.with_line("line_4", capped, intact.tension[3])
    np.testing.assert_allclose(got, plain_slope(state, np.zeros(6), np.zeros(3), mooring, tank), rtol=1e-6, atol=1e-9)


# --- the rig -------------------------------------------------------------------------------------------------------


def test_the_rig_departs_from_the_file_as_asked(tank: VesselModel) -> None:
    part = {"inertia": 0.05, "damping": 0.15, "wind": -0.1, "thrust": 0.04, "weight": 0.05, "lines": ["line_2"]}
    rig, plain = rig_of(rig=part), rig_of()
    np.testing.assert_allclose(rig.hull.inverse * 1.05, plain.hull.inverse, rtol=1e-12)
    np.testing.assert_allclose(rig.hull.damping, 1.15 * np.array(tank.dynamics.damping))
    np.testing.assert_allclose(rig.hull.wind, 0.9 * np.array([tank.wind.surge, tank.wind.sway, tank.wind.yaw]))
    np.testing.assert_allclose(rig.effect, 1.04)
    distance = neutral(tank)[0][0]
    for j in range(6):
        pulls = [
            np.interp(distance, x.lines.start[j] + x.lines.step[j] * np.arange(x.lines.tension.shape[2]),
                      x.lines.tension[j, 0]) for x in (rig, plain)]  # fmt: skip
        assert pulls[0] == pytest.approx(pulls[1] * (1.08 if j == 1 else 1.0), rel=0.03 if j == 1 else 1e-12)


def test_anchors_and_gauge_gains_are_those_drawn() -> None:
    part = {"rig": {"anchors": 0.015, "gain": 0.05}, "control": {"kind": "none"}}
    rig = rig_of(**part)
    drawn = np.array(rig.drawn["anchors"])
    np.testing.assert_allclose(rig.lines.anchors, mooring_of(rig.vessel).anchors + drawn, rtol=1e-12)
    assert 0.005 < drawn.std() < 0.03
    body = {**CALM, "rig": {"gain": 0.05}, "record": {"duration": 100.0}}
    made = simulate(Scenario.model_validate(body), 1)
    shares = [column(made, f"tension_{i + 1}").mean() / 3.97 for i in range(6)]
    np.testing.assert_allclose(shares, made[1]["rig"]["gain"], atol=0.002)
    assert np.std(shares) > 0.02


def test_every_line_of_a_rig_pulls_by_its_own_drawn_share_more(tank: VesselModel) -> None:
    plain = rig_of()
    found = []
    for seed in range(40):
        rig = draw_rig(scenario(rig={"pull": 0.1}), streams(seed), 0.1 * np.arange(600))
        factor = np.array(rig.drawn["pull"])
        found.append(factor)
        for table in ("horizontal", "tension"):
            wanted = factor[:, None, None] * getattr(plain.lines, table)
            np.testing.assert_allclose(getattr(rig.lines, table), wanted, rtol=1e-14)
    assert np.abs(np.array(found) - 1.0).max() <= 0.1
    assert np.std(found) == pytest.approx(0.2 / np.sqrt(12.0), rel=0.1)
    assert plain.drawn["pull"] == [1.0] * 6


def test_a_dragging_line_slides_at_its_own_share_of_the_force() -> None:
    low = [{"kind": "line_parted_low", "subject": "line_4", "onset": 30.0, "size": 0.5}]
    plain, rig = rig_of(faults=low), rig_of(faults=low, rig={"pull": 0.1})
    np.testing.assert_allclose(rig.lines.slide[3, 0], rig.drawn["pull"][3] * plain.lines.slide[3, 0], rtol=1e-14)
    assert rig.lines.slide[3, 1] == plain.lines.slide[3, 1]


def test_another_weather_is_the_same_rig() -> None:
    body = {"rig": {"anchors": 0.015, "gain": 0.01}, "record": {"duration": 30.0, "settle": 5.0}}
    first, other = (simulate(Scenario.model_validate(body), 3, weather) for weather in (1, 2))
    assert first[1]["rig"] == other[1]["rig"]
    assert np.std(first[1]["rig"]["anchors"]) > 0.005
    assert first[1]["rig"] != simulate(Scenario.model_validate(body), 4, 1)[1]["rig"]
    assert np.any(column(first, "tension_1") != column(other, "tension_1"))


# --- what fails ----------------------------------------------------------------------------------------------------


def test_an_entry_grows_stays_and_goes_analytic() -> None:
    time = np.array([0.0, 9.9, 10.0, 12.0, 14.0, 20.0, 22.0, 24.0, 30.0])
    step = Failure(kind="sensor_fault", subject="tension_1", mode="bias", onset=10.0, end=20.0)
    np.testing.assert_array_equal(grown(time, step), [0, 0, 1, 1, 1, 0, 0, 0, 0])
    ramp = Trap(mode="sea_growth", onset=10.0, ramp=4.0, end=20.0, size=2.0)
    np.testing.assert_allclose(grown(time, ramp), [0, 0, 0, 0.5, 1, 1, 0.5, 0, 0], atol=1e-12)


def reading(mode: str, noise: float = 0.0, **kw: Any) -> Array:
    time = 0.1 * np.arange(1000)
    fault = Failure(kind="sensor_fault", subject="tension_1", mode=mode, onset=50.0, **kw)
    draws = noise * np.random.default_rng(1).standard_normal(1000)
    return read(time, 2.0 + time, time, draws, Sensor(noise=noise), [fault])


def test_each_wrong_sensor_reads_what_its_mode_says_analytic() -> None:
    time = 0.1 * np.arange(1000)
    late, true = time >= 49.999, 2.0 + time
    np.testing.assert_allclose(reading("dead"), np.where(late, 0.0, true))
    np.testing.assert_allclose(reading("bias", size=0.3, end=60.0), true + 0.3 * (late & (time < 59.999)))
    np.testing.assert_allclose(reading("drift", size=2.0, ramp=20.0), true + np.clip((time - 50.0) / 10.0, 0.0, 2.0))
    np.testing.assert_allclose(reading("gain", size=1.1), true * np.where(late, 1.1, 1.0))
    np.testing.assert_allclose(reading("delay", size=3.0), true - 3.0 * late)
    stuck = reading("stuck", 0.1)
    assert np.unique(stuck[500:]).size == 1
    assert stuck[500] == stuck[499]
    draws = np.random.default_rng(1).standard_normal(1000)
    np.testing.assert_allclose(
        reading("noise", 0.1, size=5.0) - true, 0.1 * draws * np.where(late, 5.0, 1.0), atol=1e-9
    )


def test_position_and_heading_jump_by_their_size_on_the_log() -> None:
    rows = [("north", "jump", 1.5), ("heading", "bias", 2.0)]
    faults = [{"kind": "sensor_fault", "subject": a, "mode": b, "onset": 30.0, "size": c} for a, b, c in rows]
    wrong, right = (simulate(scenario(faults=x, control={"kind": "none"}), 1) for x in (faults, []))
    for name, _, size in rows:
        moved = column(wrong, name) - column(right, name)
        np.testing.assert_allclose(moved, np.where(0.1 * np.arange(600) >= 29.99, size, 0.0), atol=1e-9)


def test_a_controller_follows_a_wrong_position_so_that_the_log_shows_the_set_point_again() -> None:
    fault = {"kind": "sensor_fault", "subject": "north", "mode": "jump", "onset": 100.0, "size": 0.03}
    body = {**CALM, "record": {"duration": 500.0}, "faults": [fault]}
    made = simulate(Scenario.model_validate(body), 1)
    north, pull = column(made, "north"), column(made, "tension_1") - column(made, "tension_4")
    assert north[1000:1005].mean() == pytest.approx(-0.85 + 0.03, abs=0.003)
    assert north[-1000:].mean() == pytest.approx(-0.85, abs=0.003)
    assert pull[-1000:].mean() - pull[:900].mean() == pytest.approx(0.03 * 2 * 7.0, rel=0.3)


def test_a_controller_drives_the_vessel_off_when_its_position_is_stuck(tank: VesselModel) -> None:
    fault = {"kind": "sensor_fault", "subject": "north", "mode": "stuck", "onset": 100.0, "end": 400.0}
    push = {"mode": "current_step", "onset": 50.0, "ramp": 100.0, "size": 0.05, "direction": 180.0}
    body = {**CALM, "record": {"duration": 900.0}, "faults": [fault], "traps": [push]}
    north = column(simulate(Scenario.model_validate(body), 1), "north")
    assert np.unique(north[1000:4000]).size == 1
    assert abs(north[4000] - north[3999]) > 0.01
    assert north[-500:].mean() == pytest.approx(-0.85, abs=0.003)


def test_before_the_fault_the_record_is_the_healthy_one(logs: dict[str, Any]) -> None:
    healthy = logs["demo_healthy"][0].signals
    for name in DEMO:
        for key, signal in logs[name][0].signals.items():
            before = signal.time < ONSET - 0.2
            np.testing.assert_array_equal(signal.values[before], healthy[key].values[before])


def test_a_lost_line_hangs_slack_and_the_thrusters_take_its_pull(logs: dict[str, Any], tank: VesselModel) -> None:
    lost, healthy = logs["demo"][0].signals, logs["demo_healthy"][0].signals
    after = lost["tension_4"].time >= ONSET
    assert lost["tension_4"].values[after].mean() == pytest.approx(tank.mooring.parted, abs=0.002)
    assert lost["tension_4"].values[after].std() == pytest.approx(0.02, rel=0.1)
    late = lost["north"].time > ONSET + 60.0
    moved = np.array([np.mean(lost[x].values[late] - healthy[x].values[late]) for x in ("north", "east")])
    given = np.array([np.mean(lost[f"thrust_{x}"].values - healthy[f"thrust_{x}"].values, where=late) for x in
                      ("surge", "sway")])  # fmt: skip
    away = -np.array([np.cos(np.radians(210.0)), np.sin(np.radians(210.0))])
    assert moved @ away > 0.01
    assert given @ away == pytest.approx(-2.5, abs=0.6)  # the horizontal pull of the lost line


def test_without_thrusters_a_lost_line_lets_the_vessel_go_to_the_new_equilibrium(tank: VesselModel) -> None:
    faults = [{"kind": "line_lost", "subject": "line_1", "onset": 50.0}]
    made = simulate(Scenario.model_validate(
        {**CALM, "record": {"duration": 900.0}, "control": {"kind": "none"}, "faults": faults}), 1)  # fmt: skip
    found = equilibrium(mooring_of(tank).without(["line_1"]), np.zeros(3), neutral(tank)[1])
    place = [column(made, name)[-1000:].mean() for name in ("north", "east")]
    # turret moored: heading is free, so compare where the turret is
    heading = np.radians(column(made, "heading")[-1000:].mean())
    turret = np.array(place) + 0.85 * np.array([np.cos(heading), np.sin(heading)])
    wanted = found[:2] + 0.85 * np.array([np.cos(found[2]), np.sin(found[2])])
    np.testing.assert_allclose(turret, wanted, atol=2e-3)
    assert np.hypot(*turret) > 0.1


def test_a_lost_buoy_pulls_harder_by_the_published_share_golden() -> None:
    fault = {"kind": "line_weakened", "subject": "line_4", "mode": "buoyancy", "onset": 100.0, "size": 1.0}
    body = {**CALM, "record": {"duration": 400.0}, "faults": [fault]}
    made = simulate(Scenario.model_validate(body), 1)
    pull = column(made, "tension_4")
    assert pull[:999].mean() == pytest.approx(4.0, abs=0.05)
    assert pull[-1000:].mean() - pull[:999].mean() == pytest.approx(1.2655, abs=0.01)


def test_a_leak_ends_where_the_sudden_loss_ends() -> None:
    fault = {"kind": "line_weakened", "subject": "line_4", "mode": "buoyancy", "onset": 100.0, "size": 1.2}
    pulls = []
    for ramp in (0.0, 400.0):
        body = {**CALM, "record": {"duration": 700.0}, "faults": [{**fault, "ramp": ramp}]}
        pulls.append(column(simulate(Scenario.model_validate(body), 1), "tension_4"))
    assert pulls[1][-500:].mean() == pytest.approx(pulls[0][-500:].mean(), abs=0.003)
    halfway = pulls[1][2950:3050].mean() - pulls[1][:900].mean()
    assert halfway == pytest.approx(0.5 * (pulls[0][-500:].mean() - pulls[0][:900].mean()), rel=0.1)


def test_a_dead_gauge_reads_its_noise_and_nothing_else_changes(logs: dict[str, Any]) -> None:
    dead, healthy = logs["demo_sensor_dead"][0].signals, logs["demo_healthy"][0].signals
    after = dead["tension_4"].time >= ONSET
    assert abs(dead["tension_4"].values[after].mean()) < 0.002
    for key, signal in dead.items():
        if key != "tension_4":
            np.testing.assert_array_equal(signal.values, healthy[key].values)


def test_a_lost_thruster_gives_less_than_the_log_shows(tank: VesselModel) -> None:
    fault = {"kind": "actuator_fault", "subject": "thrust_surge", "onset": 200.0, "size": 0.4}
    current = {"speed": 0.06, "direction": 180.0, "sd": 0.0}
    made = simulate(scenario(
        sea={"height": 0.0}, wind={"speed": 0.0}, current=current, faults=[fault],
        record={"duration": 900.0, "settle": 300.0}), 1)  # fmt: skip
    given, load = column(made, "thrust_surge"), tank.dynamics.damping[0] * 0.06
    assert given[1000:2000].mean() == pytest.approx(load, rel=0.02)
    assert given[-1000:].mean() == pytest.approx(load / 0.6, rel=0.02)


def test_traps_change_the_weather_as_they_say(tank: VesselModel) -> None:
    grow = {"mode": "sea_growth", "onset": 300.0, "size": 2.0}
    push = {"mode": "current_step", "onset": 300.0, "size": 0.08, "direction": 180.0}
    squall = {"mode": "squall", "onset": 300.0, "end": 500.0, "size": 4.0, "direction": 90.0}
    base = {"record": {"duration": 800.0}, "wind": {"speed": 1.0, "gust": 0.0}, "current": {"speed": 0.0, "sd": 0.0}}
    calm, grown_sea, blown = (
        simulate(Scenario.model_validate({**base, "traps": traps}), 1) for traps in ([], [grow], [squall])
    )
    flat, pushed = (
        simulate(Scenario.model_validate({**base, "sea": {"height": 0.0}, "traps": traps}), 1) for traps in ([], [push])
    )
    fast = [np.diff(column(x, "north"), 2)[3000:].var() - 6 * 0.001**2 for x in (calm, grown_sea)]
    assert fast[1] / fast[0] == pytest.approx(4.0, rel=0.1)
    more = column(pushed, "thrust_surge")[5000:].mean() - column(flat, "thrust_surge")[5000:].mean()
    assert more == pytest.approx(tank.dynamics.damping[0] * 0.08, rel=0.01)
    speed, side = column(blown, "wind_speed"), column(blown, "wind_direction")
    assert speed[3100:4900].mean() == pytest.approx(4.0, abs=0.01)
    assert side[3100:4900].mean() == pytest.approx(90.0, abs=0.1)
    assert speed[5100:].mean() == pytest.approx(1.0, abs=0.01)
    assert [x["mode"] for x in blown[1]["traps"]] == ["squall"]
    assert blown[1]["faults"] == []


@pytest.mark.parametrize("direction", [0.0, 45.0, 100.0, 225.0, 310.0])
def test_a_push_is_the_force_it_says_from_where_it_says_analytic(direction: float) -> None:
    trap = {"mode": "push", "onset": 20.0, "ramp": 10.0, "size": 460e3, "direction": direction}
    made = scenario(
        vessel="fpso200", wind={"speed": 0.0, "gust": 0.0}, control={"set_point": (0.0, 0.0, 225.0)}, traps=[trap],
        sea={"height": 0.0, "peak_period": 7.0},
    )  # fmt: skip
    time = 0.1 * np.arange(600)
    hull = draw_rig(made, streams(1), time).hull
    loads = draw_weather(made, streams(1), time).loads[:, 2:4]
    c, s = np.cos(np.radians(225.0)), np.sin(np.radians(225.0))
    surge, sway = hull.wind[0] * (c * loads[:, 0] + s * loads[:, 1]), hull.wind[1] * (c * loads[:, 1] - s * loads[:, 0])
    north, east = c * surge - s * sway, s * surge + c * sway
    angle = np.radians(direction)
    np.testing.assert_allclose(north[300:], -460e3 * np.cos(angle), atol=1e-3)
    np.testing.assert_allclose(east[300:], -460e3 * np.sin(angle), atol=1e-3)
    np.testing.assert_allclose(np.hypot(north, east)[250], 460e3 / 4.0, rtol=1e-6)  # half the speed
    assert not loads[:200].any()


def test_a_current_turns_with_a_memory_of_its_own() -> None:
    base = {"speed": 0.5, "sd": 0.1, "direction_sd": 10.0, "memory": 5.0}
    time = 0.1 * np.arange(20_000)
    same, own, slow = (
        draw_weather(scenario(current=base | more), streams(1), time).loads[:, 4:6]
        for more in ({}, {"direction_memory": 5.0}, {"direction_memory": 500.0})
    )
    np.testing.assert_array_equal(same, own)
    np.testing.assert_allclose(np.hypot(*same.T), np.hypot(*slow.T), rtol=1e-12)
    angle = [np.unwrap(np.arctan2(x[:, 1], x[:, 0])) for x in (same, slow)]
    steps = [np.diff(a).std() for a in angle]
    assert steps[0] / steps[1] == pytest.approx(10.0, rel=0.05)  # sqrt of 500 / 5


def test_a_wind_from_ahead_pushes_aft() -> None:
    body = {**CALM, "record": {"duration": 300.0, "settle": 300.0}, "control": {"kind": "none"}}
    blown = simulate(Scenario.model_validate({**body, "wind": {"speed": 3.0, "direction": 0.0, "gust": 0.0}}), 1)
    assert column(blown, "north").mean() - (-0.85) == pytest.approx(-0.05 * 9.0 / 17.0, rel=0.1)


def excursion(seed: int, weather: bool, **parts: Any) -> Array:
    body = load_scenario(SCENARIOS / "fpso_line_lost.toml").model_dump(exclude={"model"})
    if not weather:
        body["sea"]["height"], body["current"]["speed"], body["current"]["sd"] = 0.0, 0.0, 0.0
    log = simulate(Scenario.model_validate({**body, **parts}), seed)[0].signals
    return np.hypot(log["north"].values, log["east"].values)[log["north"].time >= 3600.0]


def test_without_thrusters_the_fpso_goes_forty_metres_published() -> None:
    assert excursion(1, False, control={"kind": "none"})[-5000:].mean() == pytest.approx(40.0, rel=0.1)


def test_with_limited_thrusters_and_its_weather_the_fpso_goes_thirty_odd_metres_published() -> None:
    furthest = [excursion(seed, True).max() for seed in (1, 2, 3)]
    assert 30.0 <= np.mean(furthest) <= 40.0  # the thesis: up to 35 m


# --- randomness, logs, truth ---------------------------------------------------------------------------------------


def test_noise_is_independent_between_every_pair_of_sensors() -> None:
    body = {**CALM, "record": {"duration": 10_000.0}, "control": {"kind": "none"}, "wind": {"speed": 2.0, "gust": 0.0}}
    body |= {"sensors": {"wind": {"noise": 0.02}, "position": {"noise": 0.001}}}
    signals = simulate(Scenario.model_validate(body), 2)[0].signals
    values = np.array([s.values for s in signals.values()])
    assert values.shape == (11, 100_000)
    assert np.abs(np.corrcoef(values) - np.eye(11)).max() < 0.02
    np.testing.assert_allclose(values[:9].std(axis=1), [0.001, 0.001, 0.05] + 6 * [0.02], rtol=0.02)


def test_every_process_has_a_stream_of_its_own() -> None:
    axes = ("north", "east", "heading", "wind_speed", "wind_direction", "tension_1", "tension_2", "thrust_surge")
    names = ["waves 0", "waves 1", "wind", "current", "current direction", "drift tension_1", "rig gain line_1"]
    names += [f"noise {axis}" for axis in axes]
    draws = np.array([stream(1, name).standard_normal(100_000) for name in names])
    assert np.abs(np.corrcoef(draws) - np.eye(len(names))).max() < 0.02
    np.testing.assert_array_equal(draws[0], stream(1, "waves 0").standard_normal(100_000))


def test_the_same_seed_is_the_same_bytes(tmp_path: Path) -> None:
    made = scenario(rig={"anchors": 0.01, "gain": 0.01, "tension_drift": {"sd": 0.03}})
    texts = []
    for i, seed in enumerate((7, 7, 8)):
        save_log(simulate(made, seed)[0], tmp_path / f"{i}.csv")
        texts.append((tmp_path / f"{i}.csv").read_bytes())
    assert texts[0] == texts[1]
    assert texts[0] != texts[2]


def test_a_drifting_zero_has_the_asked_spread() -> None:
    body = {**CALM, "record": {"duration": 20_000.0, "sample_time": 1.0}, "control": {"kind": "none"}}
    body |= {"rig": {"tension_drift": {"sd": 0.3, "memory": 100.0}}}
    values = column(simulate(Scenario.model_validate(body), 1), "tension_3")
    assert values.std() == pytest.approx(0.3, rel=0.1)
    assert np.corrcoef(values[100:], values[:-100])[0, 1] == pytest.approx(np.exp(-1.0), abs=0.1)


def test_each_sensor_keeps_its_own_clock_and_steps() -> None:
    sensors = {"position": {"sample_time": 1.0, "quantum": 0.01}, "thrust": {"logged": False}}
    signals = simulate(scenario(sensors=sensors), 1)[0].signals
    np.testing.assert_allclose(signals["north"].time, np.arange(60.0))
    np.testing.assert_array_equal(signals["tension_1"].time, np.round(0.1 * np.arange(600), 6))
    np.testing.assert_allclose(signals["north"].values * 100, np.round(signals["north"].values * 100), atol=1e-9)
    assert "thrust_surge" not in signals


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
    assert truth["scenario"]["model"]["name"] == "cybership3"
    assert logs["demo_healthy"][1]["faults"] == []
    assert logs["demo_healthy"][1]["healthy_until"] == 1500.0
    assert logs["demo_sensor_dead"][1]["faults"][0]["mode"] == "dead"


def test_a_truths_scenario_makes_the_log_again(logs: dict[str, Any]) -> None:
    again = simulate(Scenario.model_validate(json.loads(json.dumps(logs["demo"][1]["scenario"]))), 1)
    np.testing.assert_array_equal(column(again, "tension_4"), column(logs["demo"], "tension_4"))


@pytest.mark.parametrize("path", sorted(SCENARIOS.glob("*.toml")), ids=lambda path: path.stem)
def test_every_scenario_loads_and_runs(path: Path) -> None:
    body = load_scenario(path).model_dump(exclude={"model"})
    body["record"] |= {"duration": 20.0, "settle": 5.0}
    body["rig"]["weight"] = 0.0  # the same tables for all
    for entry in (*body["faults"], *body["traps"]):
        entry |= {"onset": 10.0, "ramp": min(entry["ramp"], 2.0), "end": entry["end"] and 15.0}
    log, truth = simulate(Scenario.model_validate(body), 1)
    assert all(np.isfinite(signal.values).all() for signal in log.signals.values())
    assert len(truth["faults"]) == len(body["faults"])


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[sea]\nheigth = 1.0", "did you mean 'height'"),
        ('vessel = "cybership4"', "did you mean 'cybership3'"),
        ('[[faults]]\nkind = "line_lost"\nsubject = "line_7"\nonset = 10.0', "unknown subject 'line_7'"),
        ('[[faults]]\nkind = "line_lost"\nsubject = "line_1"\nonset = 1e9', "after the record's end"),
        ('[[faults]]\nkind = "sensor_fault"\nsubject = "tension_1"\nonset = 1.0', "allowed: dead, stuck"),
        ('[[faults]]\nkind = "line_weakened"\nsubject = "line_1"\nonset = 1.0\nmode = "dead"', "buoyancy, stiffness"),
        ('[[faults]]\nkind = "line_lost"\nsubject = "line_1"\nonset = 1.0\nmode = "dead"', "has no mode"),
        ('[[faults]]\nkind = "line_parted_low"\nsubject = "line_1"\nonset = 1.0\nsize = 1.5', "is a share"),
        ('[rig]\nlines = ["line_9"]', "unknown line 'line_9'"),
        ("[sensors.position]\nsample_time = 0.25", "a multiple of 0.1 s"),
        ('[[traps]]\nmode = "sea_turn"\nonset = 1.0\nsize = 9.0\ndirection = 3.0', "takes no direction"),
        ('[[traps]]\nmode = "push"\nonset = 1.0\nsize = 9.0', "direction is missing"),
    ],
)
def test_a_wrong_scenario_is_one_sentence(tmp_path: Path, text: str, says: str) -> None:
    path = tmp_path / "x.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=says) as caught:
        load_scenario(path)
    assert "\n" not in str(caught.value)


def test_a_line_that_never_fails_is_never_gone() -> None:
    rig = rig_of()
    assert (rig.lines.parted == NEVER).all()
    assert (rig.lines.low == NEVER).all()
