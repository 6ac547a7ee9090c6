"""The mooring system: what all lines together do to a vessel at a place.

For line j with fairlead f_j (body axes) and anchor a_j (north, east):

    d_j = a_j - p - R2(psi) f_j,   r_j = |d_j|,   u_j = d_j / r_j
    force = sum_j H_j(r_j) u_j,    moment = sum_j H_j(r_j) (R2(psi) f_j) x u_j        (earth axes, about p)
    energy = sum_j integral_{x_0}^{r_j} H_j(x) dx,   so that force = -d energy / d p

H_j, the horizontal tension, and T_j, the tension at the fairlead, are tables over r from `mooringdx.physics.line`,
linear between points, level below the first point (a slack line) and on in a straight line above the last. A lost
line is a zero table. Source: quasi-static restoring of a moored vessel [Fang2015, eq. 4; Fossen2011, ch. 12].
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from mooringdx.errors import FitError
from mooringdx.types import Array, locked, replace


@dataclass(frozen=True)
class Mooring:
    """Lines with their tables. ``eta``: north, east (m, centre of gravity, from the neutral place), heading (rad).

    ``anchors``: (n, 2), m, north and east; ``fairleads``: (n, 2), m, forward and starboard. Tables: (n, k), N, at
    distances ``start + step * arange(k)``, m.
    """

    names: tuple[str, ...]
    anchors: Array
    fairleads: Array
    start: float
    step: float
    horizontal: Array
    tension: Array

    def __post_init__(self) -> None:
        for key in ("anchors", "fairleads", "horizontal", "tension"):
            object.__setattr__(self, key, locked(getattr(self, key)))

    def pulls(self, eta: Array) -> tuple[Array, Array, Array]:
        """Return horizontal and fairlead tension, (n,) N each, and the direction to the anchor (n, 2) at ``eta``."""
        distance, direction = reaches(np.asarray(eta, dtype=np.float64), self.fairleads, self.anchors)
        horizontal = lookups(self.start, self.step, self.horizontal, distance)
        return horizontal, lookups(self.start, self.step, self.tension, distance), direction

    def force(self, eta: Array) -> Array:
        """Return the lines' force and moment on the vessel at ``eta``, (3,): N, N, N m, earth axes."""
        eta = np.asarray(eta, dtype=np.float64)
        out: Array = line_force(eta, self.fairleads, self.anchors, self.start, self.step, self.horizontal)
        return out

    def energy(self, eta: Array) -> float:
        """Return the potential energy of the lines at ``eta``, N m, from zero at the tables' first distance."""
        distance, _ = reaches(np.asarray(eta, dtype=np.float64), self.fairleads, self.anchors)
        return float(sum(_area(self.start, self.step, h, x) for h, x in zip(self.horizontal, distance, strict=True)))

    def stiffness(self, eta: Array, width: float = 1e-3) -> Array:
        """Return -d force / d eta at ``eta``, (3, 3), N, m and rad, by central differences of ``width``."""
        eta = np.asarray(eta, dtype=np.float64)
        columns = []
        for i in range(3):
            delta = np.zeros(3)
            delta[i] = width * max(1.0, self.step) if i < 2 else width
            columns.append((self.force(eta - delta) - self.force(eta + delta)) / (2.0 * delta[i]))
        return np.column_stack(columns)

    def without(self, lines: Sequence[str]) -> Mooring:
        """Return the system with ``lines`` lost: their tables are zero."""
        keep = np.array([0.0 if name in lines else 1.0 for name in self.names])[:, None]
        return replace(self, horizontal=self.horizontal * keep, tension=self.tension * keep)

    def with_line(self, line: str, horizontal: Array, tension: Array) -> Mooring:
        """Return the system with one line's tables, (k,) each, N, replaced."""
        row = self.names.index(line)
        h, t = np.array(self.horizontal), np.array(self.tension)
        h[row], t[row] = horizontal, tension
        return replace(self, horizontal=h, tension=t)


