"""Truth: another program (filterpy, scipy), a plain-numpy twin, brute force (quadrature, Monte Carlo), symmetries."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

from mooringdx.errors import FitError
from mooringdx.observers.identify import (
    Record,
    identify,
    measurement_variance,
    spectrum,
    thinned,
    wave_peak,
)
from mooringdx.observers.kalman import HEADING_STEP, Estimate, Filter, held
from mooringdx.observers.matrices import Model, Noise, Plant, discretised, model, plant_of, riccati
from mooringdx.physics.frames import rotation
from mooringdx.physics.mooring import Mooring
from mooringdx.physics.vessel import load_vessel
from mooringdx.simulate.record import stream
from mooringdx.types import Array, replace

VESSELS = Path(__file__).parents[1] / "configs" / "vessels"
NOISE = Noise((0.25, 0.1, 0.01), (8e-3, 8e-3, 3e-3), (0.01, 0.01, 0.01), (1e-6, 1e-6, 8e-7), 4.4, 0.1)
LARGE = Noise(
    (2.9e10, 2.4e10, 9e12), (2.5e7, 2.5e7, 1e10), (0.05, 0.05, 0.001), (0.005, 0.005, 5e-5), 0.9, 0.1
)  # fmt: skip


def plant() -> Plant:
    return plant_of(load_vessel(VESSELS / "cybership3.toml").dynamics)


def rig() -> Mooring:
    """Return six lines with a stiffening tension from a point ahead of the centre of gravity."""
    azimuth = np.radians(30.0 + 60.0 * np.arange(6))
    distance = 10.0 + 0.05 * np.arange(120)
    pull = 0.3 + 2.0 * np.exp((distance - 12.5) / 0.8)
    anchors = 12.5 * np.column_stack([np.cos(azimuth), np.sin(azimuth)])
    names = tuple(f"line_{i + 1}" for i in range(6))
    tables = np.tile(pull, (6, 1))
    return Mooring(names, anchors, np.tile([0.85, 0.0], (6, 1)), 10.0, 0.05, tables, tables / 0.62)


def turning_record(n: int = 3000) -> tuple[Array, Array, Array]:
    """Return places that turn through 40 deg with gaps, and forces in body and earth axes."""
    rng = stream(4, "record")
    t = 0.1 * np.arange(n)
    eta = np.column_stack([-0.85 + 0.1 * np.sin(0.3 * t), 0.1 * np.cos(0.2 * t), np.radians(20.0) * np.sin(0.02 * t)])
    eta += 0.005 * rng.standard_normal(eta.shape)
    eta[:7] = np.nan
    eta[1000:1040, 1] = np.nan
    return eta, rng.standard_normal((n, 3)), 0.3 * rng.standard_normal((n, 3))


def twin(
    filtering: Filter, models: tuple[Model, ...], measured: Array, force: Array, lines: Array, p: Array | None
) -> tuple[Array, Array, Array]:
    """Return states, innovations and their squares by matrices alone."""
    states = np.full((len(measured), 9), np.nan)
    innovations, squares = np.full((len(measured), 3), np.nan), np.full(len(measured), np.nan)
    x = None
    for k, y in enumerate(measured):
        seen = bool(np.isfinite(y).all())
        if x is None:
            if not seen:
                continue
            x = np.concatenate([y, np.zeros(12)])
        m = models[int(np.argmin([abs(x[2] - each.heading) for each in models]))]
        turn = rotation(x[2] - m.heading)
        big = np.eye(15)
        for i in (0, 6, 9, 12):
            big[i : i + 3, i : i + 3] = turn
        if p is not None and seen:
            s = m.C @ p @ m.C.T + m.R
            gain = p @ m.C.T @ np.linalg.inv(s)
        else:
            s, gain = m.S, m.K
        if seen:
            innovations[k] = y - m.C @ x
            squares[k] = innovations[k] @ turn @ np.linalg.inv(s) @ turn.T @ innovations[k]
            x = x + big @ gain @ turn.T @ innovations[k]
        states[k] = x[:9]
        if p is not None:
            p = m.F @ (p - gain @ m.C @ p if seen else p) @ m.F.T + m.Q
        rolled = big.T @ x
        earth = lines[k] + (filtering.mooring.force(x[:3]) if filtering.mooring else 0.0)
        body = force[k] + rotation(m.heading).T @ (turn.T @ earth + m.stiffness @ rolled[:3])
        x = big @ (m.F @ rolled + m.G @ body)
    return states, innovations, squares


@pytest.mark.parametrize("carried", [False, True])
@pytest.mark.parametrize("modelled", [False, True])
def test_kernel_equals_its_plain_numpy_twin(carried: bool, modelled: bool) -> None:
    measured, force, lines = turning_record()
    filtering = Filter(plant(), NOISE, 0.1, rig() if modelled else None, (-0.85, 0.0, 0.0))
    models = filtering.models(measured[:, 2])
    assert len(models) > 10
    p = 2.0 * models[0].P if carried else None
    out = filtering(measured, force, lines, models=models, start_covariance=p)
    states, innovations, squares = twin(filtering, models, measured, force, lines, p)
    for got, want in ((np.hstack([out.position, out.velocity, out.bias]), states), (out.innovation, innovations)):
        np.testing.assert_array_equal(np.isfinite(got), np.isfinite(want))
        np.testing.assert_allclose(got, want, rtol=1e-9, atol=1e-9 * np.nanmax(np.abs(want)))
    np.testing.assert_allclose(out.nis, squares, rtol=1e-7)
    assert not np.isfinite(out.innovation[1000:1040]).any()
    assert np.isfinite(out.position[7:]).all()


@pytest.mark.parametrize("vessel", ["cybership3", "fpso200"])
def test_filter_equals_filterpy_over_ten_thousand_steps(vessel: str) -> None:
    kalman = pytest.importorskip("filterpy.kalman")
    tank = vessel == "cybership3"
    small, step, noise = plant_of(load_vessel(VESSELS / f"{vessel}.toml").dynamics), 0.1 if tank else 1.0, NOISE
    noise = NOISE if tank else LARGE
    m = model(small, noise, step, 0.4)
    rng = stream(9, vessel)
    n, scale = 10_000, np.sqrt(np.diag(m.P))
    force = rng.standard_normal((n, 3)) * np.sqrt(noise.force)
    measured = np.cumsum(rng.standard_normal((n, 3)), axis=0) * scale[:3]
    measured[5000:5100] = np.nan
    theirs = kalman.KalmanFilter(dim_x=15, dim_z=3, dim_u=3)
    theirs.F, theirs.B, theirs.Q, theirs.H, theirs.R = m.F, m.G, m.Q, m.C, m.R
    theirs.x, theirs.P = np.zeros(15), 4.0 * np.array(m.P)
    theirs.x[:3] = measured[0]
    states = np.empty((n, 9))
    for k in range(n):
        if np.isfinite(measured[k]).all():
            theirs.update(measured[k])
        states[k] = theirs.x[:9]
        theirs.predict(u=force[k])
    out = Filter(small, noise, step)(measured, force, models=[m], turning=False, start_covariance=4.0 * np.array(m.P))
    ours = np.hstack([out.position, out.velocity, out.bias])
    size = np.abs(states).max(axis=0)
    assert np.max(np.abs(ours - states) / size) < 1e-9
    np.testing.assert_allclose(out.final, theirs.x, rtol=1e-9, atol=1e-9 * np.abs(theirs.x).min())
    root = np.sqrt(np.diag(theirs.P))
    assert np.max(np.abs(out.final_covariance - theirs.P) / np.outer(root, root)) < 1e-9


@pytest.mark.parametrize(("vessel", "noise", "step"), [("cybership3", NOISE, 0.1), ("fpso200", LARGE, 1.0)])
def test_steady_covariance_equals_scipy_and_solves_its_equation(vessel: str, noise: Noise, step: float) -> None:
    one = plant_of(load_vessel(VESSELS / f"{vessel}.toml").dynamics)
    stiffness = np.diag([0.2, 0.2, 0.1]) * np.diag(one.inertia)
    m = model(one, noise, step, -0.7, stiffness)
    theirs = solve_discrete_are(m.F.T, m.C.T, m.Q, m.R)
    root = np.sqrt(np.outer(np.diag(theirs), np.diag(theirs)))
    assert np.max(np.abs(m.P - theirs) / root) < 1e-9
    again = m.F @ (np.eye(15) - m.K @ m.C) @ m.P @ m.F.T + m.Q
    assert np.max(np.abs(m.P - again) / root) < 1e-11
    np.testing.assert_allclose(m.S, m.C @ m.P @ m.C.T + m.R, rtol=1e-12)
    assert m.memory < 1e4 * step


def test_scalar_riccati_has_its_closed_form() -> None:
    f, q, r = 0.9, 0.3, 2.0
    b = r - f * f * r - q
    want = 0.5 * (-b + np.sqrt(b * b + 4.0 * q * r))
    got = riccati(np.array([[f]]), np.array([[q]]), np.array([[1.0]]), np.array([[r]]))
    assert got[0, 0] == pytest.approx(want, rel=1e-13)


def test_discretisation_equals_quadrature() -> None:
    a = np.array([[0.0, 1.0, 0.0], [-4.0, -0.3, 1.0], [0.0, 0.0, 0.0]])
    b, q, step = np.array([[0.0], [1.0], [0.0]]), np.diag([0.0, 0.5, 0.2]), 0.4
    f, g, w = discretised(a, b, q, step)
    nodes, weights = np.polynomial.legendre.leggauss(20)
    times, weights = 0.5 * step * (nodes + 1.0), 0.5 * step * weights
    np.testing.assert_allclose(f, expm(a * step), rtol=1e-13, atol=1e-15)
    moved = sum(x * expm(a * t) @ b for t, x in zip(times, weights, strict=True))
    noise = sum(x * expm(a * t) @ q @ expm(a * t).T for t, x in zip(times, weights, strict=True))
    np.testing.assert_allclose(g, moved, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(w, noise, rtol=1e-12, atol=1e-15)


def test_a_turned_world_turns_the_estimate() -> None:
    measured, force, lines = turning_record(1500)
    by = 4.0 * HEADING_STEP
    turn, mooring = rotation(by), rig()
    there = replace(mooring, anchors=mooring.anchors @ turn[:2, :2].T)
    turned = measured @ turn.T
    turned[:, 2] += by
    places = (-0.85, 0.0, 0.0), (-0.85 * np.cos(by), -0.85 * np.sin(by), by)
    a = Filter(plant(), NOISE, 0.1, mooring, places[0])(measured, force, lines)
    b = Filter(plant(), NOISE, 0.1, there, places[1])(turned, force, lines @ turn.T)
    np.testing.assert_allclose(b.bias, a.bias @ turn.T, atol=1e-8)
    np.testing.assert_allclose(b.velocity, a.velocity, atol=1e-9)


def matched(n: int, noise: Noise, step: float, seed: int, stiffness: Array | None = None) -> tuple[Array, Array, Model]:
    """Return places, (n, 3), and true states, (n, 15), of the filter's own model at heading zero."""
    m = model(plant(), noise, step, 0.0, stiffness)
    rng = stream(seed, "matched")
    root = np.linalg.cholesky(m.Q + 1e-18 * np.diag(np.diag(m.P)))
    shocks = rng.standard_normal((n, 15)) @ root.T
    rough = rng.standard_normal((n, 3)) * np.sqrt(noise.measurement)
    x, states = np.zeros(15), np.empty((n, 15))
    for k in range(n):
        states[k] = x
        x = m.F @ x + shocks[k]
    return states @ m.C.T + rough, states, m


