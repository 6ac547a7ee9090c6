"""Loops of the onset bank: what every onset has gathered, and what each hypothesis is worth given that.

For a unit force m (north, east at the middle of the fairleads, and a unit moment) from sample k0 on, d the change of
the filter's state per unit force, e the innovation of the filter that knows of no force:

    rho = C d,   z += rho' S^-1 e,   Lam += rho' S^-1 rho,   d <- F (I - K C) d + G,   d(k0) = 0
    pulse of n samples:  the same sums with rho(k0) - rho(k0 + n) in place of rho

so that a force f from k0 on has the log likelihood ratio f'z - f'Lam f/2 against none. With z and Lam divided by the
temper of the onset's age first, times r where the sea is rougher than the one learned from (`risen`: r from the mean
of z'Lam^-1 z/2 over the temper, of onsets 20 to 60 s old, over the last ten minutes, five minutes late), and h_j the
(north, east, moment) that line j gives:

    free force f ~ N(0, P):        L_P(z) = 1/2 z'(I + P Lam)^-1 P z - 1/2 ln det(I + P Lam)      (north, east only)
    line j, f ~ N(-h_j, V_j):      L = -h_j'z - 1/2 h_j'Lam h_j + L_V(z + Lam h_j)

V_j has sd ``along`` and ``across`` the line, because the other lines give way a little differently than the filter's
model does [Basseville1993, ch. 7, for an onset and a size that are not known]. Each onset carries its own d, so that
gaps and a turning vessel are followed as the filter follows them. What it cannot see: an onset before the oldest kept.

Speed: all onsets are taken at once, a row of slots for each number, and F by its blocks (bias forces stay, wave states
move in pairs, so that 6 x 9 of 15 x 15 are left). It stands in one file because numba's cache of a loop does not notice
an edit of another file whose functions it took in.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mooringdx.observers.kalman import HEADING_STEP
from mooringdx.physics.mooring import lookup
from mooringdx.types import Array

Index = NDArray[np.int64]
PULSES = 3
CUT = 5.0
NOTHING, LOG4 = -np.inf, float(np.log(4.0))
WIDTH, ROW = 80, 240
"""Slots there is room for, and a row of one for each of three unit forces."""
FREE, OWN = 5, 9
"""Sums of a free force, and of an onset."""


class Slots(NamedTuple):
    """What is kept of each onset, flat rows of ``WIDTH`` slots each, so that their distances are known when compiling.

    ``when``: (WIDTH,), sample, -1 where free; ``after``: (3, WIDTH), the slot of the onset one pulse later, -1 where
    none; ``rough``: as `risen` keeps it; ``d``: 15 states x 3 unit forces; ``sums``: 24 rows, z0, z1, Lam00, Lam01,
    Lam11, z2, Lam02, Lam12, Lam22 of the onset, then the first five of each pulse; ``pulls``: losses x 3, N, N, N m.
    """

    when: Index
    after: Index
    d: Array
    sums: Array
    pulls: Array
    rough: Array


class Odds(NamedTuple):
    """Numbers of the hypotheses. ``fine``, ``fine_end``, ``end``: samples between onsets and until they are thinned to
    every fourth and dropped; ``pulses``: (3,), samples. ``line``, (losses,), ``environment``, ``pulse``: log of rate
    times the fine spacing; ``temper``: (end + 1,), by age in samples, what evidence is divided by; ``along``,
    ``across``: sd of the force that a loss leaves, over its pull; ``memory``: samples over which the sea is watched, 0
    for never; ``step``, ``group``: (2, 2), N^2, covariance of the free forces, in earth and in body axes.
    """

    fine: int
    fine_end: int
    end: int
    pulses: Index
    line: Array
    environment: float
    pulse: float
    temper: Array
    along: float
    across: float
    memory: float
    step: Array
    group: Array


class Rig(NamedTuple):
    """The lines: (n, 2) anchors and fairleads, the tables of horizontal tension as in `Mooring`.

    ``shares``: (losses, n), the share of every line's pull that a loss takes.
    """

    anchors: Array
    fairleads: Array
    start: float
    step: float
    horizontal: Array
    shares: Array


class Tuned(NamedTuple):
    """The filter's matrices at headings 3 deg apart, stacked; ``FK``: F times the gain; ``inverse``: of the
    innovations' covariance.
    """

    headings: Array
    F: Array
    G: Array
    FK: Array
    inverse: Array


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def free_force(
    y0: float, y1: float, b00: float, b01: float, b11: float, c00: float, c01: float, c11: float
) -> tuple[float, float]:
    """Return the exponent and the determinant of a free horizontal force of covariance (c00, c01; c01, c11), N^2.

    Its log likelihood ratio is exponent - ln(determinant)/2. ``y0``, ``y1``: north and east of z; ``b00``, ``b01``,
    ``b11``: of Lam; both over the temper.
    """
    m00, m01 = 1.0 + c00 * b00 + c01 * b01, c00 * b01 + c01 * b11
    m10, m11 = c01 * b00 + c11 * b01, 1.0 + c01 * b01 + c11 * b11
    det = m00 * m11 - m01 * m10
    p0, p1 = c00 * y0 + c01 * y1, c01 * y0 + c11 * y1
    fit = y0 * (m11 * p0 - m01 * p1) + y1 * (m00 * p1 - m10 * p0)
    return 0.5 * fit / det, det


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def left_over(north: float, east: float, along: float, across: float) -> tuple[float, float, float]:
    """Return the covariance (c00, c01, c11), N^2, of the horizontal force that a lost pull (north, east) leaves."""
    a, b = along * along, across * across
    return a * north * north + b * east * east, (a - b) * north * east, a * east * east + b * north * north


@njit(cache=True)
def doubt(pull: Array, along: float, across: float) -> tuple[float, float, float]:
    """Return the covariance (c00, c01, c11), N^2, of the horizontal force that a lost ``pull``, (3,), leaves."""
    out: tuple[float, float, float] = left_over(pull[0], pull[1], along, across)
    return out


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def weigh_line(j: int, slots: Slots, odds: Odds, cool: Array, out: Array) -> None:
    """Fill ``out``, two rows, with the exponent and the determinant of loss ``j`` at each onset; ``cool``: 1/temper."""
    x, h, row = slots.sums, slots.pulls, 3 * WIDTH * j
    along, across = odds.along, odds.across
    for s in range(WIDTH):
        t, n, e, m = cool[s], h[row + s], h[row + WIDTH + s], h[row + 2 * WIDTH + s]
        b00, b01, b11 = t * x[2 * WIDTH + s], t * x[3 * WIDTH + s], t * x[4 * WIDTH + s]
        b02, b12, b22 = t * x[6 * WIDTH + s], t * x[7 * WIDTH + s], t * x[8 * WIDTH + s]
        y0, y1, y2 = t * x[s], t * x[WIDTH + s], t * x[5 * WIDTH + s]
        l0, l1, l2 = b00 * n + b01 * e + b02 * m, b01 * n + b11 * e + b12 * m, b02 * n + b12 * e + b22 * m
        c00, c01, c11 = left_over(n, e, along, across)
        fit, det = free_force(y0 + l0, y1 + l1, b00, b01, b11, c00, c01, c11)
        out[s] = fit - n * (y0 + 0.5 * l0) - e * (y1 + 0.5 * l1) - m * (y2 + 0.5 * l2)
        out[WIDTH + s] = det


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def weigh_free(row: int, cov: Array, slots: Slots, cool: Array, out: Array) -> None:
    """Fill ``out``, two rows, with exponents and determinants of a free force with the sums from ``row`` on.

    ``cov``: (2, 2), N^2, of the force, earth axes; ``cool``: 1/temper.
    """
    x, at = slots.sums, WIDTH * row
    c00, c01, c11 = cov[0, 0], cov[0, 1], cov[1, 1]
    for s in range(WIDTH):
        t = cool[s]
        y0, y1 = t * x[at + s], t * x[at + WIDTH + s]
        b00, b01, b11 = t * x[at + 2 * WIDTH + s], t * x[at + 3 * WIDTH + s], t * x[at + 4 * WIDTH + s]
        fit, det = free_force(y0, y1, b00, b01, b11, c00, c01, c11)
        out[s] = fit
        out[WIDTH + s] = det


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
def standing(k: int, when: Index, odds: Odds, out: Array, cool: Array) -> None:
    """Fill, (WIDTH,) each, the log of the fine spacings that each onset stands for at sample k, and 1/temper."""
    for s in range(WIDTH):
        age = k - when[s]
        seen = when[s] >= 0 and age >= 1
        out[s] = (LOG4 if age > odds.fine_end else 0.0) if seen else NOTHING
        cool[s] = 1.0 / odds.temper[min(age, odds.temper.size - 1)] if seen else 1.0


@njit(cache=True)
def grown(mean: float) -> float:
    """Return by how much evidence is too large, from the ``mean`` of terms cut at `CUT`; 1 where that may be chance.

    A term is exponential; one of mean s has the mean s (1 - e^(-CUT/s)) when cut.
    """
    if mean < 1.2:
        return 1.0
    size = mean
    for _ in range(40):
        size = min(mean / (1.0 - np.exp(-CUT / size)), 1e3)
    out: float = size if size > 2.0 else max(1.0, 1.0 + (size - 1.3) / 0.7)
    return out


@njit(cache=True)
def risen(k: int, slots: Slots, odds: Odds, cool: Array) -> float:
    """Divide ``cool`` by how much rougher the sea is than the one learned from, and return that, 1 or more.

    z'Lam^-1 z/2 over the temper (north, east) of onsets one to three of the shortest groups old, cut so that a lost
    line weighs little, is averaged over ``memory``, and used as it was half of that before, so that a lost line weighs
    nothing until it is found. ``slots.rough``: the mean, the last rise, and a ring of the means.
    """
    rough, x, total, count = slots.rough, slots.sums, 0.0, 0
    if odds.memory == 0.0:
        return 1.0
    for s in range(WIDTH):
        age = k - slots.when[s]
        if slots.when[s] >= 0 and odds.pulses[0] <= age <= 3 * odds.pulses[0]:
            z0, z1, a, b, d = x[s], x[WIDTH + s], x[2 * WIDTH + s], x[3 * WIDTH + s], x[4 * WIDTH + s]
            det = a * d - b * b
            if det > 0.0:  # nothing was gathered in a gap
                total += min(0.5 * cool[s] * (d * z0 * z0 - 2.0 * b * z0 * z1 + a * z1 * z1) / det, CUT)
                count += 1
    if count:
        rough[0] += (total / count - rough[0]) / odds.memory
    at = 2 + k % (rough.size - 2)
    rise: float = grown(rough[at])
    rough[at] = rough[0]
    rough[1] = rise
    for s in range(WIDTH):
        cool[s] /= rise
    return rise


@njit(cache=True)
def weigh(j: int, slots: Slots, odds: Odds, group: Array, cool: Array, out: Array) -> float:
    """Fill ``out``, two rows, as of column ``j`` of `weighed`, and return the log of its prior."""
    losses = slots.pulls.size // (3 * WIDTH)
    if j < losses:
        weigh_line(j, slots, odds, cool, out)
        prior: float = odds.line[j]
        return prior
    if j == losses:
        weigh_free(0, odds.step, slots, cool, out)
        return odds.environment
    weigh_free(OWN + FREE * (j - losses - 1), group, slots, cool, out)
    return odds.pulse


@njit(cache=True)
def weighed(k: int, slots: Slots, odds: Odds, group: Array, out: Array) -> None:
    """Fill ``out``, (s, losses + 4), with prior times likelihood ratio, in logs, at sample k.

    ``group``: (2, 2), N^2, covariance of a wave group's force, earth axes. Columns: losses, step of the environment,
    pulses.
    """
    spacings, cool, worth = np.empty(WIDTH), np.empty(WIDTH), np.empty(2 * WIDTH)
    standing(k, slots.when, odds, spacings, cool)
    cool /= slots.rough[1]
    for j in range(out.shape[1]):
        prior = weigh(j, slots, odds, group, cool, worth)
        for s in range(WIDTH):
            out[s, j] = prior + spacings[s] + worth[s] - 0.5 * np.log(worth[WIDTH + s])


@njit(cache=True, error_model="numpy", fastmath={"contract", "nnan", "nsz", "reassoc"})
def heaped(worth: Array, spacings: Array) -> float:
    """Return ln sum of spacings times e^exponent / sqrt(determinant), minus infinity where there is none.

    One exponential a term that matters: what is 60 nats below the largest exponent adds less than 1e-24 of the sum.
    """
    top = NOTHING
    for s in range(WIDTH):
        top = max(top, worth[s] + spacings[s])
    if top == NOTHING:
        return NOTHING
    total = 0.0
    for s in range(WIDTH):
        less = worth[s] + spacings[s] - top
        if less > -60.0:
            total += np.exp(less) / np.sqrt(worth[WIDTH + s])
    out: float = top + np.log(total)
    return out


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
def shared(row: Array, chance: Array) -> float:
    """Return the score and fill ``chance``, (losses + 3,), with the probabilities.

    ``row``: (losses + 4,), logs: losses, step of the environment, pulses; in ``chance``: no fault, lines, step, pulse.
    """
    lines = row.size - 1 - PULSES
    rest, lost = np.zeros(3), summed(row[:lines])
    rest[1], rest[2] = row[lines], summed(row[lines + 1 :])
    chance[0], chance[lines + 1], chance[lines + 2] = rest[0], rest[1], rest[2]
    for j in range(lines):
        chance[1 + j] = row[j]
    total = summed(chance)
    for j in range(chance.size):
        chance[j] = np.exp(chance[j] - total)
    out: float = lost - summed(rest)
    return out


@njit(cache=True)
def together(logs: Array, score_row: Array) -> float:
    """Return the score of one sample and fill ``score_row``, (losses + 3,), with the probabilities.

    Order: no fault, lines, step of the environment, pulse. ``logs``: as `weighed` gives them.
    """
    row = np.empty(logs.shape[1])
    for j in range(row.size):
        row[j] = summed(logs[:, j])
    return shared(row, score_row)


@njit(cache=True)
def turn_two(a: Array, i: int, j: int, c: float, s: float) -> None:
    """Turn the entries ``j`` and ``j`` + 1 of row ``i``, north and east, in place."""
    a[i, j], a[i, j + 1] = c * a[i, j] - s * a[i, j + 1], s * a[i, j] + c * a[i, j + 1]


@njit(cache=True)
def turned(heading: float, tuned: Tuned, middle: Array) -> tuple[Array, Array, Array, Array]:
    """Return F, the effect of unit forces at the fairleads' ``middle``, (2,) body, F K and S^-1 in earth axes.

    F: (6, 9) and G: (6, 3) of the slow motion; the rest of F is the same at every heading.
    """
    at = min(max(int(np.round((heading - tuned.headings[0]) / HEADING_STEP)), 0), tuned.headings.size - 1)
    rest = heading - tuned.headings[at]
    c, s = np.cos(rest), np.sin(rest)
    cp, sp = np.cos(heading), np.sin(heading)
    north, east = cp * middle[0] - sp * middle[1], sp * middle[0] + cp * middle[1]
    F, G, FK, inverse = np.empty((6, 9)), np.empty((6, 3)), tuned.FK[at].copy(), tuned.inverse[at].copy()
    for i in range(6):
        for j in range(9):
            F[i, j] = tuned.F[at, i, j]
        turn_two(F, i, 0, c, s)
        turn_two(F, i, 6, c, s)
        surge, sway, yaw = tuned.G[at, i, 0], tuned.G[at, i, 1], tuned.G[at, i, 2]
        G[i, 0], G[i, 1], G[i, 2] = cp * surge - sp * sway - east * yaw, sp * surge + cp * sway + north * yaw, yaw
    for i in range(15):
        turn_two(FK, i, 0, c, s)
    for i in range(3):
        turn_two(inverse, i, 0, c, s)
    for j in range(9):
        F[0, j], F[1, j] = c * F[0, j] - s * F[1, j], s * F[0, j] + c * F[1, j]
    for j in range(3):
        G[0, j], G[1, j] = c * G[0, j] - s * G[1, j], s * G[0, j] + c * G[1, j]
        inverse[0, j], inverse[1, j] = c * inverse[0, j] - s * inverse[1, j], s * inverse[0, j] + c * inverse[1, j]
        for i in (0, 6, 9, 12):
            FK[i, j], FK[i + 1, j] = c * FK[i, j] - s * FK[i + 1, j], s * FK[i, j] + c * FK[i + 1, j]
    return F, G, FK, inverse


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def seen(d: Array, inverse: Array, rho: Array) -> None:
    """Fill ``rho``, six rows of 3 WIDTH, with rho and S^-1 rho of every onset."""
    a, b, c = inverse[0, 0], inverse[0, 1], inverse[0, 2]
    e, f, g = inverse[1, 1], inverse[1, 2], inverse[2, 2]
    for s in range(ROW):
        x, y, z = d[s] + d[12 * ROW + s], d[ROW + s] + d[13 * ROW + s], d[2 * ROW + s] + d[14 * ROW + s]
        rho[s], rho[ROW + s], rho[2 * ROW + s] = x, y, z
        rho[3 * ROW + s], rho[4 * ROW + s] = a * x + b * y + c * z, b * x + e * y + f * z
        rho[5 * ROW + s] = c * x + f * y + g * z


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def add_free(out: Array, row: int, rho: Array, x: float, y: float, z: float) -> None:
    """Add rho' S^-1 (x, y, z) and rho' S^-1 rho of north and east to five rows of ``out`` from ``row`` on."""
    at = WIDTH * row
    for s in range(WIDTH):
        a, b, c = rho[s], rho[ROW + s], rho[2 * ROW + s]
        d, e, f = rho[WIDTH + s], rho[ROW + WIDTH + s], rho[2 * ROW + WIDTH + s]
        p, q, r = rho[3 * ROW + s], rho[4 * ROW + s], rho[5 * ROW + s]
        u, v, w = rho[3 * ROW + WIDTH + s], rho[4 * ROW + WIDTH + s], rho[5 * ROW + WIDTH + s]
        out[at + s] += x * p + y * q + z * r
        out[at + WIDTH + s] += x * u + y * v + z * w
        out[at + 2 * WIDTH + s] += a * p + b * q + c * r
        out[at + 3 * WIDTH + s] += d * p + e * q + f * r
        out[at + 4 * WIDTH + s] += d * u + e * v + f * w


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def add_moment(out: Array, rho: Array, x: float, y: float, z: float) -> None:
    """Add what the unit moment is in, to the four rows that follow those of `add_free`."""
    for s in range(WIDTH):
        at = 2 * WIDTH + s
        p, q, r = rho[3 * ROW + at], rho[4 * ROW + at], rho[5 * ROW + at]
        out[5 * WIDTH + s] += x * p + y * q + z * r
        out[6 * WIDTH + s] += rho[s] * p + rho[ROW + s] * q + rho[2 * ROW + s] * r
        out[7 * WIDTH + s] += rho[WIDTH + s] * p + rho[ROW + WIDTH + s] * q + rho[2 * ROW + WIDTH + s] * r
        out[8 * WIDTH + s] += rho[at] * p + rho[ROW + at] * q + rho[2 * ROW + at] * r


@njit(cache=True)
def ended(after: Index, p: int, rho: Array, out: Array) -> None:
    """Fill ``out`` with the north and east columns of ``rho``, those of the onset that ends pulse ``p`` taken off."""
    for s in range(out.size):
        out[s] = rho[s]
    for s in range(WIDTH):
        later = after[p, s]
        if later >= 0:
            for m in range(6):
                out[m * ROW + s] -= rho[m * ROW + later]
                out[m * ROW + WIDTH + s] -= rho[m * ROW + WIDTH + later]


@njit(cache=True)
def gathered(error: Array, rho: Array, pulse: Array, slots: Slots) -> None:
    """Take one innovation, (3,), into every onset and pulse. ``rho``: of `seen`; ``pulse``: scratch like it."""
    x, y, z = error[0], error[1], error[2]
    add_free(slots.sums, 0, rho, x, y, z)
    add_moment(slots.sums, rho, x, y, z)
    for p in range(PULSES):
        ended(slots.after, p, rho, pulse)
        add_free(slots.sums, OWN + FREE * p, pulse, x, y, z)


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def carried(F: Array, G: Array, FK: Array, whole: Array, rho: Array, d: Array, new: Array) -> None:
    """Carry what every onset has changed of the filter's state to the next sample, a unit force acting on.

    ``F``, ``G``, ``FK``: of `turned`, ``FK`` zero where nothing was measured; ``whole``: F of the models, whose wave
    blocks are the same at every heading; ``new``: scratch, six rows of 3 WIDTH.
    """
    for r in range(6):
        a0, a1, a2, a3, a4 = F[r, 0], F[r, 1], F[r, 2], F[r, 3], F[r, 4]
        a5, a6, a7, a8 = F[r, 5], F[r, 6], F[r, 7], F[r, 8]
        x, y, z, at = FK[r, 0], FK[r, 1], FK[r, 2], r * ROW
        for s in range(ROW):
            slow = a0 * d[s] + a1 * d[ROW + s] + a2 * d[2 * ROW + s] + a3 * d[3 * ROW + s] + a4 * d[4 * ROW + s]
            slow += a5 * d[5 * ROW + s] + a6 * d[6 * ROW + s] + a7 * d[7 * ROW + s] + a8 * d[8 * ROW + s]
            new[at + s] = slow - x * rho[s] - y * rho[ROW + s] - z * rho[2 * ROW + s]
    for r in range(6):
        for i in range(3):
            g, at = G[r, i], r * ROW + i * WIDTH
            for s in range(WIDTH):
                d[at + s] = new[at + s] + g
    a, b, p, q = whole[0, 9, 9], whole[0, 9, 12], whole[0, 12, 9], whole[0, 12, 12]
    for m in range(3):
        x, y, z, at = FK[6 + m, 0], FK[6 + m, 1], FK[6 + m, 2], (6 + m) * ROW
        for s in range(ROW):
            d[at + s] -= x * rho[s] + y * rho[ROW + s] + z * rho[2 * ROW + s]
        x, y, z, at = FK[9 + m, 0], FK[9 + m, 1], FK[9 + m, 2], (9 + m) * ROW
        u, v, w = FK[12 + m, 0], FK[12 + m, 1], FK[12 + m, 2]
        for s in range(ROW):
            low, high = d[at + s], d[at + 3 * ROW + s]
            d[at + s] = a * low + b * high - x * rho[s] - y * rho[ROW + s] - z * rho[2 * ROW + s]
            d[at + 3 * ROW + s] = p * low + q * high - u * rho[s] - v * rho[ROW + s] - w * rho[2 * ROW + s]


@njit(cache=True)
def line_pulls(place: Array, rig: Rig, middle: Array) -> Array:
    """Return what each loss takes at ``place``, (losses, 3): N, N, and N m about the fairleads' middle."""
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
    return rig.shares @ out


