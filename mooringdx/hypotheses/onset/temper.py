"""What the evidence of an onset is divided by: how much more a healthy vessel's innovations gather than they should.

z'Lam^-1 z/2 (north, east) of an onset is 1 on average without a fault, at any age, where the innovations are white and
as large as their covariance says. Slow drift is neither, and the longer it is gathered the more that shows: on the FPSO
1.0 at 5 s, 1.3 at 60 s, 2 at 5 min and later. Its mean at an age a on the no-fault record is pooled with a prior:

    t(a) = max over b <= a of (m p + n(b) seen(b)) / (m + n(b)),      n(b) = record / b,  m = 10

never under 1, so that a short record keeps the prior p, and old onsets, of which a record holds few, keep more of it:
of 70 min a tenth at 60 s and two thirds at 15 min. Prototypes had one number for all ages, 2. What it cannot see: a
sea whose drift wanders more slowly than the no-fault record is long.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mooringdx.hypotheses.onset.bank import Beat, empty, rig_of, tuned
from mooringdx.hypotheses.onset.kernel import ROW, Odds, watched
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
    watched(times.warm, innovation, place, matrices, rig, middle, odds, slots, scratch, total, count)
    seen = np.divide(total, count, out=np.full(ages, prior), where=count > 0)
    stretches = np.where(count > 0, n / (times.fine * np.maximum(np.arange(ages), 1.0)), 0.0)
    pooled = (STRETCHES * prior + stretches * seen) / (STRETCHES + stretches)
    pooled[0] = pooled[1]
    mean = float(total.sum() / count.sum()) if count.any() else np.nan
    return np.maximum(np.maximum.accumulate(pooled), 1.0), mean
