"""Truth: analytic (logs made of the line's own table with known errors), brute force (a channel moved by hand), and the
simulator's physics for what a rig that departs from its file leaves over."""

from __future__ import annotations

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mooringdx.config import RunConfig, read_toml, validate
from mooringdx.errors import ConfigError, FitError
from mooringdx.physics.rig import fault_tables, mooring_of
from mooringdx.physics.vessel import vessel
from mooringdx.residuals.tension import Tension
from mooringdx.residuals.training import Training
from mooringdx.types import Array, Channels, Fault, Grid, LogSource

ROOT = Path(__file__).parents[1]
TS = 0.1
NAMES = ("north", "east", "heading", *(f"tension_{i}" for i in range(1, 7)))
UNITS = ("m", "m", "rad", *("N",) * 6)
ORIGIN = (100.0, -50.0)


@cache
def _body() -> dict[str, Any]:
    return read_toml(ROOT / "configs" / "vessels" / "cybership3.toml")


def asked(calibrate: str, names: tuple[str, ...] = NAMES, **mooring: Any) -> RunConfig:
    body = {
        "channels": {n: {"column": n} for n in names},
        "clock": {"sample_time": TS},
        "residuals": {"use": ["tension"], "tension": {"calibrate": calibrate}},
        "mooring": {"vessel": "cybership3", "model": _body(), "origin": ORIGIN, **mooring},
    }
    return validate(RunConfig, body, Path("t.toml"))


def channels(values: Array, names: tuple[str, ...] = NAMES, units: tuple[str, ...] = UNITS) -> Channels:
    return Channels(names, units, Grid(0.0, TS, len(values)), values, np.isfinite(values), LogSource("m", "csv", 0, ""))


def statics(place: Array) -> tuple[Array, Array]:
    """Return distance and table tension, (n, 6), by plain numpy: the twin of the module's loops."""
    system = mooring_of(vessel(_body()))
    c, s = np.cos(place[:, 2:]), np.sin(place[:, 2:])
    forward, starboard = system.fairleads.T
    north = system.anchors[:, 0] - (place[:, :1] - ORIGIN[0]) - (c * forward - s * starboard)
    east = system.anchors[:, 1] - (place[:, 1:2] - ORIGIN[1]) - (s * forward + c * starboard)
    distance = np.hypot(north, east)
    grid = system.start + system.step * np.arange(system.tension.shape[1])
    return distance, np.column_stack([np.interp(x, grid, system.tension[0]) for x in distance.T])


def places(n: int, seed: int, waves: float = 0.03, period: float = 1.5) -> Array:
    """Return slow wandering with waves on top, mostly north and south, (n, 3) in log coordinates, without noise."""
    rng, time = np.random.default_rng(seed), TS * np.arange(n)
    slow = [sum(np.sin(2 * np.pi * time / p + rng.uniform(0, 6)) for p in (13.0, 29.0, 71.0)) for _ in range(3)]
    fast = [np.sin(2 * np.pi * time / (period * q) + rng.uniform(0, 6)) for q in (0.9, 1.0, 1.15)]
    out = np.column_stack([0.02 * slow[0], 0.005 * slow[1], 0.002 * slow[2]])
    out += waves * np.sum(fast, axis=0)[:, None] / 2.0 * [1.0, 0.1, 0.02]
    return np.asarray(out + np.array([ORIGIN[0] - 0.85, ORIGIN[1], 0.0]))


def made(place: Array, offset: float = 0.0, gain: float = 0.0, drag: tuple[float, float] = (0.0, 0.0)) -> Array:
    """Return the tensions of lines that depart from their table by known amounts, (n, 6)."""
    distance, tension = statics(place)
    speed = np.gradient(distance, TS, axis=0)
    return tension + offset + gain * (tension - 4.0) + drag[0] * speed + drag[1] * speed * np.abs(speed)


def fitted(calibrate: str, log: Channels) -> Tension:
    return Tension.fit([Training(log, (slice(0, log.grid.n),))], asked(calibrate))


def row_of(tension: Tension) -> Mapping[Fault, Array]:
    signatures = tension.signatures()
    return dict(zip(signatures.faults, signatures.matrix, strict=True))


def test_the_plain_residual_is_measured_minus_the_table_at_the_measured_place() -> None:
    place = places(500, 1) + np.array([0.1, -0.2, 0.3])
    extra = np.random.default_rng(2).standard_normal((500, 6))
    out = fitted("none", channels(np.column_stack([place, statics(place)[1] + extra])))
    residuals = out(channels(np.column_stack([place, statics(place)[1] + extra])))
    np.testing.assert_allclose(residuals.values, extra, atol=1e-9)
    assert residuals.names[3] == "tension_4 - intact"
    assert residuals.units == ("N",) * 6


