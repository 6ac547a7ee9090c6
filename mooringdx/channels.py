"""The catalogue of channel names: unit, plausible range, meaning; and the way from a file's units to it.

Frames are NED, body axes x forward, y starboard, z down, heading clockwise from north. Wind and waves are *from*,
current is *towards*, degrees true in files and rad inside. What has no name here is a free channel ``x_<name>``.
"""

from __future__ import annotations

import difflib
import functools
import re
from dataclasses import dataclass
from typing import Any

import numpy as np

from mooringdx.errors import ConfigError
from mooringdx.types import Array

_TURNS = 200.0 * np.pi
_FAR = 1e7


@dataclass(frozen=True)
class ChannelInfo:
    """One row of the catalogue: SI ``unit`` (empty for free channels), plausible ``range`` in it, ``angle``: it wraps.

    ``assumed`` is the unit taken for a log that states none.
    """

    name: str
    unit: str
    range: tuple[float, float]
    description: str
    angle: bool = False
    assumed: str = ""


CATALOGUE: tuple[ChannelInfo, ...] = (
    ChannelInfo("time", "s", (-np.inf, np.inf), "time on the log clock"),
    ChannelInfo("north", "m", (-_FAR, _FAR), "position north of the local origin"),
    ChannelInfo("east", "m", (-_FAR, _FAR), "position east of the local origin"),
    ChannelInfo("down", "m", (-1e4, 1e4), "position below the local origin"),
    ChannelInfo("roll", "rad", (-np.pi, np.pi), "roll, starboard down positive"),
    ChannelInfo("pitch", "rad", (-np.pi, np.pi), "pitch, bow up positive"),
    ChannelInfo("heading", "rad", (-_TURNS, _TURNS), "heading, clockwise from north", True, "deg"),
    ChannelInfo("surge", "m", (-1e4, 1e4), "motion forward in body axes"),
    ChannelInfo("sway", "m", (-1e4, 1e4), "motion to starboard in body axes"),
    ChannelInfo("heave", "m", (-1e2, 1e2), "motion down in body axes"),
    ChannelInfo("yaw", "rad", (-_TURNS, _TURNS), "rotation about the down axis", True),
    ChannelInfo("accel_x", "m/s^2", (-200.0, 200.0), "acceleration forward"),
    ChannelInfo("accel_y", "m/s^2", (-200.0, 200.0), "acceleration to starboard"),
    ChannelInfo("accel_z", "m/s^2", (-200.0, 200.0), "acceleration down"),
    ChannelInfo("tension_<line>", "N", (-5e7, 5e7), "tension of a mooring line; negative only where zeroed"),
    ChannelInfo("thrust_surge", "N", (-1e8, 1e8), "commanded or measured thrust forward"),
    ChannelInfo("thrust_sway", "N", (-1e8, 1e8), "commanded or measured thrust to starboard"),
    ChannelInfo("thrust_yaw", "N m", (-1e10, 1e10), "commanded or measured turning moment"),
    ChannelInfo("thruster_<n>", "N", (-1e8, 1e8), "thrust of one thruster"),
    ChannelInfo("wind_speed", "m/s", (0.0, 120.0), "wind speed"),
    ChannelInfo("wind_direction", "rad", (-_TURNS, _TURNS), "direction the wind comes from", True, "deg"),
    ChannelInfo("current_speed", "m/s", (0.0, 10.0), "current speed"),
    ChannelInfo("current_direction", "rad", (-_TURNS, _TURNS), "direction the current sets towards", True, "deg"),
    ChannelInfo("wave_elevation_<n>", "m", (-50.0, 50.0), "sea surface at one probe, up positive"),
    ChannelInfo("wave_height", "m", (0.0, 50.0), "significant wave height"),
    ChannelInfo("wave_period", "s", (0.0, 100.0), "peak wave period"),
    ChannelInfo("latitude", "rad", (-np.pi / 2, np.pi / 2), "latitude, turned into north", False, "deg"),
    ChannelInfo("longitude", "rad", (-2 * np.pi, 2 * np.pi), "longitude, turned into east", False, "deg"),
    ChannelInfo("line_length_<line>", "m", (0.0, 2e4), "paid-out length of a line"),
    ChannelInfo("x_<name>", "", (-np.inf, np.inf), "free channel, SI base units of its own unit"),
)

_PATTERNS = tuple((re.compile(re.sub(r"<\w+>", r"\\w+", row.name)), row) for row in CATALOGUE)

