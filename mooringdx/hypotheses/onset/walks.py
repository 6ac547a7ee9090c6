"""What the onset bank makes of one log: walks from gap to gap and from one lost line to the next.

A walk begins with the log, after a gap of a minute, and at the onset of a line that was named, then without that line.
Its filter starts from the steady force that is known by then, and no onset is sought until it has settled. Over a long
gap, and since the no-fault window, only steady forces are compared:

    b = - mean (thrust + wind + lines(place))          over ten minutes on either side

What it cannot see: which of a lost line and a current changed b while nothing was seen.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from mooringdx.hypotheses.onset.bank import over
from mooringdx.hypotheses.onset.losses import shares
from mooringdx.hypotheses.onset.verdict import Piece, across, steady
from mooringdx.hypotheses.onset.witness import Sight
from mooringdx.observers.identify import Record, steady_bias
from mooringdx.physics.mooring import Mooring
from mooringdx.types import Array, Check, Event

if TYPE_CHECKING:
    from mooringdx.hypotheses.onset_glr import OnsetGlr


def pieces(bank: OnsetGlr, eta: Array, force: Array) -> tuple[list[Piece], tuple[Sight, ...]]:
    """Return one walk after another: each ends where a line was named, the next is without that line.

    A gap of a minute ends a walk too: the filter that comes out of it knows less than its steady gain says.
    """
    out: list[Piece] = []
    sights: list[Sight] = []
    mooring, gone, bias, end = bank.mooring, -1, bank.bias, 0
    for part in stretches(eta, bank.beat.confirm):
        near = bool(out) and part.start - end < bank.beat.warm // 2
        bias = bias if near else _start(bank, eta[part], force[part])
        quiet, since, first, skip = bank.beat.again if near else bank.beat.warm, end, part.start, 0
        while True:
            one, sight = _walk(
                bank, eta[: part.stop], force[: part.stop], (first, skip, gone, since, quiet), mooring, bias
            )
            out.append(one)
            sights.append(sight)
            trace, filtered = one.trace, sight.estimate.bias
            if trace.alarm >= 0:
                gone, onset = one.best()
                mooring = bank.losses[gone].after(mooring)
            if trace.alarm < 0 or first + trace.named >= part.stop - 2:
                bias = np.array(filtered[-1])
                break
            bias = np.array(filtered[max(onset - 1, 0)])
            skip, since, quiet = trace.named - onset + 1, first + onset, bank.beat.again
            first += onset
        end = part.stop
    return out, tuple(sights)


def _walk(
    bank: OnsetGlr, eta: Array, force: Array, where: tuple[int, int, int, int, int], mooring: Mooring, bias: Array
) -> tuple[Piece, Sight]:
    """Return one walk from sample ``where[0]`` on; ``where``: first, skip, gone, since, quiet of `Piece`."""
    first, skip, gone, since, quiet = where
    filtering = bank.filtering(mooring)
    models = filtering.models(eta[first:, 2])
    estimate = filtering(eta[first:], force[first:], bias=bias, models=models)
    lost = shares(bank.losses, mooring.names)
    trace = over(estimate, models, mooring, bank.odds, bank.beat, bank.alarm, lost, quiet)
    until = None if trace.alarm < 0 else max(trace.alarm - bank.beat.confirm, 1)
    piece = Piece(first, skip, gone, trace, float(means(estimate.nis[:until, None])[0]), quiet, since)
    return piece, Sight(first, skip, estimate, models, mooring, quiet, trace.rise)


def _start(bank: OnsetGlr, eta: Array, force: Array) -> Array:
    """Return the steady force of a log's warm-up: it may lie in another current than the no-fault window."""
    seen = np.isfinite(eta[: bank.beat.warm]).all(axis=1).any()
    record = Record(eta, force, np.zeros(eta.shape), bank.step)
    return steady_bias(record, bank.mooring, bank.beat.warm) if seen else bank.bias


def gaps(
    bank: OnsetGlr, eta: Array, force: Array, clock: tuple[float, float], named: Sequence[int]
) -> tuple[tuple[Event, ...], tuple[Check, ...]]:
    """Return what the steady force says of each long gap: in it a loss leaves no onset, but a change of force.

    ``named``: samples of events' onsets, whose forces are not the gap's.
    """
    parts, most = stretches(eta, bank.beat.confirm), bank.beat.warm
    horizontal, _, direction = bank.mooring.pulls(np.asarray(bank.place))
    out: list[Event] = []
    rows: list[Check] = []
    for left, right in pairwise(parts):
        last = slice(max(left.start, left.stop - most), left.stop)
        stop = min([right.stop, right.start + most, *(k for k in named if k > right.start)])
        after = slice(right.start, stop)
        if min(last.stop - last.start, after.stop - after.start) < bank.beat.again:
            continue
        change = (_start(bank, eta[after], force[after]) - _start(bank, eta[last], force[last]))[:2]
        gap = (clock[0] + clock[1] * left.stop, clock[0] + clock[1] * right.start)
        event, row = across(change, -horizontal[:, None] * direction, bank.mooring.names, gap)
        out += [] if event is None else [event]
        rows.append(row)
    return tuple(out), tuple(rows)


def since_fit(bank: OnsetGlr, walked: Sequence[Piece], sights: Sequence[Sight]) -> tuple[Check, ...]:
    """Return how the steady force has changed since the no-fault window, and which lost line looks the same."""
    if not walked:
        return ()
    trace, bias = walked[0].trace, sights[0].estimate.bias
    quiet = bias[bank.beat.warm : trace.alarm - bank.beat.confirm if trace.alarm >= 0 else len(bias), :2]
    horizontal, _, direction = bank.mooring.pulls(np.asarray(bank.place))
    return (steady(means(quiet) - bank.bias[:2], -horizontal[:, None] * direction, bank.mooring.names),)


def stretches(eta: Array, longest: int) -> tuple[slice, ...]:
    """Return the stretches of a record, (n, 3), between gaps of ``longest`` samples or more without a fix."""
    seen = np.flatnonzero(np.isfinite(eta).all(axis=1))
    if not seen.size:
        return ()
    cut = np.flatnonzero(np.diff(seen) > longest)
    starts, stops = [int(seen[0]), *seen[cut + 1].tolist()], [*(seen[cut] + 1).tolist(), int(seen[-1]) + 1]
    return tuple(slice(a, b) for a, b in zip(starts, stops, strict=True) if b - a > 1)


def means(values: Array) -> Array:
    """Return the mean of each column of (n, c) over the rows that are finite, NaN where none is."""
    good = values[np.isfinite(values).all(axis=1)]
    return np.asarray(good.mean(axis=0)) if good.size else np.full(values.shape[1], np.nan)
