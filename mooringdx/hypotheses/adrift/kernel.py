"""Forward filter behind the adrift-or-moved verdict: hot loops on plain arrays, in km and days.

While no warning is open, with m the spatial median of the last held fixes, d = |x - m|, n of them:

    r = max(floor, (n0 r0 + n q95(d)) / (n0 + n))                 shrunken 95 % radius of the watch circle
    s = r/2.448                                                   its sd per axis under a circular normal law
    C <- C + d/s - k where d/s > k, else 0                        lasting displacement: CUSUM with reset [Page1954]
    warning when d > max(d0, f r) or C > h

While a warning is open, over the causes c (service, drag, adrift) x (moving, held), a step of l km in t days, v = l/t,
the forward recursion of a hidden Markov model (L. R. Rabiner, Proceedings of the IEEE 77(2), 1989, eq. 20):

    p(c, moving) ~ [p(c, moving) (1 - a) + p(c, held) b] (1/t) g(v)^(1-w) L_c(v)^w,      a = 1 - (1 - stop_c)^t
    p(c, held)   ~ [p(c, moving) a + p(c, held) (1 - b)] (l/q^2) (1 + l^2/(nu q^2))^(-(nu+2)/2)

L_c the lognormal law of speed of the cause, g the mean of the three, w the share of the evidence on speed that is
believed, b the chance of a new departure, q the scale of a held step (Student t in the plane). The first jump d
weighs the causes by its own lognormal law. Every loop is causal: fix k changes nothing before k.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from mooringdx.hypotheses.adrift.nouns import HOLDING, LEARNING, NOT_HOLDING, SERVICE, WARNING, Numbers, Trace
from mooringdx.types import Array

RAYLEIGH_MEDIAN = 1.1774100225154747
RAYLEIGH_95 = 2.4477468306808166
SQRT_2PI = 2.5066282746310002
CENTRE_STEPS = 60
CENTRE_SOFT = 0.1  # km; far below a watch circle, keeps the iteration smooth where fixes repeat
LEAST_SPEED = 0.1  # km a day; repeated fixes have no finite log speed


@njit(cache=True)
def spatial_median(x: Array, y: Array) -> tuple[float, float]:
    """Return the point of least summed (softened) distance to the fixes: Weiszfeld's iteration, km."""
    a, b = x.mean(), y.mean()
    for _ in range(CENTRE_STEPS):
        sw, sx, sy = 0.0, 0.0, 0.0
        for i in range(x.size):
            w = 1.0 / math.sqrt((x[i] - a) ** 2 + (y[i] - b) ** 2 + CENTRE_SOFT**2)
            sw += w
            sx += w * x[i]
            sy += w * y[i]
        a, b = sx / sw, sy / sw
    return a, b


@njit(cache=True)
def _sorted_quantile(ordered: Array, share: float) -> float:
    place = share * (ordered.size - 1)
    i = min(int(place), ordered.size - 2) if ordered.size > 1 else 0
    above = ordered[min(i + 1, ordered.size - 1)]
    return float(ordered[i] + (place - i) * (above - ordered[i]))


@njit(cache=True)
def watch_circle(x: Array, y: Array, numbers: Numbers) -> tuple[float, float, float]:
    """Return neutral point and shrunken 95 % radius of the held fixes, km."""
    a, b = spatial_median(x, y)
    d = np.sort(np.sqrt((x - a) ** 2 + (y - b) ** 2))
    n, n0 = x.size, numbers.radius_weight
    radius = (n0 * numbers.radius_prior + n * _sorted_quantile(d, 0.95)) / (n0 + n)
    return a, b, max(radius, numbers.radius_floor)


@njit(cache=True)
def _lognormal(value: float, median: float, log_sd: float) -> float:
    z = math.log(value / median) / log_sd
    return math.exp(-0.5 * z * z) / (value * log_sd * SQRT_2PI)


@njit(cache=True)
def depart(weights: Array, jump: float, numbers: Numbers) -> None:
    """Start the filter at a departure: all moving, causes weighed by the first jump (km; 0 = no jump seen)."""
    for c in range(3):
        weights[2 * c] = numbers.prior[c]
        weights[2 * c + 1] = 0.0
        if jump > 0.0:
            weights[2 * c] *= _lognormal(jump, numbers.jump_median[c], numbers.jump_log_sd[c])
    weights /= weights.sum()


@njit(cache=True)
def advance(weights: Array, length: float, days: float, scale: float, numbers: Numbers) -> None:
    """Carry the six weights over one step of ``length`` km in ``days``."""
    speed = max(length / days, LEAST_SPEED)
    length = max(length, LEAST_SPEED)
    tail = 1.0 + length * length / (numbers.held_dof * scale * scale)
    held = length / (scale * scale) * tail ** (-0.5 * (numbers.held_dof + 2.0))
    common = 0.0
    for c in range(3):
        common += _lognormal(speed, numbers.speed_median[c], numbers.speed_log_sd[c]) / 3.0
    again = 1.0 - (1.0 - numbers.departure_chance) ** days
    for c in range(3):
        own = _lognormal(speed, numbers.speed_median[c], numbers.speed_log_sd[c])
        moving = common ** (1.0 - numbers.speed_weight) * own**numbers.speed_weight / days
        stop = 1.0 - (1.0 - numbers.stop_chance[c]) ** days
        go, stay = weights[2 * c], weights[2 * c + 1]
        weights[2 * c] = (go * (1.0 - stop) + stay * again) * moving
        weights[2 * c + 1] = (go * stop + stay * (1.0 - again)) * held
    weights /= weights.sum()


