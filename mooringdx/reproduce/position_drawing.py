"""Figures of [PositionThesis, chapter 5], one case each: track, positions, residuals, choice, probabilities, costs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from mooringdx.hypotheses.thesis_bank import NONE, ThesisBank, Weighed
from mooringdx.plots import canvas
from mooringdx.reproduce.position_cases import CASES, Case, Trial

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

WIDTH, DPI = 7.1, 160
POINTS = 500


@dataclass(frozen=True)
class Shown:
    """What one figure is made from: a case, its record, the bank and what it says."""

    case: Case
    record: Trial
    bank: ThesisBank
    weighed: Weighed


@dataclass(frozen=True)
class Sheet:
    """One figure: title, the place of its case in `CASES`, how it is drawn, its caption, and what is ``seen`` in it in
    a line over it.
    """

    title: str
    case: int
    draw: Callable[[Shown], Figure]
    caption: str
    seen: str


def paint(sheet: Sheet, shown: Shown) -> Figure:
    """Draw one figure in the house style, laid out once."""
    return painted(lambda: sheet.draw(shown), sheet.seen)


def painted(draw: Callable[[], Figure], seen: str) -> Figure:
    """Draw a figure in the house style with what is ``seen`` in it as a line over it, laid out once."""
    import matplotlib

    small: Any = {"legend.fontsize": 8.5, "xtick.labelsize": 8.5, "ytick.labelsize": 8.5}
    with matplotlib.rc_context({**canvas.STYLE, **small}):
        figure = draw()
        figure.suptitle(seen, x=0.01, ha="left", fontsize=10.5, fontweight="bold")
        figure.set_dpi(DPI)
        engine = figure.get_layout_engine()
        if engine is not None:
            engine.execute(figure)
            figure.set_layout_engine("none")
        return figure


def _onset(axes: Axes, shown: Shown) -> None:
    """Mark the loss and put the clock under the axes."""
    time = shown.record.time
    if shown.case.line != NONE:
        axes.axvline(shown.case.onset, color=canvas.RED, lw=1.1, ls=(0, (5, 2)), label="line lost")
    axes.set_xlim(0.0, float(2.0 * time[-1] - time[-2]))


def _thin(shown: Shown, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return canvas.envelope(shown.record.time, values, POINTS)


def track(shown: Shown) -> Figure:
    """Draw the measured and the estimated place in the plane, and the anchors' directions."""
    figure, axes = canvas.sheet(WIDTH, 5.2)
    panel, step = axes[0, 0], 10
    place = shown.weighed.watched.position[::step, -1]
    measured = shown.record.measured[::step]
    panel.plot(measured[:, 1], measured[:, 0], color="#b9c3cf", lw=0.6, label="measured")
    panel.plot(place[:, 1], place[:, 0], color=canvas.BLUE, lw=1.3, label="observer without a lost line")
    panel.plot(*shown.record.true[0, [1, 0]], "o", color=canvas.GREEN, ms=6, label="start")
    panel.set_aspect("equal", adjustable="datalim")
    panel.set_xlabel("east (m)")
    panel.set_ylabel("north (m)")
    panel.legend(loc="best")
    return figure


def positions(shown: Shown) -> Figure:
    """Draw north, east and heading over time, measured and estimated."""
    figure, axes = canvas.sheet(WIDTH, 5.0, nrows=3, sharex=True)
    unit, label = (1.0, 1.0, np.degrees(1.0)), ("north\n(m)", "east\n(m)", "heading\n(deg)")
    for i, panel in enumerate(axes[:, 0]):
        panel.plot(*_thin(shown, unit[i] * shown.record.measured[:, i]), color="#b9c3cf", lw=0.6, label="measured")
        place = unit[i] * shown.weighed.watched.position[:, -1, i]
        panel.plot(*_thin(shown, place), color=canvas.BLUE, lw=1.3, label="observer without a lost line")
        _onset(panel, shown)
        panel.set_ylabel(label[i])
    axes[0, 0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)
    axes[-1, 0].set_xlabel("time (s)")
    figure.align_ylabels()
    return figure


def residuals(shown: Shown) -> Figure:
    """Draw the innovations of two observers, that of the lost line and that of none, with means over 20 s."""
    figure, axes = canvas.sheet(WIDTH, 5.0, nrows=3, ncols=2, sharex=True, sharey="row")
    names = shown.bank.hypotheses
    pair = (names.index(shown.case.line) if shown.case.line != NONE else 0, names.index(NONE))
    label = ("north (m)", "east (m)", "heading (rad)")
    for column, h in enumerate(pair):
        for i, panel in enumerate(axes[:, column]):
            values = shown.weighed.watched.innovation[:, h, i]
            panel.plot(*_thin(shown, values), color="#b9c3cf", lw=0.5, label="each sample")
            slow = np.convolve(values, np.ones(200) / 200, mode="same")
            panel.plot(*_thin(shown, slow), color=canvas.BLUE, lw=1.3, label="mean over 20 s")
            _onset(panel, shown)
            if column == 0:
                panel.set_ylabel(label[i])
        said = "nothing lost" if h == names.index(NONE) else f"{names[h].replace('_', ' ')} lost"
        axes[0, column].set_title(f"Observer for {said}")
        axes[-1, column].set_xlabel("time (s)")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower left", ncols=3)
    figure.align_ylabels()
    return figure


