"""Covariance of window means: what the detectors take for the noise.

    Q_M = M cov( mean of z over non-overlapping windows of M samples )

Whitening does not make a window mean white (the spectrum near zero frequency is what an ARMA fit knows
least), so the covariance is measured at the scale at which it is used instead of at lag 0 as in
[Fang2015, eq. 11]. Off-diagonal correlations are shrunk towards zero by the intensity that minimises their
expected squared error, lambda = sum var(c_ij) / sum c_ij^2 [Schaefer2005]. With hundreds of windows
lambda is a few per cent and nothing changes; with tens, it keeps noise in r(r-1)/2 correlations from posing
as cancelling common motion. The variances are not shrunk: lines differ in them for physical reasons.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from mooringdx.errors import FitError
from mooringdx.types import Array, Mask

LOADING = 0.01
"""Share of each variance added to the diagonal: keeps nearly redundant residuals from a singular inverse."""


def window_means(segments: Sequence[tuple[Array, Mask]], window: int) -> list[Array]:
    """Return the means of non-overlapping windows, one (w_i, r) array a segment.

    A window counts when each channel has at least half of its samples valid; shorter tails are left out.

    Parameters
    ----------
    segments : pairs of z (n_i, r) and valid (n_i, r); one pair a contiguous no-fault stretch.
    window : samples.
    """
    means = []
    for z, valid in segments:
        count = z.shape[0] // window
        shape = (count, window, z.shape[1])
        ok = valid[: count * window].reshape(shape)
        kept = np.where(ok, z[: count * window].reshape(shape), 0.0)
        number = ok.sum(axis=1)
        good = (2 * number >= window).all(axis=1)
        means.append(kept.sum(axis=1)[good] / number[good])
    return means


def covariance_of_means(
    segments: Sequence[tuple[Array, Mask]], window: int, about: Literal["mean", "zero"] = "mean"
) -> Array:
    """Return Q_M, (r, r), squared units of z: ``window`` times the covariance of window means.

    Parameters
    ----------
    segments : pairs of z (n_i, r) and valid (n_i, r).
    window : samples, M.
    about : "mean" of all windows; "zero" where several runs with offsets are pooled, so that the offsets count as
        noise.

    Raises
    ------
    FitError : fewer than three whole windows.
    """
    means = np.concatenate(window_means(segments, window))
    if means.shape[0] < 3:
        raise FitError(
            f"the no-fault window holds {means.shape[0]} whole detector windows of {window} samples; "
            "at least 3 are needed for a covariance; give a longer [baseline] window or a shorter [detector] window"
        )
    centred = means - means.mean(axis=0) if about == "mean" else means
    lost = 1 if about == "mean" else 0
    raw = centred.T @ centred / (means.shape[0] - lost)
    sd = np.sqrt(np.diagonal(raw))
    if not (sd > 0.0).all():
        raise FitError("a residual does not move at all over the no-fault window; leave it out, or mend its channel")
    correlation = (1.0 - _intensity(centred / sd)) * raw / np.outer(sd, sd)
    np.fill_diagonal(correlation, 1.0 + LOADING)
    return np.asarray(window * correlation * np.outer(sd, sd))


def _intensity(scores: Array) -> float:
    """Return the shrinkage of correlations in [0, 1] from (w, r) standardised window means."""
    number, r = scores.shape
    if r == 1:
        return 0.0
    products = scores[:, :, None] * scores[:, None, :]
    off = ~np.eye(r, dtype=bool)
    spread = products.var(axis=0, ddof=1)[off].sum() / number
    size = (products.mean(axis=0)[off] ** 2).sum()
    return float(min(1.0, spread / size)) if size > 0.0 else 1.0
