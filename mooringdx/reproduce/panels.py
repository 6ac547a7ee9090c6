"""The panels of a reproduction's figures: what one pair of axes shows, with units, marks and legend."""

from __future__ import annotations

from statistics import NormalDist
from typing import TYPE_CHECKING, Any

import numpy as np

from mooringdx.plots import canvas
from mooringdx.plots.whiteness import autocorrelation, gaussian_plot
from mooringdx.reproduce.study import Course, Series, Study
from mooringdx.types import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LAG = 15.0
"""s of autocorrelation shown: ten wave periods."""
WAVES, RAMP = 150.0, (370.0, 520.0)
"""s: the waves start; the current grows from zero to its full speed [Fang2015, section 5.1]."""
PROBABILITIES = (0.001, 0.01, 0.1, 0.5, 0.9, 0.99, 0.999)
RAMP_COLOUR = "#f6e3bd"
FRAME: Any = {"frameon": True, "framealpha": 0.9, "edgecolor": "none", "borderaxespad": 0.1}


def words(name: str) -> str:
    """Return a residual's name as a reader sees it."""
    return name.replace("_", " ")


def flat(study: Study, series: Series) -> Array:
    """Return the raw no-fault residual without its straight trend, (n,)."""
    time = study.detection.channels.grid.time[study.quiet]
    slope, level = series.trend
    return np.asarray(series.raw[study.quiet] - level - slope * (time - time.mean()))


def running(values: Array, width: int) -> Array:
    """Return the centred mean of ``width`` samples, (n,); NaN where more than half of them are masked."""
    ok = np.isfinite(values)
    box = np.ones(width)
    count = np.convolve(ok.astype(np.float64), box, mode="same")
    total = np.convolve(np.where(ok, values, 0.0), box, mode="same")
    return np.asarray(np.where(2 * count >= width, total / np.maximum(count, 1.0), np.nan))


def schedule(panel: Axes, study: Study) -> None:
    """Shade the no-fault window and the growing current; mark the start of the waves and the fault."""
    grid = study.detection.channels.grid
    panel.axvspan(*study.window, color=canvas.QUIET, lw=0, zorder=0, label="no-fault window")
    panel.axvspan(*RAMP, color=RAMP_COLOUR, lw=0, zorder=0.1, label="current grows")
    panel.axvline(study.onset, color=canvas.RED, lw=1.2, ls=(0, (5, 2)), zorder=4, label="fault")
    panel.axvline(WAVES, color=canvas.INK, lw=1.0, ls=":", zorder=4, label="waves start")
    panel.set_xlim(grid.start, grid.stop)


def legend_below(panel: Axes) -> None:
    """Explain the marks of a time history under the figure, where they cover nothing."""
    handles, labels = panel.get_legend_handles_labels()
    panel.figure.legend(handles, labels, loc="outside lower center", ncols=4, handlelength=1.6, columnspacing=1.6)


def _headroom(panel: Axes, share: float) -> None:
    low, high = panel.get_ylim()
    panel.set_ylim(low, high + share * (high - low))


def history(panel: Axes, study: Study, values: Array, label: str) -> None:
    """Draw one series against time over the whole record, with the schedule of the experiment."""
    time = study.detection.channels.grid.time
    panel.plot(*canvas.envelope(time, values, 500), color=canvas.BLUE, lw=0.6)
    schedule(panel, study)
    panel.set_xlabel("time (s, log clock)")
    panel.set_ylabel(label)
    legend_below(panel)


