"""The bank as printed: nine passive observers, one for each lost line and one for none, weighed in two ways.

    y~_i, i = line_1 .. line_n, none          `mooringdx.observers.passive`              [PositionThesis, eq. 3.19]
    p_i by dynamic hypothesis testing         `mooringdx.hypotheses.dht`                 [PositionThesis, eq. 3.27]
    K_i by maximum likelihood                 `mooringdx.hypotheses.mle`                 [PositionThesis, eq. 4.10]
    S_i from a long record in which hypothesis i holds                                   [PositionThesis, section 4.4]

A reference, not a recommendation: as printed the observers' bias force is all but zero, so the bank asks which lost
line explains the mean force best, and a constant current of a third of a line's pull confuses it.

What it cannot see: two lines lost, a part of a line lost, a cause that is no line, and an environment that its
covariances were not learned in.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mooringdx.hypotheses.dht import FLOOR, covariance, dht
from mooringdx.hypotheses.mle import FORGETTING, mle
from mooringdx.observers.passive import Passive, Watched, checked, single_losses, watch
from mooringdx.physics.mooring import Mooring
from mooringdx.types import Array, locked

NONE = "none"
MEASUREMENT = (0.005, 0.005, 0.005)
"""The listing's R, on all three, whatever their units."""


@dataclass(frozen=True)
class Weighed:
    """What the bank says of a record. ``probability``: (n, h), DHT; ``cost``: (n, h), negative log-likelihood."""

    watched: Watched
    probability: Array
    cost: Array

    @property
    def most_probable(self) -> Array:
        """(n,), the index of the hypothesis that DHT believes in."""
        return np.asarray(np.argmax(self.probability, axis=1))

    @property
    def most_likely(self) -> Array:
        """(n,), the index of the hypothesis with the least cost."""
        return np.asarray(np.argmin(self.cost, axis=1))


@dataclass(frozen=True)
class ThesisBank:
    """A fitted bank. ``covariances``: (lines + 1, 3, 3), in the order of ``hypotheses``."""

    observer: Passive
    mooring: Mooring
    covariances: Array
    values: str = "text"
    equations: str = "printed"

    def __post_init__(self) -> None:
        checked(self.values, self.equations)
        object.__setattr__(self, "covariances", locked(self.covariances))

    @property
    def hypotheses(self) -> tuple[str, ...]:
        """Every line's name, for its loss, and "none"."""
        return (*self.mooring.names, NONE)

    def __call__(self, measured: Array, force: Array, step: float, first: Array | None = None) -> Weighed:
        """Weigh a record; see `mooringdx.observers.passive.watch` for the arguments."""
        shares = single_losses(len(self.mooring.names))
        watched = watch(self.observer, self.mooring, shares, measured, force, step, first)
        p = dht(watched.innovation, self.covariances, FLOOR[self.values])
        # The recursive form ran behind the printed figures, whatever eq. 4.10 says.
        return Weighed(watched, p, mle(watched.innovation, self.covariances, FORGETTING[self.values]))


def own_covariance(
    observer: Passive,
    mooring: Mooring,
    hypothesis: int,
    measured: Array,
    force: Array,
    step: float,
    equations: str = "printed",
) -> Array:
    """Return the covariance, (3, 3), of one observer's innovation on a record in which its hypothesis holds.

    ``hypothesis``: index as in `ThesisBank.hypotheses`. The record is used from its first sample, as in the listing.
    """
    share = single_losses(len(mooring.names))[hypothesis : hypothesis + 1]
    seen = watch(observer, mooring, share, measured, force, step)
    return covariance(seen.innovation[:, 0], equations, np.array(MEASUREMENT))
