"""One loop over time and hypotheses: a Kalman filter each, Bayes' rule over their innovations, mixing if asked.

    c_j = sum_i Pi_ij p_i,   x0_j = sum_i Pi_ij p_i x_i / c_j                          (mixing; else x0_j = x_j)
    e_j = y - C x0_j,   x_j = x0_j + K_j e_j
    p_j = c_j N(e_j; 0, S_j)^(1/temper) / sum,   p <- max(p, floor) / sum,   x_j <- F_j x_j + G_j u

F, G, K, S: the 15-state filter of `mooringdx.observers.kalman` with hypothesis j's lines, at headings 3 deg apart, its
gain steady. Mixing is that of the interacting-multiple-model filter (Blom and Bar-Shalom, IEEE Transactions on
Automatic Control 33, 1988), less the mixing of covariances, which a steady gain has no use for. A line that was lost
pulls nothing, so hypotheses differ in their stiffness and in the force that they know of.

What it cannot see: an onset; evidence that came before a filter's state was mixed away is forgotten.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from mooringdx.observers.kalman import HEADING_STEP, turn_states
from mooringdx.physics.mooring import lookup
from mooringdx.types import Array


class Stack(NamedTuple):
    """The filters' matrices: (h, bins, ..); ``headings``: (bins,), rad; ``inverse``, ``logdet``: of S."""

    headings: Array
    F: Array
    G: Array
    K: Array
    inverse: Array
    logdet: Array
    stiffness: Array


class Lines(NamedTuple):
    """The mooring's tables, as in `Mooring`, and ``shares``: (h, lines), what each hypothesis leaves of a line."""

    fairleads: Array
    anchors: Array
    start: float
    step: float
    horizontal: Array
    shares: Array


class Rule(NamedTuple):
    """How filters are weighed. ``transition``: (h, h), from row to column within a sample; ``mixed``: states too;
    ``floor``: least probability; ``power``: of the likelihood, 1 / temper; ``quiet``: samples that are not weighed.
    """

    transition: Array
    mixed: bool
    floor: float
    power: float
    quiet: int


@njit(cache=True)
def _pull(x: Array, share: Array, lines: Lines, out: Array) -> None:
    """Fill ``out``, (3,), with the force and moment of what is left of the lines at the filter's place."""
    c, s = np.cos(x[2]), np.sin(x[2])
    for j in range(len(lines.anchors)):
        if share[j] == 0.0:
            continue
        arm_n = c * lines.fairleads[j, 0] - s * lines.fairleads[j, 1]
        arm_e = s * lines.fairleads[j, 0] + c * lines.fairleads[j, 1]
        north, east = lines.anchors[j, 0] - x[0] - arm_n, lines.anchors[j, 1] - x[1] - arm_e
        distance = np.hypot(north, east)
        pull = share[j] * lookup(lines.start, lines.step, lines.horizontal[j], distance) / distance
        out[0] += pull * north
        out[1] += pull * east
        out[2] += pull * (arm_n * east - arm_e * north)


@njit(cache=True)
def _surprise(error: Array, inverse: Array, logdet: float, c: float, s: float) -> float:
    """Return minus the log density of an innovation, less a constant; ``c``, ``s``: turn from the model's heading."""
    a, b, d = c * error[0] + s * error[1], c * error[1] - s * error[0], error[2]
    square = inverse[0, 0] * a * a + inverse[1, 1] * b * b + inverse[2, 2] * d * d
    square += 2.0 * (inverse[0, 1] * a * b + inverse[0, 2] * a * d + inverse[1, 2] * b * d)
    out: float = 0.5 * (square + logdet)
    return out


@njit(cache=True)
def _corrected(x: Array, error: Array, gain: Array, c: float, s: float, work: Array) -> None:
    a, b = c * error[0] + s * error[1], c * error[1] - s * error[0]
    for i in range(15):
        work[i] = gain[i, 0] * a + gain[i, 1] * b + gain[i, 2] * error[2]
    turn_states(work, c, s)
    for i in range(15):
        x[i] += work[i]


