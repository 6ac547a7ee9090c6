"""Figures of [PositionThesis, chapter 5] for the onset bank: track, positions, residuals, posterior, score."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mooringdx.hypotheses.onset_glr import OnsetGlr
from mooringdx.hypotheses.thesis_bank import NONE
from mooringdx.observers.kalman import Estimate, Filter
from mooringdx.plots import canvas
from mooringdx.reproduce.position_cases import CASES, Case, Trial, trial
from mooringdx.reproduce.position_drawing import WIDTH
from mooringdx.reproduce.position_ours import EARLIER, WARM, channels_of, line_score, longer
from mooringdx.simulate.scenario import Scenario
from mooringdx.types import Array, Event, Posterior

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

GREY = "#b9c3cf"
FLOOR, TOP = -25.0, 15.0
"""Score between which it is drawn, nats."""
WHOLE, NEAR = (-400.0, 1000.0), (250.0, 650.0)
"""s of the thesis's clock between which figures are drawn, and the posterior."""


@dataclass(frozen=True)
class Seen:
    """One case as the bank saw it. ``estimate``: of the filter that knows of no loss, samples ``bank.step`` apart."""

    case: Case
    record: Trial
    bank: OnsetGlr
    posterior: Posterior
    events: tuple[Event, ...]
    estimate: Estimate

    @property
    def alarm(self) -> float | None:
        """The first alarm after the loss, s on the thesis's clock."""
        late = [e.detected - EARLIER for e in self.events if e.detected - EARLIER >= self.case.onset]
        return min(late) if late else None


@dataclass(frozen=True)
class OurSheet:
    """One figure: title, how it is drawn from all cases, its caption, and what is seen in it."""

    title: str
    draw: Callable[[Sequence[Seen]], Figure]
    caption: str
    seen: str


def looked(base: Scenario, case: Case, bank: OnsetGlr, seed: int) -> Seen:
    """Return the first record of a case as the bank sees it."""
    record = trial(longer(base, case), (seed, 0), shared=False)
    posterior, events, _ = bank(channels_of(record))
    n, thin = len(record.time) // bank.thin, bank.thin
    eta = record.measured[: n * thin : thin]
    force = record.thrust[: n * thin].reshape(n, thin, 3).mean(axis=1)
    estimate = Filter(bank.plant, bank.noise, bank.step, bank.mooring, bank.place)(eta, force, bias=bank.bias)
    return Seen(case, record, bank, posterior, events, estimate)


def _of(seen: Sequence[Seen], case: int) -> Seen:
    return next(s for s in seen if s.case is CASES[case])


def _marks(panel: Axes, one: Seen, span: tuple[float, float] = WHOLE) -> None:
    """Mark the loss and the alarm, shade what the bank does not hear, and show ``span`` of the thesis's clock, s."""
    if one.case.line != NONE:
        panel.axvline(one.case.onset, color=canvas.RED, lw=1.2, ls=(0, (5, 2)), label="line lost")
    if one.alarm is not None:
        panel.axvline(one.alarm, color=canvas.PURPLE, lw=1.2, ls=(0, (1, 1)), label="alarm")
    if span[0] < WARM - EARLIER:
        panel.axvspan(-EARLIER, WARM - EARLIER, color=canvas.GAP, lw=0, zorder=0, label="not listening yet")
    panel.set_xlim(*span)


def _legend(figure: Figure, panels: Sequence[Axes], columns: int) -> None:
    """Put one legend of all panels' marks under the figure."""
    names: dict[str, Artist] = {}
    for panel in panels:
        for handle, label in zip(*panel.get_legend_handles_labels(), strict=True):
            names.setdefault(label, handle)
    figure.legend(list(names.values()), list(names), loc="outside lower left", ncols=columns)


def _clock(one: Seen) -> Array:
    """Return the filter's samples on the thesis's clock, s."""
    return np.asarray(one.bank.step * np.arange(len(one.estimate.position)) - EARLIER)


