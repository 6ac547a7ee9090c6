"""Generalised likelihood ratio over a moving window, directions known from the fault signatures.

    g_j(k) = (M/2) (Gamma_j' Q^-1 zbar(k))^2 / (Gamma_j' Q^-1 Gamma_j),   zbar over the last M samples

Gamma_j direction in which fault j moves the whitened residual, Q covariance of window means times M,
[Fang2015, eq. 15] in corrected form (see `window`). For Gaussian window means 2 g_j is chi-square with one
degree of freedom without fault, and grows by M kappa_j^2 v^2 for a fault of size v, kappa_j^2 = Gamma_j' Q^-1 Gamma_j.
The likeliest fault is the argmax of g_j/level_j, one window after the alarm.

What it cannot see: faults whose directions coincide are never told apart; compressed residuals saturate, so
the statistic of a large fault does not grow with its size; a following reference absorbs slow changes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mooringdx.detectors.design import Design
from mooringdx.detectors.window import moving_window
from mooringdx.types import Statistic, Whitened


@dataclass(frozen=True)
class Glrt:
    """Moving-window likelihood ratio, one column a fault."""

    design: Design

    def __call__(self, whitened: Whitened) -> Statistic:
        """Return g, (n, f), log-likelihood units; NaN before the first full window and where no verdict is allowed."""
        d = self.design
        values = np.empty((whitened.grid.n, len(d.labels)))
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
            d.levels(len(d.labels)),
            False,
            values,
            frozen,
        )
        return d.statistic(whitened, d.labels, values, frozen)

    @property
    def dof(self) -> int:
        """Degrees of freedom of the chi-square that 2 g is for Gaussian window means."""
        return 1
