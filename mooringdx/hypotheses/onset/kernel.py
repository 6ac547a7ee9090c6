"""Loops of the onset bank: what every onset has gathered, and what each hypothesis is worth given that.

For a unit force m (north, east at the middle of the fairleads, and a unit moment) from sample k0 on, d the change of
the filter's state per unit force, e the innovation of the filter that knows of no force:

    rho = C d,   z += rho' S^-1 e,   Lam += rho' S^-1 rho,   d <- F (I - K C) d + G,   d(k0) = 0
    pulse of n samples:  z_p = z(k0) - z(k0 + n),   Lam_p = Lam(k0) + Lam(k0 + n) - X - X',
                         X += rho(k0)' S^-1 rho(k0 + n)

so that a force f from k0 on has the log likelihood ratio f'z - f'Lam f/2 against none. With z and Lam divided by the
temper first and h_j the (north, east, moment) that line j gives:

    free force f ~ N(0, P):        L_P(z) = 1/2 z'(I + P Lam)^-1 P z - 1/2 ln det(I + P Lam)      (north, east only)
    line j, f ~ N(-h_j, V_j):      L = -h_j'z - 1/2 h_j'Lam h_j + L_V(z + Lam h_j)

V_j has sd ``along`` and ``across`` the line, because the other lines give way a little differently than the filter's
model does [Basseville1993, ch. 7, for an onset and a size that are not known]. Each onset carries its own d, so that
gaps and a turning vessel are followed as the filter follows them. What it cannot see: an onset before the oldest kept.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mooringdx.observers.kalman import HEADING_STEP, turn_states
from mooringdx.physics.mooring import lookup
from mooringdx.types import Array

Index = NDArray[np.int64]
PULSES = 3
NOTHING = -np.inf


class Slots(NamedTuple):
    """What is kept of each onset. ``when``: (s,), sample, -1 where free; ``after``: (s, 3), the slot of the onset one
    pulse later, -1 where none; ``d``: (15, s, 3); ``z``: (s, 3); ``lam``: (s, 3, 3); ``cross``: (s, 3, 3, 3), X of
    each pulse; ``pulls``: (s, lines, 3), N, N, N m, of each line at the onset.
    """

    when: Index
    after: Index
    d: Array
    z: Array
    lam: Array
    cross: Array
    pulls: Array


class Odds(NamedTuple):
    """Numbers of the hypotheses. ``fine``, ``fine_end``, ``end``: samples between onsets and until they are thinned to
    every fourth and dropped; ``pulses``: (3,), samples. ``line``, ``environment``, ``pulse``: log of rate times the
    fine spacing; ``along``, ``across``: sd of the force that a lost line leaves, over its
    pull; ``step``, ``group``: (2, 2), N^2, covariance of the free forces,
    in earth and in body axes.
    """

    fine: int
    fine_end: int
    end: int
    pulses: Index
    line: float
    environment: float
    pulse: float
    temper: float
    along: float
    across: float
    step: Array
    group: Array


class Rig(NamedTuple):
    """The lines: (n, 2) anchors and fairleads, the tables of horizontal tension as in `Mooring`."""

    anchors: Array
    fairleads: Array
    start: float
    step: float
    horizontal: Array


class Tuned(NamedTuple):
    """The filter's matrices at headings 3 deg apart, stacked; ``inverse``: of the innovations' covariance."""

    headings: Array
    F: Array
    G: Array
    K: Array
    inverse: Array


@njit(cache=True)
def free_force(z0: float, z1: float, lam: Array, temper: float, c00: float, c01: float, c11: float) -> float:
    """Return the log likelihood ratio of a free horizontal force of covariance (c00, c01; c01, c11), N^2.

    ``z0``, ``z1``: north and east of z; ``lam``: (3, 3).
    """
    b00, b01, b11 = lam[0, 0] / temper, lam[0, 1] / temper, lam[1, 1] / temper
    y0, y1 = z0 / temper, z1 / temper
    m00, m01 = 1.0 + c00 * b00 + c01 * b01, c00 * b01 + c01 * b11
    m10, m11 = c01 * b00 + c11 * b01, 1.0 + c01 * b01 + c11 * b11
    det = m00 * m11 - m01 * m10
    p0, p1 = c00 * y0 + c01 * y1, c01 * y0 + c11 * y1
    fit = y0 * (m11 * p0 - m01 * p1) + y1 * (m00 * p1 - m10 * p0)
    out: float = 0.5 * fit / det - 0.5 * np.log(det)
    return out


@njit(cache=True)
def doubt(pull: Array, along: float, across: float) -> tuple[float, float, float]:
    """Return the covariance (c00, c01, c11), N^2, of the horizontal force that a lost ``pull``, (3,), leaves."""
    a, b = along**2, across**2
    n, e = pull[0], pull[1]
    return a * n * n + b * e * e, (a - b) * n * e, a * e * e + b * n * n


@njit(cache=True)
def line_lost(z: Array, lam: Array, pull: Array, temper: float, along: float, across: float) -> float:
    """Return the log likelihood ratio of a line whose ``pull``, (3,), is lost."""
    l0 = lam[0, 0] * pull[0] + lam[0, 1] * pull[1] + lam[0, 2] * pull[2]
    l1 = lam[1, 0] * pull[0] + lam[1, 1] * pull[1] + lam[1, 2] * pull[2]
    l2 = lam[2, 0] * pull[0] + lam[2, 1] * pull[1] + lam[2, 2] * pull[2]
    s = -(pull[0] * z[0] + pull[1] * z[1] + pull[2] * z[2])
    q = pull[0] * l0 + pull[1] * l1 + pull[2] * l2
    c00, c01, c11 = doubt(pull, along, across)
    out: float = (s - 0.5 * q) / temper + free_force(z[0] + l0, z[1] + l1, lam, temper, c00, c01, c11)
    return out


@njit(cache=True)
def in_earth(cov: Array, heading: float) -> Array:
    """Return a covariance of body axes, (2, 2), in earth axes."""
    c, s = np.cos(heading), np.sin(heading)
    a, b, d = cov[0, 0], cov[0, 1], cov[1, 1]
    cross = c * s * (a - d) + (c * c - s * s) * b
    return np.array(
        [[c * c * a - 2.0 * c * s * b + s * s * d, cross], [cross, s * s * a + 2.0 * c * s * b + c * c * d]]
    )


@njit(cache=True)
def weighed(k: int, slots: Slots, odds: Odds, group: Array, out: Array) -> None:
    """Fill ``out``, (s, lines + 4), with prior times likelihood ratio, in logs, at sample k.

        ``group``: (2, 2), N^2, covariance of a wave group's force, earth axes.
    Columns: lines, step of the environment, pulses.
    """
    lines = slots.pulls.shape[1]
    out[:] = NOTHING
    lam = np.zeros((3, 3))
    for s in range(slots.when.size):
        age = k - slots.when[s]
        if slots.when[s] < 0 or age < 1:
            continue
        wide = np.log(4.0) if age > odds.fine_end else 0.0
        for j in range(lines):
            worth = line_lost(slots.z[s], slots.lam[s], slots.pulls[s, j], odds.temper, odds.along, odds.across)
            out[s, j] = odds.line + wide + worth
        z0, z1, c = slots.z[s, 0], slots.z[s, 1], odds.step
        worth = free_force(z0, z1, slots.lam[s], odds.temper, c[0, 0], c[0, 1], c[1, 1])
        out[s, lines] = odds.environment + wide + worth
        step = free_force(z0, z1, slots.lam[s], odds.temper, group[0, 0], group[0, 1], group[1, 1])
        for i in range(PULSES):
            later, worth = slots.after[s, i], step
            if later >= 0:
                for a in range(2):
                    for b in range(2):
                        lam[a, b] = slots.lam[s, a, b] + slots.lam[later, a, b]
                        lam[a, b] -= slots.cross[s, i, a, b] + slots.cross[s, i, b, a]
                d0, d1 = z0 - slots.z[later, 0], z1 - slots.z[later, 1]
                worth = free_force(d0, d1, lam, odds.temper, group[0, 0], group[0, 1], group[1, 1])
            out[s, lines + 1 + i] = odds.pulse + wide + worth


@njit(cache=True)
def summed(logs: Array) -> float:
    """Return ln sum exp of all entries; minus infinity where there is none."""
    top = NOTHING
    for x in logs.flat:
        top = max(top, x)
    if top == NOTHING:
        return NOTHING
    total = 0.0
    for x in logs.flat:
        total += np.exp(x - top)
    out: float = top + np.log(total)
    return out


@njit(cache=True)
def together(logs: Array, score_row: Array) -> float:
    """Return the score of one sample and fill ``score_row``, (lines + 3,), with the probabilities.

    Order: no fault, lines, step of the environment, pulse. ``logs``: as `weighed` gives them.
    """
    lines = logs.shape[1] - 1 - PULSES
    row = np.zeros(lines + 3)
    for j in range(lines + 1):
        row[1 + j] = summed(logs[:, j])
    row[lines + 2] = summed(logs[:, lines + 1 :])
    total = summed(row)
    for j in range(row.size):
        score_row[j] = np.exp(row[j] - total)
    lost = summed(row[1 : 1 + lines])
    rest = np.zeros(3)
    rest[1:] = row[lines + 1 :]
    out: float = lost - summed(rest)
    return out


@njit(cache=True)
def turned(heading: float, tuned: Tuned, middle: Array) -> tuple[Array, Array, Array, Array]:
    """Return F, the effect of unit forces at the fairleads' ``middle``, (2,) body, K and S^-1 in earth axes."""
    at = min(max(int(np.round((heading - tuned.headings[0]) / HEADING_STEP)), 0), tuned.headings.size - 1)
    rest = heading - tuned.headings[at]
    c, s = np.cos(rest), np.sin(rest)
    cp, sp = np.cos(heading), np.sin(heading)
    F, G, K = tuned.F[at].copy(), np.empty((15, 3)), np.empty((15, 3))
    for i in range(15):
        turn_states(F[i], c, s)
    for j in range(15):
        turn_states(F[:, j], c, s)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    north, east = cp * middle[0] - sp * middle[1], sp * middle[0] + cp * middle[1]
    body = np.array([[cp, sp, 0.0], [-sp, cp, 0.0], [-east, north, 1.0]])
    G[:], K[:] = tuned.G[at] @ body, tuned.K[at] @ np.ascontiguousarray(turn.T)
    for j in range(3):
        turn_states(G[:, j], c, s)
        turn_states(K[:, j], c, s)
    return F, G, K, turn @ tuned.inverse[at] @ np.ascontiguousarray(turn.T)