def test_statics_that_are_off_are_learned_and_hold_where_the_vessel_was_not() -> None:
    place = places(6000, 1)
    out = fitted("linear", channels(np.column_stack([place, made(place, 0.3, 0.06)])))
    away = places(600, 5) + np.array([0.15, -0.1, 0.05])
    residuals = out(channels(np.column_stack([away, made(away, 0.3, 0.06)])))
    np.testing.assert_allclose(out.coefficients[:, 1], 0.06, rtol=1e-3)
    assert np.abs(residuals.values).max() < 1e-3
    offset = fitted("offset", channels(np.column_stack([place, made(place, 0.3, 0.06)])))
    assert np.abs(offset(channels(np.column_stack([away, made(away, 0.3, 0.06)]))).values.mean(axis=0)).max() > 0.03


def test_noise_of_the_position_does_not_shrink_the_gain_of_a_line_across_the_motion() -> None:
    place = places(12000, 1)
    noise = np.random.default_rng(3).standard_normal(place.shape) * [0.003, 0.003, 0.001]
    out = fitted("linear", channels(np.column_stack([place + noise, made(place, 0.0, 0.08)])))
    np.testing.assert_allclose(out.coefficients[:, 1], 0.08, atol=0.02)


def test_drag_of_the_line_is_taken_out_h_samples_late_and_only_where_it_is_worth_it() -> None:
    place = places(6000, 1)
    rng = np.random.default_rng(4)
    noise = np.column_stack(
        [rng.normal(0, 0.0005, (6000, 2)), rng.normal(0, 2e-4, 6000), rng.normal(0, 0.01, (6000, 6))]
    )
    log = channels(np.column_stack([place, made(place, 0.0, 0.0, (4.0, 20.0))]) + noise)
    plain, drag = fitted("linear", log), fitted("dynamic", log)
    assert drag.half >= 1
    before, after = np.nanstd(plain(log).values, axis=0), np.nanstd(drag(log).values, axis=0)
    assert np.all(after[[0, 2, 3, 5]] < 0.3 * before[[0, 2, 3, 5]])
    np.testing.assert_allclose(drag.coefficients[[0, 3], 2], 4.0, rtol=0.25)
    calm = channels(np.column_stack([place, made(place)]) + noise)
    assert fitted("dynamic", calm).half == 0


def test_no_residual_knows_what_comes_after_it_and_a_gap_masks_only_what_it_touches() -> None:
    place = places(3000, 1)
    values = np.column_stack([place, made(place, 0.1, 0.0, (4.0, 20.0))])
    out = fitted("dynamic", channels(values))
    whole = out(channels(values))
    assert not whole.valid[: 2 * out.half].any()
    assert whole.valid[2 * out.half :].all()
    later = values.copy()
    later[1000:] += 0.01
    np.testing.assert_array_equal(out(channels(later)).values[:1000], whole.values[:1000])
    gap = values.copy()
    gap[500, 1] = np.nan
    bad = np.flatnonzero(~out(channels(gap)).valid[2 * out.half :].all(axis=1)) + 2 * out.half
    np.testing.assert_array_equal(bad, np.arange(500, 500 + 2 * out.half + 1))


@pytest.mark.parametrize(("axis", "by"), [("north", 1e-3), ("east", 1e-3), ("heading", 1e-3), ("tension_4", 1.0)])
def test_signature_of_a_wrong_channel_is_what_moving_it_does(axis: str, by: float) -> None:
    place = np.tile(np.median(places(3000, 1), axis=0), (10, 1))
    training = places(3000, 1)
    out = fitted("linear", channels(np.column_stack([training, made(training, 0.2, 0.05)])))
    values = np.column_stack([place, made(place, 0.2, 0.05)])
    moved = values.copy()
    moved[:, NAMES.index(axis)] += by
    change = (out(channels(moved)).values - out(channels(values)).values)[5] / by
    np.testing.assert_allclose(row_of(out)[Fault("sensor_fault", axis)], change, atol=0.02)


def test_line_sensor_and_buoy_are_one_class_and_their_totals_are_the_lines_own() -> None:
    place = places(3000, 1)
    out = fitted("linear", channels(np.column_stack([place, made(place)])))
    rows, signatures = row_of(out), out.signatures()
    lost, weak = Fault("line_lost", "line_4"), Fault("line_weakened", "line_4", "buoyancy")
    np.testing.assert_array_equal(rows[lost], rows[Fault("sensor_fault", "tension_4")])
    np.testing.assert_array_equal(rows[weak], np.eye(6)[3])
    total = dict(zip(signatures.faults, signatures.total, strict=True))
    sign = dict(zip(signatures.faults, signatures.sign, strict=True))
    level = statics(np.median(place, axis=0)[None])[1][0, 3]
    assert total[lost] == pytest.approx(-(level - 0.05), abs=0.01)
    assert total[weak] == pytest.approx(1.2655, abs=0.01)  # of the same line by MoorPy, at the neutral distance
    assert (sign[lost], sign[weak], sign[Fault("sensor_fault", "tension_4")]) == (-1.0, 1.0, 0.0)
    environment = [f for f in signatures.faults if f.kind == "environment"]
    assert len(environment) == 4
    assert not any(rows[f].any() for f in environment)


