"""How a hull answers a wave to first order: a closed form from its main dimensions, or a table of the user's.

Signs: x forward, y to starboard, z DOWN, yaw clockwise, roll starboard down, pitch bow up. Phases relative to the crest
at the centre of gravity, time dependence exp(i w t). ``heading``: where the waves TRAVEL to, from the bow clockwise:
0 following, pi/2 from port, pi head sea. The elevation (up) is

    zeta(x, y, t) = Re exp(i (w t - k (x cos b + y sin b))),   k = w^2/g (deep water)

Closed form, with a = k cos(b) L/2, j0 and j1 the spherical Bessel functions, B' = B Cb:

    surge, sway  = -i (cos b, sin b) j0(a) j0(k B sin(b)/2) (1 - exp(-kT))/(kT)
    yaw          = -(6/L) sin b j1(a) j0(k B sin(b)/2) (1 - exp(-kT))/(kT)
    heave, pitch = (-j0(a), -i (6/L) j1(a)) exp(-|k cos b| T) f h
    f = 1 - kT + i A^2/(kB'),   h = 1/(1 - 2kT + i A^2/(kB')),   A = 2 sin(kB'/2) exp(-kT)
    roll         = 0

Heave and pitch: the box of [Jensen2004] at zero speed; |f| and |h| are his, their phases follow from his equation of
motion. Surge, sway and yaw: the hull follows the water's orbit averaged over the box L x B x T, which is the
Froude-Krylov force on it with the added mass standing for diffraction. Roll is left out: it needs the metacentric
height and a viscous damping that no main dimension gives. Neither knows the hull's form, its mooring, nor the depth of
the water: docs/waves.md has the differences from a panel method.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from mooringdx.errors import ConfigError
from mooringdx.physics.vessel import Hull
from mooringdx.physics.waves import GRAVITY
from mooringdx.registry import resolve
from mooringdx.types import Array, locked

Complex = NDArray[np.complex128]
DOF = ("surge", "sway", "heave", "roll", "pitch", "yaw")
MIRROR = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])  # the same waves from the other side
UNITS: dict[str, float] = {"m/m": 1.0, "rad/m": 1.0, "deg/m": np.pi / 180.0}


def closed_form(hull: Hull, omega: Array, heading: float) -> Complex:
    """Return the answer to a wave of unit amplitude, (6, n): m/m and rad/m, in the order of `DOF`.

    ``omega``: (n,), rad/s, zero and above; ``heading``: rad, where the waves travel to, from the bow clockwise.
    """
    from scipy.special import spherical_jn

    length, breadth, draught = hull.length, hull.breadth, hull.draught
    k = np.maximum(np.asarray(omega, dtype=np.float64), 1e-6) ** 2 / GRAVITY
    along, across = np.cos(heading), np.sin(heading)
    a = 0.5 * k * along * length
    mean, slope = spherical_jn(0, a), 6.0 / length * spherical_jn(1, a)
    orbit = spherical_jn(0, 0.5 * k * across * breadth) * -np.expm1(-k * draught) / (k * draught)
    box = k * breadth * hull.block
    damping = 1j * (2.0 * np.sin(0.5 * box) * np.exp(-k * draught)) ** 2 / box
    vertical = np.exp(-np.abs(along) * k * draught) * (1.0 - k * draught + damping)
    vertical = vertical / (1.0 - 2.0 * k * draught + damping)
    out = np.zeros((6, k.size), dtype=np.complex128)
    out[0] = -1j * along * mean * orbit
    out[1] = -1j * across * mean * orbit
    out[2] = -mean * vertical
    out[4] = -1j * slope * vertical
    out[5] = -across * slope * orbit
    return out


@dataclass(frozen=True)
class ResponseTable:
    """Answers of a hull symmetric about its centre plane, at chosen frequencies and headings.

    ``omega``: (w,), rad/s, increasing; ``heading``: (h,), rad, increasing from 0 to pi; ``amplitude``: (6, h, w),
    m/m and rad/m, signs and phases as in this module.
    """

    omega: Array
    heading: Array
    amplitude: Complex

    def __post_init__(self) -> None:
        object.__setattr__(self, "omega", locked(self.omega))
        object.__setattr__(self, "heading", locked(self.heading))
        object.__setattr__(self, "amplitude", locked(self.amplitude, np.complex128))
        if self.amplitude.shape != (6, self.heading.size, self.omega.size):
            raise ValueError(f"response {self.amplitude.shape} is not 6 x {self.heading.size} x {self.omega.size}")

    def __call__(self, omega: Array, heading: float) -> Complex:
        """Return the answer at each frequency, (6, n), linear between frequencies and between headings.

        ``omega``: (n,), rad/s; ``heading``: rad, any. Below the first frequency the first holds; above the last the
        hull does not answer. Waves from starboard mirror those from port.
        """
        wrapped = float(np.angle(np.exp(1j * heading)))
        place = np.clip(abs(wrapped), self.heading[0], self.heading[-1])
        i = int(np.clip(np.searchsorted(self.heading, place) - 1, 0, self.heading.size - 2))
        share = (place - self.heading[i]) / (self.heading[i + 1] - self.heading[i])
        rows = (1.0 - share) * self.amplitude[:, i] + share * self.amplitude[:, i + 1]
        if wrapped < 0.0:
            rows = rows * MIRROR[:, None]
        return np.stack([np.interp(omega, self.omega, row, right=0.0) for row in rows])


def read_response(path: Path) -> ResponseTable:
    """Read a response table from a CSV file, one row a frequency, heading and motion.

    Columns: ``omega`` (rad/s) or ``period`` (s); ``heading`` (deg, 0 to 180: where the waves travel to, from the bow;
    180 is a head sea, 90 comes from port); ``dof`` (of `DOF`); ``amplitude`` (m/m, rad/m); ``phase`` (deg, ahead of the
    crest at the centre of gravity, signs of this module); optional ``unit`` (m/m, rad/m or deg/m). Lines that start
    with # are comments. A motion without any row is zero; one with rows has one at every frequency and heading.

    Raises ConfigError, in one sentence with the line, for whatever is else.
    """
    cells: dict[tuple[str, float, float], complex] = {}
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: the response table cannot be read ({error}); give a CSV text file") from None
    numbered = [(i, line) for i, line in enumerate(lines, 1) if line.strip() and not line.startswith("#")]
    header = [word.strip() for word in numbered[0][1].split(",")] if numbered else []
    _check_header(path, header)
    for i, line in numbered[1:]:
        key, value = _cell(f"{path}, line {i}", header, line.split(","))
        if key in cells:
            raise ConfigError(f"{path}, line {i}: this frequency, heading and dof stand twice; keep one row")
        cells[key] = value
    return _table(path, cells)


def _check_header(path: Path, header: list[str]) -> None:
    """Raise ConfigError unless the columns are those of `read_response`."""
    needed = {"heading", "dof", "amplitude", "phase"}
    clock = {"omega", "period"} & set(header)
    if len(clock) != 1 or not needed <= set(header) or set(header) - needed - clock - {"unit"}:
        raise ConfigError(
            f"{path}: columns '{', '.join(header)}' are not those of a response table; allowed: omega (rad/s) or "
            "period (s), heading (deg), dof, amplitude, phase (deg), and optionally unit"
        )


def _cell(where: str, header: list[str], words: list[str]) -> tuple[tuple[str, float, float], complex]:
    """Return one row as (dof, heading deg, omega) and its complex value; ``where`` names file and line."""
    if len(words) != len(header):
        raise ConfigError(f"{where}: {len(words)} cells under {len(header)} columns; give one cell a column")
    row = {name: word.strip() for name, word in zip(header, words, strict=True)}
    dof, unit = row["dof"], row.get("unit", "")
    resolve(dof, dict.fromkeys(DOF), f"dof in {where}:")
    linear = dof in DOF[:3]
    scale = resolve(unit, UNITS, f"unit in {where}:") if unit else 1.0
    if unit and (unit == "m/m") != linear:
        raise ConfigError(f"{where}: unit '{unit}' does not suit {dof}; allowed: {'m/m' if linear else 'rad/m, deg/m'}")
    clock = "omega" if "omega" in row else "period"
    try:
        number = {name: float(row[name]) for name in (clock, "heading", "amplitude", "phase")}
    except ValueError as error:
        raise ConfigError(f"{where}: {error}; give plain numbers") from None
    _check_range(where, clock, number)
    omega = number[clock] if clock == "omega" else 2.0 * np.pi / number[clock]
    return (dof, number["heading"], omega), scale * number["amplitude"] * np.exp(1j * np.radians(number["phase"]))


def _check_range(where: str, clock: str, number: Mapping[str, float]) -> None:
    """Raise ConfigError for a number that is not finite or not where it can be."""
    good = all(np.isfinite(value) for value in number.values())
    if not (good and number[clock] > 0.0 and 0.0 <= number["heading"] <= 180.0 and number["amplitude"] >= 0.0):
        raise ConfigError(
            f"{where}: {', '.join(f'{name} {value:g}' for name, value in number.items())}; {clock} must be above 0, "
            "heading within 0 to 180 (the other side follows by symmetry), amplitude at least 0, all finite"
        )


def _table(path: Path, cells: Mapping[tuple[str, float, float], complex]) -> ResponseTable:
    """Return the cells as a full table, or raise ConfigError for what is missing."""
    heading = sorted({key[1] for key in cells})
    omega = sorted({key[2] for key in cells})
    if len(omega) < 2 or heading[:1] != [0.0] or heading[-1:] != [180.0]:
        raise ConfigError(
            f"{path}: {len(omega)} frequencies and headings {', '.join(f'{h:g}' for h in heading) or 'none'}; a "
            "response table needs at least two frequencies, and headings from 0 to 180 deg with both ends"
        )
    out = np.zeros((6, len(heading), len(omega)), dtype=np.complex128)
    for d, dof in enumerate(DOF):
        if not any(key[0] == dof for key in cells):
            continue
        for h, angle in enumerate(heading):
            for w, frequency in enumerate(omega):
                if (dof, angle, frequency) not in cells:
                    raise ConfigError(
                        f"{path}: no {dof} at heading {angle:g} deg and {frequency:g} rad/s; give every motion at "
                        "every frequency and heading, or leave the motion out altogether"
                    )
                out[d, h, w] = cells[dof, angle, frequency]
    return ResponseTable(np.array(omega), np.radians(heading), out)
