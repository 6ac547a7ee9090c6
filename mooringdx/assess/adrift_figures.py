"""The pictures of an adrift-or-moved assessment: one overview a site, one track for every other failure alarm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from mooringdx.assess.adrift import ROWS, Score
from mooringdx.assess.adrift_tables import alarm_rows, alarm_title
from mooringdx.hypotheses.adrift.nouns import NOT_HOLDING, WARNING
from mooringdx.plots.canvas import BLUE, FAINT, GREEN, INK, ORANGE, PURPLE, RED, STYLE, save, sheet
from mooringdx.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MARKS = {
    "adrift": (RED, "v"),
    "drag_then_hold": (ORANGE, "D"),
    "moved_step_redeployment": (GREEN, "s"),
}


def names(score: Score) -> list[tuple[str, str]]:
    """Return file name and title of each figure of one site, in order."""
    site = score.track.site.name
    alarms = [(f"figures/{site}_alarm_{k + 1}.png", alarm_title(score, i)) for k, i in enumerate(score.other_alarms)]
    return [(f"figures/{site}.png", f"{site}: distance from the neutral point, labels and verdict"), *alarms]


def figures(scores: Sequence[Score]) -> Mapping[str, bytes]:
    """Return every figure as PNG bytes by file name."""
    import matplotlib

    out = {}
    for score in scores:
        with matplotlib.rc_context(STYLE):
            drawn = [overview(score), *(alarm(score, i) for i in score.other_alarms)]
        for (name, title), figure in zip(names(score), drawn, strict=True):
            out[name] = save(figure, {"Title": title, "Source": score.track.source.sha256})[0]
    return out


def overview(score: Score) -> Figure:
    """Draw the distance from the neutral point over the years, what was said, and the labels."""
    track, verdict = score.track, score.track.verdict
    fixes = verdict.seen
    date = track.day.astype("datetime64[D]")
    figure, axes = sheet(12.0, 5.6, nrows=2, ncols=1, sharex=True, gridspec_kw={"height_ratios": [3, 1]})
    top, bottom = axes[:, 0]
    distance = np.maximum(verdict.offset / 1000.0, 0.05)
    quiet, warned, lost = (
        fixes & (verdict.call < WARNING),
        fixes & (verdict.call >= WARNING) & (verdict.call != NOT_HOLDING),
        fixes & (verdict.call == NOT_HOLDING),
    )
    for rows, colour, mark, word in (
        (quiet, FAINT, ".", "in service"),
        (warned, BLUE, "o", "warning open"),
        (lost, RED, "x", "not holding"),
    ):
        top.plot(date[rows], distance[rows], mark, color=colour, markersize=4 if mark != "." else 2, label=word)
    top.plot(date[fixes], verdict.limit[fixes] / 1000.0, color=PURPLE, linewidth=0.9, label="warning distance")
    for kind, (colour, mark) in MARKS.items():
        days = [r.label.first_outside for r in score.rows if r.label.kind == kind]
        at = np.array(days, dtype=np.int64).astype("datetime64[D]")
        top.plot(at, np.full(len(days), 4000.0), mark, color=colour, markersize=6, label=f"label: {ROWS[kind]}")
    top.set_yscale("log")
    top.set_ylim(0.05, 8000.0)
    top.set_ylabel("distance from neutral point (km)")
    role = "tuned on" if track.site.tuned_on else "scored with settings frozen"
    top.set_title(f"{track.site.name} ({role}): {track.years:.1f} buoy-years; labels are kinematic")
    top.legend(loc="upper center", bbox_to_anchor=(0.5, -0.02), ncols=7, fontsize=7.5, frameon=False)
    bottom.plot(date, verdict.not_holding, color=RED, linewidth=0.9)
    bottom.set_ylabel("P(not holding)")
    bottom.set_ylim(-0.03, 1.03)
    return figure


def alarm(score: Score, event: int) -> Figure:
    """Draw the track of one other failure alarm, its distance and probability day by day."""
    track, verdict = score.track, score.track.verdict
    rows = alarm_rows(score, event)
    first = rows[verdict.episode[rows] == event][0]
    centre, radius = verdict.neutral[first], verdict.radius[first] / 1000.0
    north, east = ((v[rows] - c) / 1000.0 for v, c in zip((track.north, track.east), centre, strict=True))
    figure, axes = sheet(10.5, 4.6, nrows=1, ncols=2)
    place, over = axes[0]
    _track(place, north, east, verdict.call[rows], radius, float(verdict.limit[first]) / 1000.0)
    day = track.day[rows] - track.day[first]
    over.plot(day, np.hypot(north, east), "o-", color=BLUE, markersize=3.5)
    over.set_xlabel("days since the warning")
    over.set_ylabel("distance from neutral point (km)", color=BLUE)
    right = over.twinx()
    right.plot(day, verdict.not_holding[rows], ".-", color=RED, linewidth=0.9)
    right.set_ylabel("P(not holding)", color=RED)
    right.set_ylim(-0.03, 1.03)
    right.grid(visible=False)
    figure.suptitle(alarm_title(score, event), fontsize=9.5)
    return figure


def _track(axes: Axes, north: Array, east: Array, call: Array, radius: float, limit: float) -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 181)
    axes.plot(radius * np.sin(angle), radius * np.cos(angle), color=GREEN, linewidth=1.0, label="watch circle, 95 %")
    axes.plot(limit * np.sin(angle), limit * np.cos(angle), "--", color=PURPLE, linewidth=0.9, label="warning distance")
    axes.plot(east, north, "-", color=FAINT, linewidth=0.8)
    for rows, colour, word in (
        (call < WARNING, INK, "in service"),
        ((call >= WARNING) & (call != NOT_HOLDING), BLUE, "warning open"),
        (call == NOT_HOLDING, RED, "not holding"),
    ):
        axes.plot(east[rows], north[rows], "o", color=colour, markersize=3.5, label=word)
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("east of neutral point (km)")
    axes.set_ylabel("north of neutral point (km)")
    axes.legend(fontsize=7.5, loc="best")