def test_innovations_and_errors_are_as_large_as_the_filter_says() -> None:
    stiffness = np.diag([17.0, 17.0, 12.0])
    measured, states, m = matched(30_000, NOISE, 0.1, 3, stiffness)
    np.testing.assert_allclose(springs(stiffness).stiffness(np.zeros(3)), stiffness, atol=0.02)
    out: Estimate = Filter(plant(), NOISE, 0.1, springs(stiffness))(measured, models=[m], turning=False)
    assert out.nis_mean == pytest.approx(3.0, abs=0.06)
    np.testing.assert_allclose(out.covariance, m.S, atol=0.03 * float(np.diag(m.S).max()))
    error = np.hstack([out.position, out.velocity, out.bias]) - states[:, :9]
    after = (np.eye(15) - m.K @ m.C) @ m.P
    np.testing.assert_allclose(error[500:].std(axis=0), np.sqrt(np.diag(after)[:9]), rtol=0.1)


def springs(stiffness: Array) -> Mooring:
    """Return a mooring whose force is -K eta for small eta, K diagonal with one value for north and east."""
    far, arm = 1e4, float(np.sqrt(stiffness[2, 2] / stiffness[0, 0]))
    fairleads = np.array([[0.0, 0.0], [0.0, 0.0], [arm, 0.0], [arm, 0.0], [-arm, 0.0], [-arm, 0.0]])
    toward = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0], [0.0, 1.0], [0.0, -1.0]])
    rate = stiffness[0, 0] * np.array([0.5, 0.5, 0.25, 0.25, 0.25, 0.25])
    tables = rate[:, None] * np.arange(0.0, 20.0, 0.1)[None, :]
    names = tuple(f"line_{i + 1}" for i in range(6))
    return Mooring(names, fairleads + far * toward, fairleads, far - 10.0, 0.1, tables, tables)