@njit(cache=True)
def finite(row: Array) -> bool:
    """Return whether all of (3,) are finite."""
    return bool(np.isfinite(row[0]) and np.isfinite(row[1]) and np.isfinite(row[2]))


@njit(cache=True)
def stepped(error: Array, heading: float, tuned: Tuned, middle: Array, slots: Slots, scratch: Array) -> Array:
    """Take one innovation, (3,), NaN where none was, into every onset, carry it to the next sample, and return G.

    ``scratch``: (2, 6 ROW); G: (6, 3), what unit forces do to the state in a sample, for `born`.
    """
    F, G, FK, inverse = turned(heading, tuned, middle)
    seen(slots.d, inverse, scratch[0])
    if finite(error):
        gathered(error, scratch[0], scratch[1], slots)
    else:
        FK *= 0.0
    carried(F, G, FK, tuned.F, scratch[0], slots.d, scratch[1])
    return G


@njit(cache=True)
def aged(k: int, slots: Slots, odds: Odds) -> None:
    """Drop the onsets that sample k + 1 no longer asks for; one that ends a pulse goes no sooner than the pulse."""
    for s in range(WIDTH):
        age = k + 1 - slots.when[s]
        if age > odds.end or (age > odds.fine_end and slots.when[s] % (4 * odds.fine) != 0):
            slots.when[s] = -1


