"""The canvas under every figure: colours, clock, units, decimation and the marks of events.

Figures are `matplotlib.figure.Figure` objects without any pyplot state. Colours are those of Okabe and Ito,
which people with any common colour blindness can tell apart; no meaning rests on colour alone.
"""

from __future__ import annotations

import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mooringdx.types import Array, Detection, Event, Grid, Mask

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

INK, FAINT, QUIET, GAP = "#333333", "#8a8f98", "#dcecf7", "#e4e4e6"
BLUE, ORANGE, GREEN, RED, PURPLE, SKY = "#0072b2", "#e69f00", "#009e73", "#c1440e", "#9467a8", "#56b4e9"
CYCLE = (BLUE, ORANGE, GREEN, PURPLE, SKY, "#7f6000", "#cc79a7", INK)
POINTS = 1500
STYLE: Any = {
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titlelocation": "left",
    "axes.titley": 1.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": FAINT,
    "axes.labelcolor": INK,
    "axes.grid": True,
    "axes.unicode_minus": False,
    "axes.formatter.useoffset": False,
    "grid.color": "#eceef1",
    "grid.linewidth": 0.8,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.direction": "out",
    "text.color": INK,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "lines.linewidth": 0.9,
    "path.simplify": True,
    "svg.hashsalt": "mooringdx",
    "svg.fonttype": "path",
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
}


@dataclass(frozen=True)
class Plot:
    """One kind of figure.

    ``parts`` lists the figures of this kind that a detection calls for (empty: the kind does not apply; ``""`` is the
    only one of its kind); ``draw`` and ``caption`` take the detection and one of these parts.
    """

    title: str
    section: str
    parts: Callable[[Detection], tuple[str, ...]]
    draw: Callable[[Detection, str], Figure]
    caption: Callable[[Detection, str], str]

    def applies(self, detection: Detection) -> bool:
        """Say whether a detection calls for any figure of this kind."""
        return bool(self.parts(detection))


def paint(plot: Plot, detection: Detection, part: str = "") -> Figure:
    """Draw one figure in the house style, laid out once."""
    import matplotlib

    with matplotlib.rc_context(STYLE):
        figure = plot.draw(detection, part)
        engine = figure.get_layout_engine()
        if engine is not None:
            engine.execute(figure)
            figure.set_layout_engine("none")
        return figure


def save(figure: Figure, metadata: Mapping[str, str], dpi: int = 110) -> tuple[bytes, bytes]:
    """Return a painted figure as (PNG, SVG) bytes that depend on nothing but the figure and ``metadata``.

    ``metadata`` may hold Title, Description and Source; it is written inside both files.
    """
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    png, svg = io.BytesIO(), io.BytesIO()
    with matplotlib.rc_context(STYLE):
        figure.set_dpi(dpi)
        FigureCanvasAgg(figure).print_png(png, metadata={**metadata, "Software": "mooringdx"})
        FigureCanvasSVG(figure).print_svg(svg, metadata={**metadata, "Date": None, "Creator": "mooringdx"})
    return png.getvalue(), svg.getvalue()


def sheet(width: float, height: float, edges: Mapping[str, float] | None = None, **grid: Any) -> tuple[Figure, Any]:
    """Return a figure of ``width`` x ``height`` inches and its axes (array of shape given by ``nrows``, ``ncols``).

    The layout is worked out from the texts, or fixed by ``edges`` (as in `Figure.subplots_adjust`), which is quicker.
    """
    from matplotlib.figure import Figure as NewFigure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    figure = NewFigure(
        figsize=(width, height), layout=None if edges else ConstrainedLayoutEngine(w_pad=0.06, h_pad=0.05)
    )
    if edges:
        figure.subplots_adjust(**edges)
    return figure, figure.subplots(squeeze=False, **grid)


@dataclass(frozen=True)
class Clock:
    """The horizontal axis of a record: seconds, hours, or dates when the record has an epoch and lasts for days."""

    per: float
    label: str
    epoch_days: float | None = None

    def __call__(self, time: Any) -> Any:
        """Turn s on the log clock into axis units (hours, ... or days since 1970)."""
        return np.asarray(time, dtype=np.float64) / self.per + (self.epoch_days or 0.0)

    def dress(self, axes: Axes) -> None:
        """Put ticks and label on an x axis."""
        if self.epoch_days is not None:
            from matplotlib.dates import AutoDateLocator, ConciseDateFormatter

            locator = AutoDateLocator(minticks=3, maxticks=8)
            axes.xaxis.set_major_locator(locator)
            axes.xaxis.set_major_formatter(ConciseDateFormatter(locator, show_offset=False))
        else:
            from matplotlib.ticker import MaxNLocator

            axes.xaxis.set_major_locator(MaxNLocator(9))
        axes.set_xlabel(self.label)


def clock(grid: Grid) -> Clock:
    """Choose the time axis for a record."""
    span = grid.sample_time * grid.n
    if grid.epoch_ns is not None and span > 3 * 86400.0:
        days = np.array([grid.epoch_ns, grid.epoch_ns + round(1e9 * span)], dtype="datetime64[ns]").astype(
            "datetime64[D]"
        )
        return Clock(86400.0, f"date (UTC), {days[0]} to {days[1]}", grid.epoch_ns / 86400e9)
    if span <= 2.5 * 3600.0:
        return Clock(1.0, "time (s, log clock)")
    if span <= 4 * 86400.0:
        return Clock(3600.0, "time (h, log clock)")
    return Clock(86400.0, "time (d, log clock)")