def test_a_lost_measurement_is_only_predicted_and_forces_hold() -> None:
    values = np.array([[np.nan, 1.0], [2.0, np.nan], [np.nan, np.nan], [3.0, 4.0]])
    np.testing.assert_array_equal(held(values), [[0.0, 1.0], [2.0, 1.0], [2.0, 1.0], [3.0, 4.0]])
    measured, force, lines = turning_record(400)
    force[200:210] = np.nan
    held_by_hand = force.copy()
    held_by_hand[200:210] = force[199]
    filtering = Filter(plant(), NOISE, 0.1)
    np.testing.assert_array_equal(
        filtering(measured, force, lines).position, filtering(measured, held_by_hand, lines).position
    )


def test_a_prefix_gives_the_prefix() -> None:
    measured, force, lines = turning_record(2000)
    filtering = Filter(plant(), NOISE, 0.1, rig(), (-0.85, 0.0, 0.0))
    whole, part = filtering(measured, force, lines), filtering(measured[:1200], force[:1200], lines[:1200])
    np.testing.assert_array_equal(whole.bias[:1200], part.bias)


def test_noise_of_positions_and_peak_of_waves_are_read_from_the_record() -> None:
    rng, t = stream(5, "waves"), 0.1 * np.arange(20_000)
    band = np.linspace(3.6, 6.4, 60)
    size = 0.004 * np.exp(-((band - 4.4) ** 2) / 0.18)
    waves = np.cos(np.outer(t, band) + 2 * np.pi * rng.random(60)) @ size
    slow = 0.3 * np.sin(0.48 * t)
    sd = np.array([1e-3, 1e-3, 9e-4])
    measured = np.column_stack([slow + waves, 0.5 * waves, 0.2 * waves]) + sd * rng.standard_normal((t.size, 3))
    variance = measurement_variance(measured)
    np.testing.assert_allclose(variance, sd**2, rtol=0.1)
    omega, density = spectrum(measured, 0.1, 13.0)
    assert wave_peak(omega, density, variance, 0.1, 1.5) == pytest.approx(4.4, rel=0.06)
    np.testing.assert_allclose(density.sum(axis=0) * omega[1] / (2 * np.pi), measured.var(axis=0), rtol=0.2)
    # A short record of a large vessel: the noise of 10 Hz fixes must not be taken for waves.
    t = 0.1 * np.arange(30_000)
    rough = 0.0707 * rng.standard_normal((t.size, 3))
    large = rough + 0.1 * np.column_stack([np.cos(np.outer(t, np.linspace(0.8, 1.0, 40))).sum(axis=1) / 6.0] * 3)
    omega, density = spectrum(large, 0.1, 670.0)
    assert wave_peak(omega, density, measurement_variance(large), 0.1, 0.035) == pytest.approx(0.9, rel=0.15)