@pytest.mark.parametrize("share", [0.3, 1.1])
def test_the_share_of_buoyancy_is_read_back_from_tables_that_were_not_used(share: float) -> None:
    place = places(3000, 1)
    out = fitted("none", channels(np.column_stack([place, made(place)])))
    system, faulty = mooring_of(vessel(_body())), fault_tables(vessel(_body()), "buoyancy", [share])[1][0]
    grid = system.start + system.step * np.arange(len(faulty))
    distance, tension = statics(place[:150] + np.array([0.1, 0.0, 0.0]))
    change = float(np.mean(np.interp(distance[:, 3], grid, faulty) - tension[:, 3]))
    found, low, high = out.share("line_4", change, 0.01, distance)
    assert found == pytest.approx(share, abs=0.005)
    assert low < share < high
    assert high - low == pytest.approx(2 * 1.96 * 0.01 / 1.2655, rel=0.2)


def test_what_is_left_of_a_tension_tells_a_line_lost_from_one_parted_low() -> None:
    place = places(3000, 1)
    out = fitted("none", channels(np.column_stack([place, made(place)])))
    distance, tension = statics(place[:150])
    level = float(tension[:, 3].mean())
    for left, kind in ((0.0125, "line_lost"), (0.3, "line_parted_low"), (0.7, "line_parted_low")):
        assert out.kind("line_4", (left - 1.0) * level, 0.02, distance) == kind
    assert out.kind("line_4", -0.1 * level, 0.02, distance) == "line_weakened"
    assert out.kind("line_4", 0.3 * level, 0.02, distance) == "line_weakened"


def test_what_is_stored_gives_the_same_residuals() -> None:
    place = places(3000, 1)
    log = channels(np.column_stack([place, made(place, 0.1, 0.05, (4.0, 20.0))]))
    out = fitted("dynamic", log)
    again = Tension.from_dict(json.loads(json.dumps(out.to_dict())))
    np.testing.assert_array_equal(again(log).values, out(log).values)
    np.testing.assert_array_equal(again.signatures().matrix, out.signatures().matrix)


def test_what_is_missing_is_said_in_a_sentence() -> None:
    place = places(500, 1)
    values = np.column_stack([place, made(place)])
    log = channels(values)
    blind = channels(values[:, [0, 1, 3]], ("north", "east", "tension_1"), ("m", "m", "N"))
    odd = channels(values, (*NAMES[:-1], "tension_9"))
    for bad, run, error, words in (
        (blind, asked("none"), ConfigError, "no 'heading'"),
        (log, asked("none", model={}, vessel=None), ConfigError, "name a vessel file"),
        (odd, asked("none"), ConfigError, "'tension_9' belongs to no line"),
        (channels(values[:, :3], NAMES[:3], UNITS[:3]), asked("none"), ConfigError, "no tension channel"),
        (channels(values[:30]), asked("linear"), FitError, "no-fault rows"),
    ):
        with pytest.raises(error, match=words):
            Tension.fit([Training(bad, (slice(0, bad.grid.n),))], run)
    out = fitted("none", log)
    with pytest.raises(ConfigError, match="unknown line"):
        out.share("line_7", 0.1, 0.1, out.distances(log))
    with pytest.raises(ConfigError, match="no 'heading'"):
        out(blind)


def test_a_window_without_a_place_is_judged_at_the_middle_of_the_no_fault_places() -> None:
    place = places(3000, 1)
    out = fitted("none", channels(np.column_stack([place, made(place)])))
    unknown = np.full((50, 6), np.nan)
    assert out.share("line_4", 1.2655, 0.01, unknown)[0] == pytest.approx(1.0, abs=0.01)
    assert out.kind("line_4", -3.9, 0.01, unknown) == "line_lost"


@pytest.mark.parametrize("calibrate", ["linear", "dynamic"])
def test_nothing_outside_the_no_fault_window_is_learned_from(calibrate: str) -> None:
    place = places(3000, 1)
    values = np.column_stack([place, made(place, 0.1, 0.05, (4.0, 20.0))])
    wild = values.copy()
    wild[[999, 2500], :2] += 5.0
    fits = [Tension.fit([Training(channels(v), (slice(1000, 2500),))], asked(calibrate)) for v in (values, wild)]
    np.testing.assert_array_equal(fits[0].coefficients, fits[1].coefficients)