def choice(shown: Shown) -> Figure:
    """Draw which scenario each method takes for true."""
    figure, axes = canvas.sheet(WIDTH, 3.4)
    panel, time, names = axes[0, 0], shown.record.time, shown.bank.hypotheses
    panel.step(time, shown.weighed.most_likely + 1, color=canvas.ORANGE, lw=2.6, label="most likely (MLE)")
    panel.step(time, shown.weighed.most_probable + 1, color=canvas.BLUE, lw=1.0, label="most probable (DHT)")
    _onset(panel, shown)
    panel.set_yticks(np.arange(1, len(names) + 1), [name.replace("_", " ") for name in names])
    panel.set_ylim(0.5, len(names) + 0.5)
    panel.set_ylabel("scenario")
    panel.set_xlabel("time (s)")
    panel.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3)
    return figure


def probabilities(shown: Shown) -> Figure:
    """Draw the probability of every hypothesis, one panel each."""
    names = shown.bank.hypotheses
    figure, axes = canvas.sheet(WIDTH, 6.4, nrows=len(names), sharex=True, sharey=True)
    for i, panel in enumerate(axes[:, 0]):
        panel.plot(*_thin(shown, shown.weighed.probability[:, i]), color=canvas.BLUE, lw=0.9)
        _onset(panel, shown)
        panel.set_ylim(-0.1, 1.1)
        panel.set_yticks([0.0, 1.0])
        panel.set_ylabel(names[i].replace("_", " "), rotation=0, ha="right", va="center")
    axes[0, 0].set_title("probability of every scenario (-)")
    axes[-1, 0].set_xlabel("time (s)")
    return figure


def likelihoods(shown: Shown) -> Figure:
    """Draw the negative log-likelihood of every scenario, and below it how far each is above the least."""
    figure, axes = canvas.sheet(WIDTH, 5.6, nrows=2, sharex=True)
    names, cost = shown.bank.hypotheses, shown.weighed.cost
    rows = ((cost, "negative\nlog-likelihood (-)"), (cost - cost.min(axis=1, keepdims=True), "above the least (-)"))
    for panel, (values, label) in zip(axes[:, 0], rows, strict=True):
        for i, name in enumerate(names):
            colour = canvas.INK if name == NONE else canvas.CYCLE[i % (len(canvas.CYCLE) - 1)]
            bold = name in (NONE, shown.case.line)
            style, width = "-" if bold else ("--", ":", "-.")[i % 3], 2.0 if bold else 1.0
            panel.plot(*_thin(shown, values[:, i]), color=colour, ls=style, lw=width, label=name.replace("_", " "))
        _onset(panel, shown)
        panel.set_ylabel(label)
    axes[0, 0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=5)
    axes[1, 0].set_xlabel("time (s)")
    figure.align_ylabels()
    return figure


SHEETS: Mapping[str, Sheet] = {
    "fig5_1_track": Sheet(
        "Fig. 5.1: track, nothing lost",
        0,
        track,
        "From 2 m north and 2 m east to rest. With one noise for both axes the measured places lie on a line.",
        "Nothing lost: with one noise for both axes every place lies on one line",
    ),
    "fig5_17_positions": Sheet(
        "Fig. 5.17: positions, line 7 lost",
        4,
        positions,
        "North, east and heading. The thrusters, limited here to 0.25 MN an axis, are weaker than the lost line's 0.46 "
        "MN and hold the vessel where it is; in the thesis they bring it back.",
        "Line 7 lost: the vessel goes away along it and does not come back",
    ),
    "fig5_11_residuals": Sheet(
        "Fig. 5.11: residuals, line 6 lost",
        2,
        residuals,
        "Innovations (grey) and their means over 20 s (blue) of the observer whose line is lost and of that of none: "
        "each is off by centimetres while it is wrong.",
        "Line 6 lost: centimetres of mean under decimetres of noise",
    ),
    "fig5_8_scenario": Sheet(
        "Fig. 5.8: scenario, nothing lost, with current",
        1,
        choice,
        "The current pulls as if line 6 were lost, which is what both methods are tempted to say.",
        "Nothing lost, with current: both methods first say line 6",
    ),
    "fig5_20_probabilities": Sheet(
        "Fig. 5.20: probabilities, line 7 lost",
        4,
        probabilities,
        "Lines 3 and 4 are the neighbours of line 7, and the likeliest mistakes.",
        "Line 7 lost: from none to line 7, past its neighbours 3 and 4",
    ),
    "fig5_28_likelihoods": Sheet(
        "Fig. 5.28: likelihoods, line 8 lost, with current",
        7,
        likelihoods,
        "The current makes up for about a third of the lost line, so that none stays nearly as likely as the truth.",
        "Line 8 lost, with current: line 8 and none stay close to each other",
    ),
}


def captions(command: str) -> dict[str, str]:
    """Return the captions by name, each with its case, its bench and the command that makes the figure."""
    return {
        name: f"{s.title}. {s.caption} Case: {CASES[s.case].name}; printed bank, shared noise. Made by: {command}"
        for name, s in SHEETS.items()
    }