def equilibrium(mooring: Mooring, load: Array, start: Array, hold_heading: bool = False) -> Array:
    """Return where the lines hold a constant ``load`` (3,), N, N, N m, earth axes: eta, (3,), found from ``start``.

    A minimum of energy - load . eta, so it is stable: a vessel on a turret swings until the load points away from the
    turret, unless ``hold_heading`` keeps the heading of ``start``. What nothing holds or loads stays where it started.
    Raise FitError when the lines cannot hold the load.
    """
    eta, load = np.array(start, dtype=np.float64), np.asarray(load, dtype=np.float64)
    reach = float(np.mean(reaches(eta, mooring.fairleads, mooring.anchors)[0]))
    lever = max(float(np.max(np.abs(mooring.fairleads), initial=0.0)), 1e-3 * reach)
    unit = np.array([1.0, 1.0, 0.0 if hold_heading else 1.0 / lever])  # coordinates in m: the yaw's is an arc
    limit = 0.02 * reach
    enough = 1e-9 * float(
        np.linalg.norm(unit * load) + np.sum(mooring.pulls(eta)[0]) + np.max(mooring.horizontal[:, 0])
    )
    for _ in range(300):
        slope = -unit * (mooring.force(eta) + load)
        if np.linalg.norm(slope) <= enough:
            return eta
        curved, axes = np.linalg.eigh(_symmetric(unit[:, None] * mooring.stiffness(eta) * unit))
        along = axes.T @ slope
        size = np.maximum(np.abs(curved), 1e-9 * np.max(np.abs(curved)) + 1e-300)
        step = -axes @ (along / size)
        step *= min(1.0, limit / float(np.max(np.abs(step))))
        eta = _descended(mooring, load, eta, unit * step, unit)
    raise FitError(
        f"the lines cannot hold a load of {load[0]:.4g} N north, {load[1]:.4g} N east and {load[2]:.4g} N m from the "
        "start that was given; lower the load, or leave more lines"
    )


def _symmetric(matrix: Array) -> Array:
    return np.asarray(0.5 * (matrix + matrix.T))


def _descended(mooring: Mooring, load: Array, eta: Array, step: Array, unit: Array) -> Array:
    """Return ``eta`` after the longest halved step that lowers the energy or the force that is left over."""
    height = mooring.energy(eta) - float(load @ eta)
    left = float(np.linalg.norm(unit * (mooring.force(eta) + load)))
    for _ in range(40):
        trial = eta + step
        lower = mooring.energy(trial) - float(load @ trial) < height
        if lower or np.linalg.norm(unit * (mooring.force(trial) + load)) < left:
            break
        step = step / 2.0
    return np.asarray(eta + step)


@njit(cache=True)
def lookup(start: float, step: float, table: Array, distance: float) -> float:
    """Return a table's value at ``distance``: level before its start, a straight line beyond its end."""
    place = (distance - start) / step
    if place <= 0.0:
        slack: float = table[0]
        return slack
    i = min(int(place), table.size - 2)
    out: float = table[i] + (place - i) * (table[i + 1] - table[i])
    return out


@njit(cache=True)
def reaches(eta: Array, fairleads: Array, anchors: Array) -> tuple[Array, Array]:
    """Return the distance from each fairlead to its anchor, (n,), m, and the unit vector to it, (n, 2), earth axes."""
    n = len(anchors)
    distance, direction = np.empty(n), np.empty((n, 2))
    c, s = np.cos(eta[2]), np.sin(eta[2])
    for j in range(n):
        north = anchors[j, 0] - eta[0] - c * fairleads[j, 0] + s * fairleads[j, 1]
        east = anchors[j, 1] - eta[1] - s * fairleads[j, 0] - c * fairleads[j, 1]
        distance[j] = np.hypot(north, east)
        direction[j, 0], direction[j, 1] = north / distance[j], east / distance[j]
    return distance, direction


@njit(cache=True)
def lookups(start: float, step: float, tables: Array, distance: Array) -> Array:
    """Return each line's table at its own distance, (n,)."""
    out = np.empty(distance.size)
    for j in range(distance.size):
        out[j] = lookup(start, step, tables[j], distance[j])
    return out


@njit(cache=True)
def line_force(eta: Array, fairleads: Array, anchors: Array, start: float, step: float, horizontal: Array) -> Array:
    """Return the sum of the lines' forces and moments at ``eta``, (3,), earth axes."""
    out = np.zeros(3)
    c, s = np.cos(eta[2]), np.sin(eta[2])
    for j in range(len(anchors)):
        arm_n = c * fairleads[j, 0] - s * fairleads[j, 1]
        arm_e = s * fairleads[j, 0] + c * fairleads[j, 1]
        north, east = anchors[j, 0] - eta[0] - arm_n, anchors[j, 1] - eta[1] - arm_e
        distance = np.hypot(north, east)
        pull = lookup(start, step, horizontal[j], distance) / distance
        out[0] += pull * north
        out[1] += pull * east
        out[2] += pull * (arm_n * east - arm_e * north)
    return out


@njit(cache=True)
def _area(start: float, step: float, table: Array, distance: float) -> float:
    """Return the integral of a table from its first distance to ``distance``."""
    place = (distance - start) / step
    if place <= 0.0:
        out: float = table[0] * step * place
        return out
    whole = min(int(place), table.size - 2)
    total = 0.0
    for i in range(whole):
        total += 0.5 * (table[i] + table[i + 1])
    rest = place - whole
    total += rest * (table[whole] + 0.5 * rest * (table[whole + 1] - table[whole]))
    out = total * step
    return out