@njit(cache=True)
def weigh(
    weights: Array,
    state: int,
    still: int,
    step: float,
    gap: float,
    d: float,
    far: float,
    scale: float,
    numbers: Numbers,
) -> tuple[int, int]:
    """Take one fix under warning into ``weights``; return the call and the number of held fixes in a row."""
    if gap > numbers.departure_gap and (state != HOLDING or step > far):
        depart(weights, step if step > far else 0.0, numbers)
        return (NOT_HOLDING if state == NOT_HOLDING else WARNING), 0
    advance(weights, step, gap, scale, numbers)
    stays = weights[1] + weights[3] + weights[5]
    if weights[2] + weights[4] >= numbers.alarm and d > far:
        state = NOT_HOLDING
    elif stays >= numbers.held:
        state = HOLDING
    return state, (still + 1 if stays >= numbers.held else 0)


@njit(cache=True)
def _remember(held: Array, count: int, x: Array, y: Array, k: int) -> int:
    """Put fix k into the ring of held fixes (rows x, y, step before it); return the new count."""
    i = count % held.shape[1]
    held[0, i], held[1, i], held[2, i] = x[k], y[k], 0.0
    if k > 0 and count > 0:
        held[2, i] = math.sqrt((x[k] - x[k - 1]) ** 2 + (y[k] - y[k - 1]) ** 2)
    return count + 1


@njit(cache=True)
def run(day: Array, x: Array, y: Array, numbers: Numbers) -> Trace:
    """Walk over the fixes once. ``day``: (n,), rising; ``x``, ``y``: (n,), km; all finite.

    One loop, because each fix needs the whole state that the fix before left.
    """
    n = day.size
    out = Trace(
        np.zeros((n, 2)), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n, np.int64),
        np.zeros(n, np.int64), np.full(n, -1), np.zeros(n, np.bool_), np.zeros((n, 8)),
    )  # fmt: skip
    held, weights = np.zeros((3, numbers.history)), np.zeros(6)
    count, opened, state, still, start, by_jump = 0, -1, LEARNING, 0, 0, True
    a, b, r, level, scale = 0.0, 0.0, numbers.radius_prior, 0.0, numbers.held_scale
    for k in range(n):
        gap = day[k] - day[k - 1] if k > 0 else 1.0
        step = math.sqrt((x[k] - x[k - 1]) ** 2 + (y[k] - y[k - 1]) ** 2) if k > 0 else 0.0
        if gap > (numbers.lost_gap if state >= WARNING else numbers.expired_gap):
            state, count = LEARNING, 0
        if count == 0:
            a, b, r, level = x[k], y[k], max(numbers.radius_prior, numbers.radius_floor), 0.0
        elif state < WARNING:
            m = min(count, numbers.history)
            a, b, r = watch_circle(held[0, :m], held[1, :m], numbers)
            scale = max(numbers.held_scale, _sorted_quantile(np.sort(held[2, :m]), 0.5) / RAYLEIGH_MEDIAN)
        d = math.sqrt((x[k] - a) ** 2 + (y[k] - b) ** 2)
        far = max(numbers.warn_distance, numbers.warn_factor * r)
        if state == SERVICE:
            start = k if level == 0.0 else start
            excess = d * RAYLEIGH_95 / r - numbers.cusum_allowance
            level = level + excess if excess > 0.0 else 0.0
            if d > far or level > numbers.cusum_level:
                state, opened, still, by_jump = WARNING, opened + 1, 0, d > far
                depart(weights, d if by_jump else 0.0, numbers)
        elif state == LEARNING and d > far:
            count, a, b, d = 0, x[k], y[k], 0.0
        elif state >= WARNING:
            state, still = weigh(weights, state, still, step, gap, d, far, scale, numbers)
        out.centre[k, 0], out.centre[k, 1], out.radius[k], out.limit[k], out.offset[k] = a, b, r, far, d
        out.cusum[k], out.rise[k], out.call[k], out.near[k] = level, start, state, d <= far
        if state >= WARNING:
            out.episode[k] = opened
            out.probability[k, 2:] = weights
            if still >= numbers.learn_fixes:
                count = count if by_jump and d <= far else 0
                for i in range(k - numbers.learn_fixes + 1, k + 1):
                    count = _remember(held, count, x, y, i)
                state, level = SERVICE, 0.0
        else:
            out.probability[k, state] = 1.0
            count = _remember(held, count, x, y, k)
            state = SERVICE if count >= numbers.learn_fixes else state
    return out
