"""Every channel and every residual against time, with the no-fault window and the events."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from mooringdx.plots import canvas
from mooringdx.plots.suspects import residual_order
from mooringdx.types import Array, Detection, Mask

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PANELS = 6


def _stack(
    detection: Detection, names: Sequence[str], units: Sequence[str], values: Array, valid: Mask, zero: bool
) -> Figure:
    """Draw one panel a name. ``values``: (n, k), SI, NaN where not ``valid``."""
    figure, axes = canvas.sheet(10.0, 0.75 + 1.15 * len(names), nrows=len(names), sharex=True)
    at = canvas.clock(detection.channels.grid)
    x = at(detection.channels.grid.time)
    for panel, name, unit, y, ok in zip(axes[:, 0], names, units, values.T, valid.T, strict=True):
        factor, shown = canvas.display(unit, y)
        style = {"marker": ".", "ms": 2.5} if y.size < 600 else {}
        panel.plot(*canvas.envelope(x, factor * y), color=canvas.BLUE, **style)
        for start, stop in canvas.holes(ok):
            panel.axvspan(x[start], x[min(stop, x.size - 1)], color=canvas.GAP, lw=0, zorder=1)
        if zero:
            panel.axhline(0.0, color=canvas.FAINT, lw=0.8, zorder=1)
        panel.set_ylabel(f"{name.replace('_', ' ')}\n({shown})", rotation=0, ha="right", va="center")
        panel.margins(x=0.0)
        panel.locator_params(axis="y", nbins=4)
        canvas.shade(panel, detection, at)
    figure.align_ylabels()
    canvas.name_events(axes[0, 0], detection.events, at)
    at.dress(axes[-1, 0])
    return figure


def channel_parts(detection: Detection) -> tuple[str, ...]:
    """Return the parts of the channel figures, six channels each."""
    return canvas.chunks(detection.channels.names, PANELS) if detection.channels.names else ()


def channels(detection: Detection, part: str) -> Figure:
    """Draw aligned channels."""
    c = detection.channels
    index = [c.names.index(name) for name in canvas.chunk(c.names, PANELS, part)]
    names = [c.names[i] for i in index]
    return _stack(detection, names, [c.units[i] for i in index], c.values[:, index], c.valid[:, index], False)


def channel_caption(detection: Detection, _part: str) -> str:
    """Say what the channel figures show."""
    return "Channels as logged, on one clock. " + _key(detection) + _thinned(detection)


def residual_parts(detection: Detection) -> tuple[str, ...]:
    """Return the parts of the residual figures, six residuals each."""
    found = detection.residuals
    return canvas.chunks(found.names, PANELS) if found is not None and found.names else ()


def residuals(detection: Detection, part: str) -> Figure:
    """Draw residuals; those that the events move come first."""
    r = detection.residuals
    assert r is not None
    first, rest = residual_order(detection)
    names = canvas.chunk(first + rest, PANELS, part)
    index = [r.names.index(name) for name in names]
    return _stack(detection, names, [r.units[i] for i in index], r.values[:, index], r.valid[:, index], True)


def residual_caption(detection: Detection, part: str) -> str:
    """Say what the residual figures show."""
    first, _ = residual_order(detection)
    lead = ""
    if detection.events and part in ("", "1"):
        lead = f" Moved most by the events: {', '.join(name.replace('_', ' ') for name in first[:PANELS])}."
    return (
        "Residuals: measured minus expected, near zero while nothing is wrong. Look for a change of level that stays."
        f"{lead} {_key(detection)}{_thinned(detection)}"
    )


def force_parts(detection: Detection) -> tuple[str, ...]:
    """Return the parts of the force figures, six forces each; none without a vessel."""
    return canvas.chunks(detection.forces.names, PANELS) if detection.forces is not None else ()


def forces(detection: Detection, part: str) -> Figure:
    """Draw the balance of forces that tells a line from its sensor."""
    f = detection.forces
    assert f is not None
    index = [f.names.index(name) for name in canvas.chunk(f.names, PANELS, part)]
    names = [f.names[i] for i in index]
    return _stack(detection, names, [f.units[i] for i in index], f.values[:, index], f.valid[:, index], True)


def force_caption(detection: Detection, _part: str) -> str:
    """Say what the force figures show."""
    return (
        "Force of the surroundings on the vessel: the mean of what its motion gives with the measured tensions and "
        "with those of intact lines. A lost line moves it away from that line's anchor, a sensor that reads too little "
        f"towards it, the environment in any direction. {_key(detection)}{_thinned(detection)}"
    )


def _key(detection: Detection) -> str:
    """Explain shading and marks that are in the figure, and only those."""
    grid = detection.channels.grid
    words = []
    if any(stop > grid.start and start < grid.stop for start, stop in detection.no_fault):
        words.append("Blue shade: no-fault window.")
    if detection.events:
        words.append("Dashed red line: onset of an event (its number above); red bar: while it stands.")
    if not bool(np.all(detection.channels.valid)):
        words.append("Grey: no valid samples.")
    return " ".join(words)


def _thinned(detection: Detection) -> str:
    if detection.channels.grid.n <= 2 * canvas.POINTS:
        return ""
    return " Lines show the smallest and largest value of each stretch, so no peak is lost."
