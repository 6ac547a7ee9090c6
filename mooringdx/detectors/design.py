"""What every detector is made of: the directions to look in, the noise to divide by, the window, the reference."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mooringdx.detectors.reference import Reference
from mooringdx.types import Array, Mask, Signatures, Statistic, Whitened, locked


@dataclass(frozen=True)
class Design:
    """The fitted constants of a detector.

    Parameters
    ----------
    labels : (f,) names of the faults.
    directions : (f, r), change of the whitened residual per unit of each fault's size.
    sign : (f,), +1 or -1 where only that sign of the size is the fault, else 0.
    covariance : (r, r), Q_M of `covariance_of_means`, squared units of the whitened residual.
    window : samples, M.
    reference : the no-fault mean and sd, frozen or following.
    level : (columns,), holds a following reference while the statistic is above; None where none is set yet.
    branch : main, short or slow.
    """

    labels: tuple[str, ...]
    directions: Array
    sign: Array
    covariance: Array
    window: int
    reference: Reference
    level: Array | None = None
    branch: str = "main"

    def __post_init__(self) -> None:
        for key in ("directions", "sign", "covariance"):
            object.__setattr__(self, key, locked(getattr(self, key)))
        if self.level is not None:
            object.__setattr__(self, "level", locked(np.atleast_1d(self.level)))
        f, r = self.directions.shape
        if self.covariance.shape != (r, r) or self.reference.mean.shape != (r,):
            raise ValueError(f"covariance {self.covariance.shape} and {r} residuals do not agree")
        if len(self.labels) != f or self.sign.shape != (f,):
            raise ValueError(f"{len(self.labels)} labels, {self.sign.shape} signs for {f} directions")
        if self.window < 1:
            raise ValueError(f"detector window of {self.window} samples; at least 1 is needed")

    @classmethod
    def of(
        cls,
        signatures: Signatures,
        covariance: Array,
        window: int,
        reference: Reference,
        level: Array | None = None,
        branch: str = "main",
    ) -> Design:
        """Return the design for the signatures as the whitener has mapped them."""
        labels = tuple(fault.label for fault in signatures.faults)
        return cls(labels, signatures.matrix, signatures.sign, covariance, window, reference, level, branch)

    def levels(self, columns: int) -> Array:
        """Return the level of each of ``columns``; inf, so that nothing is ever held, where none is set."""
        if self.level is None:
            return np.full(columns, np.inf)
        return np.ascontiguousarray(np.broadcast_to(self.level, (columns,)))

    def statistic(self, whitened: Whitened, labels: tuple[str, ...], values: Array, frozen: Mask) -> Statistic:
        """Return the values with the names and the clock they belong to."""
        following = self.reference.tau is not None
        return Statistic(self.branch, labels, whitened.grid, values, locked(frozen, np.bool_) if following else None)
