"""Generalised likelihood ratio over a moving window, direction unknown.

    g(k) = (M/2) zbar(k)' Q^-1 zbar(k)

The maximum of the likelihood ratio over every direction and size [Fang2015, sec. 3.1, isolation by projection].
For Gaussian window means 2 g is chi-square with r degrees of freedom without fault. It asks for no signature
and names no fault; knowing the direction buys about 1.5 times in delay.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mooringdx.detectors.design import Design
from mooringdx.detectors.window import moving_window
from mooringdx.types import Statistic, Whitened

LABEL = "any change"


@dataclass(frozen=True)
class GlrtUnknown:
    """Moving-window chi-square, one column for all faults."""

    design: Design

    def __call__(self, whitened: Whitened) -> Statistic:
        """Return g, (n, 1), log-likelihood units; NaN before the first full window and where no verdict is allowed."""
        d = self.design
        values = np.empty((whitened.grid.n, 1))
        frozen = np.zeros(whitened.grid.n, np.bool_)
        moving_window(
            whitened.values,
            whitened.valid,
            d.directions,
            d.sign,
            d.covariance,
            d.window,
            (d.reference.mean, d.reference.sd),
            d.reference.pace,
            d.levels(1),
            True,
            values,
            frozen,
        )
        return d.statistic(whitened, (LABEL,), values, frozen)

    @property
    def dof(self) -> int:
        """Degrees of freedom of the chi-square that 2 g is for Gaussian window means."""
        return int(self.design.covariance.shape[0])