def track(seen: Sequence[Seen]) -> Figure:
    """Draw the measured and the estimated place in the plane: nothing lost, and line 7 lost."""
    figure, axes = canvas.sheet(WIDTH, 4.4, ncols=2)
    for panel, one in zip(axes[0], (_of(seen, 0), _of(seen, 4)), strict=True):
        place, clock = one.estimate.position, _clock(one)
        alarm = one.alarm if one.alarm is not None else np.inf
        loss = one.case.onset if one.case.line != NONE else np.inf
        fix = one.record.measured[round(WARM / one.record.time[1]) :: 10]
        panel.plot(fix[:, 1], fix[:, 0], color=GREY, lw=0.6, label="measured")
        parts = (
            ((clock >= WARM - EARLIER) & (clock < loss), canvas.GREEN, "filter, nothing lost"),
            ((clock >= loss) & (clock < alarm), canvas.ORANGE, "filter, from the loss to the alarm"),
            (clock >= alarm, canvas.BLUE, "filter, after the alarm"),
        )
        for mask, colour, label in parts:
            panel.plot(place[mask, 1], place[mask, 0], color=colour, lw=1.8, label=label)
        panel.set_aspect("equal", adjustable="datalim")
        panel.set_title(_title(one))
        panel.set_xlabel("east (m)")
        panel.set_ylabel("north (m)")
    _legend(figure, list(axes[0]), 4)
    return figure


def positions(seen: Sequence[Seen]) -> Figure:
    """Draw north, east and heading over time, line 7 lost."""
    one, scale = _of(seen, 4), (1.0, 1.0, float(np.degrees(1.0)))

    def draw(panel: Axes, i: int) -> None:
        fix = canvas.envelope(one.record.time - EARLIER, scale[i] * one.record.measured[:, i], 600)
        panel.plot(*fix, color=GREY, lw=0.6, label="measured")
        panel.plot(_clock(one), scale[i] * one.estimate.position[:, i], color=canvas.BLUE, lw=1.3, label="filter")

    return _three(one, ("north (m)", "east (m)", "heading (deg)"), draw)


def residuals(seen: Sequence[Seen]) -> Figure:
    """Draw the innovations of the one filter with means over 20 s, line 6 lost."""
    one = _of(seen, 2)
    width = max(1, round(20.0 / one.bank.step))

    def draw(panel: Axes, i: int) -> None:
        values = np.nan_to_num(one.estimate.innovation[:, i])
        panel.plot(_clock(one), values, color=GREY, lw=0.6, label="each sample")
        mean = np.convolve(values, np.ones(width) / width)[: len(values)]
        panel.plot(_clock(one), mean, color=canvas.BLUE, lw=1.3, label="mean over the last 20 s")

    return _three(one, ("north (m)", "east (m)", "heading (rad)"), draw)


def _three(one: Seen, labels: Sequence[str], draw: Callable[[Axes, int], None]) -> Figure:
    """Draw a panel for each of north, east and heading over time, with the loss and the alarm marked."""
    figure, axes = canvas.sheet(WIDTH, 5.4, nrows=3, sharex=True)
    for i, (panel, label) in enumerate(zip(axes[:, 0], labels, strict=True)):
        draw(panel, i)
        _marks(panel, one)
        panel.set_ylabel(label)
    axes[-1, 0].set_xlabel("time (s, the thesis's clock)")
    figure.align_ylabels()
    _legend(figure, list(axes[:, 0]), 5)
    return figure


def posterior(seen: Sequence[Seen]) -> Figure:
    """Draw the probability of the scenarios over time, a panel a case."""
    figure, axes = canvas.sheet(WIDTH, 8.0, nrows=4, ncols=2, sharex=True, sharey=True)
    for panel, one in zip(axes.ravel(), seen, strict=True):
        lines = one.bank.mooring.names
        p = one.posterior.probability[::10]
        clock = one.posterior.time[::10] - EARLIER
        own = 1 + lines.index(one.case.line) if one.case.line != NONE else -1
        others = [1 + j for j in range(len(lines)) if 1 + j != own]
        curves = [
            (p[:, 0], canvas.INK, "-", "no fault"),
            (p[:, others].sum(axis=1), canvas.ORANGE, "--", "any other line"),
            (p[:, 1 + len(lines)], canvas.GREEN, "-.", "environment"),
            (p[:, 2 + len(lines)], canvas.SKY, "-", "wave group"),
        ]
        if own >= 0:
            curves.insert(1, (p[:, own], canvas.BLUE, "-", "the lost line"))
        said = (clock >= NEAR[0]) & (clock <= NEAR[1])
        for values, colour, style, label in curves:
            wide = 2.2 if label == "the lost line" else 1.2
            panel.plot(clock[said], values[said], color=colour, ls=style, lw=wide, label=label)
        _marks(panel, one, NEAR)
        panel.set_title(_title(one))
        panel.set_ylim(-0.04, 1.06)
    _outside(figure, axes, "probability (-)")
    return figure


