"""Truth: statics (a vessel at rest), brute force (a faulty log beside the healthy one), and simulated rigs."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mooringdx import simulate
from mooringdx.config import RunConfig, read_toml, validate
from mooringdx.errors import ConfigError
from mooringdx.observers.forces import measured_force, quickened, wind_force
from mooringdx.observers.matrices import Noise
from mooringdx.physics import rig
from mooringdx.physics.mooring import Mooring
from mooringdx.physics.vessel import load_vessel
from mooringdx.residuals.force_balance import ForceBalance
from mooringdx.residuals.training import SIGNATURE_ERROR, Training
from mooringdx.results import encode, json_bytes
from mooringdx.types import Array, Channels, Grid, LogSource, replace

CONFIGS = Path(__file__).parents[1] / "configs"
FITTED = slice(0, 12_000)
ONSET = 13_200
PLACES = ("north", "east", "heading")
TENSIONS = tuple(f"tension_{i + 1}" for i in range(6))


def logged(scenario: str, seed: int = 1) -> Channels:
    """Return a scenario's log on its own clock, in rad."""
    log, _ = simulate.simulate(simulate.load_scenario(CONFIGS / "scenarios" / f"{scenario}.toml"), seed)
    signals = log.signals
    time = signals["north"].time
    columns = [np.radians(s.values) if s.unit == "deg" else s.values for s in signals.values()]
    units = tuple("rad" if s.unit == "deg" else s.unit for s in signals.values())
    values = np.column_stack(columns)
    grid = Grid(float(time[0]), float(time[1] - time[0]), time.size)
    return Channels(tuple(signals), units, grid, values, np.isfinite(values), log.source)


def run(names: tuple[str, ...], use: tuple[str, ...] = ("force_balance",), **more: Any) -> RunConfig:
    mooring = {"model": read_toml(CONFIGS / "vessels" / "cybership3.toml"), **more.pop("mooring", {})}
    body = {
        "channels": {n: {"column": n} for n in names},
        "clock": {"sample_time": 0.1},
        "residuals": {"use": list(use)},
        "mooring": mooring,
        **more,
    }
    return validate(RunConfig, body, Path("t.toml"))


@pytest.fixture(scope="module")
def broken() -> Channels:
    """A line lost at 1320 s."""
    return logged("fang_line_lost")


@pytest.fixture(scope="module")
def fitted(broken: Channels) -> ForceBalance:
    return ForceBalance.fit([Training(broken, (FITTED,))], run(broken.names))


def only(channels: Channels, names: tuple[str, ...]) -> Channels:
    """Return some of the channels."""
    at = [channels.names.index(n) for n in names]
    units = tuple(channels.units[i] for i in at)
    return replace(channels, names=names, units=units, values=channels.values[:, at], valid=channels.valid[:, at])


def resting(fitted: ForceBalance, eta: Array, tensions: Array, seconds: float = 150.0) -> Channels:
    """Return a vessel that stays at ``eta`` with these tensions, no wind and no thrust."""
    n = round(10 * seconds)
    names = (*PLACES, *TENSIONS)
    values = np.tile(np.concatenate([eta, tensions]), (n, 1))
    units = ("m", "m", "rad", *["N"] * 6)
    return Channels(names, units, Grid(0.0, 0.1, n), values, np.isfinite(values), LogSource("made", "csv", 0, ""))


def at_rest(mooring: Mooring, load: Array, start: Array) -> Array:
    """Return where the lines balance ``load``, (3,), by Newton's method."""
    eta = np.array(start)
    for _ in range(60):
        eta = eta + 0.7 * np.linalg.solve(mooring.stiffness(eta), mooring.force(eta) + load)
    np.testing.assert_allclose(mooring.force(eta), -load, atol=1e-9)
    return eta


def moved(values: Array, onset: int = ONSET, window: int = 300, settle: int = 150) -> Array:
    """Return the mean of a window after the onset less that of the one before."""
    return values[onset + settle : onset + settle + window].mean(axis=0) - values[onset - window : onset].mean(axis=0)


def row(channels_signatures: Any, label: str) -> Array:
    labels = [f.label for f in channels_signatures.faults]
    return np.asarray(channels_signatures.matrix[labels.index(label)])