def correlation(panel: Axes, study: Study, rows: list[tuple[Array, str, str, str]], reach: float = LAG) -> None:
    """Draw autocorrelations. ``rows``: (values, colour, line style, name)."""
    number = max(int(np.isfinite(values).sum()) for values, *_ in rows)
    lags = min(round(reach / study.sample_time), number // 2)
    bound = 1.96 / np.sqrt(number)
    panel.axhspan(-bound, bound, color=canvas.QUIET, lw=0, label="95 % of white noise")
    panel.axhline(0.0, color=canvas.FAINT, lw=0.8)
    for values, colour, style, name in rows:
        panel.plot(
            np.arange(lags + 1) * study.sample_time, autocorrelation(values, lags), color=colour, ls=style, label=name
        )
    panel.set_ylim(-1.05, 1.05)
    panel.set_xlim(0.0, lags * study.sample_time)
    panel.locator_params(axis="x", nbins=4)
    panel.set_xlabel("lag (s)")
    panel.set_ylabel("autocorrelation (-)")
    panel.legend(loc="upper right", handlelength=1.4)


def densities(panel: Axes, study: Study, series: Series, label: str) -> None:
    """Draw the densities of a raw residual before and after the fault, each with its Gaussian."""
    kinds = [(study.quiet, canvas.BLUE, "-", "before"), (study.late, canvas.ORANGE, "--", "after")]
    found = series.raw[(study.quiet | study.late) & np.isfinite(series.raw)]
    edges = np.linspace(float(np.quantile(found, 0.0002)), float(np.quantile(found, 0.9998)), 61)
    at = np.linspace(edges[0], edges[-1], 240)
    for mask, colour, style, name in kinds:
        x = series.raw[mask & np.isfinite(series.raw)]
        panel.stairs(
            np.histogram(x, edges)[0] / x.size / np.diff(edges),
            edges,
            color=colour,
            ls=style,
            label=f"{name} the fault",
        )
        law = np.exp(-0.5 * ((at - x.mean()) / x.std()) ** 2) / (x.std() * np.sqrt(2 * np.pi))
        panel.plot(at, law, color=canvas.INK, lw=1.0, ls=":", label="Gaussian" if name == "before" else None)
    _headroom(panel, 0.45)
    panel.set_xlabel(label)
    panel.set_ylabel(f"density (1/({series.unit}))" if "/" in series.unit else f"density (1/{series.unit})")
    panel.legend(loc="upper left", ncols=2, handlelength=1.4, columnspacing=0.9, **FRAME)


def _scores(panel: Axes, low: float, high: float, room: float) -> None:
    """Put probabilities at their normal scores on a y axis."""
    normal = NormalDist()
    shown = [p for p in PROBABILITIES if low - 0.3 <= normal.inv_cdf(p) <= high + 0.3]
    panel.set_yticks([normal.inv_cdf(p) for p in shown], [f"{p:g}" for p in shown])
    panel.set_ylim(low - 0.4, high + room)
    panel.set_ylabel("probability (-)")


def paper(panel: Axes, rows: list[tuple[Array, Any, str, str]], label: str) -> None:
    """Draw distributions on Gaussian paper, each with the line of its own mean and sd."""
    low, high = -3.0, 3.0
    for values, colour, mark, name in rows:
        x, score = gaussian_plot(values, 160)
        low, high = min(low, float(score[0])), max(high, float(score[-1]))
        panel.plot(x, score, mark, ms=3.5, mew=0.8, color=colour, label=name)
        reach = np.array([score[0], score[-1]])
        finite = values[np.isfinite(values)]
        panel.plot(finite.mean() + finite.std() * reach, reach, color=canvas.INK, lw=0.9, ls="--", zorder=1)
    panel.plot([], [], color=canvas.INK, lw=0.9, ls="--", label="Gaussian, same mean and sd")
    _scores(panel, low, high, 0.7 + 0.85 * (len(rows) + 1))
    panel.set_xlabel(label)
    panel.locator_params(axis="x", nbins=6)
    panel.legend(loc="upper left", handlelength=1.4, **FRAME)


def course_history(panel: Axes, study: Study, course: Course) -> None:
    """Draw a statistic and its levels against time."""
    time = study.detection.channels.grid.time
    seen = np.where(np.isfinite(course.values), np.maximum(course.values, 1e-2), np.nan)
    panel.plot(*canvas.envelope(time, seen, 600), color=canvas.BLUE)
    panel.axhline(course.level, color=canvas.RED, lw=1.3, label="level, Weibull law")
    panel.axhline(course.ideal_level, color=canvas.PURPLE, lw=1.3, ls="--", label="level, Gaussian means")
    schedule(panel, study)
    canvas.log_scale(panel)
    panel.set_ylim(1e-2, 3.0 * max(float(np.nanmax(course.values)), course.level))
    panel.set_xlabel("time (s, log clock)")
    panel.set_ylabel("g (-)")
    legend_below(panel)


def weibull_density(panel: Axes, course: Course) -> None:
    """Draw the density of the no-fault statistic with its laws."""
    edges = np.linspace(0.0, float(np.quantile(course.quiet, 0.998)), 41)
    density = np.histogram(course.quiet, edges)[0] / course.quiet.size / np.diff(edges)
    panel.stairs(density, edges, color=canvas.BLUE, lw=1.2, label="no-fault window")
    at = np.linspace(edges[1] / 6, edges[-1], 400)
    u = at / course.scale
    law = course.shape / course.scale * u ** (course.shape - 1.0) * np.exp(-(u**course.shape))
    name = f"Weibull, scale {course.scale:.2g}, shape {course.shape:.2g}"
    panel.plot(at, law, color=canvas.RED, lw=1.3, label=name)
    panel.plot(
        at, np.exp(-at) / np.sqrt(np.pi * at), color=canvas.INK, lw=1.1, ls="--", label="half chi-square (white z)"
    )
    panel.set_ylim(0.0, 1.5 * float(density.max()))
    panel.set_xlim(0.0, edges[-1])
    panel.set_xlabel("g (-)")
    panel.set_ylabel("density (-)")
    panel.legend(loc="upper right", handlelength=1.3)


def distribution(panel: Axes, course: Course) -> None:
    """Draw the distribution of the no-fault statistic on Gaussian paper with its laws."""
    from scipy.special import erf, ndtri

    x, score = gaussian_plot(course.quiet, 160)
    panel.plot(x, score, ".", ms=3.5, color=canvas.BLUE, label="no-fault window")
    at = np.geomspace(max(float(course.quiet.min()), 1e-4), 1.3 * float(course.quiet.max()), 400)
    laws = (
        (-np.expm1(-((at / course.scale) ** course.shape)), canvas.RED, "-", "Weibull"),
        (erf(np.sqrt(at)), canvas.INK, "--", "half chi-square (white z)"),
    )
    for law, colour, style, name in laws:
        ok = (law > 1e-5) & (law < 1.0 - 1e-9)
        panel.plot(at[ok], ndtri(law[ok]), color=colour, ls=style, lw=1.2, label=name)
    _scores(panel, float(score[0]), float(score[-1]), 0.6)
    panel.set_xlim(0.0, 1.25 * float(course.quiet.max()))
    panel.set_ylim(float(score[0]) - 2.2, float(score[-1]) + 0.6)
    panel.set_xlabel("g (-)")
    panel.legend(loc="lower right", handlelength=1.4)