def score(seen: Sequence[Seen]) -> Figure:
    """Draw the score up to the naming, with the levels of warning and alarm, a panel a case."""
    figure, axes = canvas.sheet(WIDTH, 8.0, nrows=4, ncols=2, sharex=True, sharey=True)
    for panel, one in zip(axes.ravel(), seen, strict=True):
        clock = one.posterior.time[::10] - EARLIER
        values = line_score(one.posterior, len(one.bank.mooring.names))[::10]
        named = [e.named for e in one.events if e.named is not None]
        until = (clock >= WARM - EARLIER) & (clock <= (min(named) - EARLIER if named else np.inf))
        panel.plot(clock[until], np.clip(values[until], FLOOR, TOP), color=canvas.BLUE, lw=1.4, label="score")
        panel.axhline(one.bank.warning, color=canvas.ORANGE, lw=1.1, ls="--", label="warning level")
        panel.axhline(one.bank.alarm, color=canvas.INK, lw=1.1, label="alarm level")
        _marks(panel, one)
        panel.set_title(_title(one))
        panel.set_ylim(FLOOR - 2.0, TOP + 2.0)
    _outside(figure, axes, "score (nats)")
    return figure


def _title(one: Seen) -> str:
    """Return the case and what was said of it."""
    name = one.case.line.replace("_", " ") + " lost" if one.case.line != NONE else "nothing lost"
    name += ", current" if one.case.pull else ""
    if one.alarm is None:
        false = len(one.events)
        return f"{name}: " + ("no alarm" if not false else f"{false} false alarms")
    hit = min((e for e in one.events if e.detected - EARLIER >= one.case.onset), key=lambda e: e.detected)
    return f"{name}: {hit.subject.replace('_', ' ')} after {one.alarm - one.case.onset:.0f} s"


def _outside(figure: Figure, axes: np.ndarray, label: str) -> None:
    """Label the outer axes and put one legend under them."""
    for panel in axes[:, 0]:
        panel.set_ylabel(label)
    for panel in axes[-1]:
        panel.set_xlabel("time (s, the thesis's clock)")
    _legend(figure, list(axes.ravel()), 4)


_CLOCK = (
    "Time is that of the thesis's record, which begins at 0; this one begins 900 s earlier, and the bank hears nothing "
    "for its first 600 s."
)
OUR_SHEETS: Mapping[str, OurSheet] = {
    "ours_posterior": OurSheet(
        "Our default: posterior of the scenarios, eight cases",
        posterior,
        "A step of force may be the environment's until it has the size and the direction of a line, and a wave group "
        "until it has outlasted one. After the naming the bank begins anew without the line, and its probability then "
        f"stands for no further fault. {_CLOCK}",
        "From no fault, by way of environment or wave group, to the lost line",
    ),
    "ours_score": OurSheet(
        "Our default: score, eight cases",
        score,
        f"Log odds of a lost line against no fault, environment and wave group, up to the naming; cut at {FLOOR:.0f} "
        f"and {TOP:.0f}. Line 7 points into the sea, where wave groups push: its loss must outlast them. {_CLOCK}",
        "The score crosses warning and alarm level within seconds of each other",
    ),
    "ours_track": OurSheet(
        "Our default: track, nothing lost, and line 7 lost",
        track,
        "With independent noise the fixes fill the plane. The filter is the one behind all scenarios; it knows of no "
        "loss and follows all the same, because its bias force is alive. From the end of the warm-up on.",
        "Fixes fill the plane, and how far the vessel had gone when the alarm came",
    ),
    "ours_positions": OurSheet(
        "Our default: positions, line 7 lost",
        positions,
        f"North, east and heading, measured and filtered. {_CLOCK}",
        "Line 7 lost: the filter follows the vessel through the loss",
    ),
    "ours_residuals": OurSheet(
        "Our default: residuals, line 6 lost",
        residuals,
        "Innovations of the one filter (grey, every second) and their means over the last 20 s (blue). On the beam, "
        "where this sea pushes little, its bias force is slow to learn the loss and the innovations grow to metres; "
        f"what sounds the alarm is their first half minute. {_CLOCK}",
        "Line 6 lost: innovations leave zero, and the alarm comes long before their peak",
    ),
}


def our_captions(command: str) -> dict[str, str]:
    """Return the captions by name, each with the command that makes the figure."""
    return {name: f"{s.title}. {s.caption} Independent noise. Made by: {command}" for name, s in OUR_SHEETS.items()}
