"""The smallest fault that a chain finds and names, in closed form: by it the whitening is chosen.

    found   mu_j >= sqrt(2 level_j) + 1.645 sqrt(scale_j),               mu_j = v_j sqrt(M) kappa_j
    named   mu_j sqrt(1 - rho_ij^2) >= sqrt(scale) (1.645 + sqrt(1.645^2 + 2 ln 20))   for every rival i

kappa_j^2 = Gamma_j' Q^-1 Gamma_j, rho_ij = Gamma_i' Q^-1 Gamma_j / (kappa_i kappa_j), scale_j twice the mean of the
statistic without fault. Found: the mean statistic of a full window exceeds the level with 95 %. Named: one window
later the scaled statistic leads each rival's by more than ln 20 = 3 with 95 %; two Gaussian projections of correlation
rho differ in half their squares by mu^2 (1 - rho^2)/2 with sd mu sqrt(1 - rho^2) [Kay1998, ch. 6]. Where the
rival admits only the other sign, its statistic is zero and does not stand in the way.

Sizes are in the units of each signature; they use the mapped slope at zero, so that for compressed residuals they hold
for small faults, which is what they are for: a large one saturates. Coinciding directions are never told apart: inf.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mooringdx.types import Array

CONFIDENCE = 1.6449
"""Normal quantile of 95 %."""
LEAD = float(np.log(20.0))
"""By how much the winner's scaled statistic must lead to stand alone."""


class SmallestFault(NamedTuple):
    """Sizes (f,), units of the signatures: ``found``, ``named`` (inf where never alone), nearest ``rival`` index."""

    found: Array
    named: Array
    rival: Array

    @property
    def needed(self) -> Array:
        """Return the size that is both found and named alone, (f,); where none ever is, the size that is found."""
        return np.where(np.isfinite(self.named), np.maximum(self.found, self.named), self.found)


def smallest_fault(
    directions: Array, sign: Array, covariance: Array, window: int, level: Array, scale: Array
) -> SmallestFault:
    """Return the smallest fault per direction.

    Parameters
    ----------
    directions : (f, r), mapped signatures, whitened units per unit of size.
    sign : (f,), +1, -1, or 0.
    covariance : (r, r), Q_M.
    window : samples, M.
    level, scale : (f,), of the threshold.
    """
    inner = directions @ np.linalg.solve(covariance, directions.T)
    kappa = np.sqrt(np.maximum(np.diagonal(inner), 0.0))
    seen = kappa > 0.0
    safe = np.where(seen, kappa, 1.0)
    unit = np.where(seen, 1.0 / (safe * np.sqrt(window)), np.inf)
    found = (np.sqrt(2.0 * level) + CONFIDENCE * np.sqrt(scale)) * unit
    rho = inner / np.outer(safe, safe)
    rival_mean = rho * np.where(sign == 0.0, 1.0, sign)[:, None]
    shut_out = (rival_mean * sign[None, :] < 0.0) & (sign[:, None] != 0.0)
    closeness = np.where(shut_out, 0.0, np.abs(rho))
    np.fill_diagonal(closeness, 0.0)
    rival = closeness.argmax(axis=1)
    apart = np.sqrt(np.maximum(1.0 - closeness.max(axis=1) ** 2, 0.0))
    gap = np.sqrt(scale) * (CONFIDENCE + np.sqrt(CONFIDENCE**2 + 2.0 * LEAD))
    named = np.where(apart > 1e-3, gap / np.maximum(apart, 1e-3), np.inf) * unit
    return SmallestFault(found, np.where(seen, named, np.inf), rival)