def display(unit: str, values: Array) -> tuple[float, str]:
    """Return (factor, unit) to show SI ``values`` in: rad as deg, large N as kN, large m as km; "1" as "-"."""
    some = values[:: max(1, values.shape[0] // 100_000)]
    finite = some[np.isfinite(some)]
    top = float(np.quantile(np.abs(finite), 0.99)) if finite.size else 0.0
    if unit == "rad":
        return float(np.degrees(1.0)), "deg"
    if unit in ("N", "m", "N m", "Pa") and top >= 5000.0:
        return 1e-3, f"k{unit}"
    if unit == "m" and 0.0 < top < 0.02:
        return 1e3, "mm"
    return 1.0, unit if unit not in ("", "1") else "-"


def log_scale(axes: Axes) -> None:
    """Make a y axis logarithmic with few, plainly written ticks."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

    axes.set_yscale("log")
    axes.yaxis.set_major_locator(LogLocator(numticks=8))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.yaxis.set_major_formatter(
        FuncFormatter(lambda value, _: f"{value:g}".replace("e-0", "e-").replace("e+0", "e"))
    )


def envelope(x: Array, y: Array, points: int = POINTS) -> tuple[Array, Array]:
    """Thin a line to at most ``2 * points`` vertices that show every extreme.

    Parameters
    ----------
    x, y : (n,), y NaN where there is no sample.
    points : number of bins; each keeps its smallest and largest value.
    """
    n = y.size
    if n <= 2 * points:
        return x, y
    edges = np.linspace(0, n, points + 1).astype(np.int64)[:-1]
    low, high = np.fmin.reduceat(y, edges), np.fmax.reduceat(y, edges)
    return np.repeat(x[edges], 2), np.column_stack([low, high]).ravel()


def holes(valid: Mask, limit: int = 200) -> list[tuple[int, int]]:
    """Return [start, stop) of the longest runs of False that can be seen at figure size, at most ``limit``."""
    edge = np.flatnonzero(np.diff(np.r_[True, valid, True].astype(np.int8)))
    runs = [(int(a), int(b)) for a, b in zip(edge[::2], edge[1::2], strict=True) if b - a >= max(1, valid.size // 600)]
    return sorted(sorted(runs, key=lambda run: run[0] - run[1])[:limit])


def quiet(detection: Detection) -> Mask:
    """Return (n,), true on the no-fault windows; without any, before the first event; without events, everywhere."""
    grid = detection.channels.grid
    mask = np.zeros(grid.n, dtype=np.bool_)
    for window in detection.no_fault:
        mask[grid.window(window)] = True
    if not mask.any():
        mask[: grid.index(min((e.onset_interval[0] for e in detection.events), default=grid.stop))] = True
    return mask if mask.any() else ~mask


def quiet_words(detection: Detection) -> str:
    """Name the record that `quiet` picks, for captions."""
    if detection.no_fault:
        return "the no-fault window"
    return "the record before the first event" if detection.events else "the whole record"


def shade(axes: Axes, detection: Detection, at: Clock) -> None:
    """Shade the no-fault windows and mark each event's onset (line) and its standing time (bar at the top)."""
    grid = detection.channels.grid
    for start, stop in detection.no_fault:
        if stop > grid.start and start < grid.stop:
            axes.axvspan(at(max(start, grid.start)), at(min(stop, grid.stop)), color=QUIET, lw=0, zorder=0)
    for event in detection.events:
        axes.axvline(at(event.onset), color=RED, lw=1.1, ls=(0, (5, 2)), zorder=4)
        stop = grid.stop if event.cleared is None else event.cleared
        axes.plot(
            at([event.onset, stop]),
            [1, 1],
            color=RED,
            lw=6,
            solid_capstyle="butt",
            transform=axes.get_xaxis_transform(),
            scalex=False,
        )


def name_events(axes: Axes, events: Iterable[Event], at: Clock) -> None:
    """Write the events' numbers over a panel; neighbours that would collide share one label."""
    low, high = axes.get_xlim()
    groups: list[tuple[float, list[int]]] = []
    for number, event in enumerate(events, start=1):
        x = float(at(event.onset))
        if groups and x - groups[-1][0] < 0.025 * (high - low):
            groups[-1][1].append(number)
        else:
            groups.append((x, [number]))
    for x, numbers in groups:
        text = f"{numbers[0]}" if len(numbers) == 1 else f"{numbers[0]}-{numbers[-1]}"
        axes.annotate(
            text, (x, 1), (0, 4), xycoords=axes.get_xaxis_transform(), textcoords="offset points",
            ha="center", color=RED, fontsize=9, fontweight="bold", annotation_clip=True,
        )  # fmt: skip


def chunks(names: Sequence[str], size: int) -> tuple[str, ...]:
    """Return the parts "1", "2", ... when ``names`` are drawn ``size`` to a figure; "" for a single figure."""
    count = -(-len(names) // size)
    return ("",) if count == 1 else tuple(str(i + 1) for i in range(count))


def chunk(names: Sequence[str], size: int, part: str) -> list[str]:
    """Return the names that stand on one part of `chunks`."""
    first = (int(part or 1) - 1) * size
    return list(names[first : first + size])
