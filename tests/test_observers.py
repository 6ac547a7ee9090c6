"""Truth: a plain-numpy twin, statics, a steady state by hand, other programs (scipy, filterpy), differences."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from mooringdx.errors import ConfigError, FitError
from mooringdx.observers.ekf import Vessel, advanced, ekf, jacobian
from mooringdx.observers.kalman import Filter
from mooringdx.observers.matrices import Noise, Plant, plant_of
from mooringdx.observers.passive import Passive, passive, single_losses, watch
from mooringdx.observers.rpem import track
from mooringdx.observers.ukf import step_noise, ukf
from mooringdx.physics.frames import rotation
from mooringdx.physics.mooring import Mooring
from mooringdx.physics.rig import mooring_of
from mooringdx.physics.vessel import load_vessel
from mooringdx.simulate.record import stream
from mooringdx.types import Array, replace

VESSEL = Path(__file__).parents[1] / "configs" / "vessels" / "fpso200.toml"
W0 = 2.0 * np.pi / 7.0


@pytest.fixture(scope="module")
def lines() -> Mooring:
    return mooring_of(load_vessel(VESSEL))


def hull() -> Plant:
    return plant_of(load_vessel(VESSEL).dynamics)


def record(n: int) -> tuple[Array, Array]:
    """Return a wandering measured place and a thrust."""
    rng = stream(7, "passive record")
    t = 0.1 * np.arange(n)
    eta = np.column_stack([3.0 * np.sin(0.05 * t), 2.0 * np.cos(0.03 * t), -2.36 + 0.2 * np.sin(0.02 * t)])
    return eta + [0.07, 0.07, 0.007] * rng.standard_normal((n, 3)), 1e5 * rng.standard_normal((n, 3))


def slope(o: Passive, x: Array, y: Array, held: Array, turn: Array, seen: bool) -> Array:
    """Return the derivative of one observer's state by matrices, as in the opening of the module."""
    xi, xi_w, eta, b, nu = np.split(x, 5)
    e = y - eta - xi_w if seen else np.zeros(3)
    force = -o.damping @ nu + turn.T @ (b + o.K4 * e) + held
    return np.concatenate(
        [
            xi_w + o.K1[0] * e,
            -o.wave[0] * xi - o.wave[1] * xi_w + o.K1[1] * e,
            turn @ nu + o.K2 * e,
            -o.decay * b + o.K3 * e,
            o.inverse @ force,
        ]
    )


def twin(o: Passive, lines: Mooring, shares: Array, measured: Array, force: Array, h: float) -> tuple[Array, Array]:
    innovation = np.full((len(measured), len(shares), 3), np.nan)
    final = np.empty((len(shares), 15))
    for i, share in enumerate(shares):
        rig = replace(lines, horizontal=lines.horizontal * share[:, None])
        x = np.zeros(15)
        x[6:9] = measured[0]
        for k, y in enumerate(measured):
            seen = bool(np.isfinite(y).all())
            if seen:
                innovation[k, i] = y - x[6:9] - x[3:6]
            turn = rotation(y[2] if seen else x[8])
            held = turn.T @ rig.force(x[6:9]) + force[k]
            a = slope(o, x, y, held, turn, seen)
            b = slope(o, x + 0.5 * h * a, y, held, turn, seen)
            c = slope(o, x + 0.5 * h * b, y, held, turn, seen)
            d = slope(o, x + h * c, y, held, turn, seen)
            x = x + h / 6.0 * (a + 2.0 * b + 2.0 * c + d)
        final[i] = x
    return innovation, final


