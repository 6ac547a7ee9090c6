"""The catalogue and the units. Truth: published conversion factors, and the geodesic of a sphere for positions."""

from __future__ import annotations

import math

import numpy as np
import pytest

from mooringdx import channels
from mooringdx.channels import CATALOGUE, entry, is_unit, si_unit, si_unit_of, to_local, to_si, unit_in_header
from mooringdx.errors import ConfigError

# Exact by definition (SI brochure, NIST SP 811).
FACTORS = [
    ("kN", "tension_1", 1e3),
    ("MN", "tension_SB", 1e6),
    ("t", "tension_1", 9806.65),
    ("tonnef", "tension_1", 9806.65),
    ("tf", "tension_1", 9806.65),
    ("kg", "tension_1", 9.80665),
    ("kg-force", "tension_1", 9.80665),
    ("kgf", "tension_1", 9.80665),
    ("lbf", "tension_1", 4.4482216152605),
    ("deg", "heading", math.pi / 180),
    ("°", "roll", math.pi / 180),
    ("ft", "north", 0.3048),
    ("km", "east", 1e3),
    ("mm", "sway", 1e-3),
    ("knots", "wind_speed", 1852 / 3600),
    ("kn", "current_speed", 1852 / 3600),
    ("km/h", "wind_speed", 1 / 3.6),
    ("g", "accel_x", 9.80665),
    ("m/s2", "accel_y", 1.0),
    ("m s-2", "accel_y", 1.0),
    ("cm/s", "current_speed", 0.01),
    ("min", "wave_period", 60.0),
    ("kNm", "thrust_yaw", 1e3),
    ("%", "x_power", 0.01),
    ("deg/s", "x_rate", math.pi / 180),
    ("kPa", "x_pressure", 1e3),
]


@pytest.mark.parametrize(("unit", "name", "factor"), FACTORS)
def test_units_convert_as_published(unit: str, name: str, factor: float) -> None:
    values = np.array([-2.0, 0.0, 1.0, np.nan])
    got = to_si(values, unit, name)
    np.testing.assert_allclose(got, values * factor, rtol=1e-14)


def test_temperature_has_its_own_zero() -> None:
    np.testing.assert_allclose(to_si(np.array([0.0, 20.0]), "degC", "x_water"), [273.15, 293.15], rtol=1e-14)


@pytest.mark.parametrize(
    ("unit", "name"),
    [("m", "tension_1"), ("kN", "north"), ("%", "heading"), ("deg", "wave_height"), ("s", "wind_speed")],
)
def test_another_dimension_is_refused_in_a_sentence(unit: str, name: str) -> None:
    with pytest.raises(ConfigError, match=rf"channel '{name}'.*{unit}"):
        to_si(np.zeros(2), unit, name)


@pytest.mark.parametrize("unit", ["furlongs per", "(", "foo", "$", "2", "m^"])
def test_no_unit_is_refused_in_a_sentence(unit: str) -> None:
    assert not is_unit(unit)
    with pytest.raises(ConfigError, match="is no known unit"):
        to_si(np.zeros(2), unit, "north")


@pytest.mark.parametrize(
    ("unit", "si"),
    [("kN", "N"), ("deg", "rad"), ("ft/s", "m/s"), ("hPa", "Pa"), ("kNm", "N m"), ("N/mm", "N/m"), ("%", "1"),
     ("mm/s^2", "m/s^2"), ("degC", "K"), ("rpm", "rad/s")],
)  # fmt: skip
def test_si_form_of_a_free_unit(unit: str, si: str) -> None:
    assert si_unit_of(unit) == si


@pytest.mark.parametrize(
    ("header", "bare", "unit"),
    [("T1 [kN]", "T1", "kN"), ("psi (deg)", "psi", "deg"), ("Tension_SB [N]", "Tension_SB", "N"), ("x_m", "x", "m"),
     ("T1_kN", "T1", "kN"), ("Force / N", "Force", "N"), ("north_km", "north", "km"), ("T1_N", "T1", "N"),
     ("pos_N", "pos_N", None), ("Tension (PS)", "Tension (PS)", None), ("Line (1)", "Line (1)", None),
     ("wind_u_mps", "wind_u", "mps"), ("ACC [m/s2]", "ACC", "m/s2"), ("T1_min", "T1_min", None),
     ("WM_Position", "WM_Position", None), ("Sway[m]", "Sway", "m"), ("thrust, kN", "thrust", "kN"),
     ("ratio [-]", "ratio", "-"), ("wave_elevation_1 (cm)", "wave_elevation_1", "cm"), ("lat_deg", "lat", "deg")],
)  # fmt: skip
def test_unit_in_header(header: str, bare: str, unit: str | None) -> None:
    assert unit_in_header(header) == (bare, unit)


def test_the_units_that_are_known_by_heart_are_units() -> None:
    for unit in channels._PLAIN:
        to_si(np.zeros(1), unit, "x_any")


def test_every_row_of_the_catalogue_is_found_by_its_own_name() -> None:
    for row in CATALOGUE:
        name = row.name.replace("<line>", "SB").replace("<n>", "3").replace("<name>", "any_thing")
        assert entry(name) == row
        assert row.range[0] < row.range[1]
        if row.unit:
            np.testing.assert_array_equal(to_si(np.ones(1), row.unit, name), 1.0)
    assert si_unit("x_any") == ""


def test_an_unknown_channel_names_the_nearest() -> None:
    with pytest.raises(ConfigError, match=r"'headin'; did you mean 'heading'\? allowed: time, north"):
        entry("headin")
    with pytest.raises(ConfigError, match=r"did you mean 'tension_<line>'"):
        entry("tensoin_4")


def test_positions_against_the_radii_of_curvature() -> None:
    # Analytic: WGS 84 meridian and normal radii at the origin, first order.
    lat0, lon0 = math.radians(60.0), math.radians(5.0)
    a, e2 = 6378137.0, 6.69437999014e-3
    w = 1 - e2 * math.sin(lat0) ** 2
    meridian, normal = a * (1 - e2) / w**1.5, a / math.sqrt(w)
    step = 1e-5
    lat = np.array([lat0] * 9 + [lat0 + step, lat0, np.nan])
    lon = np.array([lon0] * 9 + [lon0, lon0 + step, lon0])
    north, east, origin = to_local(lat, lon)
    assert origin == pytest.approx((lat0, lon0), abs=1e-15)
    np.testing.assert_allclose(north[9:11], [meridian * step, 0.0], atol=1e-3)
    np.testing.assert_allclose(east[9:11], [0.0, normal * math.cos(lat0) * step], atol=1e-3)
    assert np.isnan(north[11])


def test_the_date_line_is_no_jump() -> None:
    lat = np.zeros(10)
    lon = np.radians([179.9999, -179.9999, 179.9999, -179.9999, 179.9999, -179.9999, 180.0, 180.0, -180.0, 180.0])
    _, east, _ = to_local(lat, lon)
    assert np.abs(east).max() < 15.0


def test_no_fix_is_refused() -> None:
    with pytest.raises(ConfigError, match="no fix"):
        to_local(np.full(3, np.nan), np.zeros(3))