@njit(cache=True)
def _add_product(out: Array, a: Array, s: int, b: Array, t: int) -> None:
    """Add a'b to ``out``, (3, 3), of slots ``s`` and ``t`` of two (3, slots, 3)."""
    for i in range(3):
        for j in range(3):
            out[i, j] += a[0, s, i] * b[0, t, j] + a[1, s, i] * b[1, t, j] + a[2, s, i] * b[2, t, j]


@njit(cache=True)
def gathered(error: Array, K: Array, inverse: Array, slots: Slots) -> None:
    """Take one innovation, (3,), into every onset, and update what it has changed of the filter's state."""
    count = slots.when.size
    flat = slots.d.reshape(15, 3 * count)
    moved = flat[:3] + flat[12:]
    flat -= K @ moved
    rho, heavy = moved.reshape(3, count, 3), (inverse @ moved).reshape(3, count, 3)
    for s in range(count):
        if slots.when[s] < 0:
            continue
        for i in range(3):
            for m in range(3):
                slots.z[s, i] += heavy[m, s, i] * error[m]
        _add_product(slots.lam[s], rho, s, heavy, s)
        for i in range(PULSES):
            later = slots.after[s, i]
            if later >= 0:
                _add_product(slots.cross[s, i], rho, s, heavy, later)


