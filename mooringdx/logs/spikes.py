"""Find isolated spikes: an excursion of one to three samples that comes back to where it left.

A spike is x_a ... x_{b-1} with both edges |x_a - x_{a-1}| and |x_b - x_{b-1}| above k s and of opposite sign, |x_b -
x_{a-1}| at most 0.3 of the smaller edge, and the hole that it leaves no longer than the largest gap. s is the robust
standard deviation (1.4826 median) of the sample-to-sample change, the largest of the block of 64 samples and its two
neighbours and never under the median over the log's non-zero changes (50,000 of them): so waves, quantised and
stepping signals set their own scale [Hampel1974].

A step does not come back, and the first samples of a fault are no spike for the same reason. More than three spikes
within two blocks are not isolated: such a signal is noisy, which is evidence, so they are kept and only counted. What
it cannot see: a spike on a signal that never moves otherwise, and that a snap load shorter than three samples is
real. A log so slow that the hole of one sample exceeds the largest gap (daily positions) has no spikes: each sample
is evidence.
"""

from __future__ import annotations

import numba
import numpy as np

from mooringdx.types import Array, Mask

BLOCK = 64
WIDEST = 3
RETURN = 0.3
CROWD = 3
ENOUGH = 50_000


def change_scale(values: Array) -> Array:
    """Return the local robust sd of the sample-to-sample change, one a block of `BLOCK` samples. ``values``: (n,)."""
    change = np.abs(np.diff(values))
    blocks = -(-values.size // BLOCK)
    some = change[:: max(1, change.size // ENOUGH)]
    moving = some[some > 0.0]
    floor = float(np.median(moving)) if moving.size else 0.0
    own = np.zeros(blocks)
    whole = change.size // BLOCK
    if whole:
        own[:whole] = np.median(change[: whole * BLOCK].reshape(whole, BLOCK), axis=1)
    if whole < blocks and change.size:
        own[whole:] = np.median(change[-min(BLOCK, change.size) :])
    around = np.maximum(own, floor)
    around[1:] = np.maximum(around[1:], own[:-1])
    around[:-1] = np.maximum(around[:-1], own[1:])
    return 1.4826 * around


def find_spikes(time: Array, values: Array, spike_sd: float, max_gap: float) -> tuple[Mask, int]:
    """Return which samples are isolated spikes, and how many spikes stood too close together to be masked.

    Parameters
    ----------
    time, values : (n,), s strictly increasing, finite.
    spike_sd : edge height in local robust sd of the sample-to-sample change.
    max_gap : s, the longest hole that a spike may leave.
    """
    if values.size < 5:
        return np.zeros(values.size, dtype=np.bool_), 0
    first, width = _scan(time, values, spike_sd * change_scale(values), max_gap * (1.0 + 1e-9))
    return _isolated(first, width, values.size)


def _isolated(first: Array, width: Array, n: int) -> tuple[Mask, int]:
    mask = np.zeros(n, dtype=np.bool_)
    reach = 2 * BLOCK
    near = np.searchsorted(first, first + reach, "right") - np.searchsorted(first, first - reach, "left")
    alone = near <= CROWD
    for k in range(WIDEST):
        mask[(first + k)[alone & (width > k)].astype(np.intp)] = True
    return mask, int(np.count_nonzero(~alone))


@numba.njit(cache=True)
def _scan(time: Array, values: Array, limit: Array, max_gap: float) -> tuple[Array, Array]:
    n = values.size
    first = np.empty(n, dtype=np.float64)
    width = np.empty(n, dtype=np.float64)
    found = 0
    i = 1
    while i < n - 1:
        up = values[i] - values[i - 1]
        least = limit[i // BLOCK]
        step = 1
        if abs(up) > least and least > 0.0:
            for w in range(1, WIDEST + 1):
                b = i + w
                if b >= n or time[b] - time[i - 1] > max_gap:
                    break
                down = values[b] - values[b - 1]
                small = min(abs(up), abs(down))
                if up * down < 0.0 and abs(down) > least and abs(values[b] - values[i - 1]) <= RETURN * small:
                    first[found] = i
                    width[found] = w
                    found += 1
                    step = w
                    break
        i += step
    return first[:found].copy(), width[:found].copy()