def test_a_lost_line_is_expected_to_disturb_the_others_by_a_share_of_what_their_tension_changes() -> None:
    place = places(3000, 1)
    out = fitted("none", channels(np.column_stack([place, made(place)])))
    signatures = out.signatures()
    system, centre = mooring_of(vessel(_body())), out.centre
    pull, tension, toward = system.pulls(centre)
    force = np.array([*(toward[3] * pull[3] / tension[3]), 0.0])  # the yaw moment is the thrusters' business
    away = np.linalg.solve(system.stiffness(centre)[:2, :2], force[:2])
    moved = system.pulls(centre + 1e-3 * np.array([*away, 0.0]))[1] - tension
    error = dict(zip(signatures.faults, signatures.error, strict=True))[Fault("line_lost", "line_4")]
    np.testing.assert_allclose(error[[0, 1, 2, 4, 5]], 0.1 * np.abs(moved[[0, 1, 2, 4, 5]]) / 1e-3, rtol=0.02)
    assert error[3] == 0.0


def test_lines_that_are_asked_for_are_watched_and_a_vessel_without_buoys_has_none_to_lose() -> None:
    body = read_toml(ROOT / "configs" / "vessels" / "fpso200.toml")
    names = ("north", "east", "heading", "tension_7", "tension_2")
    run = asked("none", names, vessel="fpso200", model=body, origin=(0.0, 0.0), lines=["line_7"])
    system = mooring_of(vessel(body))
    tension = system.pulls(np.array([5.0, -3.0, 0.2]))[1]
    values = np.tile([5.0, -3.0, 0.2, tension[6] + 1e4, tension[1]], (100, 1))
    log = channels(values, names, ("m", "m", "rad", "N", "N"))
    out = Tension.fit([Training(log, (slice(0, 100),))], run)
    np.testing.assert_allclose(out(log).values, 1e4, rtol=1e-9)
    assert {f.kind for f in out.signatures().faults} == {"line_lost", "sensor_fault", "environment"}
    with pytest.raises(ConfigError, match="no buoy"):
        out.share("line_7", 1e4, 1e3, out.distances(log))


@cache
def _simulated(seed: int, fault: str) -> Channels:
    """Return the log of a rig that departs from its file, with one fault or trap at 900 s."""
    from mooringdx.simulate import simulate
    from mooringdx.simulate.scenario import Scenario

    rig = {"weight": 0.05, "anchors": 0.015, "gain": 0.008, "damping": 0.15, "inertia": 0.05, "wind": -0.1}
    body: dict[str, Any] = {"model": _body(), "rig": rig, "record": {"duration": 1020.0, "settle": 60.0}}
    if fault == "buoyancy":
        entry = {"kind": "line_weakened", "subject": "line_4", "mode": "buoyancy", "onset": 900.0, "size": 1.0}
        body["faults"] = [entry]
    else:
        body["traps"] = [{"kind": "environment", "mode": "sea_growth", "onset": 900.0, "ramp": 20.0, "size": 1.5}]
    raw = simulate(validate(Scenario, body, Path("s.toml")), seed)[0]
    columns = [np.asarray(raw.signals[n].values) for n in NAMES]
    columns[2] = np.radians(columns[2])
    moved = np.array([*ORIGIN, 0.0])
    return channels(np.column_stack(columns) + np.array([*moved, *np.zeros(6)]))


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2])
def test_on_a_rig_off_its_file_the_share_is_right_within_three_per_cent_after_45_s(seed: int) -> None:
    log = _simulated(seed, "buoyancy")
    for calibrate in ("linear", "dynamic"):
        out = Tension.fit([Training(log, (slice(0, 8000),))], asked(calibrate))
        values = out(log).values
        window = slice(9150, 9450)
        still = np.nanmean(values[100:8000], axis=0)
        change = values[window].mean(axis=0) - still
        share, low, high = out.share("line_4", float(change[3]), 0.01, out.distances(log)[window])
        assert share == pytest.approx(1.0, abs=0.03)
        assert low < high
        assert np.abs(np.delete(change, 3)).max() < 0.03


@pytest.mark.slow
def test_a_rougher_sea_moves_the_calibrated_residual_less_than_the_plain_one() -> None:
    log = _simulated(1, "sea")
    spread, mean = {}, {}
    for calibrate in ("none", "dynamic"):
        out = Tension.fit([Training(log, (slice(0, 8000),))], asked(calibrate))
        values = out(log).values
        spread[calibrate] = values[9200:].std(axis=0)
        mean[calibrate] = np.abs(values[9200:].mean(axis=0) - values[100:8000].mean(axis=0)).max()
    assert np.all(spread["dynamic"] < 0.5 * spread["none"])
    assert mean["dynamic"] < 0.005