@njit(cache=True)
def carried(F: Array, G: Array, slots: Slots) -> None:
    """Carry what every onset has changed of the filter's state to the next sample, a unit force acting on."""
    count = slots.when.size
    slots.d[:] = (F @ slots.d.reshape(15, 3 * count)).reshape(15, count, 3)
    for s in range(count):
        if slots.when[s] >= 0:
            for i in range(15):
                for j in range(3):
                    slots.d[i, s, j] += G[i, j]


@njit(cache=True)
def line_pulls(place: Array, rig: Rig, middle: Array) -> Array:
    """Return each line's pull at ``place``, (lines, 3): N, N, and N m about the fairleads' middle."""
    out = np.empty((len(rig.anchors), 3))
    c, s = np.cos(place[2]), np.sin(place[2])
    for j in range(len(out)):
        fn, fe = rig.fairleads[j, 0], rig.fairleads[j, 1]
        north = rig.anchors[j, 0] - place[0] - c * fn + s * fe
        east = rig.anchors[j, 1] - place[1] - s * fn - c * fe
        reach = np.hypot(north, east)
        pull = lookup(rig.start, rig.step, rig.horizontal[j], reach) / reach
        arm_n, arm_e = c * (fn - middle[0]) - s * (fe - middle[1]), s * (fn - middle[0]) + c * (fe - middle[1])
        out[j, 0], out[j, 1] = pull * north, pull * east
        out[j, 2] = pull * (arm_n * east - arm_e * north)
    return out