@njit(cache=True)
def born(k: int, pulls: Array, G: Array, slots: Slots, odds: Odds) -> None:
    """Begin an onset at sample k in a free slot, tied to those that it ends a pulse of.

    ``G``: (6, 3), what unit forces have done to the state by the next sample.
    """
    free = 0
    while slots.when[free] >= 0:
        free += 1
    slots.when[free] = k
    for i in range(45):
        slots.d[i * WIDTH + free] = G[i // 3, i % 3] if i < 18 else 0.0
    for i in range(OWN + PULSES * FREE):
        slots.sums[i * WIDTH + free] = 0.0
    for i in range(3 * len(pulls)):
        slots.pulls[i * WIDTH + free] = pulls[i // 3, i % 3]
    for i in range(PULSES):
        slots.after[i, free] = -1
        for s in range(WIDTH):
            if slots.when[s] >= 0 and slots.when[s] + odds.pulses[i] == k:
                slots.after[i, s] = free


@njit(cache=True)
def walk(
    first: int, last: int, stop: float, quiet: int, innovation: Array, place: Array, tuned: Tuned, rig: Rig,
    middle: Array, odds: Odds, slots: Slots, score: Array, probability: Array, rise: Array,
) -> int:  # fmt: skip
    """Go over samples ``first`` to ``last`` and return the first whose score is ``stop`` or more, else ``last``.

    ``quiet``: no onset begins before this sample. ``innovation``, ``place``: (n, 3). Fills ``score``, (n,),
    ``probability``, (n, losses + 3), and ``rise``, (n,), as of `risen`, and carries ``slots`` on.
    """
    scratch, spacings, cool = np.empty((2, 6 * ROW)), np.empty(WIDTH), np.empty(WIDTH)
    worth, row = np.empty(2 * WIDTH), np.empty(len(rig.shares) + 1 + PULSES)
    for k in range(first, last):
        if not finite(place[k]):
            continue
        G = stepped(innovation[k], place[k, 2], tuned, middle, slots, scratch)
        standing(k, slots.when, odds, spacings, cool)
        rise[k] = risen(k, slots, odds, cool)
        group = in_earth(odds.group, place[k, 2]) * rise[k]
        for j in range(row.size):
            row[j] = weigh(j, slots, odds, group, cool, worth) + heaped(worth, spacings)
        score[k] = shared(row, probability[k])
        aged(k, slots, odds)
        if k >= quiet and k % odds.fine == 0:
            born(k, line_pulls(place[k], rig, middle), G, slots, odds)
        if score[k] >= stop:
            return k
    return last


@njit(cache=True)
def watched(
    quiet: int, innovation: Array, place: Array, tuned: Tuned, rig: Rig, middle: Array, odds: Odds, slots: Slots,
    scratch: Array, total: Array, count: Array,
) -> None:  # fmt: skip
    """Add z'Lam^-1 z/2 of north and east of every onset, at every fine spacing of its age, to ``total``."""
    x = slots.sums
    for k in range(len(place)):
        if not finite(place[k]):
            continue
        G = stepped(innovation[k], place[k, 2], tuned, middle, slots, scratch)
        for s in range(WIDTH):
            age = k - slots.when[s]
            if slots.when[s] < 0 or age < odds.fine or age % odds.fine != 0:
                continue
            z0, z1, a, b, d = x[s], x[WIDTH + s], x[2 * WIDTH + s], x[3 * WIDTH + s], x[4 * WIDTH + s]
            det = a * d - b * b
            if det > 0.0:
                total[age // odds.fine] += 0.5 * (d * z0 * z0 - 2.0 * b * z0 * z1 + a * z1 * z1) / det
                count[age // odds.fine] += 1.0
        aged(k, slots, odds)
        if k >= quiet and k % odds.fine == 0:
            born(k, line_pulls(place[k], rig, middle), G, slots, odds)


@njit(cache=True)
def followed(
    onsets: Index, last: int, innovation: Array, place: Array, rise: Array, tuned: Tuned, rig: Rig, middle: Array,
    line: int, odds: Odds, slots: Slots, out: Array,
) -> None:  # fmt: skip
    """Fill ``out`` with L from the first of ``onsets`` on."""
    first, begun = onsets[0], 0
    logs, worth, scratch = np.zeros(onsets.size), np.empty(2 * WIDTH), np.empty((2, 6 * ROW))
    spacings, cool = np.empty(WIDTH), np.empty(WIDTH)
    for k in range(first, last):
        if k > first:
            out[k - first] = out[k - first - 1]
        if not finite(place[k]):
            continue
        G = stepped(innovation[k], place[k, 2], tuned, middle, slots, scratch)
        standing(k, slots.when, odds, spacings, cool)
        cool /= rise[k]
        weigh_line(line, slots, odds, cool, worth)
        for s in range(begun):
            logs[s] = worth[s] - 0.5 * np.log(worth[WIDTH + s])
        out[k - first] = summed(logs) - np.log(onsets.size)
        while begun < onsets.size and onsets[begun] <= k:
            born(k, line_pulls(place[k], rig, middle), G, slots, odds)
            begun += 1
