"""What the evidence of an onset is divided by: how much more a healthy vessel's innovations gather than they should.

z'Lam^-1 z/2 (north, east) of an onset is 1 on average without a fault, at any age, where the innovations are white and
as large as their covariance says. Slow drift is neither, and the longer it is gathered the more that shows: on the FPSO
1.0 at 5 s, 1.3 at 60 s, 2 at 5 min. Its mean at an age a on the no-fault record is pooled with a prior:

    t(a) = max over b <= a of (m p + n(b) seen(b)) / (m + n(b)),      n(b) = record / b,  m = 10

so that a short record keeps the prior p, and old onsets, of which a record holds few, keep more of it [PositionThesis
has one number, 2]. What it cannot see: a sea whose drift wanders more slowly than the no-fault record is long.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import njit

from mooringdx.hypotheses.onset.bank import Beat, empty, rig_of, tuned
from mooringdx.hypotheses.onset.kernel import (
    ROW,
    WIDTH,
    Odds,
    Rig,
    Slots,
    Tuned,
    aged,
    born,
    finite,
    line_pulls,
    stepped,
)
from mooringdx.observers.kalman import Estimate
from mooringdx.observers.matrices import Model
from mooringdx.physics.mooring import Mooring
from mooringdx.types import Array

STRETCHES = 10.0
"""How many stretches of record the prior counts as."""


def tempers(
    estimate: Estimate, models: Sequence[Model], mooring: Mooring, odds: Odds, times: Beat, prior: float
) -> tuple[Array, float]:
    """Return what the evidence of an onset is divided by, one number each fine spacing of its age, and the mean seen.

    The second is the mean of z'Lam^-1 z/2 over the record and all ages, NaN where the record is too short for an onset.
    """
    innovation, place = estimate.innovation, estimate.position
    n, ages = len(place), times.end // times.fine + 1
    total, count = np.zeros(ages), np.zeros(ages)
    slots, rig, scratch = empty(times, len(mooring.names)), rig_of(mooring), np.empty((2, 6 * ROW))
    matrices, middle = tuned(models), mooring.fairleads.mean(axis=0)
    _gathered(times.warm, innovation, place, matrices, rig, middle, odds, slots, scratch, total, count)
    seen = np.divide(total, count, out=np.full(ages, prior), where=count > 0)
    stretches = np.where(count > 0, n / (times.fine * np.maximum(np.arange(ages), 1.0)), 0.0)
    pooled = (STRETCHES * prior + stretches * seen) / (STRETCHES + stretches)
    pooled[0] = pooled[1]
    mean = float(total.sum() / count.sum()) if count.any() else np.nan
    return np.maximum(np.maximum.accumulate(pooled), 1.0), mean


@njit(cache=True)
def _gathered(
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
