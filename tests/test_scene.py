"""Truth: brute force and construction: what keeps a healthy vessel from looking broken."""

import numpy as np
import pytest

from mooringdx.chain import believed, drifting
from mooringdx.checks import roughness, shows_sea
from mooringdx.detectors.design import Design
from mooringdx.detectors.reference import Reference
from mooringdx.logs import in_si
from mooringdx.physics.waves import density
from mooringdx.timing import peak_period
from mooringdx.types import Fault, LogSource, RawLog, Signal, Signatures

TIME = 0.2 * np.arange(6000)


@pytest.mark.parametrize("noise", [0.0, 1.0, 2.0])
def test_white_noise_is_not_taken_for_waves(noise: float) -> None:
    rng = np.random.default_rng(1)
    omega = 2.0 * np.pi * np.fft.rfftfreq(TIME.size, 0.2)
    spectrum = np.append(0.0, density("jonswap", omega[1:], 4.0, 5.5))
    phases = np.exp(2j * np.pi * rng.random(omega.size))
    waves = np.fft.irfft(phases * np.sqrt(spectrum))
    seen = waves / waves.std() + noise * rng.standard_normal(TIME.size)
    assert peak_period([seen[:, None]], 0.2) == pytest.approx(5.5, rel=0.12)


def test_a_log_in_memory_is_put_in_si() -> None:
    raw = {
        "heading": Signal("heading", TIME, np.full(TIME.size, 180.0), "deg"),
        "tension_1": Signal("tension_1", TIME, TIME, "kN"),
    }
    found = in_si(RawLog(raw, LogSource("x", "simulated", 0, ""))).signals
    assert found["heading"].values[0] == pytest.approx(np.pi)
    assert found["heading"].unit == "rad"
    assert found["tension_1"].values[10] == pytest.approx(1000.0 * TIME[10])
    again = in_si(RawLog(found, LogSource("x", "simulated", 0, ""))).signals
    assert np.array_equal(again["heading"].values, found["heading"].values)


def test_the_sea_is_what_moves_with_the_waves() -> None:
    names = ("north", "tension_1", "thrust_surge", "wind_speed")
    assert shows_sea(names).tolist() == [True, True, False, False]
    rng = np.random.default_rng(2)
    still = rng.standard_normal((4000, 4))
    reference = np.std(np.diff(still, axis=0), axis=0)
    rough = still * [2.0, 2.0, 50.0, 50.0]
    assert roughness(rough, names, reference) == pytest.approx(2.0, rel=0.05)
    assert roughness(0.5 * still, names, reference) == 1.0


def design(matrix: np.ndarray) -> tuple[Design, Signatures]:
    """Return a design of two residuals whose whitener has gains 2 and 5, and the raw signatures."""
    faults = (Fault("sensor_fault", "tension_1"), Fault("sensor_fault", "tension_2"))
    raw = Signatures(faults, ("r1", "r2"), matrix, ("N", "N"), np.full(2, np.nan), np.zeros(2))
    gained = matrix * [2.0, 5.0]
    reference = Reference(np.zeros(2), np.ones(2), None, 0)
    return Design(("a", "b"), gained, np.zeros(2), np.eye(2), 50, reference, None, "slow"), raw


def test_residuals_are_believed_and_drift_through_the_whiteners_gain() -> None:
    base, raw = design(np.eye(2))
    floored = believed(base, raw, np.array([0.1, 0.2]))
    assert np.allclose(floored.covariance, np.eye(2) + 50.0 * np.diag([0.2**2, 1.0**2]))
    assert believed(base, raw, np.zeros(2)) is base
    mapped = Signatures(raw.faults, raw.residuals, base.directions, raw.units, raw.total, raw.sign)
    assert np.allclose(drifting(base, mapped, 0.03).covariance, np.eye(2) + 50.0 * np.diag([0.06**2, 0.15**2]))
