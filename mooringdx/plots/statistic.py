"""The detection statistic against its threshold, and its distribution when nothing is wrong.

Laws of the tail of the scaled no-fault statistic g, as the threshold stored them:
Weibull [Fang2015, eq. 20-22]            P(g > x) = exp(-(x / scale)^shape)
Weibull tied to the median m             P(g > x) = 2^(-(x / m)^shape)
power of a normal variable, tied to m    P(g > x) = erfc(0.47694 (x / m)^shape)
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from mooringdx.plots import canvas
from mooringdx.types import Array, Detection, Event, Statistic, Threshold

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FLOOR = 0.01
LAWS: dict[str, tuple[tuple[str, str], Callable[[Array, float, float], Array]]] = {
    "upper-half Weibull": (
        ("weibull_upper_median", "weibull_upper_shape"),
        lambda x, m, b: np.exp2(-((x / m) ** b)),
    ),
    "normal power": (
        ("normal_power_median", "normal_power_shape"),
        lambda x, m, b: np.array([math.erfc(v) for v in 0.4769362762044699 * (x / m) ** b]),
    ),
    "Weibull": (("weibull_scale", "weibull_shape"), lambda x, s, b: np.exp(-((x / s) ** b))),
}


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
    for place, j in enumerate(bold):
        label = statistic.labels[j].replace("_", " ")
        panel.plot(
            *canvas.envelope(x, y[:, j]), color=canvas.CYCLE[place], lw=1.2, zorder=3.9 - 0.1 * place, label=label
        )
    if rest:
        label = "largest of the other faults" if bold else "largest of all faults"
        panel.plot(*canvas.envelope(x, _largest(y[:, rest])), color="#aab0ba", lw=0.8, zorder=2, label=label)
    panel.set_yscale("log")
    top = float(np.nanmax(y)) if np.isfinite(y).any() else 1.0
    panel.set_ylim(FLOOR, max(50.0, 40.0 * top))
    panel.margins(x=0.0)
    if threshold is not None:
        panel.axhline(1.0, color=canvas.RED, lw=1.4, zorder=5, label=_level_words(threshold))
        low, high = (v / threshold.scaled_level for v in threshold.scaled_interval)
        if np.isfinite([low, high]).all() and 0 < low < high:
            panel.axhspan(low, high, color=canvas.RED, alpha=0.10, lw=0, zorder=1)
    panel.set_ylabel("statistic / alarm level (-)" if threshold is not None else "statistic (-)")
    canvas.shade(panel, detection, at)
    panel.set_xlim(x[0], x[-1])
    at.dress(panel)
    panel.legend(loc="upper left", ncols=2, handlelength=1.2, borderaxespad=0.3, frameon=True, framealpha=0.85,
                 edgecolor="none")  # fmt: skip


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
        panel.plot(*law, color=canvas.INK, lw=1.2, label=f"fitted tail ({law_name(threshold)})")
    panel.axvline(threshold.scaled_level, color=canvas.RED, lw=1.4, label=_level_words(threshold))
    low, high = threshold.scaled_interval
    if np.isfinite([low, high]).all():
        panel.axvspan(low, high, color=canvas.RED, alpha=0.10, lw=0)
    if threshold.probability > 0:
        panel.axhline(threshold.probability, color=canvas.FAINT, lw=0.9, ls=":")
    panel.set_yscale("log")
    from matplotlib.ticker import LogLocator, NullLocator

    panel.yaxis.set_major_locator(LogLocator(numticks=8))
    panel.yaxis.set_minor_locator(NullLocator())
    lowest = min([float(p[keep].min(initial=1.0)), threshold.probability or 1.0])
    panel.set_ylim(0.2 * lowest, 2.0)
    panel.set_xlim(0.0, max(1.15 * threshold.scaled_level, 1.05 * min(high, 3 * threshold.scaled_level)))
    panel.set_xlabel("scaled statistic (-)")
    panel.set_ylabel("probability of exceedance per sample (-)")
    panel.legend(loc="upper right", handlelength=1.2, frameon=True, framealpha=0.85, edgecolor="none")


def law_name(threshold: Threshold) -> str:
    """Return the name of the stored law, empty when it is none of `LAWS`."""
    return next((name for name, (keys, _) in LAWS.items() if all(k in threshold.tail for k in keys)), "")


def tail(threshold: Threshold, x: Array) -> tuple[Array, Array] | None:
    """Return (x, exceedance) of the stored central law, or None when its parameters are not stored."""
    name = law_name(threshold)
    if not name:
        return None
    keys, law = LAWS[name]
    p = law(x, *(float(threshold.tail[k]) for k in keys))
    return x[p > 0], p[p > 0]


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
            " The level stands where the law meets the dotted probability; the further it is from the last dot,"
            " the more it rests on the law."
        )
    if threshold.verdict != "supported":
        words += f" The level is {threshold.verdict.upper()}: {threshold.reason}."
    return words


def lead_branch(detection: Detection, event: Event) -> str | None:
    """Return the branch that found an event, as its evidence says, else the first."""
    names = parts(detection)
    told = f"{event.evidence.get('branch', '')} {event.evidence.get('detector', '')}"
    words = re.findall(r"\w+", told)
    return next((w for w in words if w in names), names[0] if names else None)