@njit(cache=True)
def _ahead(
    x: Array, earth: Array, body: Array, F: Array, G: Array, K: Array, heading: float, c: float, s: float, work: Array
) -> None:
    """Carry ``x`` one sample on. ``earth``: all forces in earth axes, of which F has the lines' stiffness ``K``."""
    turn_states(x, c, -s)
    a, b, n = c * earth[0] + s * earth[1], c * earth[1] - s * earth[0], earth[2]
    a += K[0, 0] * x[0] + K[0, 1] * x[1] + K[0, 2] * x[2]
    b += K[1, 0] * x[0] + K[1, 1] * x[1] + K[1, 2] * x[2]
    n += K[2, 0] * x[0] + K[2, 1] * x[1] + K[2, 2] * x[2]
    cr, sr = np.cos(heading), np.sin(heading)
    surge, sway, yaw = body[0] + cr * a + sr * b, body[1] + cr * b - sr * a, body[2] + n
    for i in range(15):
        total = G[i, 0] * surge + G[i, 1] * sway + G[i, 2] * yaw
        for j in range(15):
            total += F[i, j] * x[j]
        work[i] = total
    for i in range(15):
        x[i] = work[i]
    turn_states(x, c, s)


@njit(cache=True)
def _passed_on(p: Array, x: Array, rule: Rule, work: Array) -> None:
    """Let probabilities, and states where they are mixed, pass from hypothesis to hypothesis, in place."""
    h = p.size
    new = rule.transition.T @ p
    if rule.mixed:
        for j in range(h):
            for i in range(15):
                work[j, i] = 0.0
            for m in range(h):
                weight = rule.transition[m, j] * p[m]
                if weight > 0.0:
                    for i in range(15):
                        work[j, i] += weight * x[m, i]
        for j in range(h):
            if new[j] > 0.0:
                for i in range(15):
                    x[j, i] = work[j, i] / new[j]
    for j in range(h):
        p[j] = new[j]


@njit(cache=True)
def _believed(p: Array, worth: Array, floor: float) -> None:
    """Multiply probabilities by exp(``worth``) and normalise, in place, none below ``floor``."""
    most, total, rest = -np.inf, 0.0, 0.0
    for i in range(p.size):
        worth[i] += np.log(p[i]) if p[i] > 0.0 else -np.inf
        most = max(most, worth[i])
    for i in range(p.size):
        p[i] = np.exp(worth[i] - most)
        total += p[i]
    for i in range(p.size):
        p[i] = max(p[i] / total, floor)
        rest += p[i]
    for i in range(p.size):
        p[i] /= rest


@njit(cache=True)
def weigh(
    measured: Array, body: Array, earth: Array, bias: Array, start: Array, stack: Stack, lines: Lines, rule: Rule
) -> tuple[Array, Array]:
    """Return the probabilities after every sample, (n, h), and the last states, (h, 15).

    ``measured``: (n, 3), m, m, rad; rows with a NaN are only predicted. ``body``, ``earth``: (n, 3), known forces but
    those of the lines, N, N, N m. ``bias``: (3,), to start with. ``start``: (h,), probabilities to start with, which
    stand for the first ``rule.quiet`` samples.
    """
    n, h, bins = len(measured), len(lines.shares), len(stack.headings)
    out, x, p = np.empty((n, h)), np.zeros((h, 15)), start.copy()
    work, mix, worth, error, force = np.empty(15), np.empty((h, 15)), np.empty(h), np.empty(3), np.empty(3)
    started = False
    for k in range(n):
        seen = np.isfinite(measured[k, 0]) and np.isfinite(measured[k, 1]) and np.isfinite(measured[k, 2])
        if not started and seen:
            for i in range(h):
                x[i, :3], x[i, 6:9] = measured[k], bias
        started = started or seen
        if started and rule.transition.size:
            _passed_on(p, x, rule, mix)
        for i in range(h):
            at = min(max(int(np.round((x[i, 2] - stack.headings[0]) / HEADING_STEP)), 0), bins - 1)
            rest = x[i, 2] - stack.headings[at]
            c, s = np.cos(rest), np.sin(rest)
            if seen:
                for m in range(3):
                    error[m] = measured[k, m] - x[i, m] - x[i, 12 + m]
                worth[i] = -rule.power * _surprise(error, stack.inverse[i, at], stack.logdet[i, at], c, s)
                _corrected(x[i], error, stack.K[i, at], c, s, work)
            if started:
                for m in range(3):
                    force[m] = earth[k, m]
                _pull(x[i], lines.shares[i], lines, force)
                _ahead(
                    x[i], force, body[k], stack.F[i, at], stack.G[i, at], stack.stiffness[i, at], stack.headings[at],
                    c, s, work,
                )  # fmt: skip
        if seen:
            _believed(p, worth, rule.floor)
        if k < rule.quiet:
            p[:] = start
        out[k] = p
    return out, x
