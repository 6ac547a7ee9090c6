"""The detection statistic against its threshold, and its distribution when nothing is wrong.

Law of the tail of the scaled no-fault statistic, as the threshold stored it (a power of a chi-square, tied to
the median m), in place of the Weibull of [Fang2015, eq. 20-22]:
P(g > x) = Q(d/2, c (x/m)^shape),   Q(d/2, c) = 1/2,   d the degrees of freedom, Q the upper incomplete gamma ratio.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Literal

import numpy as np

from mooringdx.plots import canvas
from mooringdx.types import Array, Detection, Event, Statistic, Threshold

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FLOOR = 0.01


def parts(detection: Detection) -> tuple[str, ...]:
    """Return the branches that have any value."""
    return tuple(s.branch for s in detection.statistics if bool(np.isfinite(s.values).any()))


def pick(detection: Detection, branch: str) -> tuple[Statistic, Threshold | None]:
    """Return the statistic of a branch and its threshold (None when it has none)."""
    statistic = next(s for s in detection.statistics if s.branch == branch)
    return statistic, next((t for t in detection.thresholds if t.branch == branch), None)


def ratio(statistic: Statistic, threshold: Threshold | None) -> Array:
    """Return the statistic in units of its alarm level, (n, f); as it is when there is no level."""
    if threshold is None:
        return statistic.values
    return np.asarray(statistic.values / np.broadcast_to(threshold.level, statistic.values.shape[1:]))


def draw(detection: Detection, branch: str) -> Figure:
    """Draw statistic over level for the whole log, and the no-fault distribution beside it."""
    statistic, threshold = pick(detection, branch)
    wide = threshold is not None and threshold.curve.shape[0] > 0
    figure, axes = canvas.sheet(
        10.0, 3.9, ncols=2 if wide else 1, width_ratios=[1.9, 1.0] if wide else [1.0]
    )  # fmt: skip
    history(axes[0, 0], detection, statistic, threshold)
    at = canvas.clock(detection.channels.grid)
    canvas.name_events(axes[0, 0], detection.events, at)
    if threshold is not None and wide:
        _distribution(axes[0, 1], threshold)
    return figure


def history(
    panel: Axes,
    detection: Detection,
    statistic: Statistic,
    threshold: Threshold | None,
    window: tuple[float, float] | None = None,
) -> None:
    """Draw statistic over level against time in s of ``window`` (default: all); the suspects in colour."""
    grid = statistic.grid
    rows = grid.window(window) if window else slice(0, grid.n)
    at = canvas.clock(detection.channels.grid)
    x, y = at(grid.time[rows]), np.maximum(ratio(statistic, threshold)[rows], FLOOR)
    bold = _suspects(detection, statistic)[:4]
    rest = [j for j in range(y.shape[1]) if j not in bold]
    for order, j in enumerate(bold):
        label = statistic.labels[j].replace("_", " ")
        panel.plot(
            *canvas.envelope(x, y[:, j]), color=canvas.CYCLE[order], lw=1.2, zorder=3.9 - 0.1 * order, label=label
        )
    if rest:
        label = "largest of the other faults" if bold else "largest of all faults"
        panel.plot(*canvas.envelope(x, _largest(y[:, rest])), color="#aab0ba", lw=0.8, zorder=2, label=label)
    canvas.log_scale(panel)
    top = float(np.nanmax(y)) if np.isfinite(y).any() else 1.0
    panel.set_ylim(FLOOR, max(8.0, 3.0 * top) if window else max(50.0, 40.0 * top))
    panel.margins(x=0.0)
    if threshold is not None:
        panel.axhline(1.0, color=canvas.RED, lw=1.4, zorder=5, label=_level_words(threshold))
        low, high = (v / threshold.scaled_level for v in threshold.scaled_interval)
        if np.isfinite([low, high]).all() and 0 < low < high:
            panel.axhspan(low, high, color=canvas.RED, alpha=0.10, lw=0, zorder=1)
    panel.set_ylabel("statistic / alarm level (-)" if threshold is not None else "statistic (-)")
    if window is None:
        canvas.shade(panel, detection, at)
    panel.set_xlim(x[0], x[-1])
    at.dress(panel)
    _legend(panel, "lower right" if window else "upper left", 2)


def _legend(panel: Axes, place: Literal["lower right", "upper left", "upper right"], columns: int) -> None:
    panel.legend(
        loc=place, ncols=columns, handlelength=1.2, borderaxespad=0.3, frameon=True, framealpha=0.85, edgecolor="none"
    )


def _largest(values: Array) -> Array:
    """Return the largest of each row that is not masked, (n,)."""
    return np.asarray(np.fmax.reduce(values, axis=1))


def _level_words(threshold: Threshold) -> str:
    return "alarm level" if threshold.verdict == "supported" else f"alarm level ({threshold.verdict.upper()})"


def _suspects(detection: Detection, statistic: Statistic) -> list[int]:
    """Return the columns that the events and their rivals name, in the order of the events."""
    wanted: list[tuple[str, str]] = []
    for event in detection.events:
        wanted += [(event.kind, event.subject), *((r.kind, r.subject) for r in event.rivals)]
    found: list[int] = []
    for kind, subject in wanted:
        for j, label in enumerate(statistic.labels):
            words = label.split(" ")
            if words[:2] == [kind, subject] and j not in found:
                found.append(j)
    return found


def _distribution(panel: Axes, threshold: Threshold) -> None:
    """Draw the exceedance of the scaled no-fault statistic with its law and level."""
    x, p = threshold.curve[:, 0], threshold.curve[:, 1]
    keep = (x > 0) & (p > 0)
    panel.plot(x[keep], p[keep], color=canvas.BLUE, lw=0, marker=".", ms=4, label="no-fault record")
    law = tail(threshold, np.linspace(0.0, 1.15 * threshold.scaled_level, 200)[1:])
    if law is not None:
        panel.plot(*law, color=canvas.INK, lw=1.2, label="fitted law")
    panel.axvline(threshold.scaled_level, color=canvas.RED, lw=1.4, label=_level_words(threshold))
    low, high = threshold.scaled_interval
    if np.isfinite([low, high]).all():
        panel.axvspan(low, high, color=canvas.RED, alpha=0.10, lw=0)
    asked = threshold.probability if threshold.probability > 0 else 1.0
    if asked < 1.0:
        panel.axhline(asked, color=canvas.FAINT, lw=1.1, ls=":", label="asked rate")
    canvas.log_scale(panel)
    panel.set_ylim(0.2 * min(float(p[keep].min(initial=1.0)), asked), 2.0)
    panel.set_xlim(0.0, max(1.15 * threshold.scaled_level, 1.05 * min(high, 3 * threshold.scaled_level)))
    panel.set_xlabel("scaled statistic (-)")
    panel.set_ylabel("probability of exceedance (-)")
    _legend(panel, "upper right", 1)


def tail(threshold: Threshold, x: Array) -> tuple[Array, Array] | None:
    """Return (x, exceedance) of the stored central law, or None when its parameters are not stored."""
    stored = threshold.tail
    if not {"degrees", "median", "shape"} <= set(stored):
        return None
    from scipy.special import gammaincc, gammainccinv

    half = 0.5 * stored["degrees"]
    p = gammaincc(half, gammainccinv(half, 0.5) * (x / stored["median"]) ** stored["shape"])
    return x[p > 0], np.asarray(p[p > 0])


def caption(detection: Detection, branch: str) -> str:
    """Say what the statistic and its distribution show."""
    _, threshold = pick(detection, branch)
    words = f"Branch '{branch}': the statistic of every fault divided by its alarm level; above 1 is an alarm."
    if threshold is None:
        return words.replace(" divided by its alarm level; above 1 is an alarm", "; this branch has no level")
    words += " Red band: where the level could lie, given how short the no-fault record is."
    if threshold.curve.shape[0]:
        words += (
            " Right: how often the no-fault statistic (scaled, all faults pooled) exceeded a value."
            " The law meets the dotted line, the asked rate, about at the best estimate of the level; the level"
            " itself stands further right, so that the rate holds with the wanted assurance. The further it is from the"
            " last dot, the more it rests on the law."
        )
    if threshold.verdict != "supported":
        words += f" The level is {threshold.verdict.upper()}: {threshold.reason.rstrip('.')}."
    return words


def lead_branch(detection: Detection, event: Event) -> str | None:
    """Return the branch that found an event, as its evidence says, else the first."""
    names = parts(detection)
    told = f"{event.evidence.get('branch', '')} {event.evidence.get('detector', '')}"
    words = re.findall(r"\w+", told)
    return next((w for w in words if w in names), names[0] if names else None)
