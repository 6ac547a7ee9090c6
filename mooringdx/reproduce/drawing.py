"""The figures of [Fang2015, figs. 3-8], each panel as the paper has it, and the trend that the paper does not show.

They are 7.1 inches wide with letters of 8 points and more: the printed width of the page that shows them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mooringdx.config import rate_text
from mooringdx.plots import canvas
from mooringdx.reproduce.panels import (
    correlation,
    course_history,
    densities,
    distribution,
    flat,
    history,
    paper,
    running,
    schedule,
    weibull_density,
    words,
)
from mooringdx.reproduce.study import SETTLE, Course, Series, Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH, DPI = 7.1, 160


@dataclass(frozen=True)
class Sheet:
    """One figure: its title, and how it is drawn."""

    title: str
    draw: Callable[[Study], Figure]


def paint(sheet: Sheet, study: Study) -> Figure:
    """Draw one figure in the house style, laid out once."""
    import matplotlib

    with matplotlib.rc_context(
        {**canvas.STYLE, "legend.fontsize": 8.0, "xtick.labelsize": 8.0, "ytick.labelsize": 8.0}
    ):
        figure = sheet.draw(study)
        figure.set_dpi(DPI)
        figure.draw_without_rendering()
        _hold_ticks(figure)  # they move with the layout, and the layout with them: neither would come to rest
        figure.draw_without_rendering()
        figure.set_layout_engine("none")
        return figure


def _hold_ticks(figure: Figure) -> None:
    """Fix every axis' ticks where they stand."""
    from matplotlib.ticker import FixedLocator

    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            axis.set_major_locator(FixedLocator([t for t in axis.get_majorticklocs() if low <= t <= high]))


def raw_sheet(study: Study, series: Series) -> Figure:
    """Draw time history, autocorrelation, density before and after, and the Gaussian plot of a raw residual."""
    figure, axes = canvas.sheet(WIDTH, 5.6, nrows=2, ncols=2)
    label = f"{series.symbol}, {words(series.name)} ({series.unit})"
    history(axes[0, 0], study, series.raw, label)
    calm = series.raw[study.quiet]
    rows = [(calm, canvas.BLUE, "-", "mean off"), (flat(study, series), canvas.ORANGE, "--", "mean and trend off")]
    correlation(axes[0, 1], study, rows)
    densities(axes[1, 0], study, series, label)
    paper(axes[1, 1], [(calm, canvas.BLUE, ".", "no fault")], label)
    for panel, title in zip(axes.flat, ("Time history", "Autocorrelation", "Density", "Gaussian paper"), strict=True):
        panel.set_title(title)
    return figure


def trend_sheet(study: Study) -> Figure:
    """Draw the slow part of both residuals, the straight line over the no-fault window, and what whitening leaves."""
    figure, axes = canvas.sheet(WIDTH, 6.4, nrows=4, sharex=True)
    time = study.detection.channels.grid.time
    shown = time < study.onset
    for row, series in zip((0, 2), (study.force, study.tension), strict=True):
        pairs = ((series.raw, f"{series.symbol}\n({series.unit})"), (series.white, f"{series.symbol} white\n(-)"))
        for panel, (values, label) in zip(axes[row : row + 2, 0], pairs, strict=True):
            slow = running(values[shown], round(30.0 / study.sample_time))
            panel.plot(*canvas.envelope(time[shown], values[shown], 600), color="#b9c3cf", lw=0.5, label="residual")
            panel.plot(time[shown], slow, color=canvas.BLUE, lw=1.5, label="mean of 30 s")
            schedule(panel, study)
            panel.set_xlim(0.0, study.onset + 5.0)
            panel.set_ylabel(label)
            panel.locator_params(axis="y", nbins=4)
        slope, level = series.trend
        at = time[study.quiet]
        axes[row, 0].plot(at, level + slope * (at - at.mean()), color=canvas.RED, lw=1.6, label="trend")
    axes[0, 0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, columnspacing=1.2, handlelength=1.4)
    axes[-1, 0].set_xlabel("time (s, log clock)")
    figure.align_ylabels()
    return figure


def correlation_sheet(study: Study, stage: str) -> Figure:
    """Draw the autocorrelation of both residuals, "white" or "packed", over that of the stage before it."""
    figure, axes = canvas.sheet(WIDTH, 2.9, ncols=2, sharey=True)
    names = {"raw": "raw", "white": "whitened", "packed": "compressed"}
    before = {"white": "raw", "packed": "white"}[stage]
    for panel, series in zip(axes[0], (study.force, study.tension), strict=True):
        rows = [
            (getattr(series, before)[study.quiet], "#9aa3ae", "--", names[before]),
            (getattr(series, stage)[study.quiet], canvas.BLUE, "-", names[stage]),
        ]
        correlation(panel, study, rows)
        if stage == "packed":
            panel.set_ylim(-0.2, 0.3)
        panel.set_title(f"{series.symbol}, {words(series.name)}")
    return figure


