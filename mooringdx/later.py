"""A second fault while the first still stands in alarm: what no alarm can announce."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mooringdx import decide
from mooringdx.scene import Index, Scene
from mooringdx.testify import Hearing, applied, tell
from mooringdx.types import Event, replace


def later(scene: Scene, alarm: decide.Alarm, first: Event) -> list[Event]:
    """Return the faults that came while ``first`` still stood in alarm, which no alarm can announce.

    Window by window, the raw mean is held against that of the window after the naming. What the standing faults may do
    to it is taken out: any change of their size, and their signatures' own error. What is left must pass the level of
    the main branch in two windows running; it is named like any other. A second fault smaller than what the first
    leaves unexplained is not seen.
    """
    grid, window = scene.channels.grid, scene.fitted.timing.window
    standing = [first]
    out: list[Event] = []
    at = round(((first.named or first.detected) - grid.start) / grid.sample_time)
    end = grid.n if alarm.stop is None else alarm.stop
    still = slice(at, at + window)
    passed = 0
    for stop in range(at + 2 * window, end + 1, window):
        chosen, peak, rows = _against(scene, still, slice(stop - window, stop), standing)
        passed = passed + 1 if chosen is not None and peak > scene.fitted.thresholds[0].scaled_level else 0
        if passed < 2 or chosen is None:
            continue
        event = _later_event(scene, chosen, peak, still, stop, rows)
        out.append(event)
        standing.append(event)
        passed = 0
    return out


def _against(
    scene: Scene, still: slice, look: slice, standing: Sequence[Event]
) -> tuple[decide.Name | None, float, Index]:
    """Weigh the change from window ``still`` to ``look``, the standing faults taken out: (name, largest g, rows)."""
    measured = scene.residuals
    good = [measured.valid[part].mean(axis=0) >= 0.5 for part in (still, look)]
    taken = {f"tension_{e.subject.split('_', 1)[-1]} - intact" for e in standing}  # a lost line's statics say nothing
    rows = np.flatnonzero(good[0] & good[1] & np.array([name not in taken for name in measured.names]))
    if not len(rows):
        return None, 0.0, rows
    means = [np.nanmean(measured.values[part][:, rows], axis=0) for part in (look, still)]
    change, count = means[0] - means[1], look.stop - look.start
    known = decide.part(measured.signatures, rows)
    spread = 2.0 * scene.covariance(rows) / count + np.diag(scene.doubt(look)[rows] ** 2)
    for event in standing:
        for i, fault in enumerate(known.faults):
            size = event.evidence.get("tension_change", event.size)
            if fault.subject == event.subject and size is not None:
                direction = known.matrix[i]
                spread = spread + np.diag((size * known.error[i]) ** 2)
                spread = spread + (10.0 * size) ** 2 * np.outer(direction, direction)
    inverse = np.linalg.inv(spread)
    energy = np.einsum("fr,rs,fs->f", known.matrix, inverse, known.matrix)
    score = known.matrix @ inverse @ change
    right = (energy > 0) & (score * known.sign >= 0)
    peak = float(np.max(np.where(right, score**2 / np.where(energy > 0, 2.0 * energy, 1.0), 0.0)))
    scores, misfit = decide.weigh(change, count, known, spread * count)
    chosen = decide.name(decide.level_alike(scores, change, known, spread))
    return (None if chosen is None else replace(chosen, misfit=float(misfit[chosen.winner]))), peak, rows


def _later_event(scene: Scene, chosen: decide.Name, peak: float, still: slice, stop: int, rows: Index) -> Event:
    """Return the event of a fault found in two windows that end at ``stop``."""
    grid, window, signatures = scene.channels.grid, scene.fitted.timing.window, scene.residuals.signatures
    fault = signatures.faults[chosen.winner]
    last = slice(stop - window, stop)
    values = scene.residuals.values[last][:, rows] - np.nanmean(scene.residuals.values[still][:, rows], axis=0)
    covariance = 2.0 * scene.covariance(rows)
    known = decide.part(signatures, rows)
    size = decide.size(values, scene.residuals.valid[last][:, rows], known, chosen.winner, covariance)
    time = grid.start + grid.sample_time * np.array([stop - 3 * window, stop - 2 * window, stop - window, stop - 1])
    level = scene.fitted.thresholds[0].scaled_level
    event = Event(
        kind="unknown" if fault.kind == "environment" and chosen.misfit > decide.POOR_FIT else fault.kind,
        subject=fault.subject,
        mode=fault.mode,
        onset=float(time[1]),
        onset_interval=(float(time[0]), float(time[2])),
        detected=float(time[2]),
        named=float(time[3]),
        size=None if size is None else size[0],
        size_unit=signatures.units[chosen.winner],
        size_interval=None if size is None else size[1],
        probability=chosen.probability,
        rivals=decide.rivals(signatures, chosen, rows),
        cannot_tell=decide.cannot_tell(signatures, chosen, rows),
        evidence={
            "detector": "change while another fault stands",
            "peak": peak,
            "threshold": level,
            "channels": [scene.residuals.names[i] for i in rows],
        },
        marks=("while_another_stands",),
    )
    if scene.forces is None:
        return event
    onset = (stop - 2 * window, stop - 3 * window, stop - window)
    told = tell(Hearing(scene.residuals, scene.forces, scene.fitted.testimony, covariance, rows, onset, grid.n), chosen)
    at = grid.start + grid.sample_time * (stop if told is None else told.at)
    return event if told is None else applied(event, told, signatures, at)
