"""Draw what is in a log: one page with a row and a small plot for every signal.

The plots are written as SVG polygons directly, one point a pixel column (lowest and highest value in it): a page of
hundreds of signals stays small, and the same log gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mooringdx.logs.survey import SurveyRow
from mooringdx.types import Array, RawLog, Signal

WIDTH, HEIGHT = 360, 44


def inspect_html(rows: Sequence[SurveyRow], log: RawLog) -> str:
    """Return one self-contained HTML page for the rows of ``survey(log)``."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    loader = PackageLoader("mooringdx", "templates")
    env = Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
    env.filters["number"] = _number
    span = _span(rows)
    lines = [sparkline(log.signals[r.signal], span) for r in rows]
    page = env.get_template("inspect.html.j2")
    return page.render(
        log=log, rows=list(zip(rows, lines, strict=True)), start=span[0], stop=span[1], width=WIDTH, height=HEIGHT
    )


def _number(value: float | None, digits: int = 4) -> str:
    return "" if value is None else f"{value:.{digits}g}"


def _span(rows: Sequence[SurveyRow]) -> tuple[float, float]:
    starts, stops = [r.start for r in rows if r.start is not None], [r.stop for r in rows if r.stop is not None]
    return (min(starts), max(stops)) if starts and stops else (0.0, 1.0)


def sparkline(signal: Signal, span: tuple[float, float]) -> tuple[str, ...]:
    """Return the point lists of the SVG polygons of one signal over ``span``, s; one a stretch without a gap.

    Each pixel column that holds samples gives its lowest and highest value, scaled to the signal's own range; a column
    without samples ends the polygon, unless the signal is slower than the columns.
    """
    good = np.isfinite(signal.time) & np.isfinite(signal.values)
    good &= (signal.time >= span[0]) & (signal.time <= span[1])
    time, values = signal.time[good], signal.values[good]
    if time.size == 0:
        return ()
    width = max(span[1] - span[0], 1e-12)
    column = np.minimum((time - span[0]) / width * WIDTH, WIDTH - 1).astype(np.intp)
    low, high = np.full(WIDTH, np.inf), np.full(WIDTH, -np.inf)
    np.minimum.at(low, column, values)
    np.maximum.at(high, column, values)
    filled = np.flatnonzero(np.isfinite(low))
    usual = float(np.median(np.diff(filled))) if filled.size > 1 else 1.0
    breaks = np.flatnonzero(np.diff(filled) > 3.0 * usual) + 1
    y_low, y_high = _pixels(low, high, filled)
    return tuple(_polygon(part, y_low, y_high) for part in np.split(filled, breaks))


def _pixels(low: Array, high: Array, filled: np.ndarray[tuple[int, ...], np.dtype[np.intp]]) -> tuple[Array, Array]:
    bottom, top = float(low[filled].min()), float(high[filled].max())
    scale = (HEIGHT - 4) / (top - bottom) if top > bottom else 0.0
    middle = HEIGHT / 2.0 if scale == 0.0 else HEIGHT - 2.0
    y_low, y_high = np.full(WIDTH, middle), np.full(WIDTH, middle)
    y_low[filled] = middle - (low[filled] - bottom) * scale + 0.5
    y_high[filled] = middle - (high[filled] - bottom) * scale - 0.5
    return y_low, y_high


def _polygon(part: np.ndarray[tuple[int, ...], np.dtype[np.intp]], y_low: Array, y_high: Array) -> str:
    there = [f"{x}.5,{y_high[x]:.1f}" for x in part]
    back = [f"{x}.5,{y_low[x]:.1f}" for x in part[::-1]]
    if part.size == 1:
        there = [f"{part[0]},{y_high[part[0]]:.1f}", f"{part[0] + 1},{y_high[part[0]]:.1f}"]
        back = [f"{part[0] + 1},{y_low[part[0]]:.1f}", f"{part[0]},{y_low[part[0]]:.1f}"]
    return " ".join(there + back)
