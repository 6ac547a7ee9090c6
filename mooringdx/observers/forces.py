"""Known forces on a moored vessel, and each line as seen from a place.

    wind:   [c_x V^2 cos a, c_y V^2 sin a, c_n V^2 sin 2a],   a the wind's travel from the bow
    lines:  sum_j T_m,j (H_j/T_j)(x) u_j, moment about the centre of gravity by the fairlead's arm     [Fang2015, eq. 4]

T_m,j is the measured tension at the fairlead, H_j/T_j the share of it that is horizontal, by the statics of the intact
line at the measured place x. What it cannot see: the vessel's own speed in the wind, and a line so changed that its
angle at the fairlead is no longer the intact one's (a line without its buoys: a few per cent).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from mooringdx.observers.kalman import held
from mooringdx.observers.matrices import Noise, Plant
from mooringdx.physics.frames import rotation, unwrapped
from mooringdx.physics.mooring import Mooring, lookup
from mooringdx.physics.vessel import VesselModel
from mooringdx.types import Array, Channels, replace

PLACE = ("north", "east", "heading")
THRUST = ("thrust_surge", "thrust_sway", "thrust_yaw")
WIND = ("wind_speed", "wind_direction")


@dataclass(frozen=True)
class Sight:
    """One line as seen from the no-fault place: ``tension``: its channel or empty. Sizes in N, NaN where it has none.

    ``pull``: (3,), the unit force towards the anchor with its moment (1, 1, m), earth axes. ``share``: H/T.
    ``slope``: dH/dT of a lost buoyancy.
    """

    line: str
    tension: str
    lost: float
    weakened: float
    share: float
    slope: float
    pull: tuple[float, float, float]


def wind_force(coefficients: Sequence[float], speed: Array, travel: Array) -> Array:
    """Return the wind's force in body axes, (n, 3), N, N, N m.

    ``coefficients``: surge, sway, yaw, per squared speed. ``speed``: (n,), m/s; ``travel``: (n,), rad, from the bow.
    """
    shape = np.column_stack([np.cos(travel), np.sin(travel), np.sin(2.0 * travel)])
    return np.asarray(np.asarray(coefficients) * shape * (speed**2)[:, None])


def place_and_force(
    channels: Channels,
    origin: Sequence[float],
    known: Sequence[str],
    wind: Sequence[float],
    piece: slice = slice(None),
) -> tuple[Array, Array]:
    """Return where a log's vessel is and the force that it knows of, (n, 3) each, at the samples of ``piece``.

    Place: from the neutral place ``origin``, m, m, rad, NaN where not seen, the heading unwrapped. Force: body axes, N,
    N, N m, of the channels in ``known``, thrust and wind by its coefficients ``wind``; a gap holds the last value.
    """
    columns = [channels.names.index(name) for name in PLACE]
    eta = np.where(channels.valid[piece][:, columns], channels.values[piece][:, columns], np.nan)
    eta[:, :2] -= origin
    eta[:, 2] = unwrapped(eta[:, 2])
    force = np.zeros(eta.shape)
    for i, name in enumerate(THRUST):
        if name in known:
            force[:, i] += held(channels.column(name)[piece][:, None])[:, 0]
    if set(WIND) <= set(known):
        speed, direction = held(np.column_stack([channels.column(name)[piece] for name in WIND])).T
        force += wind_force(wind, speed, direction + np.pi - held(eta)[:, 2])
    return eta, force


@njit(cache=True)
def measured_force(
    eta: Array, pulls: Array, fairleads: Array, anchors: Array, start: float, step: float,
    horizontal: Array, tension: Array,
) -> Array:  # fmt: skip
    """Return the lines' force and moment, (n, 3), N, N, N m, earth axes, by their measured tensions.

    ``eta``: (n, 3), the places; ``pulls``: (n, lines), N, measured; where NaN, the model's. Tables: (lines, k), N.
    """
    out = np.zeros((len(eta), 3))
    for k in range(len(eta)):
        c, s = np.cos(eta[k, 2]), np.sin(eta[k, 2])
        for j in range(len(anchors)):
            arm_n = c * fairleads[j, 0] - s * fairleads[j, 1]
            arm_e = s * fairleads[j, 0] + c * fairleads[j, 1]
            north, east = anchors[j, 0] - eta[k, 0] - arm_n, anchors[j, 1] - eta[k, 1] - arm_e
            distance = np.hypot(north, east)
            pull = lookup(start, step, horizontal[j], distance)
            whole = lookup(start, step, tension[j], distance)
            if np.isfinite(pulls[k, j]):
                pull = pulls[k, j] * pull / whole if whole > 0.0 else 0.0
            out[k, 0] += pull * north / distance
            out[k, 1] += pull * east / distance
            out[k, 2] += pull * (arm_n * east - arm_e * north) / distance
    return out


def quickened(noise: Noise, memory: float, plant: Plant) -> Noise:
    """Return the noise with the bias's intensity raised to where it follows a force within about ``memory`` s.

    A quiet record says that forces hardly change and the likeliest bias would then take its whole length to follow; a
    lost line is not in the record. The price is the noise of b over times under ``memory``, which averaging takes out.
    """
    least = max(noise.force[0], noise.force[1]) / memory**2
    turning = max(noise.force[2] / memory**2, least * float(plant.inertia[2, 2] / plant.inertia[0, 0]))
    north, east, yaw = noise.bias
    return replace(noise, bias=(max(north, least), max(east, least), max(yaw, turning)))


def sights(ship: VesselModel, mooring: Mooring, place: Array, tensions: Mapping[str, str]) -> tuple[Sight, ...]:
    """Return every line as seen from ``place``."""
    from mooringdx.physics.rig import fault_tables

    horizontal, tension, direction = mooring.pulls(place)
    arms = mooring.fairleads @ rotation(float(place[2]))[:2, :2].T
    n = len(mooring.names)
    slope, weakened = np.full(n, np.nan), np.full(n, np.nan)
    if any(section.buoy > 0.0 for section in ship.mooring.sections):
        table_h, table_t = fault_tables(ship, "buoyancy", [1.0])
        bare = replace(mooring, horizontal=np.repeat(table_h, n, axis=0), tension=np.repeat(table_t, n, axis=0))
        h, t, _ = bare.pulls(place)
        weakened = t - tension
        slope = (h - horizontal) / weakened
    out = []
    for j, line in enumerate(mooring.names):
        moment = float(arms[j, 0] * direction[j, 1] - arms[j, 1] * direction[j, 0])
        pull = (float(direction[j, 0]), float(direction[j, 1]), moment)
        lost = ship.mooring.parted - float(tension[j])
        share = float(horizontal[j] / tension[j]) if tension[j] > 0.0 else 0.0
        out.append(Sight(line, tensions.get(line, ""), lost, float(weakened[j]), share, float(slope[j]), pull))
    return tuple(out)