def compression_sheet(study: Study) -> Figure:
    """Draw both whitened residuals before and after compression: time history and Gaussian plot."""
    figure, axes = canvas.sheet(WIDTH, 5.4, nrows=2, ncols=2, width_ratios=[1.35, 1.0])
    time = study.detection.channels.grid.time[study.quiet]
    for line, series in zip(axes, (study.force, study.tension), strict=True):
        pair = (series.white[study.quiet], series.packed[study.quiet])
        for values, colour, name in zip(pair, (canvas.BLUE, canvas.GREEN), ("whitened", "compressed"), strict=True):
            line[0].plot(*canvas.envelope(time, values, 350), color=colour, lw=0.6, label=name)
        top = float(np.nanmax(np.abs(pair[0])))
        line[0].set_ylim(-1.1 * top, 1.5 * top)
        line[0].locator_params(axis="y", nbins=5)
        line[0].set_xlim(*study.window)
        line[0].set_xlabel("time (s, log clock)")
        label = f"{series.symbol} over its sd (-)"
        line[0].set_ylabel(label)
        line[0].legend(loc="upper right", ncols=2, handlelength=1.2)
        rows = [(pair[0], canvas.BLUE, ".", "whitened"), (pair[1], canvas.GREEN, "+", "compressed")]
        paper(line[1], rows, label)
    axes[0, 0].set_title("No-fault window")
    axes[0, 1].set_title("Gaussian paper")
    return figure


def statistic_sheet(study: Study, window: int) -> Figure:
    """Draw g with its threshold, its density with the Weibull law, its autocorrelation and its distribution."""
    course = next(c for c in study.courses if c.window == window)
    figure, axes = canvas.sheet(WIDTH, 5.8, nrows=2, ncols=2)
    course_history(axes[0, 0], study, course)
    weibull_density(axes[0, 1], course)
    correlation(axes[1, 0], study, [(course.quiet, canvas.BLUE, "-", "g, no fault")], 2.2 * window * study.sample_time)
    axes[1, 0].axvline(window * study.sample_time, color=canvas.FAINT, lw=1.0, ls=":", label="window")
    axes[1, 0].legend(loc="upper right", handlelength=1.4)
    distribution(axes[1, 1], course)
    titles = (f"Statistic, M = {window}", "Density, no fault", "Autocorrelation, no fault", "Distribution, no fault")
    for panel, title in zip(axes.flat, titles, strict=True):
        panel.set_title(title)
    return figure


def _captions(study: Study) -> dict[str, str]:
    """Return what each figure shows, by its name."""
    force, tension = (f"{s.symbol} ({words(s.name)})" for s in (study.force, study.tension))
    raw = (
        "Time history with the no-fault window (blue) and the growing current (yellow) inside it; autocorrelation over "
        "the no-fault window with the mean taken off, and with the straight trend taken off too; density before the "
        f"fault at {study.onset:g} s and from {SETTLE:g} s after it; the no-fault distribution on Gaussian paper, "
        "where the dashed line is the Gaussian of the same mean and sd."
    )
    fixed = {
        "fig3_raw_r1": f"Fig. 3: raw residual {force}. {raw}",
        "fig4_raw_r5": f"Fig. 4: raw residual {tension}, r9 by eq. 6. {raw}",
        "trend": (
            "Not in the paper: the current grows inside the fitted window. Means over 30 s of both residuals, and the "
            "straight line that is taken off before the ARMA fit (never off what is filtered); below each, what "
            "whitening leaves of it."
        ),
        "fig5_acf_whitened": (
            "Fig. 5: autocorrelation of the whitened residuals over the no-fault window, raw (mean off) beside it. "
            "White noise stays inside the shaded band at 95 % of the lags."
        ),
        "fig6_compression": (
            "Fig. 6: whitened residuals before (blue dots) and after (green crosses) the compression of eqs. 9 and 10, "
            "k = 3: time history, and Gaussian paper, where the compressed tails turn away from the line."
        ),
        "fig7_acf_compressed": (
            "Fig. 7: autocorrelation of the compressed residuals over the no-fault window, uncompressed beside it; the "
            "scale is cut, at lag zero both are 1."
        ),
    }
    return fixed | {f"fig8_statistic_m{c.window}": _statistic_caption(study, c) for c in study.courses}


def _statistic_caption(study: Study, course: Course) -> str:
    when = f"at {course.alarm:.1f} s" if course.alarm is not None else "never"
    return (
        f"Fig. 8, M = {course.window} samples ({course.window * study.sample_time:g} s): the statistic of eq. 15 "
        f"(mended) on r1, r2 and the tension of {words(study.line)}. Red: level for {rate_text(study.asked)} on all "
        f"lines by the Weibull law, {course.level:.3g}; dashed: by the law of Gaussian window means of the same "
        f"variance, {course.ideal_level:.3g}. The red level is passed {when}; the fault is at {study.onset:g} s. "
        "Density, autocorrelation and distribution (on Gaussian paper) are of the no-fault window only, which holds "
        f"{course.quiet.size / course.window:.1f} windows."
    )


def captions(study: Study, command: str) -> dict[str, str]:
    """Return the captions by name, each with the command that makes the figure."""
    return {name: f"{text} Made by: {command}" for name, text in _captions(study).items()}


SHEETS: Mapping[str, Sheet] = {
    "fig3_raw_r1": Sheet("Fig. 3: raw residual r1", lambda s: raw_sheet(s, s.force)),
    "fig4_raw_r5": Sheet("Fig. 4: raw residual of line 4", lambda s: raw_sheet(s, s.tension)),
    "trend": Sheet("The trend in the fitted window", trend_sheet),
    "fig5_acf_whitened": Sheet("Fig. 5: autocorrelation, whitened", lambda s: correlation_sheet(s, "white")),
    "fig6_compression": Sheet("Fig. 6: before and after compression", compression_sheet),
    "fig7_acf_compressed": Sheet("Fig. 7: autocorrelation, compressed", lambda s: correlation_sheet(s, "packed")),
    "fig8_statistic_m400": Sheet("Fig. 8: statistic, window of the figure", lambda s: statistic_sheet(s, 400)),
    "fig8_statistic_m150": Sheet("Fig. 8: statistic, window of the text", lambda s: statistic_sheet(s, 150)),
}
