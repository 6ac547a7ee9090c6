"""Put the stamps of one signal in order: late messages, doubled and coarse stamps, a clock that was set back.

A stamp that lies below the largest one before it is *late*. A run of late samples is a **clock step** when it goes
back by more than the largest gap, keeps its rate for at least ``STEADY`` samples, and covers time that the samples
before it already covered; any other late run is **out of order** and is sorted. From stamps alone a clock that was
set *forward* cannot be told from missing data: it is a gap. Stamps that are impossibly far from all others (a clock
not yet set, a damaged digit) are dropped.

Source: none; the rules are this project's own.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mooringdx.types import Array

Index = NDArray[np.intp]

STEADY = 8
MOST_STEPS = 50
ENOUGH = 50_000
COARSE_SHARE = 0.3
FAR = 10.0


@dataclass(frozen=True)
class ClockStep:
    """A clock set back at sample ``index`` (as logged) by ``size`` s; the stamp before it was ``before`` s."""

    index: int
    before: float
    size: float


@dataclass(frozen=True)
class Ordered:
    """Samples in time order. ``index``: (n,), where each stood in the log; ``time``: (n,), s, strictly increasing.

    ``late``: samples that had to be moved; ``doubled``: dropped with a used stamp; ``far``: dropped as impossibly
    far; ``overlapped``: dropped because the clock had been set back over them; ``spread``: samples that shared a coarse
    stamp and were spread evenly; ``steps``: the clock steps.
    """

    index: Index
    time: Array
    late: int = 0
    doubled: int = 0
    far: int = 0
    overlapped: int = 0
    spread: int = 0
    steps: tuple[ClockStep, ...] = ()


def period_of(time: Array) -> float:
    """Return the nominal period (median spacing) of stamps in order, s; NaN for fewer than two.

    Of a long signal 50,000 spacings spread over it are taken.
    """
    if time.size < 2:
        return float("nan")
    spacing = np.diff(time)
    return float(np.median(spacing[:: max(1, spacing.size // ENOUGH)]))


def find_steps(time: Array, max_gap: float) -> tuple[ClockStep, ...]:
    """Return where the clock was set back. ``time``: (n,), s, as logged; ``max_gap``: s."""
    if time.size < 2 or not np.any(np.diff(time) < 0.0):
        return ()
    shifted = np.array(time)
    steps: list[ClockStep] = []
    while len(steps) < MOST_STEPS:
        step = _next_step(shifted, steps[-1].index + 1 if steps else 1, max_gap)
        if step is None:
            return tuple(steps)
        steps.append(step)
        shifted[step.index :] += step.size
    return ()  # that many are not steps but a shuffled log


def _next_step(time: Array, first: int, max_gap: float) -> ClockStep | None:
    highest = np.maximum.accumulate(time)
    late = np.concatenate(([False], time[1:] < highest[:-1]))
    edges = np.flatnonzero(np.diff(np.concatenate(([0], late.astype(np.int8), [0]))))
    starts, stops = edges[::2], edges[1::2]
    period = float(np.median(np.abs(np.diff(time))))
    back = highest[starts - 1] - time[starts]
    for k in np.flatnonzero((stops - starts >= STEADY) & (back > max(max_gap, 3.0 * period)) & (starts >= first)):
        a, b = int(starts[k]), int(stops[k])
        spacing = np.diff(time[a:b])
        steady = np.median(np.abs(spacing - period)) <= 0.5 * period and np.mean(spacing > 0.0) > 0.9
        covered = np.count_nonzero((time[:a] >= time[a:b].min()) & (time[:a] <= time[a:b].max()))
        if steady and 2 * covered >= b - a:
            return ClockStep(a, float(highest[a - 1]), float(back[k] + period))
    return None


def order(time: Array, values: Array, steps: tuple[ClockStep, ...], continue_steps: bool) -> Ordered:
    """Return the finite samples of one signal in time order.

    Parameters
    ----------
    time, values : (n,), s and any unit, as logged.
    steps : where the clock was set back, from `find_steps`.
    continue_steps : True when every signal shares the steps, so that it is the logger's own clock: the stamps after
        a step are moved forward so that the log goes on. Else the stamps are believed and the samples whose time was
        already covered are dropped.
    """
    index = np.flatnonzero(np.isfinite(time) & np.isfinite(values))
    stamp = time[index]
    overlapped = 0
    if continue_steps:
        for step in steps:
            stamp[index >= step.index] += step.size
    else:
        for step in steps:
            again = (index >= step.index) & (stamp <= step.before)
            overlapped += int(np.count_nonzero(again))
            index, stamp = index[~again], stamp[~again]
    index, stamp, late = _sorted(index, stamp)
    index, stamp, far = _without_far(index, stamp)
    stamp, spread = _spread(stamp, values[index])
    new = np.concatenate(([True], np.diff(stamp) > 0.0))[: stamp.size]
    doubled = int(stamp.size - np.count_nonzero(new))
    return Ordered(index[new], stamp[new], late, doubled, far, overlapped, spread, steps)


def _sorted(index: Index, stamp: Array) -> tuple[Index, Array, int]:
    if stamp.size < 2 or not np.any(np.diff(stamp) < 0.0):
        return index, stamp, 0
    behind = np.count_nonzero(stamp[1:] < np.maximum.accumulate(stamp)[:-1])
    ahead = np.count_nonzero(stamp[:-1] > np.minimum.accumulate(stamp[::-1])[::-1][1:])
    by_time = np.argsort(stamp, kind="stable")
    return index[by_time], stamp[by_time], int(min(behind, ahead))


def _without_far(index: Index, stamp: Array) -> tuple[Index, Array, int]:
    """Drop the few first or last stamps that a gap of many times the span of the rest sets apart."""
    n = stamp.size
    few = max(3, n // 1000)
    if n < 20:
        return index, stamp, 0
    limit = FAR * float(stamp[n - 1 - few] - stamp[few])
    if limit <= 0.0:
        return index, stamp, 0
    spacing = np.diff(stamp)
    head, tail = np.flatnonzero(spacing[:few] > limit), np.flatnonzero(spacing[-few:] > limit)
    first = int(head[-1]) + 1 if head.size else 0
    last = n - few + int(tail[0]) if tail.size else n
    return index[first:last], stamp[first:last], n - (last - first)


def _spread(stamp: Array, values: Array) -> tuple[Array, int]:
    """Spread samples that share a coarse stamp (whole seconds of a 10 Hz log) evenly up to the next stamp."""
    same = np.diff(stamp) == 0.0
    if stamp.size < 20 or np.mean(same) < COARSE_SHARE or np.mean(np.diff(values)[same] != 0.0) < 0.5:
        return stamp, 0
    starts = np.flatnonzero(np.concatenate(([True], ~same)))
    length = np.diff(np.concatenate((starts, [stamp.size])))
    if starts.size < 3:
        return stamp, 0
    to_next = np.diff(stamp[starts])
    usual = float(np.median(to_next))
    room = np.minimum(np.concatenate((to_next, [usual])), usual)
    full = float(np.max(length)) if starts.size < 10 else float(np.quantile(length, 0.9))
    rank = np.arange(stamp.size) - np.repeat(starts, length)
    out = stamp + rank * np.repeat(room / np.maximum(length, full), length)
    return out, int(np.count_nonzero(rank))