# What logs write -> what the units library reads.
_SPELLING = {
    "": "dimensionless", "-": "dimensionless", "1": "dimensionless", "%": "percent", "pct": "percent",
    "°": "degree", "degs": "degree", "kn": "knot", "kt": "knot", "kts": "knot", "mps": "m/s", "kmh": "km/h",
    "kph": "km/h", "t": "metric_ton", "te": "metric_ton", "tonne": "metric_ton", "tonnes": "metric_ton",
    "tonnef": "metric_ton*g_0", "tonne-force": "metric_ton*g_0", "tonne_force": "metric_ton*g_0",
    "tf": "metric_ton*g_0",
    "kgf": "kilogram*g_0", "kg-force": "kilogram*g_0", "kg_force": "kilogram*g_0", "kp": "kilogram*g_0",
    "Nm": "N*m", "kNm": "kN*m", "MNm": "MN*m", "N-m": "N*m", "kN-m": "kN*m", "C": "degC", "°C": "degC", "sec": "s",
    "secs": "s", "deg/sec": "degree/s", "m/sec": "m/s", "g": "gram", "lbs": "pound", "kips": "kip",
}  # fmt: skip
_NAMES = {
    "": "1", "kg*m/s**2": "N", "kg*m**2/s**2": "N m", "kg/m/s**2": "Pa", "kg*m**2/s**3": "W", "kg/s**2": "N/m",
    "kg*m**2/A/s**3": "V", "m/s**2": "m/s^2",
}  # fmt: skip
# Endings that are read as a unit ("north_km"); not short ones that mostly mean something else ("T1_min", "pos_N").
_ENDINGS = (
    "m", "mm", "cm", "km", "ft", "s", "ms", "us", "ns", "kN", "MN", "tonnef", "tf", "kgf",
    "deg", "rad", "mrad", "mps", "kts", "knots", "kmh", "rpm", "Hz", "Pa", "kPa",
    "MPa", "hPa", "mbar", "V", "mV", "pct",
)  # fmt: skip
_PLAIN = frozenset((*_ENDINGS, *_SPELLING, "N", "m/s", "m/s2", "m/s^2", "deg/s", "rad/s", "knot", "kg", "W", "kW", "A"))
# In brackets these name a side, a number or nothing rather than a unit: "Tension (PS)", "Line (1)".
_NO_UNIT = frozenset(("", "1", "PS", "ps", "P", "S", "A", "B", "D", "F", "L", "R"))
_FORCE_WORD = re.compile(r"(?i)tension|force|thrust|load|line|fair|anch|^t_?\d+$")


def entry(name: str) -> ChannelInfo:
    """Return the row for a channel name such as ``tension_4``; ConfigError with the nearest name if there is none."""
    for pattern, row in _PATTERNS:
        if pattern.fullmatch(name):
            return row
    words = [row.name for row in CATALOGUE]
    plain = {re.sub(r"<\w+>", "", word): word for word in words}
    near = difflib.get_close_matches(name, plain, n=1, cutoff=0.5)
    hint = f"; did you mean '{plain[near[0]]}'?" if near else ";"
    raise ConfigError(f"unknown channel '{name}'{hint} allowed: {', '.join(words)}")


def si_unit(name: str) -> str:
    """Return the unit of a channel inside the program; empty for free channels, which keep the SI form of their own."""
    return entry(name).unit


def si_unit_of(unit: str) -> str:
    """Return the SI form of a file's unit: "kN" -> "N", "deg" -> "rad", "ft/s" -> "m/s"; ConfigError if no unit."""
    return unit_text(_unit(unit, unit))


def quantity(value: float, unit: str) -> Any:
    """Return a number with its unit, for arithmetic that checks dimensions; an empty unit is a pure number."""
    return value * (_unit(unit, unit) if unit else _registry().Quantity(1.0, "dimensionless"))


def unit_text(value: Any) -> str:
    """Return the SI unit of what `quantity` arithmetic gave: "N", "N m", "m/s"; empty for a pure number."""
    base = format(value.to_base_units().units, "~C")
    return _NAMES.get(base, base.replace("**", "^"))