@njit(cache=True)
def aged(k: int, slots: Slots, odds: Odds) -> None:
    """Drop the onsets that sample k + 1 no longer asks for, and what points at them."""
    for s in range(slots.when.size):
        age = k + 1 - slots.when[s]
        thin = age > odds.fine_end and slots.when[s] % (4 * odds.fine) != 0
        if slots.when[s] >= 0 and (thin or age > odds.end):
            slots.when[s] = -1
            for t in range(slots.when.size):
                for i in range(PULSES):
                    if slots.after[t, i] == s:
                        slots.after[t, i] = -1


@njit(cache=True)
def born(k: int, pulls: Array, slots: Slots, odds: Odds) -> int:
    """Begin an onset at sample k in a free slot, tied to those that it ends a pulse of; return the slot."""
    free = 0
    while slots.when[free] >= 0:
        free += 1
    slots.when[free] = k
    slots.after[free] = -1
    slots.d[:, free] = 0.0
    slots.z[free] = 0.0
    slots.lam[free] = 0.0
    slots.cross[free] = 0.0
    slots.pulls[free] = pulls
    for s in range(slots.when.size):
        for i in range(PULSES):
            if slots.when[s] >= 0 and slots.when[s] + odds.pulses[i] == k:
                slots.after[s, i] = free
    return free


@njit(cache=True)
def walk(
    first: int, last: int, stop: float, quiet: int, innovation: Array, place: Array, tuned: Tuned, rig: Rig,
    middle: Array, odds: Odds, slots: Slots, score: Array, probability: Array,
) -> int:  # fmt: skip
    """Go over samples ``first`` to ``last`` and return the first whose score is ``stop`` or more, else ``last``.

    ``quiet``: no onset begins before this sample. ``innovation``, ``place``: (n, 3). Fills ``score``, (n,), and
    ``probability``, (n, lines + 3), and carries ``slots`` on.
    """
    logs = np.empty((slots.when.size, len(rig.anchors) + 1 + PULSES))
    for k in range(first, last):
        if not np.isfinite(place[k]).all():
            continue
        F, G, K, inverse = turned(place[k, 2], tuned, middle)
        if np.isfinite(innovation[k]).all():
            gathered(innovation[k], K, inverse, slots)
        weighed(k, slots, odds, in_earth(odds.group, place[k, 2]), logs)
        score[k] = together(logs, probability[k])
        aged(k, slots, odds)
        if k >= quiet and k % odds.fine == 0:
            born(k, line_pulls(place[k], rig, middle), slots, odds)
        carried(F, G, slots)
        if score[k] >= stop:
            return k
    return last
