"""What an event is decided from: one log's walk up to the statistics, and how far residuals are off by themselves.

Three things beside the no-fault covariance keep a healthy vessel from looking broken: the reference may have followed
the residuals up to the alarm; a rougher sea than the fitted one scatters them in proportion to its agitation; and a
vessel that has moved by D makes every line's tension wrong by SIGNATURE_ERROR |dT/dx D|, what its statics are worth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mooringdx.baseline import Fitted
from mooringdx.chain import Walk
from mooringdx.checks import SEA, agitation, roughness, shows_sea
from mooringdx.config import RunConfig
from mooringdx.decide import Alarm
from mooringdx.residuals.tension import AXES, Tension
from mooringdx.residuals.training import SIGNATURE_ERROR
from mooringdx.types import Array, Channels, Residuals

Index = NDArray[np.intp]
_BLOCK = 40.0
"""Peak periods over which the sea before an alarm is judged."""


@dataclass(frozen=True)
class Scene:
    """One log's walk; ``forces``: the balance of forces, where a vessel is known."""

    channels: Channels
    residuals: Residuals
    walk: Walk
    fitted: Fitted
    run: RunConfig
    verdict: str
    forces: Residuals | None = None

    @property
    def tension(self) -> Tension | None:
        """The tension residuals of a known vessel, None without one."""
        return next((p for p in self.fitted.stack.parts if isinstance(p, Tension)), None)

    @property
    def late(self) -> int:
        """How many samples the residuals come after what they show."""
        part = self.tension
        return 0 if part is None else part.half

    def covariance(self, rows: Index, start: int | None = None) -> Array:
        """Return the covariance of window means times the window for ``rows``, (k, k), in the sea before ``start``."""
        raw = np.asarray(self.fitted.raw.covariance)[np.ix_(rows, rows)]
        return raw if start is None else raw * self.roughness(start) ** 2

    def roughness(self, start: int) -> float:
        """Return the sea before sample ``start`` over the roughest of the no-fault record, at least 1."""
        before = self.channels.values[max(0, start - self.block) : start]
        return roughness(before, self.channels.names, np.asarray(self.fitted.agitation))

    def beyond(self, start: int) -> float:
        """Return how far the sea before ``start`` is beyond the fitted one, over its worst channel; 1 within SEA."""
        last = max(0, start - self.fitted.timing.window)
        now, then = agitation(self.channels.values[max(0, last - self.block) : last]), np.asarray(self.fitted.agitation)
        use = shows_sea(self.channels.names) & (then > 0)
        worst = float(np.max(now[use] / then[use])) if use.any() else 1.0
        return worst if worst > SEA else 1.0

    @property
    def block(self) -> int:
        """Samples over which the sea is judged."""
        timing = self.fitted.timing
        return max(8, round(_BLOCK * timing.peak_period / timing.sample_time))

    def seas(self) -> Array:
        """Return the roughness before every sample, (n,), renewed every eighth of a block."""
        hop = max(1, self.block // 8)
        found = [self.roughness(start) for start in range(0, self.channels.grid.n, hop)]
        return np.repeat(found, hop)[: self.channels.grid.n]

    def reference(self, alarm: Alarm, rows: Index) -> Array:
        """Return the no-fault mean of ``rows``, (k,): over the following reference's memory, or as fitted."""
        timing, measured = self.fitted.timing, self.residuals
        stop = alarm.start - 2 * timing.window
        start = stop - timing.memory
        if timing.memory == 0 or start < 0 or alarm.branches == ("slow",):
            return np.asarray(self.fitted.raw.mean)[rows]
        good = measured.valid[start:stop][:, rows].all(axis=1)
        if good.mean() < 0.5:
            return np.asarray(self.fitted.raw.mean)[rows]
        return np.asarray(measured.values[start:stop][good][:, rows].mean(axis=0))

    def doubt(self, look: slice) -> Array:
        """Return by how much the residuals may be off in ``look`` because the vessel has moved, (r,) sd."""
        out = np.zeros(len(self.residuals.names))
        part = self.tension
        if part is None:
            return out
        columns = [self.channels.names.index(axis) for axis in AXES]
        place = np.where(self.channels.valid[look][:, columns], self.channels.values[look][:, columns], np.nan)
        place = place[np.isfinite(place).all(axis=1)]
        if not len(place):
            return out
        moved = place.mean(axis=0) - [*part.origin, 0.0] - part.centre
        moved[2] = (moved[2] + np.pi) % (2.0 * np.pi) - np.pi
        wrong = SIGNATURE_ERROR * np.sqrt(((part.slopes() * moved) ** 2).sum(axis=1))
        where = {name: i for i, name in enumerate(self.residuals.names)}
        for (_, channel), sd in zip(part.lines, wrong, strict=True):
            out[where[f"{channel} - intact"]] = sd
        return out
