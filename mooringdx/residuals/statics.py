"""Lines as tables: distances, tensions at them, and what a change of tension says of the line.

    x_j = |anchor_j - place - R(heading) fairlead_j|,  T_s(x): fairlead tension of a line that lost the share s of its
    buoyancy, a table;  s from a mean change v:  mean over the distances of a window of T_s(x) - T_0(x) = v

The mean runs over the distances as they were, so that waves and a vessel that has moved are in it. Source: statics of
the line [Hall2021], residual [Fang2015, eq. 6]. Not seen: whether it was the line at all that changed, or its sensor.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from mooringdx.physics.mooring import lookup, reaches
from mooringdx.types import Array

PARTED = 0.10
"""Share of the model's tension under which a line has parted at its fairlead: less than what hangs from it pulls."""
SLIGHT = 0.85
"""Share above which a fall is not called a line parted near its anchor: that takes at least 0.3 of the tension."""

_GAIN = 0.1  # sd that the gain has before the log says anything: it tames a vessel that hardly moved
_BLOCKS = 40  # whose means say how far neighbours are alike


def share_of_loss(levels: Array, curve: Array, change: float, sd: float) -> tuple[float, float, float]:
    """Return the share of buoyancy lost that explains a mean ``change`` of tension, with its 95 % limits.

    Parameters
    ----------
    levels : (l,), shares lost, rising from 0. curve : (l,), N, the change of tension at each (`changes`).
    change : N, window mean of the residual less its no-fault mean. sd : N, of that mean, calibration included.

    Outside the levels the nearest end is given.
    """
    from scipy.interpolate import PchipInterpolator

    share = PchipInterpolator(curve, levels)
    middle, low, high = share(np.clip(change + sd * np.array([0.0, -1.96, 1.96]), curve[0], curve[-1]))
    return float(middle), float(low), float(high)


def kind_of_change(change: float, sd: float, model: float, parted: float = 0.0) -> str:
    """Return what a mean ``change`` of a line's tension says of the line, were it no fault of its sensor.

    Parameters
    ----------
    change, sd : N, as for `share_of_loss`. model : N, mean tension of the intact line at the places of the window.
    parted : N that hangs from the fairlead after a break.

    Under PARTED of the model line_lost; under SLIGHT, by 2 ``sd``, line_parted_low (a break near the anchor leaves what
    slides over the seabed); a rise, or a slight fall, line_weakened.
    """
    left = model + change
    if left < max(PARTED * model, parted):
        return "line_lost"
    return "line_parted_low" if left + 2.0 * sd < SLIGHT * model else "line_weakened"


def changes(start: float, step: float, tables: Array, distance: Array) -> Array:
    """Return the mean of each table less the first, (levels, lines), N, over (m, lines) distances, m."""
    tensions = np.array([tabled(start, step, table, distance) for table in tables])
    return np.asarray((tensions - tensions[0]).mean(axis=1))


def corrections(rest: Array, static: Array, beside: Array, speed: Array, terms: int) -> tuple[Array, float]:
    """Return each line's first ``terms`` corrections, (lines, 4), and the mean logarithm of the sd of what they leave.

    Parameters
    ----------
    rest : (m, lines), N, measured less intact tension. static : (m, lines), N, the intact one less its reference;
        ``beside`` the same from other samples of the place, with noise of their own. speed : (m, lines), m/s.
    terms : of offset (N), gain, linear (N s/m) and quadratic (N s2/m2) drag.
    """
    drag = speed * np.abs(speed)
    coefficients, sd = np.zeros((rest.shape[1], 4)), np.empty(rest.shape[1])
    for j in range(rest.shape[1]):
        design = np.column_stack([np.ones(len(rest)), static[:, j], speed[:, j], drag[:, j]])[:, :terms]
        instrument = design.copy()
        instrument[:, 1:2] = beside[:, j : j + 1]
        coefficients[j, :terms] = _solved(design, instrument, rest[:, j])
        sd[j] = np.std(rest[:, j] - design @ coefficients[j, :terms])
    return coefficients, float(np.mean(np.log(np.maximum(sd, 1e-300))))


def _solved(design: Array, instrument: Array, target: Array) -> Array:
    """Return the coefficients that leave nothing along the instruments; the second keeps to 0 +- _GAIN where open."""
    free = np.linalg.lstsq(instrument.T @ design, instrument.T @ target, rcond=None)[0]
    if design.shape[1] < 2:
        return np.asarray(free)
    rest = target - design @ free
    size = max(1, len(rest) // _BLOCKS)
    means = rest[: len(rest) // size * size].reshape(-1, size).mean(axis=1)
    cross = instrument.T @ design
    cross[1, 1] += size * float(np.var(means)) / _GAIN**2
    return np.asarray(np.linalg.lstsq(cross, instrument.T @ target, rcond=None)[0])


def late(values: Array, by: int) -> Array:
    """Return (n, c) values ``by`` rows later, NaN before the first."""
    out = np.full_like(values, np.nan)
    out[by:] = values[: max(0, len(values) - by)]
    return out


def late_slope(values: Array, half: int) -> Array:
    """Return the least-squares slope a row over the last 2 half + 1 rows, (n, c): that at ``half`` rows ago."""
    out = np.full_like(values, np.nan)
    n = len(values) - 2 * half
    if n > 0:
        weight = 3.0 / (half * (half + 1) * (2 * half + 1))
        out[2 * half :] = weight * sum(i * values[half + i : half + i + n] for i in range(-half, half + 1))
    return out


@njit(cache=True)
def distances(eta: Array, fairleads: Array, anchors: Array) -> Array:
    """Return the distances from fairlead to anchor, (n, lines), m, at places (n, 3); NaN where a place is."""
    out = np.empty((len(eta), len(anchors)))
    for k in range(len(eta)):
        out[k] = reaches(eta[k], fairleads, anchors)[0]
    return out


@njit(cache=True)
def tabled(start: float, step: float, table: Array, distance: Array) -> Array:
    """Return a table's values at (n, lines) distances; NaN stays NaN."""
    out = np.empty_like(distance)
    for k in range(distance.shape[0]):
        for j in range(distance.shape[1]):
            x = distance[k, j]
            out[k, j] = lookup(start, step, table, x) if x == x else np.nan
    return out