def test_a_vessel_at_rest_shows_the_statics_of_each_cause(fitted: ForceBalance) -> None:
    still = replace(fitted, known=(), mean=np.zeros(6))
    mooring, load = fitted.mooring, np.array([0.4, -0.3, -0.2])
    start = np.asarray(fitted.place)
    here = at_rest(mooring, load, start)
    _, tension, direction = mooring.pulls(here)
    by_tension, by_model, valid = still.biases(resting(fitted, here, tension))
    assert by_tension is not None
    np.testing.assert_allclose(by_tension[-1], load, atol=1e-6)
    np.testing.assert_allclose(by_model[-1], load, atol=1e-6)
    assert valid[-1]
    assert not valid[0]

    lost = mooring.without(["line_4"])
    there = at_rest(lost, load, here)
    horizontal, pulls, toward = mooring.pulls(there)
    by_tension, by_model, _ = still.biases(resting(fitted, there, np.where(np.arange(6) == 3, 0.0, pulls)))
    assert by_tension is not None
    np.testing.assert_allclose(by_tension[-1], load, atol=1e-6)  # the measured tensions explain the force
    np.testing.assert_allclose((by_model[-1] - load)[:2], -horizontal[3] * toward[3], atol=1e-6)
    change = 0.5 * (by_tension[-1] + by_model[-1]) - load
    want = row(fitted.signatures(), "line_lost line_4")[:3] * -pulls[3]
    # Two sd: without thrust the vessel gives way by half a metre, where the lost line would stand less steeply.
    assert np.linalg.norm((change - want)[:2]) < 2.0 * SIGNATURE_ERROR * np.linalg.norm(want[:2])

    dead = np.where(np.arange(6) == 3, 0.0, tension)
    by_tension, by_model, _ = still.biases(resting(fitted, here, dead))
    assert by_tension is not None
    np.testing.assert_allclose(by_model[-1], load, atol=1e-6)
    change = 0.5 * (by_tension[-1] + by_model[-1]) - load
    want = row(fitted.signatures(), "sensor_fault tension_4")[:3] * -tension[3]
    assert np.linalg.norm((change - want)[:2]) < SIGNATURE_ERROR * np.linalg.norm(want[:2])
    assert change[:2] @ direction[3] > 0.0 > row(fitted.signatures(), "sensor_fault tension_4")[:2] @ direction[3]


def test_lost_buoyancy_at_rest_is_its_signature(fitted: ForceBalance) -> None:
    ship = load_vessel(CONFIGS / "vessels" / "cybership3.toml")
    still = replace(fitted, known=(), mean=np.zeros(6))
    table_h, table_t = rig.fault_tables(ship, "buoyancy", [1.0])
    weak = fitted.mooring.with_line("line_2", table_h[0], table_t[0])
    here = at_rest(weak, np.zeros(3), np.asarray(fitted.place))
    _, tension, _ = weak.pulls(here)
    by_tension, by_model, _ = still.biases(resting(fitted, here, tension))
    assert by_tension is not None
    size = tension[1] - fitted.mooring.pulls(here)[1][1]
    got = np.concatenate([0.5 * (by_tension[-1] + by_model[-1]), by_model[-1] - by_tension[-1]])
    want = row(fitted.signatures(), "line_weakened line_2 (buoyancy)") * size
    np.testing.assert_allclose(got, want, atol=0.1 * np.abs(want).max())
    labels = [f.label for f in fitted.signatures().faults]
    at = labels.index("line_weakened line_2 (buoyancy)")
    assert fitted.signatures().total[at] == pytest.approx(size, rel=0.05)
    assert fitted.signatures().sign[at] == 1.0


def test_a_lost_line_and_its_dead_sensor_move_the_common_force_opposite_ways(
    fitted: ForceBalance, broken: Channels
) -> None:
    dead = np.array(broken.values)
    healthy = logged("fang_healthy")
    dead[:] = healthy.values
    dead[ONSET:, broken.names.index("tension_4")] = 0.0
    by_line, by_sensor = moved(fitted(broken).values), moved(fitted(replace(healthy, values=dead)).values)
    sight = fitted.sights[3]
    pull = np.asarray(sight.pull)
    assert by_line[:2] @ pull[:2] < -0.8 < 0.8 < by_sensor[:2] @ pull[:2]
    half = 0.5 * sight.share * -sight.lost * pull
    assert np.linalg.norm(by_line[:2] + half[:2]) < 0.35 * np.linalg.norm(half[:2])
    assert np.linalg.norm(by_sensor[:2] - half[:2]) < 0.35 * np.linalg.norm(half[:2])
    np.testing.assert_allclose(by_line[3:5], by_sensor[3:5], atol=0.3)  # the difference names the line, not the cause


