"""What position says of one line that another witness says was lost, at an onset that this witness gives.

    L(k) = ln mean_k0 exp L_j(k; k0)          k0 on a small grid over the onset's interval, L_j = 0 for k <= k0

L_j is the log likelihood ratio of the loss of line j from k0 on against nothing at all, as in
`mooringdx.hypotheses.onset.kernel` (pull known, lost nearly whole and nearly along itself, divided by the temper), from
the innovations of the bank's filter that knows of no loss [PositionThesis; Basseville1993, ch. 7]. Where it first
passes +7 nats the loss is confirmed, at -5 refuted: a sequential test whose errors are e^-7 and e^-5, a thousandth and
under a hundredth, where the noise is as identified. To confirm asks for more, because a wave group along the line looks
like a break and is no hypothesis here; to refute at -7 takes longer and was no surer (`benchmarks/fusion.py --levels`).
No prior: a hazard has no say once another witness has given line and onset.

What it cannot see: a squall or a wave group at that very time, along that line and of its pull; the loss of a neighbour
that points within some 60 deg of it, which pushes the vessel the same way; the loss of a part of the pull; an onset in
the filter's first ten minutes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from mooringdx.hypotheses.onset.bank import Beat, empty, rig_of, tuned
from mooringdx.hypotheses.onset.kernel import Index, Odds, followed
from mooringdx.observers.kalman import Estimate
from mooringdx.observers.matrices import Model
from mooringdx.physics.mooring import Mooring
from mooringdx.types import Array

CERTAIN, REFUTED = 7.0, -5.0
"""Nats at which a loss is confirmed, and refuted."""
_ONSETS = 9
_SHOWN = 60


@dataclass(frozen=True)
class Sight:
    """One walk's filter: from sample ``first`` of the bank's; what it says holds from ``skip`` samples later on.

    ``quiet``: its samples until the filter has settled; ``rise``: (n,), how much rougher the sea was than the one
    learned from, 1 or more, as in the walk.
    """

    first: int
    skip: int
    estimate: Estimate
    models: tuple[Model, ...]
    mooring: Mooring
    quiet: int
    rise: Array

    def has(self, line: str) -> bool:
        """Return whether the filter still has the line: one that it takes for lost pulls nothing."""
        names = self.mooring.names
        return line in names and bool(self.mooring.horizontal[names.index(line)].any())


@dataclass(frozen=True)
class Heard:
    """Position's testimony on the loss of ``line``.

    ``score``: nats when it was told, or at the end of the look; ``time``: s of that; ``onset``: s; ``why``: why nothing
    was told, else empty. ``trace``: (m, 2) rows of s since the onset and nats, thinned.
    """

    line: str
    verdict: Literal["confirmed", "refuted", "untold"]
    score: float
    onset: float
    time: float
    trace: tuple[tuple[float, float], ...] = ()
    why: str = ""


@dataclass(frozen=True)
class Witness:
    """Ask the bank's filters of one log about a line. ``clock``: s of sample 0, s between samples."""

    sights: tuple[Sight, ...]
    odds: Odds
    times: Beat
    clock: tuple[float, float]

    def __call__(self, line: str, interval: tuple[float, float], stop: float = np.inf) -> Heard:
        """Return what position says of the loss of ``line`` at an onset in ``interval``, s, up to ``stop``, s."""
        start, step = self.clock
        low = int(np.floor((interval[0] - start) / step))
        high = max(low, int(np.ceil((interval[1] - start) / step)))
        sight = next((s for s in reversed(self.sights) if s.first <= low and s.has(line)), None)
        middle = 0.5 * (interval[0] + interval[1])
        if sight is None or low - sight.first < sight.quiet or high >= sight.first + len(sight.estimate.position):
            why = "its filter had not settled, after the start, a gap or another loss, or there was no fix"
            return Heard(line, "untold", 0.0, middle, middle, (), why)
        onsets = np.unique(np.linspace(low, high, min(high - low + 1, _ONSETS)).round().astype(np.int64)) - sight.first
        last = len(sight.estimate.position)
        if np.isfinite(stop):
            last = min(last, int((stop - start) / step) - sight.first)
        last = min(last, int(onsets[-1]) + self.times.end)
        nats = ratio(sight, line, onsets, last, self.odds)
        return self._told(line, nats, middle, start + step * (sight.first + float(onsets[0])))

    def _told(self, line: str, nats: Array, onset: float, begin: float) -> Heard:
        step = self.clock[1]
        sure = np.flatnonzero((nats >= CERTAIN) | (nats <= REFUTED))
        at = int(sure[0]) if sure.size else len(nats) - 1
        if at < 1:
            return Heard(line, "untold", 0.0, onset, onset, (), "nothing of the log is left to look at")
        score, time = float(nats[at]), begin + step * at
        hop = max(1, at // _SHOWN)
        rows = sorted({*range(0, at + 1, hop), at})
        trace = tuple((round(begin + step * i - onset, 3), round(float(nats[i]), 3)) for i in rows)
        if sure.size:
            return Heard(line, "confirmed" if score > 0.0 else "refuted", score, onset, time, trace)
        why = f"it came to {score:+.1f} nats, short of {CERTAIN:+g} and of {REFUTED:+g}"
        return Heard(line, "untold", score, onset, time, trace, why)


def ratio(sight: Sight, line: str, onsets: Index, last: int, odds: Odds) -> Array:
    """Return L at the samples from the first of ``onsets`` up to ``last`` (exclusive), in nats; (0,) where none is.

    ``onsets``: (m,), ascending samples of the sight. A sample without a fix keeps the value before it.
    """
    rig = rig_of(sight.mooring)
    out = np.zeros(max(last - int(onsets[0]), 0))
    followed(
        onsets, last, sight.estimate.innovation, sight.estimate.position, sight.rise, tuned(sight.models), rig,
        sight.mooring.fairleads.mean(axis=0), sight.mooring.names.index(line), odds,
        empty(odds, len(sight.mooring.names)), out,
    )  # fmt: skip
    return out


def summary(heard: Heard) -> dict[str, object]:
    """Return a testimony as evidence of an event: JSON-safe."""
    return {
        "verdict": heard.verdict,
        "log_likelihood_ratio": heard.score,
        "seconds": heard.time - heard.onset,
        "told": heard.time if heard.verdict != "untold" else None,
        "why": heard.why,
        "trace": [list(row) for row in heard.trace],
    }
