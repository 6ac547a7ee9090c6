"""What the adrift-or-moved verdict is made of: calls, settings as the loops take them, the trace and the verdict."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mooringdx.types import Array, Mask, locked

#: What is said at a fix. The order matters: from WARNING on, a warning is open.
LEARNING, SERVICE, WARNING, NOT_HOLDING, HOLDING = range(5)
CALLS = ("learning", "in service", "warning", "not holding", "holding")

#: Columns of the probability. With no warning open the second is 1 by construction.
HYPOTHESES = (
    "learning",
    "in service",
    "service visit, moving",
    "service visit, held",
    "drag, moving",
    "drag, held",
    "adrift, moving",
    "adrift, held",
)


class Numbers(NamedTuple):
    """The settings as the loops take them, km and days; triples are service, drag, adrift."""

    history: int
    learn_fixes: int
    warn_distance: float
    warn_factor: float
    radius_prior: float
    radius_weight: float
    radius_floor: float
    cusum_allowance: float
    cusum_level: float
    prior: Array
    stop_chance: Array
    jump_median: Array
    jump_log_sd: Array
    speed_median: Array
    speed_log_sd: Array
    speed_weight: float
    held_scale: float
    held_dof: float
    departure_chance: float
    alarm: float
    held: float
    departure_gap: float
    lost_gap: float
    expired_gap: float


class Trace(NamedTuple):
    """What is said at each fix: ``centre`` (n, 2), ``probability`` (n, 8), the rest (n,); lengths in km.

    ``limit``: warning distance; ``rise``: the fix at which the CUSUM last left zero; ``episode``: number of the open
    warning, -1 where none; ``near``: the fix lies within the warning distance.
    """

    centre: Array
    radius: Array
    limit: Array
    offset: Array
    cusum: Array
    rise: Array
    call: Array
    episode: Array
    near: Array
    probability: Array


@dataclass(frozen=True)
class Verdict:
    """The verdict day by day; on a day without a fix the last one stands, for a while. Lengths in m, times in s.

    ``time``, ``seen`` (a fix that day), ``radius`` (shrunken 95 % radius of the watch circle), ``limit`` (warning
    distance), ``offset`` (from the neutral point), ``cusum``, ``rise`` (s, when the CUSUM last left zero), ``call``
    (index into CALLS, -1 before the first fix), ``episode`` (-1 with no warning open), ``near``: (n,);
    ``neutral``: (n, 2), north and east; ``probability``: (n, 8), columns HYPOTHESES, rows sum to 1.
    """

    time: Array
    seen: Mask
    neutral: Array
    radius: Array
    limit: Array
    offset: Array
    cusum: Array
    rise: Array
    call: Array
    episode: Array
    near: Mask
    probability: Array

    def __post_init__(self) -> None:
        for key in ("time", "neutral", "radius", "limit", "offset", "cusum", "rise", "probability"):
            object.__setattr__(self, key, locked(getattr(self, key)))
        for key in ("call", "episode"):
            object.__setattr__(self, key, locked(getattr(self, key), np.int64))
        for key in ("seen", "near"):
            object.__setattr__(self, key, locked(getattr(self, key), np.bool_))

    @property
    def not_holding(self) -> Array:
        """(n,), probability that the buoy is moving and it is no service visit: drag or adrift."""
        return np.asarray(self.probability[:, 4] + self.probability[:, 6])

    @property
    def holding(self) -> Array:
        """(n,), probability that a buoy under warning is held, wherever it is."""
        return np.asarray(self.probability[:, 3] + self.probability[:, 5] + self.probability[:, 7])
