"""Cross-fitting and the drift flag: what makes a threshold from one record honest.

Cross-fit: the record is cut into five contiguous folds; whatever is learned (mean, scale, ARMA, covariance of
window means) is learned on four and tried on the fifth. In-sample values flatter: with 40 windows and eight channels
an in-sample threshold gave up to 43 times the asked rate.

Drift: R = 16 var(means of 16 M) / var(means of M), non-overlapping, 8 in place of 16 under 80 windows. White noise
gives 1 on average but with only a few blocks it scatters widely, so the ratio is divided by what a steady
white record of the same length would exceed once in a hundred (all lines together) over 1.2, where that is above 1:
R > 1.2 is then a one per cent test at any length. It sees drift that is a good part of the noise of a mean
over 16 windows within one record; slower or smaller drift it cannot see.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from mooringdx.types import Array, Mask

DRIFT_LIMIT = 1.2
_FALSE_FLAGS = 0.01


def fold_slices(n: int, folds: int = 5) -> list[slice]:
    """Return ``folds`` contiguous slices of nearly equal length that cover ``n`` samples."""
    edges = np.linspace(0, n, folds + 1).round().astype(int)
    return [slice(int(a), int(b)) for a, b in pairwise(edges)]


def crossfit(
    lengths: Sequence[int],
    fit_fold: Callable[[list[tuple[int, slice]]], Callable[[int, slice], Array]],
    folds: int = 5,
) -> list[Array]:
    """Return the held-back statistics, one array (n_i, f) a held-back stretch.

    The segments are laid end to end and cut into contiguous folds, so that one long record and several short ones
    are treated alike.

    Parameters
    ----------
    lengths : samples of each no-fault segment.
    fit_fold : given the training stretches as (segment, slice), fits and returns a function that gives the
        statistic of a held-back stretch (segment, slice).
    folds : number of folds.
    """
    starts = np.concatenate([[0], np.cumsum(lengths)])

    def stretches(parts: Sequence[slice]) -> list[tuple[int, slice]]:
        out = []
        for part in parts:
            for i, (a, b) in enumerate(pairwise(starts)):
                first, last = max(part.start, int(a)), min(part.stop, int(b))
                if last > first:
                    out.append((i, slice(first - int(a), last - int(a))))
        return out

    cuts = fold_slices(int(starts[-1]), folds)
    held: list[Array] = []
    for i, cut in enumerate(cuts):
        before = slice(0, cut.start)
        after = slice(cut.stop, int(starts[-1]))
        apply = fit_fold(stretches([part for part in (before, after) if part.stop > part.start]))
        held += [apply(segment, part) for segment, part in stretches([cuts[i]])]
    return held


def drift_ratio(segments: Sequence[tuple[Array, Mask]], window: int) -> float:
    """Return R, the largest over the residuals; NaN where the record holds too few long blocks to judge.

    Parameters
    ----------
    segments : pairs of whitened, uncompressed residuals (n_i, r) and valid (n_i, r); blocks are compared with the
        mean of their own segment, so that an offset between runs is not drift.
    window : detector window, samples.
    """
    from scipy.stats import f

    number = sum(z.shape[0] // window for z, _ in segments)
    factor = 16 if number >= 80 else 8
    long_sum, long_dof = _spread(segments, factor * window)
    short_sum, short_dof = _spread(segments, window)
    if long_dof < 3 or short_dof < 3:
        return float("nan")
    ratio = factor * (long_sum / long_dof) / np.maximum(short_sum / short_dof, 1e-300)
    lines = ratio.shape[0]
    usual = float(f.isf(_FALSE_FLAGS / lines, long_dof, short_dof))
    return float(ratio.max() / max(1.0, usual / DRIFT_LIMIT))


def _spread(segments: Sequence[tuple[Array, Mask]], block: int) -> tuple[Array, int]:
    """Return the sum of squares (r,) of block means about their segment's, and its degrees of freedom."""
    total, dof = np.zeros(segments[0][0].shape[1]), 0
    for z, valid in segments:
        count = z.shape[0] // block
        shape = (count, block, z.shape[1])
        ok = valid[: count * block].reshape(shape)
        sums = np.where(ok, z[: count * block].reshape(shape), 0.0).sum(axis=1)
        enough = (2 * ok.sum(axis=1) >= block).all(axis=1)
        if enough.sum() < 2:
            continue
        means = sums[enough] / ok.sum(axis=1)[enough]
        total += ((means - means.mean(axis=0)) ** 2).sum(axis=0)
        dof += int(enough.sum()) - 1
    return total, dof
