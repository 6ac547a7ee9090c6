"""Every figure can be read in print: units on every axis, no text over the edge, letters large enough."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import detections
import pytest
from matplotlib.text import Text
from test_reproduce import study

from mooringdx.plots import FIGURES
from mooringdx.plots import paint as paint_plot
from mooringdx.reproduce.drawing import SHEETS, captions, paint
from mooringdx.types import Detection

PRINTED = 7.17
"""inches: A4 less the margins of the page's style."""
SMALLEST = 8.0


def cases() -> Iterator[tuple[str, str, str]]:
    """Yield (detection, figure, part): each figure on the first detection that calls for it."""
    for name, plot in FIGURES.items():
        found = [(case, name, plot.parts(build())[-1]) for case, build in detections.ALL.items() if plot.parts(build())]
        yield from found[:1]


def texts(figure: Any) -> Iterator[Text]:
    """Yield every text that is drawn and not empty: tick labels outside their axis are not drawn."""
    for text in figure.findobj(Text):
        if text.get_text().strip() and text.get_visible():
            yield text


def ticks_off(figure: Any) -> set[int]:
    """Return the ids of the tick labels that lie beyond their axis' limits, which matplotlib does not draw."""
    out = set()
    for axes in figure.axes:
        for axis in (axes.xaxis, axes.yaxis):
            low, high = sorted(axis.get_view_interval())
            slack = 1e-9 * (high - low)
            for tick in [*axis.get_major_ticks(), *axis.get_minor_ticks()]:
                shown = low - slack <= tick.get_loc() <= high + slack and axis.get_visible()
                for label, on in ((tick.label1, tick.label1.get_visible()), (tick.label2, tick.label2.get_visible())):
                    if not (shown and on):
                        out.add(id(label))
    return out


def outside(figure: Any) -> list[str]:
    """Return the texts whose extent leaves the canvas by more than a pixel."""
    figure.canvas.draw()
    renderer = figure.canvas.get_renderer()
    width, height = figure.canvas.get_width_height()
    hidden = ticks_off(figure)
    wrong = []
    for text in texts(figure):
        box = text.get_window_extent(renderer)
        if id(text) in hidden or (text.get_clip_on() and text.get_clip_box() is not None):
            continue
        if box.x0 < -1 or box.y0 < -1 or box.x1 > width + 1 or box.y1 > height + 1:
            wrong.append(f"{text.get_text()!r} at {box.x0:.0f} {box.y0:.0f} {box.x1:.0f} {box.y1:.0f}")
    return wrong


def unlabelled(figure: Any) -> list[str]:
    """Return the axes without a unit in brackets; a shared x axis is labelled once, "(-)" says that there is none."""
    wrong = []
    for axes in figure.axes:
        if axes.get_label() == "<colorbar>":
            continue
        shared = [a.get_xlabel() for a in axes.get_shared_x_axes().get_siblings(axes)]
        if not any("(" in label and ")" in label for label in shared):
            wrong.append(f"x of {axes.get_title(loc='left')!r}: {axes.get_xlabel()!r}")
        if not ("(" in axes.get_ylabel() and ")" in axes.get_ylabel()):
            wrong.append(f"y of {axes.get_title(loc='left')!r}: {axes.get_ylabel()!r}")
    return wrong


def agg(figure: Any) -> Any:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure)
    return figure


@pytest.mark.parametrize(("case", "name", "part"), list(cases()))
def test_a_report_figure_has_units_and_stays_inside(case: str, name: str, part: str) -> None:
    """Truth: geometry of every text artist."""
    detection: Detection = detections.ALL[case]()
    figure = agg(paint_plot(FIGURES[name], detection, part))
    assert outside(figure) == []
    assert unlabelled(figure) == []


@pytest.mark.parametrize("name", list(SHEETS))
def test_a_reproduced_figure_is_readable_in_print(name: str) -> None:
    """Truth: geometry, and the size of every letter at the printed width; no legend covers another."""
    figure = agg(paint(SHEETS[name], study()))
    assert outside(figure) == []
    assert unlabelled(figure) == []
    assert figure.get_figwidth() <= PRINTED
    assert min(text.get_fontsize() for text in texts(figure)) >= SMALLEST
    legends = [*figure.legends, *(a.get_legend() for a in figure.axes if a.get_legend())]
    boxes = [legend.get_window_extent(figure.canvas.get_renderer()) for legend in legends]
    assert boxes
    assert not any(a.overlaps(b) for i, a in enumerate(boxes) for b in boxes[i + 1 :])
    assert captions(study(), "mooringdx")[name].endswith("Made by: mooringdx")


def test_a_text_over_the_edge_and_an_axis_without_unit_are_seen() -> None:
    """Truth: two faults put in by hand."""
    figure = agg(paint(SHEETS["fig5_acf_whitened"], study()))
    figure.axes[0].set_ylabel("correlation")
    figure.text(0.99, 0.5, "a long word")
    assert len(outside(figure)) == 1
    assert unlabelled(figure) == ["y of 'r1, surge acceleration': 'correlation'"]