def test_force_follows_a_lost_line_within_its_memory(fitted: ForceBalance, broken: Channels) -> None:
    _, by_model, _ = fitted.biases(broken)
    pull = np.asarray(fitted.sights[3].pull)[:2]
    along = -(by_model[:, :2] - by_model[ONSET - 300 : ONSET, :2].mean(axis=0)) @ pull
    rise = int(np.argmax(along[ONSET:] > 0.63 * 2.45)) / 10
    assert 1.0 < rise < 8.0
    assert fitted.settle == pytest.approx(24.0, abs=6.0)


def test_discrimination_index_of_a_whole_line(fitted: ForceBalance, broken: Channels) -> None:
    out = fitted(broken)
    rows = out.values[: ONSET - 100][out.valid[: ONSET - 100].all(axis=1)]
    means = rows[: len(rows) // 150 * 150].reshape(-1, 150, 6).mean(axis=1)
    spread = np.cov(means[:, :2].T)
    for sight in fitted.sights:
        pull = np.asarray(sight.pull)[:2]
        assert 2.5 * np.sqrt(pull @ np.linalg.solve(spread, pull)) > 20.0


def test_the_difference_holds_what_the_tension_residuals_hold(fitted: ForceBalance, broken: Channels) -> None:
    out, m = fitted(broken), fitted.mooring
    eta = np.column_stack([broken.column(c) for c in PLACES])
    pulls = np.column_stack([broken.column(c) for c in TENSIONS])
    tables = (m.fairleads, m.anchors, m.start, m.step, m.horizontal, m.tension)
    measured, modelled = measured_force(eta, pulls, *tables), measured_force(eta, np.full(pulls.shape, np.nan), *tables)
    start = round(fitted.settle * 10) // 150 * 150 + 150
    x, y = ((measured - modelled)[start:], out.values[start:, 3:])
    x, y = (a[: len(a) // 150 * 150].reshape(-1, 150, 3).mean(axis=1) for a in (x, y))
    keep = np.abs(np.arange(len(x)) * 150 + start - ONSET) > 300  # not while the filters follow the loss
    rest = (y - x)[keep] - (y - x)[keep].mean(axis=0)
    share = 1.0 - rest.var(axis=0) / y[keep].var(axis=0)
    assert share.min() > 0.98


def test_measured_force_equals_the_model_where_tensions_are_the_models(fitted: ForceBalance) -> None:
    rng = np.random.default_rng(2)
    m = fitted.mooring
    eta = np.asarray(fitted.place) + rng.normal(0.0, [0.1, 0.1, 0.1], (20, 3))
    tensions = np.array([m.pulls(e)[1] for e in eta])
    tensions[::3, 2] = np.nan  # a missing gauge: the model stands in
    out = measured_force(eta, tensions, m.fairleads, m.anchors, m.start, m.step, m.horizontal, m.tension)
    np.testing.assert_allclose(out, [m.force(e) for e in eta], rtol=1e-10, atol=1e-10)
    doubled = measured_force(eta, 2.0 * tensions, m.fairleads, m.anchors, m.start, m.step, m.horizontal, m.tension)
    np.testing.assert_allclose(doubled[1], 2.0 * out[1], rtol=1e-10, atol=1e-10)


def test_wind_pushes_away_from_where_it_comes() -> None:
    travel = np.radians([0.0, 90.0]) + np.pi  # from ahead, from starboard
    out = wind_force((0.05, 0.25, 0.1), np.array([2.0, 2.0]), travel)
    np.testing.assert_allclose(out, [[-0.2, 0.0, 0.0], [0.0, -1.0, 0.0]], atol=1e-12)


def test_a_quiet_record_does_not_make_the_force_deaf(fitted: ForceBalance) -> None:
    quiet = Noise((0.36, 0.1, 0.01), (1e-9, 1e-9, 1e-9), (0.01, 0.01, 0.01), (1e-6, 1e-6, 1e-6), 4.2, 0.1)
    raised = quickened(quiet, 6.0, fitted.plant)
    assert raised.bias == pytest.approx((0.01, 0.01, 0.01 * 32.0 / 80.0))
    lively = replace(quiet, bias=(1.0, 1.0, 1.0))
    assert quickened(lively, 6.0, fitted.plant) == lively


def test_residuals_are_causal_mean_free_and_masked_at_start_and_after_long_gaps(
    fitted: ForceBalance, broken: Channels
) -> None:
    out = fitted(broken)
    settle = int(np.ceil(fitted.settle * 10))
    assert not out.valid[: settle - 1].any()
    assert out.valid[settle + 1 :].all()
    np.testing.assert_allclose(out.values[FITTED][out.valid[FITTED].all(axis=1)].mean(axis=0), 0.0, atol=1e-9)
    part = replace(
        broken, values=broken.values[:3000], valid=broken.valid[:3000], grid=replace(broken.grid, n=3000)
    )  # fmt: skip
    np.testing.assert_array_equal(fitted(part).values, out.values[:3000])
    values, valid = np.array(broken.values), np.array(broken.valid)
    for start, stop in ((5000, 5020), (8000, 8000 + 2 * settle)):
        values[start:stop, 0], valid[start:stop, 0] = np.nan, False
    gappy = fitted(replace(broken, values=values, valid=valid)).valid.all(axis=1)
    assert not gappy[5000:5020].any()
    assert gappy[5020:8000].all()
    assert not gappy[8000 : 8000 + 3 * settle].any()
    assert gappy[8000 + 3 * settle :].all()


def test_stored_and_read_again_it_gives_the_same_without_statics(
    fitted: ForceBalance, broken: Channels, monkeypatch: pytest.MonkeyPatch
) -> None:
    body = json.loads(json.dumps(fitted.to_dict()))

    def refused(*args: Any) -> None:
        raise AssertionError("statics are solved again")

    monkeypatch.setattr(rig, "mooring_of", refused)
    monkeypatch.setattr(rig, "fault_tables", refused)
    again = ForceBalance.from_dict(body)
    a, b = fitted(broken), again(broken)
    np.testing.assert_array_equal(a.values, b.values)
    np.testing.assert_array_equal(a.signatures.matrix, b.signatures.matrix)
    assert a.signatures.faults == b.signatures.faults
    assert json.loads(json.dumps(again.to_dict())) == body


def test_what_is_logged_decides_what_is_shown(broken: Channels) -> None:
    short = [Training(broken, (slice(0, 1500),))]
    beside = ForceBalance.fit(short, run(broken.names, ("tension", "force_balance")))
    assert beside.names == ("common force north", "common force east", "common moment yaw")
    bare = only(broken, PLACES)
    alone = ForceBalance.fit([Training(bare, (slice(0, 1500),))], run(PLACES))
    out = alone(bare)
    assert out.names == ("unexplained force north", "unexplained force east", "unexplained moment yaw")
    faults = {f.kind for f in out.signatures.faults}
    assert faults == {"line_lost", "line_weakened", "environment", "sensor_fault"}
    assert not any(f.subject.startswith("tension") for f in out.signatures.faults)
    sight = alone.sights[3]
    np.testing.assert_allclose(row(out.signatures, "line_lost line_4"), sight.share * np.asarray(sight.pull))


@pytest.mark.parametrize(
    ("names", "mooring", "message"),
    [
        (PLACES, {"model": {}}, "needs a vessel file"),
        (("north", "east", "tension_1"), {}, "unknown channel 'heading'"),
        ((*PLACES, "tension_1"), {"lines": ["line_9"]}, "no channel 'tension_9'"),
    ],
)
def test_what_is_missing_is_said(
    broken: Channels, names: tuple[str, ...], mooring: dict[str, Any], message: str
) -> None:
    some = only(broken, names)
    with pytest.raises(ConfigError, match=message):
        ForceBalance.fit([Training(some, (FITTED,))], run(names, mooring=mooring))


def test_a_vessel_without_buoys_comes_back_from_a_file(fitted: ForceBalance) -> None:
    """JSON has no NaN: what a line without a buoy has for its loss is null in the file."""
    bare = replace(fitted, sights=tuple(replace(s, weakened=np.nan, slope=np.nan) for s in fitted.sights))
    again = ForceBalance.from_dict(json.loads(json_bytes(encode(bare.to_dict()))))
    assert not any(f.kind == "line_weakened" for f in again.signatures().faults)
    assert np.array_equal(again.signatures().matrix, bare.signatures().matrix)
