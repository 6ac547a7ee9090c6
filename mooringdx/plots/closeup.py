"""One event from close by: the data, the residuals and the statistic around its onset."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from mooringdx.plots import canvas, statistic
from mooringdx.plots.suspects import residuals_of
from mooringdx.types import Array, Detection, Event

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MOST = 6


def parts(detection: Detection) -> tuple[str, ...]:
    """Return one part an event, "event_1" ... for the first six."""
    return tuple(f"event_{i + 1}" for i in range(min(MOST, len(detection.events))))


def event_of(detection: Detection, part: str) -> Event:
    """Return the event that a part stands for."""
    return detection.events[int(part.removeprefix("event_")) - 1]


def window(detection: Detection, event: Event) -> tuple[float, float]:
    """Return the span to show, s: a few times what it took to detect and name the event, on both sides."""
    grid = detection.channels.grid
    last = event.detected if event.named is None else event.named
    took = max(last - event.onset_interval[0], event.onset_interval[1] - event.onset_interval[0])
    took = max(took, 25 * grid.sample_time)
    return max(grid.start, event.onset - 2.0 * took), min(grid.stop, last + 2.0 * took)


def draw(detection: Detection, part: str) -> Figure:
    """Draw the event's channels, residuals and statistic on one clock."""
    event = event_of(detection, part)
    lines = _lines(detection, event)
    branch = statistic.lead_branch(detection, event)
    count = len(lines) + (branch is not None)
    ratios = [1.0] * len(lines) + ([1.9] if branch is not None else [])
    figure, axes = canvas.sheet(10.0, 0.8 + 1.25 * sum(ratios), nrows=count, sharex=True, height_ratios=ratios)
    span = window(detection, event)
    rows = detection.channels.grid.window(span)
    at = canvas.clock(detection.channels.grid)
    x = at(detection.channels.grid.time[rows])
    for panel, (name, unit, values) in zip(axes[:, 0], lines, strict=False):
        factor, shown = canvas.display(unit, values[rows])
        style = {"marker": ".", "ms": 4} if x.size < 600 else {}
        panel.plot(*canvas.envelope(x, factor * values[rows]), color=canvas.BLUE, **style)
        panel.set_ylabel(f"{name}\n({shown})", rotation=0, ha="right", va="center")
        for start, stop in canvas.holes(np.isfinite(values[rows])):
            panel.axvspan(x[start], x[min(stop, x.size - 1)], color=canvas.GAP, lw=0, zorder=0.5)
        panel.locator_params(axis="y", nbins=4)
        panel.margins(x=0.0)
        _marks(panel, event, at)
    if branch is not None:
        panel = axes[-1, 0]
        statistic.history(panel, detection, *statistic.pick(detection, branch), window=span)
        _marks(panel, event, at)
    at.dress(axes[-1, 0])
    figure.align_ylabels(axes[: len(lines), 0])
    _legend(axes[0, 0], event)
    return figure


def _lines(detection: Detection, event: Event) -> list[tuple[str, str, Array]]:
    """Return (name, unit, (n,) values) of up to two channels and two residuals to show."""
    c, r = detection.channels, detection.residuals
    told: Any = event.evidence.get("channels", ())
    told = [told] if isinstance(told, str) else list(told)
    tail = event.subject.rsplit("_", 1)[-1]
    wanted = [event.subject, f"tension_{event.subject}", f"tension_{tail}", *told]
    names = [name for name in dict.fromkeys(wanted) if name in c.names][:2] or list(c.names[:1])
    out = [(name.replace("_", " "), c.units[c.names.index(name)], c.column(name)) for name in names]
    if r is not None:
        for name in residuals_of(detection, event)[:2]:
            i = r.names.index(name)
            out.append((f"residual\n{name.replace('_', ' ')}", r.units[i], np.asarray(r.values[:, i])))
    return out


def _marks(panel: Axes, event: Event, at: canvas.Clock) -> None:
    low, high = event.onset_interval
    panel.axvspan(at(low), at(high), color=canvas.ORANGE, alpha=0.30, lw=0, zorder=1)
    panel.axvline(at(event.onset), color=canvas.RED, lw=1.4, ls=(0, (5, 2)), zorder=5)
    panel.axvline(at(event.detected), color=canvas.INK, lw=1.2, zorder=4)
    if event.named is not None and event.named > event.detected:
        panel.axvline(at(event.named), color=canvas.INK, lw=1.2, ls=":", zorder=4)


def _legend(panel: Axes, event: Event) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    keys: list[Any] = [
        Line2D([], [], color=canvas.RED, ls=(0, (5, 2)), label="onset"),
        Patch(color=canvas.ORANGE, alpha=0.30, lw=0, label="onset, 95 % interval"),
        Line2D([], [], color=canvas.INK, label="detected"),
    ]
    if event.named is not None and event.named > event.detected:
        keys.append(Line2D([], [], color=canvas.INK, ls=":", label="named"))
    panel.legend(handles=keys, loc="lower left", bbox_to_anchor=(0.0, 1.02), ncols=4, borderaxespad=0.0)


def caption(detection: Detection, part: str) -> str:
    """Say what the close-up shows."""
    event = event_of(detection, part)
    number = part.removeprefix("event_")
    words = f"Event {number} from close by: what the sensors read, the residuals it moves"
    words += " and the statistic over its alarm level." if statistic.parts(detection) else "."
    if event.named is not None and event.named > event.detected:
        words += " The alarm comes at 'detected'; the name is decided only at 'named', when the window is full of it."
    return words
