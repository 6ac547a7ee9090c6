"""The vessel seen from above: where it lay with nothing wrong, and where it went after the onset."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from mooringdx.plots import canvas
from mooringdx.types import Array, Detection, Event

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

PAIRS = (("east", "north"), ("sway", "surge"), ("longitude", "latitude"))
STEPS = 48


def pair(detection: Detection) -> tuple[str, str] | None:
    """Return the (across, up) channels of the track, or None when no pair was logged."""
    names = detection.channels.names
    return next((p for p in PAIRS if p[0] in names and p[1] in names), None)


def parts(detection: Detection) -> tuple[str, ...]:
    """Return one part where both coordinates have valid samples."""
    found = pair(detection)
    if found is None:
        return ()
    both = np.isfinite(detection.channels.column(found[0])) & np.isfinite(detection.channels.column(found[1]))
    return ("",) if bool(both.any()) else ()


def draw(detection: Detection, _part: str) -> Figure:
    """Draw the track; axes have equal scale."""
    found = pair(detection)
    assert found is not None
    c = detection.channels
    xy = np.column_stack([c.column(found[0]), c.column(found[1])])
    factor, unit = canvas.display(c.units[c.names.index(found[0])], xy)
    xy = xy * factor
    figure, axes = canvas.sheet(8.2, 5.6)
    panel = axes[0, 0]
    _cloud(panel, detection, xy)
    lead = min(detection.events, key=lambda e: e.onset, default=None)
    if lead is not None:
        _drift(figure, panel, detection, xy, lead)
    neutral = np.nanmedian(xy[canvas.quiet(detection)], axis=0)
    if np.isfinite(neutral).all():
        panel.plot(*neutral, "+", ms=13, mew=2.2, color=canvas.INK, label="neutral point", zorder=7)
    panel.set_xlabel(f"{found[0]} ({unit})")
    panel.set_ylabel(f"{found[1]} ({unit})")
    panel.set_aspect("equal", adjustable="datalim")
    panel.locator_params(nbins=7)
    panel.legend(loc="upper left", bbox_to_anchor=(0.0, -0.12), ncols=4, borderaxespad=0.0, handletextpad=0.4)
    return figure


def _cloud(panel: Axes, detection: Detection, xy: Array) -> None:
    """Draw all positions faintly and those of the no-fault record in blue."""
    mask = canvas.quiet(detection)
    for rows, colour, label in (
        (np.flatnonzero(~mask), "#c9ccd2", "other positions"),
        (np.flatnonzero(mask), canvas.SKY, canvas.quiet_words(detection).removeprefix("the ")),
    ):
        if rows.size:
            some = xy[rows[:: max(1, rows.size // 3000)]]
            panel.plot(*some.T, ".", ms=2.2, color=colour, alpha=0.6, label=label, zorder=2, rasterized=True)


def _drift(figure: Figure, panel: Axes, detection: Detection, xy: Array, event: Event) -> None:
    """Draw the mean path after the onset, coloured by the time since then."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    grid = detection.channels.grid
    first = grid.index(event.onset)
    stop = grid.n if event.cleared is None else grid.index(event.cleared)
    path = _block_means(xy[first:stop])
    if path.shape[0] == 0:
        return
    span = (stop - first) * grid.sample_time
    per, unit = next((p, u) for p, u in ((86400.0, "d"), (3600.0, "h"), (1.0, "s")) if span >= 2 * p or p == 1.0)
    shades = ScalarMappable(Normalize(0.0, span / per), "viridis_r")
    panel.plot(*path.T, color=canvas.INK, lw=0.8, alpha=0.55, zorder=4)
    since = (np.arange(path.shape[0]) + 0.5) / path.shape[0] * span / per
    panel.scatter(
        path[:, 0], path[:, 1], c=shades.to_rgba(since), s=15, zorder=5, linewidths=0, label="mean path after onset"
    )
    bar = figure.colorbar(shades, ax=panel, pad=0.02, fraction=0.04)
    bar.set_label(f"time since onset of event {detection.events.index(event) + 1} ({unit})")
    for time, marker, label in ((event.onset, "^", "onset"), (event.detected, "o", "detected")):
        spot = _near(xy, grid.index(time))
        if spot is not None:
            panel.plot(
                *spot, marker, ms=9, mfc="none", mec=canvas.RED, mew=1.8, ls="none", label=label, zorder=6
            )  # fmt: skip
    panel.plot(*path[-1], "s", ms=8, mfc="none", mec=canvas.RED, mew=1.8, ls="none", zorder=6, label=_last(event))


def _last(event: Event) -> str:
    return "end of log" if event.cleared is None else "cleared"


def _block_means(xy: Array) -> Array:
    """Return at most `STEPS` means of equal stretches, (k, 2), leaving out stretches without samples."""
    count = min(STEPS, xy.shape[0])
    means = [block[np.isfinite(block).all(axis=1)] for block in np.array_split(xy, count)] if count else []
    kept = [block.mean(axis=0) for block in means if block.shape[0]]
    return np.asarray(kept, dtype=np.float64).reshape(-1, 2)


def _near(xy: Array, index: int) -> Array | None:
    """Return the valid position at ``index`` or the next one, (2,)."""
    later = np.flatnonzero(np.isfinite(xy[index:]).all(axis=1))
    return np.asarray(xy[index + later[0]]) if later.size else None


def caption(detection: Detection, _part: str) -> str:
    """Say what the track shows."""
    words = f"Track from above, equal scales. Light blue: {canvas.quiet_words(detection)}; cross: its median."
    if detection.events:
        words += (
            " Dots on the line: mean position of equal stretches after the first onset, darker with time."
            " A lost line shows as a new mean position away from its anchor; waves alone only widen the cloud."
        )
    return words
