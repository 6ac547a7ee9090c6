"""Spectra, spreading and dispersion against their definitions."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from mooringdx.errors import ConfigError
from mooringdx.physics.waves import GRAVITY, SPECTRA, density, moments, spreading, wavenumber


@pytest.mark.parametrize("kind", SPECTRA)
@pytest.mark.parametrize("peakedness", [1.0, 3.3, 7.0])
def test_the_density_integrates_to_a_sixteenth_of_the_height_squared(kind: str, peakedness: float) -> None:
    omega = np.linspace(0.0, 60.0, 600_001)
    area = moments(omega, density(kind, omega, 3.5, 11.0, peakedness), 0)
    assert area == pytest.approx(3.5**2 / 16.0, rel=1e-5)


@pytest.mark.parametrize("kind", SPECTRA)
@pytest.mark.parametrize(("n", "dt"), [(7200, 0.5), (3600, 1.0), (36_000, 0.1)])
def test_the_bins_of_a_record_hold_the_height_but_for_the_tail_beyond_nyquist(kind: str, n: int, dt: float) -> None:
    omega = 2.0 * np.pi * np.fft.rfftfreq(n, dt)
    area = float(np.sum(density(kind, omega, 3.0, 10.0)) * omega[1])
    tail = 1.25 / (omega[-1] * 10.0 / (2.0 * np.pi)) ** 4
    assert 1.0 - 1.05 * tail - 2e-5 < area * 16.0 / 9.0 < 1.0 + 1e-4


def test_pierson_moskowitz_is_the_published_form_in_the_zero_crossing_period() -> None:
    height, crossing = 3.5, 9.0
    omega = np.linspace(0.2, 3.0, 500)
    x = omega * crossing
    want = 4.0 * np.pi**3 * height**2 * crossing * x**-5.0 * np.exp(-((x / (2.0 * np.pi)) ** -4.0) / np.pi)
    peak = crossing * (5.0 * np.pi / 4.0) ** 0.25
    np.testing.assert_allclose(density("pierson-moskowitz", omega, height, peak), want, rtol=1e-10)


def test_the_zero_crossing_period_follows_from_the_moments() -> None:
    omega = np.geomspace(0.05, 500.0, 400_001)
    spectrum = density("pierson-moskowitz", omega, 2.0, 9.0 * (5.0 * np.pi / 4.0) ** 0.25)
    crossing = 2.0 * np.pi * np.sqrt(moments(omega, spectrum, 0) / moments(omega, spectrum, 2))
    assert crossing == pytest.approx(9.0, rel=1e-4)


def test_jonswap_without_a_peak_is_pierson_moskowitz_and_the_peak_is_where_it_is_asked() -> None:
    omega = np.linspace(0.3, 3.0, 27_001)
    flat = density("jonswap", omega, 2.0, 8.0, 1.0)
    np.testing.assert_allclose(flat, density("pierson-moskowitz", omega, 2.0, 8.0), rtol=1e-12)
    sharp = density("jonswap", omega, 2.0, 8.0, 3.3)
    assert omega[sharp.argmax()] == pytest.approx(2.0 * np.pi / 8.0, abs=1e-3)
    ratio = sharp / flat
    assert ratio.max() / ratio[-1] == pytest.approx(3.3, rel=1e-3)
    sides = np.interp(np.array([0.93, 1.09]) * 2.0 * np.pi / 8.0, omega, ratio / ratio[-1])
    np.testing.assert_allclose(sides, 3.3 ** np.exp(-0.5), rtol=1e-3)  # one published width to either side


def test_no_energy_at_rest_and_none_without_waves() -> None:
    omega = np.array([0.0, 0.5, 1.0])
    assert density("jonswap", omega, 3.0, 10.0)[0] == 0.0
    assert not density("jonswap", omega, 0.0, 10.0).any()


@given(st.floats(0.5, 60.0), st.integers(2, 9))
def test_the_directions_have_the_mean_cosine_of_the_law(exponent: float, count: int) -> None:
    offset, share = spreading(exponent, count)
    assert offset.shape == share.shape == (count,)
    assert share.sum() == pytest.approx(1.0)
    assert share @ np.cos(offset) == pytest.approx(exponent / (exponent + 1.0), rel=1e-9)
    np.testing.assert_allclose(offset, -offset[::-1], atol=1e-9)


def test_the_directions_integrate_like_the_law_itself() -> None:
    offset, share = spreading(6.0, 7)

    def law(b: float) -> float:
        return float(np.cos(0.5 * b) ** 12.0)

    for function in (lambda b: np.cos(b) ** 2, lambda b: np.sin(b) ** 4):
        weighed = quad(lambda b, of=function: law(b) * of(b), -np.pi, np.pi)[0]
        want = weighed / quad(law, -np.pi, np.pi)[0]
        assert share @ function(offset) == pytest.approx(want, rel=1e-9)


@pytest.mark.parametrize("exponent", [None, 0, 0.0])
def test_no_spreading_is_one_direction(exponent: float | None) -> None:
    offset, share = spreading(exponent, 7)
    assert offset.tolist() == [0.0]
    assert share.tolist() == [1.0]


@given(st.floats(1e-4, 8.0), st.floats(0.5, 3000.0))
def test_the_wavenumber_satisfies_the_dispersion_relation(omega: float, depth: float) -> None:
    k = wavenumber(np.array([omega]), depth)[0]
    assert GRAVITY * k * np.tanh(k * depth) == pytest.approx(omega**2, rel=1e-10)


def test_the_wavenumber_has_its_two_limits() -> None:
    omega = np.array([0.0, 0.5, 2.0])
    np.testing.assert_allclose(wavenumber(omega), omega**2 / GRAVITY)
    np.testing.assert_allclose(wavenumber(omega, 2000.0), omega**2 / GRAVITY, rtol=1e-12)
    np.testing.assert_allclose(wavenumber(omega * 1e-3, 10.0), omega * 1e-3 / np.sqrt(GRAVITY * 10.0), rtol=1e-5)


def test_a_wrong_sea_is_one_sentence() -> None:
    omega = np.linspace(0.0, 2.0, 5)
    with pytest.raises(ConfigError, match=r"unknown wave spectrum 'jonswp'; did you mean 'jonswap'"):
        density("jonswp", omega, 1.0, 8.0)
    for wrong in ((-1.0, 8.0, 3.3), (1.0, 0.0, 3.3), (1.0, 8.0, 0.5), (float("nan"), 8.0, 3.3)):
        with pytest.raises(ConfigError, match="correct the sea state"):
            density("jonswap", omega, *wrong)
    for exponent, count in ((-1.0, 5), (5.0, 0), (float("nan"), 5)):
        with pytest.raises(ConfigError, match="correct the sea state"):
            spreading(exponent, count)
    with pytest.raises(ConfigError, match="depth"):
        wavenumber(omega, 0.0)