def test_forces_are_averaged_where_the_record_is_thinned() -> None:
    record = Record(np.arange(30.0).reshape(10, 3), np.arange(30.0).reshape(10, 3), np.zeros((10, 3)), 0.1)
    thin = thinned(record, 2.0 * np.pi / 3.0)  # ten of 30 samples a period: every third
    assert thin.step == pytest.approx(0.3)
    np.testing.assert_array_equal(thin.measured[:, 0], [0.0, 9.0, 18.0])
    np.testing.assert_array_equal(thin.force[:, 0], [3.0, 12.0, 21.0])


def test_identified_noise_is_that_of_the_record() -> None:
    stiffness = np.diag([17.0, 17.0, 12.0])
    true = Noise((0.3, 0.1, 0.03), (3e-3, 3e-3, 1.2e-3), (0.02, 0.01, 0.01), (1e-6, 1e-6, 8e-7), 4.4, 0.08)
    measured, _, _ = matched(8_000, true, 0.1, 8, stiffness)
    zero, variance = np.zeros(measured.shape), np.array(true.measurement)
    record = Record(measured, zero, zero, 0.1)
    found = identify(record, plant(), springs(stiffness), stiffness, np.zeros(3), variance)
    assert found.nis == pytest.approx(3.0, abs=0.1)
    np.testing.assert_allclose(found.noise.force, true.force, rtol=0.4)
    assert abs(np.log(found.noise.bias[0] / true.bias[0])) < 1.5
    np.testing.assert_allclose(found.noise.wave, true.wave, rtol=0.25)
    assert found.noise.share == pytest.approx(true.share, rel=0.4)
    with pytest.raises(FitError, match="under two slow periods"):
        identify(Record(measured[:300], zero[:300], zero[:300], 0.1), plant(), None, stiffness, np.zeros(3))
