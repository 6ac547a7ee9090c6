"""Error covariances of the thesis's bank, from a log of one vessel with nothing broken.

    simulated   x(k+1) = F x(k) + G u(k) + w,  y = place + C x + v,  b <- e^(-h/T_b) b,  10,000 s for each hypothesis
                with its line lost from the start; S_i from what observer i makes of it [PositionThesis, section 4.4]
    no_fault    S_none from the no-fault window, and S_i = S_none for every lost line

F, G, w: the 15-state model of `mooringdx.observers.matrices` with the noise that was identified and the stiffness of
the lines that are left, at the no-fault place. A steady force holds the vessel there without the lost line, as a
controller would, and a heading loop (0.05 rad/s, damping 0.8, a choice) keeps it on its heading; the observers are told
both. One seed serves all hypotheses, as the thesis's does: its test adds up differences of ln det S, so that a percent
of sampling error between nine records would outweigh the evidence. Departures: the plant is linear, its slow force is
white plus a walk and no squared envelope, and there is no steady current. "no_fault" assumes that a loss leaves the
innovations of the observer that knows of it as they were: then ln det S cancels.

What neither sees: another sea than that of the no-fault window.
"""

from __future__ import annotations

import zlib

import numpy as np
from numba import njit

from mooringdx.hypotheses.dht import covariance
from mooringdx.hypotheses.thesis_bank import own_covariance
from mooringdx.observers.matrices import STATES, Model, Noise, Plant, model
from mooringdx.observers.passive import BIAS_TIME, Passive, single_losses, watch
from mooringdx.physics.frames import rotation
from mooringdx.physics.mooring import Mooring
from mooringdx.types import Array

DURATION, SEED = 10_000.0, 1
"""s at full scale; of all streams of the simulation."""
SETTLE = 600.0
"""s at full scale of a no-fault window that an observer is left to settle in."""
_TURN, _DAMPED = 0.05, 0.8


def simulated(
    observer: Passive,
    mooring: Mooring,
    plant: Plant,
    noise: Noise,
    place: Array,
    step: float,
    time_scale: float = 1.0,
    equations: str = "printed",
) -> Array:
    """Return the covariances, (lines + 1, 3, 3), of each observer in its own plant; the last is that of none.

    ``place``: (3,), m, m, rad; ``step``: s; ``equations``: of `mooringdx.hypotheses.dht.covariance`.
    """
    n = round(DURATION / (time_scale * step))
    shocks = np.column_stack([_stream(f"state {i}").standard_normal(n) for i in range(STATES)])
    fixes = np.column_stack([_stream(f"fix {i}").standard_normal(n) for i in range(3)])
    rigs = (*(mooring.without([name]) for name in mooring.names), mooring)
    out = []
    for i, rig in enumerate(rigs):
        measured, force = lived(plant, noise, rig, place, step, shocks, fixes, time_scale)
        out.append(own_covariance(observer, mooring, i, measured, force, step, equations))
    return np.array(out)


def lived(
    plant: Plant,
    noise: Noise,
    mooring: Mooring,
    place: Array,
    step: float,
    shocks: Array,
    fixes: Array,
    time_scale: float = 1.0,
) -> tuple[Array, Array]:
    """Return places, (n, 3), m, m, rad, and the known force in body axes, (n, 3), of the linear plant.

    ``shocks``: (n, 15) and ``fixes``: (n, 3), white and of sd one.
    """
    place = np.asarray(place, dtype=np.float64)
    one = model(plant, noise, step, float(place[2]), mooring.stiffness(place))
    moment = float(plant.inertia[2, 2])
    turn = _TURN * time_scale
    loop = np.array([-moment * turn**2, -2.0 * _DAMPED * turn * moment])
    steady = -rotation(float(place[2])).T @ mooring.force(place)
    keep = float(np.exp(-step * time_scale / BIAS_TIME))
    slow, yaw = _moved(one.F, one.G, shocks @ root(one, plant).T, loop, keep)
    measured = place + slow @ one.C.T + fixes * np.sqrt(np.asarray(noise.measurement))
    force = np.tile(steady, (len(slow), 1))
    force[:, 2] += yaw
    return measured, force


def root(one: Model, plant: Plant) -> Array:
    """Return a root L, (15, 15), of a model's Q = L L', whose states have units far apart."""
    scale = np.ones(STATES)
    scale[6:9] = np.diag(plant.inertia)
    values, axes = np.linalg.eigh(one.Q / np.outer(scale, scale))
    return np.asarray(scale[:, None] * axes * np.sqrt(np.maximum(values, 0.0)))


def no_fault(observer: Passive, mooring: Mooring, measured: Array, force: Array, step: float, skip: int) -> Array:
    """Return the covariance, (3, 3), of the observer of whole lines on a no-fault piece, and that of no observer else.

    ``skip``: samples to settle in; a piece under twice as long is used whole. Second moments about zero.
    """
    seen = watch(observer, mooring, single_losses(len(mooring.names))[-1:], measured, force, step)
    error = seen.innovation[:, 0]
    return covariance(error[skip:] if len(error) >= 2 * skip else error)


def _stream(name: str) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(SEED, spawn_key=(zlib.crc32(name.encode()),)))


@njit(cache=True)
def _moved(F: Array, G: Array, shocks: Array, loop: Array, keep: float) -> tuple[Array, Array]:
    """Return the states, (n, 15), and the heading loop's moment, (n,)."""
    n = len(shocks)
    out, moment, x = np.empty((n, 15)), np.empty(n), np.zeros(15)
    for k in range(n):
        out[k] = x
        moment[k] = loop[0] * x[2] + loop[1] * x[5]
        new = np.empty(15)
        for i in range(15):
            total = shocks[k, i] + G[i, 2] * moment[k]
            for j in range(15):
                total += F[i, j] * x[j]
            new[i] = total
        for i in range(6, 9):
            new[i] -= (1.0 - keep) * x[i]
        x = new
    return out, moment
