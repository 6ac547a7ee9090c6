"""Probabilities of the rival hypotheses against time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mooringdx.plots import canvas
from mooringdx.types import Detection

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def parts(detection: Detection) -> tuple[str, ...]:
    """Return the banks that have probabilities."""
    return tuple(p.bank for p in detection.posteriors if p.time.size)


def draw(detection: Detection, bank: str) -> Figure:
    """Draw the whole record above, the stretch around the first event below."""
    found = next(p for p in detection.posteriors if p.bank == bank)
    at = canvas.clock(detection.channels.grid)
    first = min(detection.events, key=lambda e: e.onset, default=None)
    figure, axes = canvas.sheet(10.0, 5.2 if first else 3.0, nrows=2 if first else 1)
    for row, panel in enumerate(axes[:, 0]):
        keep = np.ones(found.time.size, dtype=np.bool_)
        if row == 1 and first is not None:
            last = max(first.detected, first.named or first.detected)
            reach = max(4.0 * (last - first.onset), 12 * float(np.median(np.diff(found.time))))
            keep = (found.time >= first.onset - reach) & (found.time <= last + reach)
        x = at(found.time[keep])
        style = {"marker": ".", "ms": 5} if x.size < 120 else {}
        for j, name in enumerate(found.hypotheses):
            y = found.probability[keep, j]
            dash = ("-", "--", "-.", ":")[(j // len(canvas.CYCLE)) % 4]
            panel.plot(*canvas.envelope(x, y), color=canvas.CYCLE[j % len(canvas.CYCLE)], ls=dash, lw=1.4,
                       label=name.replace("_", " "), **style)  # fmt: skip
        panel.set_ylim(-0.03, 1.05)
        panel.set_ylabel("probability (-)")
        canvas.shade(panel, detection, at)
        panel.set_xlim(x[0], x[-1])
        at.dress(panel)
    axes[0, 0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.04), ncols=6, borderaxespad=0.0)
    return figure


def caption(detection: Detection, bank: str) -> str:
    """Say what the probabilities mean."""
    words = f"Probability of each hypothesis of the bank '{bank}', given the data up to that time; they sum to 1."
    if detection.events:
        words += " Lower panel: the stretch around the first event, marked by the dashed red line."
    return words