@pytest.mark.parametrize("equations", ["printed", "mended"])
def test_passive_kernel_is_its_numpy_twin(lines: Mooring, equations: str) -> None:
    plant = hull()
    o = passive(replace(plant, damping=plant.damping + 1e5 * np.arange(9.0).reshape(3, 3)), W0, equations=equations)
    measured, force = record(400)
    measured[100:120, 1] = np.nan
    shares = single_losses(8)
    shares[3, 5] = 0.4
    got = watch(o, lines, shares, measured, force, 0.1)
    innovation, final = twin(o, lines, shares, measured, force, 0.1)
    np.testing.assert_array_equal(np.isnan(got.innovation), np.isnan(innovation))
    np.testing.assert_allclose(got.innovation, innovation, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(got.final, final, rtol=1e-9, atol=1e-9)


def test_passive_step_agrees_with_an_adaptive_integrator(lines: Mooring) -> None:
    o = passive(hull(), W0)
    measured, force = record(2)
    x0 = np.zeros(15)
    x0[6:9] = measured[0] + [1.0, -2.0, 0.01]
    got = watch(o, lines, np.ones((1, 8)), measured[:1], force[:1], 0.1, x0).final[0]
    turn = rotation(measured[0, 2])
    held = turn.T @ lines.force(x0[6:9]) + force[0]
    exact = solve_ivp(lambda _, x: slope(o, x, measured[0], held, turn, True), (0.0, 0.1), x0, rtol=1e-11, atol=1e-13)
    np.testing.assert_allclose(got - x0, exact.y[:, -1] - x0, rtol=2e-4, atol=1e-9)


@pytest.mark.parametrize("equations", ["printed", "mended"])
def test_passive_steady_innovation_is_the_unexplained_force_over_the_gain(lines: Mooring, equations: str) -> None:
    """Measured at rest at the middle, line 7 held for lost: what it pulls must be carried by innovation and speed.

    By hand: eta' = 0 gives R nu = -K2 y~, and the forces balance, R D R' K2 y~ + (K4 + K3 T_b) y~ + tau_m = 0.
    """
    o = passive(hull(), W0, equations=equations)
    place = np.array([0.0, 0.0, -2.36])
    measured = np.tile(place, (40000, 1))
    got = watch(o, lines, single_losses(8)[6:7], measured, np.zeros((40000, 3)), 0.1)
    e, eta = got.innovation[-1, 0], got.position[-1, 0]
    turn = rotation(-2.36)
    push = lines.without(["line_7"]).force(eta)
    resist = turn @ o.damping @ turn.T * o.K2 + np.diag(o.K4 + o.K3 / o.decay)
    np.testing.assert_allclose((resist @ e + push)[:2], 0.0, atol=1e-3 * np.hypot(*push[:2]))
    assert np.hypot(*push[:2]) > 1e5
    if equations == "printed":
        assert np.abs(got.bias[-1, 0, :2]).max() < 100.0, "K3 in N/m: the bias never learns the force"
    else:
        assert np.hypot(*got.bias[-1, 0, :2]) > 0.5 * np.hypot(*push[:2])


def test_passive_wave_filter_keeps_waves_out_of_the_slow_motion(lines: Mooring) -> None:
    t = 0.1 * np.arange(6000)
    measured = np.column_stack([0.5 * np.sin(W0 * t), 0.0 * t, -2.36 + 0.0 * t])
    out = watch(passive(hull(), W0, equations="mended"), lines, np.ones((1, 8)), measured, np.zeros((6000, 3)), 0.1)
    without = watch(
        replace(passive(hull(), W0), K1=np.zeros((2, 3))), lines, np.ones((1, 8)), measured, np.zeros((6000, 3)), 0.1
    )
    kept, passed = out.position[3000:, 0, 0].std(), without.position[3000:, 0, 0].std()
    assert kept < 0.15 * measured[3000:, 0].std()
    assert passed > 3.0 * kept


def test_passive_values_are_those_printed_and_listed() -> None:
    text, listing = passive(hull(), W0), passive(hull(), W0, values="listing")
    assert text.K2[0] == pytest.approx(1.2255 * W0)
    assert listing.K2[0] == pytest.approx(1.1)
    assert text.K1[0, 0] == pytest.approx(-1.8 * 1.2255)
    assert text.K1[1, 2] == pytest.approx(1.8 * W0)
    np.testing.assert_allclose(text.K4, [0.1, 0.1, 0.01])
    np.testing.assert_allclose(listing.K3, [0.03, 0.03, 0.001])
    with pytest.raises(ConfigError, match="text, listing"):
        passive(hull(), W0, values="other")


NOISE = Noise(
    (2.9e10, 2.4e10, 9e12), (2.5e7, 2.5e7, 1e10), (0.05, 0.05, 0.001), (0.005, 0.005, 5e-5), 0.9, 0.1
)  # fmt: skip


def moored(lines: Mooring | None, step: float = 0.5, bias: bool = True) -> Vessel:
    return Vessel(hull(), NOISE, step, lines, bias)


def simulated(vessel: Vessel, n: int, name: str = "ekf record") -> Array:
    """Return the places that the model itself makes, noise and all, from rest 3 m off."""
    rng = stream(2, name)
    root = np.linalg.cholesky(step_noise(vessel, -2.36) + 1e-18 * np.eye(15))
    rig, x = vessel.rig, np.zeros(15)
    x[:3] = [3.0, -2.0, -2.36]
    out = np.empty((n, 3))
    for k in range(n):
        out[k] = x[:3] + x[12:15] + np.sqrt(NOISE.measurement) * rng.standard_normal(3)
        x = advanced(
            x, np.zeros(3), vessel.step, vessel.plant.damping, vessel.inverse, vessel.waves(vessel.step),
            rig.fairleads, rig.anchors, rig.start, rig.step, rig.horizontal,
        )  # fmt: skip
        x = x + root @ rng.standard_normal(15)
    return out


def test_jacobian_is_the_slope_of_the_step(lines: Mooring) -> None:
    vessel, rng = moored(lines, 1e-3), stream(9, "place")
    x = np.zeros(15)
    x[:9] = [12.0, -8.0, 0.7, 0.3, -0.2, 0.01, 2e5, -1e5, 3e6]
    rig = replace(lines, fairleads=lines.fairleads + rng.uniform(-40.0, 40.0, lines.fairleads.shape))
    args = (vessel.plant.damping, vessel.inverse)
    tables = (rig.fairleads, rig.anchors, rig.start, rig.step, rig.horizontal)
    got = jacobian(x, *args, *tables)

    def rate(at: Array) -> Array:
        turn = rotation(at[2])
        force = turn.T @ (rig.force(at[:3]) + at[6:9]) - vessel.plant.damping @ at[3:6]
        return np.concatenate([turn @ at[3:6], vessel.inverse @ force, np.zeros(3)])

    unit = np.array([1e-2, 1e-2, 1e-5, 1e-3, 1e-3, 1e-5, 10.0, 10.0, 1e3])
    for i in range(9):
        delta = np.zeros(15)
        delta[i] = unit[i]
        want = (rate(x + delta) - rate(x - delta)) / (2.0 * unit[i])
        np.testing.assert_allclose(got[:, i], want, rtol=2e-4, atol=1e-9 * np.abs(want).max() + 1e-16)


def test_ekf_without_lines_at_one_heading_is_the_exact_linear_filter() -> None:
    measured = simulated(moored(None), 400)
    measured[:, 2] = -2.36
    measured[50:60, 0] = np.nan
    still = replace(NOISE, force=(2.9e10, 2.4e10, 1e-3), bias=(2.5e7, 2.5e7, 1e-9), wave=(0.05, 0.05, 1e-12))
    vessel = Vessel(hull(), still, 0.5)
    x, p = vessel.start(measured)
    force = 1e5 * stream(1, "force").standard_normal((400, 3)) * [1.0, 1.0, 0.0]
    got = ekf(vessel, measured, force, (x, p))
    linear = Filter(hull(), still, 0.5)
    want = linear(measured, force, models=[linear.model(-2.36)], turning=False, start_covariance=p)
    np.testing.assert_allclose(got.innovation[:, :2], want.innovation[:, :2], atol=2e-5)  # sd 0.1
    np.testing.assert_allclose(got.bias[-1, :2], want.bias[-1, :2], rtol=1e-4, atol=5.0)
    np.testing.assert_allclose(np.diag(got.final_covariance)[:2], np.diag(want.final_covariance)[:2], rtol=1e-4)


def test_ekf_is_consistent_on_what_its_own_model_makes(lines: Mooring) -> None:
    vessel = moored(lines)
    out = ekf(vessel, simulated(vessel, 6000))
    assert float(np.nanmean(out.nis[200:])) == pytest.approx(3.0, abs=0.1)
    np.testing.assert_allclose(out.covariance, out.covariance.T)


@pytest.mark.parametrize("alpha", [1.0, 1e-3])
def test_ukf_and_ekf_agree_where_little_bends(lines: Mooring, alpha: float) -> None:
    vessel = moored(lines)
    measured = simulated(vessel, 300)
    one, other = ekf(vessel, measured), ukf(vessel, measured, alpha=alpha)
    sd = np.sqrt(np.diag(one.covariance))
    assert np.abs((one.innovation - other.innovation)[20:] / sd).max() < 0.05
    assert float(np.nanmean(other.nis)) == pytest.approx(float(np.nanmean(one.nis)), rel=0.02)


def test_ukf_is_that_of_another_program(lines: Mooring) -> None:
    """filterpy's unscented filter, told to draw its points anew after the prediction, on the same model."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    vessel = moored(lines)
    measured = simulated(vessel, 60)
    x, p = vessel.start(measured)
    q, rig = step_noise(vessel, -2.36), lines

    def on(state: Array, dt: float) -> Array:
        return advanced(
            np.ascontiguousarray(state), np.zeros(3), dt, vessel.plant.damping, vessel.inverse, vessel.waves(dt),
            rig.fairleads, rig.anchors, rig.start, rig.step, rig.horizontal,
        )  # fmt: skip

    points = MerweScaledSigmaPoints(15, 1.0, 2.0, 0.0, sqrt_method=lambda a: np.linalg.cholesky(a).T)
    other = UnscentedKalmanFilter(15, 3, 0.5, lambda s: s[:3] + s[12:15], on, points)
    other.x, other.P, other.Q, other.R = x.copy(), p.copy(), q, np.diag(NOISE.measurement)
    other.sigmas_f = points.sigma_points(x, p)
    got = ukf(vessel, measured, start=(x, p), noise=q)
    for k in range(60):
        other.sigmas_f = points.sigma_points(other.x, other.P)
        other.update(measured[k])
        np.testing.assert_allclose(got.innovation[k], other.y, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(got.position[k], other.x[:3], rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(got.bias[k], other.x[6:9], rtol=1e-5, atol=1e-2)
        other.predict()


def test_twelve_states_settle_beside_a_steady_force_and_fifteen_do_not(lines: Mooring) -> None:
    """A vessel held 10 m off by a force that no filter is told of: by the lines' stiffness."""
    place = np.array([10.0, 0.0, -2.36])
    measured = np.tile(place, (3000, 1)) + 0.01 * stream(6, "hold").standard_normal((3000, 3)) * [1.0, 1.0, 0.01]
    tight = replace(NOISE, force=(1e8, 1e8, 1e12), wave=(0.01, 0.01, 1e-5))
    both = [Vessel(hull(), tight, 0.5, lines, bias) for bias in (False, True)]
    for estimated in (lambda v: ekf(v, measured), lambda v: ukf(v, measured)):
        without, with_bias = (estimated(v).position[-500:].mean(axis=0) for v in both)
        assert abs(without[0] - 10.0) > 0.3
        assert abs(with_bias[0] - 10.0) < 0.02
    found = ekf(both[1], measured).bias[-500:].mean(axis=0)
    np.testing.assert_allclose(found[:2], -lines.force(place)[:2], atol=2e3)
    assert not ekf(both[0], measured).bias.any()


def test_an_alpha_of_zero_is_refused(lines: Mooring) -> None:
    with pytest.raises(ConfigError, match="above 0"):
        ukf(moored(lines), np.zeros((3, 3)), alpha=0.0)


MASS, DRAG = 6.1e7, 1e5


def swell(w: float, n: int, step: float, name: str = "swell") -> Array:
    """Return slow drift, a narrow-band motion of frequency ``w`` and noise, (n,), m."""
    from scipy.signal import lfilter

    rng = stream(8, name)
    pole = np.exp((-0.05 * w + 1j * w) * step)
    wave = lfilter([1.0, -1.0], [1.0, -2.0 * pole.real, abs(pole) ** 2], rng.standard_normal(n))
    return np.asarray(
        0.3 * wave / wave.std() + np.sin(2.0 * np.pi * np.arange(n) * step / 400.0) + 0.05 * rng.standard_normal(n)
    )


@pytest.mark.parametrize(("equations", "close"), [("mended", True), ("printed", False)])
def test_rpem_sensitivity_against_brute_force(equations: str, close: bool) -> None:
    """The prediction run at w + d and w - d with the gains of the run at w held: what eq. 13 differentiates."""
    step, w, n, width = 0.5, 0.6, 300, 1e-4
    z = swell(0.55, n, step)
    got = track(z, np.zeros(n), step, MASS, DRAG, w, equations=equations, adapt=False)

    def predictions(at: float) -> Array:
        if equations == "printed":
            wave = np.array([[1.0, step], [-(at**2) * step, 1.0 - 0.2 * at * step]])
            low = np.eye(3) + step * np.array([[0, 1, 0], [0, -DRAG / MASS, 1 / MASS], [0, 0, 0]])
        else:
            wave = expm(step * np.array([[0.0, 1.0], [-(at**2), -0.2 * at]]))
            low = expm(step * np.array([[0, 1, 0], [0, -DRAG / MASS, 1 / MASS], [0, 0, 0]]))
        phi = np.zeros((5, 5))
        phi[np.ix_([0, 1, 4], [0, 1, 4])], phi[2:4, 2:4] = low, wave
        x, out = np.array([z[0], 0.0, 0.0, 0.0, 0.0]), np.empty(n)
        for k in range(n):
            out[k] = x[0] + x[3]
            x = phi @ (x + got.gain[k] * (z[k] - out[k]))
        return out

    np.testing.assert_allclose(z - predictions(w), got.innovation, atol=1e-9)
    want = (predictions(w + width) - predictions(w - width)) / (2.0 * width)
    off = np.abs(got.sensitivity - want).max() / np.abs(want).max()
    assert off < 1e-4 if close else off > 0.02, "eq. 14 as printed loses the gain's term"


@pytest.mark.parametrize(("step", "start"), [(0.5, 0.9), (0.2, 0.35), (1.0, None)])
def test_rpem_finds_the_frequency(step: float, start: float | None) -> None:
    n = round(3000.0 / step)
    z = swell(0.55, n, step)
    z[n // 3 : n // 3 + 20] = np.nan
    out = track(z, np.zeros(n), step, MASS, DRAG, start)
    assert float(np.median(out.frequency[n // 2 :])) == pytest.approx(0.55, rel=0.06)
    assert float(np.std((z - out.slow)[n // 2 :])) < 0.45
    if start is None:
        assert out.frequency[0] == pytest.approx(0.55, rel=0.15)


def test_rpem_printed_runs_away_at_one_second_and_the_exact_block_does_not() -> None:
    """I + A dt has poles of modulus^2 1 - 2 z w dt + (w dt)^2, over 1 where dt > 2 z/w: here 0.2 s."""
    z = swell(1.0, 600, 1.0)
    gap = np.where(np.arange(600) > 300, np.nan, z)
    printed, mended = (
        track(gap, np.zeros(600), 1.0, MASS, DRAG, 1.0, equations=e, adapt=False) for e in ("printed", "mended")
    )
    assert np.abs(printed.wave[-50:]).max() > 1e3
    assert np.abs(mended.wave[-50:]).max() < 1e-3


def test_rpem_needs_fixes_to_start_and_known_equations() -> None:
    with pytest.raises(FitError, match="under 20 fixes"):
        track(np.full(100, np.nan), np.zeros(100), 1.0, MASS, DRAG)
    with pytest.raises(ConfigError, match="printed, mended"):
        track(np.zeros(100), np.zeros(100), 1.0, MASS, DRAG, 0.6, equations="other")
