"""Truth: a plain-numpy twin, statics, a steady state by hand, a second integrator (scipy), Bayes by enumeration."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from mooringdx.errors import ConfigError
from mooringdx.observers.matrices import Plant, plant_of
from mooringdx.observers.passive import Passive, passive, single_losses, watch
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