def to_si(values: Array, unit: str, name: str) -> Array:
    """Convert values of one channel from a file's unit to SI.

    Parameters
    ----------
    values : any shape, in ``unit``.
    unit : as logs write it ("kN", "t", "deg", "knots", "kg-force", "%"). A mass where the catalogue wants a force is
        the weight of that mass (g_0 = 9.80665 m/s^2), and "g" where it wants an acceleration is g_0.
    name : catalogue name; a free channel takes any unit and becomes ``si_unit_of(unit)``.

    Raises
    ------
    ConfigError : no such unit, or of another dimension than the catalogue's.
    """
    wanted = entry(name).unit
    source = _unit(unit, name)
    if not wanted:
        target = source.to_base_units().units
    else:
        target = _unit(wanted, name).units
        weight = source * _registry().Quantity(1.0, "g_0")
        if unit.strip() == "g" and wanted == "m/s^2":
            source = _registry().Quantity(1.0, "g_0")
        elif wanted in ("N", "N m") and weight.is_compatible_with(target):
            source = weight
    if not source.is_compatible_with(target) or (wanted == "rad" and str(source.units) in ("dimensionless", "percent")):
        raise ConfigError(
            f"channel '{name}': unit '{unit}' is not of the dimension of {wanted}; give one such as {wanted}"
        )
    if source.units == target:
        return values
    zero = float((0.0 * source).to(target).magnitude) if source.dimensionality == "[temperature]" else 0.0
    return np.asarray(values * (float(source.to(target).magnitude) - zero) + zero, dtype=np.float64)


def is_unit(text: str) -> bool:
    """Return whether a short text is a unit of measurement."""
    if text in _PLAIN:  # without starting the units library, which takes a second
        return True
    try:
        _unit(text, text)
    except ConfigError:
        return False
    return True


def unit_in_header(text: str) -> tuple[str, str | None]:
    """Return (bare name, unit or None) of a column header: "T1 [kN]", "psi (deg)", "north_km", "F / N"."""
    text = text.strip()
    bracket = re.fullmatch(r"(.*?)[\s_]*[\[(<]\s*([^\[\]()<>]*?)\s*[\])>]", text)
    if bracket and bracket[1] and bracket[2] not in _NO_UNIT and is_unit(bracket[2]):
        return bracket[1], bracket[2]
    slash = re.fullmatch(r"(.*?\S)(?:\s+/\s*|\s*,\s+)(\S+)", text)
    if slash and slash[2] not in _NO_UNIT and is_unit(slash[2]):
        return slash[1], slash[2]
    ending = re.fullmatch(r"(.+)_([A-Za-z]+)", text)
    if ending and (ending[2] in _ENDINGS or (ending[2] == "N" and _FORCE_WORD.search(ending[1]))):
        return ending[1], ending[2]
    return text, None


def to_local(latitude: Array, longitude: Array) -> tuple[Array, Array, tuple[float, float]]:
    """Turn geodetic positions (WGS 84) into metres north and east on the tangent plane at the first fixes.

    Parameters
    ----------
    latitude, longitude : (n,), rad; NaN where there is no fix.

    Returns
    -------
    north, east : (n,), m. origin : (latitude, longitude) in rad, the median of the first nine fixes. The plane leaves
    the ellipsoid by d^3 / (6 R^2): 0.5 m at 50 km, 4 km at 1,000 km.

    Raises
    ------
    ConfigError : no fix at all.
    """
    import pymap3d

    known = np.flatnonzero(np.isfinite(latitude) & np.isfinite(longitude))[:9]
    if known.size == 0:
        raise ConfigError("latitude and longitude hold no fix; check the columns that are mapped to them")
    first = longitude[known[0]]
    around = np.mod(longitude[known] - first + np.pi, 2 * np.pi) - np.pi
    origin = float(np.median(latitude[known])), float(first + np.median(around))
    height = np.zeros_like(latitude)
    east, north, _ = pymap3d.geodetic2enu(latitude, longitude, height, origin[0], origin[1], 0.0, deg=False)
    return np.asarray(north, dtype=np.float64), np.asarray(east, dtype=np.float64), origin


@functools.cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry(autoconvert_offset_to_baseunit=True, cache_folder=None)


@functools.lru_cache(maxsize=256)
def _unit(text: str, name: str) -> Any:
    """Return one of the unit as a quantity."""
    from tokenize import TokenError

    import pint

    word = text.strip()
    plain = word.replace("·", "*").replace("²", "2").replace("³", "3").replace(" ", "*")
    spelled = _SPELLING.get(word) or re.sub(r"(?<=[A-Za-z])(-?\d)", r"^\1", plain)
    try:
        return _registry().Quantity(1.0, _registry().Unit(spelled))
    except (pint.errors.PintError, ValueError, TypeError, AttributeError, AssertionError, KeyError, TokenError):
        raise ConfigError(
            f"channel '{name}': '{text}' is no known unit; write it like m, kN, deg, knots, tonnef or m/s^2"
        ) from None
