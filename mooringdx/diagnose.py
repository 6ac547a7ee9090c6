"""From what the detectors saw to events with a name, an onset, a size and rivals.

The alarm may come from any branch; the name, the onset and the size come from the raw residuals: compressed ones
saturate, and a step in a whitened one is a transient first, so that both bend the direction of a large fault. The
window that names ends one window after the alarm. What the alignment found in the data themselves (a channel held
while the others move, a late clock) is an event of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from mooringdx import decide
from mooringdx.checks import LEAST_JUDGED, SEA, agitation, shows_sea
from mooringdx.later import later
from mooringdx.scene import Index, Scene
from mooringdx.testify import Hearing, applied, tell
from mooringdx.types import Channels, Defect, Event, Fault, Posterior, Rival, Statistic, replace

FAULTS = ("line_lost", "line_parted_low", "line_weakened", "sensor_fault", "actuator_fault", "mooring_lost")
LONGEST_BLIND = 4.0
_WEAKENED = 0.85


def find(scene: Scene) -> tuple[Event, ...]:
    """Return all events of the detectors and of the data's own defects, in order of onset."""
    timing, alarm = scene.fitted.timing, scene.run.alarm
    hold = 2 * timing.window
    seas = scene.seas() if timing.memory == 0 else np.ones(1)
    least = max(1, round(alarm.min_duration / timing.sample_time))
    found = []
    for statistic, threshold in zip(scene.walk.statistics, scene.fitted.thresholds, strict=True):
        ratio = decide.peak_ratio(statistic, threshold)
        if timing.memory == 0 and statistic.branch != "slow":
            ratio = ratio / seas**2  # a following reference scales itself
        found += decide.alarms(statistic.branch, ratio, alarm.hysteresis, hold, least)
    events = []
    for one in decide.merge(found, hold):
        events.append(_event(scene, one))
        events += later(scene, one, events[-1])
    events += [_defect_event(scene, d) for d in scene.channels.defects if d.alarming]
    return tuple(sorted(events, key=lambda e: (e.onset, e.detected, e.subject)))


def _event(scene: Scene, alarm: decide.Alarm) -> Event:
    """Name one alarm."""
    timing, grid = scene.fitted.timing, scene.channels.grid
    slow = alarm.branches == ("slow",)
    window = timing.slow if slow else timing.window
    at = alarm.peak_at if slow else _naming(scene, alarm, window)
    look = slice(max(0, at - window + 1), at + 1)
    rows = np.flatnonzero(scene.residuals.valid[look].mean(axis=0) >= 0.5)
    chosen, moved = _name(scene, alarm, look, rows)
    early, end = at, _end(scene, alarm)
    if moved > -decide.RIVAL_GAP and end - at > 2 * window:  # what a moved vessel explains may have grown since
        last = slice(end - window, end)
        visible = np.flatnonzero(scene.residuals.valid[last].mean(axis=0) >= 0.5)
        again, still = _name(scene, alarm, last, visible)
        if again is not None and still <= -decide.RIVAL_GAP:
            chosen, moved, rows, at = again, still, visible, end - 1
    first, low, high = (max(0, k - scene.late) for k in _onset(scene, alarm, early, rows, chosen))
    time = grid.start + grid.sample_time * np.array([alarm.start, at, first, low, high])
    common: dict[str, Any] = {
        "onset": float(time[2]),
        "onset_interval": (float(time[3]), float(time[4])),
        "detected": float(time[0]),
        "named": float(time[1]),
        "cleared": None if alarm.stop is None else grid.start + grid.sample_time * alarm.stop,
        "evidence": _evidence(scene, alarm, rows),
    }
    marks = _marks(scene, alarm)
    if chosen is None:
        why = "every residual was masked in the window that would name the cause"
        return Event(kind="unknown", subject="log", cannot_tell=why, marks=marks, **common)
    signatures = scene.residuals.signatures
    fault = signatures.faults[chosen.winner]
    size = _size(scene, alarm, _size_window(scene, alarm, first, at), chosen.winner, rows)
    kind, mode = _kind(scene, fault, chosen.winner, size, first, alarm)
    if mode == "drift":  # a step's likelihood dates a slow onset late
        low = max(0, low - 2 * window)
        common["onset_interval"] = (grid.start + grid.sample_time * low, common["onset_interval"][1])
    if kind == "environment" and chosen.misfit > decide.POOR_FIT:
        kind = "unknown"
    event = Event(
        kind=kind,
        subject=fault.subject,
        mode=mode,
        size=None if size is None else size[0],
        size_unit=signatures.units[chosen.winner],
        size_interval=None if size is None else size[1],
        probability=chosen.probability,
        rivals=decide.rivals(signatures, chosen, rows),
        cannot_tell=decide.cannot_tell(signatures, chosen, rows),
        marks=(*marks, "poorly_explained") if chosen.misfit > decide.POOR_FIT else marks,
        **common,
    )
    if moved > -decide.RIVAL_GAP:
        return _environment(event, moved)
    event = _testified(scene, alarm, event, chosen, (first, low, high), rows)
    told = round(((event.named or event.detected) - grid.start) / grid.sample_time)
    if told > alarm.start + 4 * window:  # told where the change had grown: so is its size
        at = min(told, end) - 1
        size = _size(scene, alarm, _size_window(scene, alarm, first, at), chosen.winner, rows)
        event = event if size is None else replace(event, size=size[0], size_interval=size[1])
    return _sized(scene, event, _size_window(scene, alarm, first, at))


def _naming(scene: Scene, alarm: decide.Alarm, window: int) -> int:
    """Return the last sample of the first window after the alarm of which half is valid, while the alarm stands."""
    good = np.concatenate([[0], np.cumsum(scene.residuals.valid.any(axis=1))])
    end = max(alarm.start, _end(scene, alarm) - 1)
    first = min(alarm.start + window, scene.channels.grid.n - 1)
    for at in range(first, end + 1):
        if good[at + 1] - good[max(0, at - window + 1)] >= 0.5 * window:
            return at
    return first


def _testified(
    scene: Scene, alarm: decide.Alarm, event: Event, chosen: decide.Name, onset: tuple[int, int, int], rows: Index
) -> Event:
    """Return the event with line and sensor told apart by the balance of forces, where a vessel is known."""
    if scene.forces is None:
        return event
    covariance, rough = scene.covariance(rows, alarm.start), scene.beyond(alarm.start)
    end = _end(scene, alarm)
    told = tell(
        Hearing(scene.residuals, scene.forces, scene.fitted.testimony, covariance, rows, onset, end, rough), chosen
    )
    if told is None:
        return event
    grid = scene.channels.grid
    event = applied(event, told, scene.residuals.signatures, grid.start + grid.sample_time * told.at)
    if event.kind != "sensor_fault":
        return event
    fault = scene.residuals.signatures.faults[told.sensor]
    return replace(event, mode=_kind(scene, fault, told.sensor, None, onset[0], alarm)[1])


def _environment(event: Event, moved: float) -> Event:
    """Return the event as one of the environment: a vessel that was only moved explains it, no fault needs to.

    The best fault stays as its rival: its size was fitted, which is worth up to RIVAL_GAP of log-likelihood by itself.
    """
    share = float(1.0 / (1.0 + np.exp(moved + decide.RIVAL_GAP)))
    fault = Rival(event.kind, event.subject, share, "a vessel that was only moved shows as much")
    return replace(
        event, kind="environment", subject="position", mode=None, size=None, size_interval=None, size_unit="",
        probability=1.0 - share, rivals=(fault,), cannot_tell=None,
    )  # fmt: skip


def _sized(scene: Scene, event: Event, look: slice) -> Event:
    """Return a line's event with its kind by what is left of the tension, and a buoy's loss as a share."""
    part = scene.tension
    if part is None or not event.kind.startswith("line_") or event.size is None or event.size_interval is None:
        return event
    sd = (event.size_interval[1] - event.size_interval[0]) / 3.92
    distance = part.distances(scene.channels)[look]
    kind = part.kind(event.subject, event.size, sd, distance)
    figures = {**event.evidence, "tension_change": event.size, "tension_change_interval": list(event.size_interval)}
    if kind == "line_weakened" and event.size > 0.0 and len(part.levels) > 1:
        share, low, high = part.share(event.subject, event.size, sd, distance)
        return replace(
            event, kind=kind, mode="buoyancy", size=share, size_unit="share of buoyancy", size_interval=(low, high),
            evidence=figures,
        )  # fmt: skip
    if kind == "line_weakened":
        return replace(event, kind=kind, mode=None, evidence=figures)
    whole = part.intact(event.subject, distance)
    low, high = (-x / whole for x in reversed(event.size_interval))
    return replace(
        event, kind=kind, mode=None, size=-event.size / whole, size_unit="share of tension", size_interval=(low, high),
        evidence=figures,
    )  # fmt: skip


def _name(scene: Scene, alarm: decide.Alarm, look: slice, rows: Index) -> tuple[decide.Name | None, float]:
    """Weigh the faults on the raw residuals ``rows`` that are valid in the window ``look``.

    The second value is the log-likelihood ratio of a vessel that was only moved, over the best fault.
    """
    measured = scene.residuals
    good = measured.valid[look][:, rows].all(axis=1)
    if not len(rows) or not good.any():
        return None, -np.inf
    mean = measured.values[look][good][:, rows].mean(axis=0) - scene.reference(alarm, rows)
    count, doubt = int(good.sum()), scene.doubt(look)[rows]
    covariance = scene.covariance(rows, alarm.start) + count * np.diag(doubt**2)
    known = decide.part(measured.signatures, rows)
    scores, misfit = decide.weigh(mean, count, known, covariance)
    levelled = decide.level_alike(scores, mean, known, covariance)
    chosen = decide.name(levelled)
    if chosen is None:
        return None, -np.inf
    moved = decide.unmoved(mean, covariance / count) - float(levelled[chosen.winner]) if doubt.any() else -np.inf
    twins = [
        chosen.winner,
        *(r for r, _ in chosen.rivals if decide.alike(known, chosen.winner, r, np.arange(len(rows)))),
    ]
    return replace(chosen, misfit=float(min(misfit[r] for r in twins))), moved


def _onset(scene: Scene, alarm: decide.Alarm, at: int, rows: Index, chosen: decide.Name | None) -> tuple[int, int, int]:
    """Return the onset sample and its interval for the named fault; the alarm itself when nothing was named."""
    if chosen is None:
        return alarm.start, alarm.start, alarm.start
    timing = scene.fitted.timing
    back = max(timing.slow, 2 * timing.window) if alarm.branches == ("slow",) else 2 * timing.window
    while True:
        found = _onset_within(scene, alarm, at, rows, chosen.winner, back)
        if found[1] > max(0, alarm.start - back) or back >= min(alarm.start, 32 * timing.window):
            return found
        back *= 2  # the interval touches the end of the search: look further back


def _onset_within(
    scene: Scene, alarm: decide.Alarm, at: int, rows: Index, winner: int, back: int
) -> tuple[int, int, int]:
    measured, first = scene.residuals, max(0, alarm.start - back)
    direction = np.asarray(measured.signatures.matrix)[winner][rows]
    weight = np.linalg.solve(scene.covariance(rows), direction)
    stretch = slice(first, at + 1)
    good = np.asarray(measured.valid[stretch][:, rows].all(axis=1), dtype=np.bool_)
    still = scene.reference(alarm, rows)
    u = np.where(good, (np.nan_to_num(measured.values[stretch][:, rows]) - still) @ weight, 0.0)
    energy = float(weight @ direction)
    before = u[: max(alarm.start - first - scene.fitted.timing.window, 0)]
    roughness = float(np.var(before)) / energy if before.size > 8 else 1.0
    found = decide.onset(u, good, energy, 0, at - first, alarm.start - first, roughness)
    return first + found[0], first + found[1], first + found[2]


def _size(
    scene: Scene, alarm: decide.Alarm, look: slice, winner: int, rows: Index
) -> tuple[float, tuple[float, float]] | None:
    """Return size and interval from raw residuals, the last two of the three windows after the alarm."""
    measured = scene.residuals
    begin, last = look.start, look.stop
    still = scene.reference(alarm, rows)
    values = measured.values[begin:last][:, rows] - still
    covariance = scene.covariance(rows, alarm.start)
    signatures = decide.part(measured.signatures, rows)
    return decide.size(values, measured.valid[begin:last][:, rows], signatures, winner, covariance)


def _size_window(scene: Scene, alarm: decide.Alarm, first: int, named: int) -> slice:
    """Return two windows: up to three windows after the alarm, or up to where the cause was named if that was later."""
    timing = scene.fitted.timing
    last = min(max(alarm.start + 3 * timing.window, named + 1), _end(scene, alarm))
    return slice(max(first, last - 2 * timing.window), last)


def _end(scene: Scene, alarm: decide.Alarm) -> int:
    """Return about where the fault itself ended: the statistic remembers it for one window more."""
    if alarm.stop is None:
        return scene.channels.grid.n
    return max(alarm.start + 1, alarm.stop - scene.fitted.timing.window)


def _kind(
    scene: Scene,
    fault: Fault,
    winner: int,
    size: tuple[float, tuple[float, float]] | None,
    first: int,
    alarm: decide.Alarm,
) -> tuple[str, str | None]:
    """Refine the kind by the size (a line's share) or the waveform (how a sensor is wrong)."""
    total = float(scene.residuals.signatures.total[winner])
    if fault.kind == "line_lost" and size is not None and np.isfinite(total) and size[0] / total < _WEAKENED:
        return "line_weakened", None
    if fault.kind != "sensor_fault" or fault.subject not in scene.channels.names:
        return fault.kind, fault.mode
    column = scene.channels.column(fault.subject)
    last = max(first + 1, min(_end(scene, alarm), first + 20 * scene.fitted.timing.window))
    reference = scene.fitted.level[:, scene.channels.names.index(fault.subject)]
    reference = reference[np.isfinite(reference)]
    sd = np.sqrt(np.diagonal(scene.fitted.raw.covariance))
    own = int(np.argmax(np.abs(scene.residuals.signatures.matrix[winner]) / np.where(sd > 0, sd, np.inf)))
    gain = scene.residuals.signatures.matrix[winner, own]
    first = min(first, last - scene.late - 1)
    residual = (scene.residuals.values[first + scene.late : last, own] - scene.fitted.raw.mean[own]) / gain
    seen = column[first : last - scene.late]
    good = np.isfinite(seen) & np.isfinite(residual)
    return fault.kind, decide.sensor_mode(reference, seen[good], residual[good])


def _evidence(scene: Scene, alarm: decide.Alarm, rows: Index) -> dict[str, object]:
    branch = next(i for i, s in enumerate(scene.walk.statistics) if s.branch == alarm.peak_branch)
    threshold, statistic = scene.fitted.thresholds[branch], scene.walk.statistics[branch]
    row = statistic.values[alarm.peak_at] / threshold.level
    top = int(np.nanargmax(row)) if np.isfinite(row).any() else 0
    kinds = {"main": scene.run.detector.kind}
    return {
        "detector": ", ".join(f"{kinds.get(b, 'glrt')} ({b} branch)" for b in alarm.branches),
        "peak": float(alarm.peak * threshold.level[top]),
        "threshold": float(threshold.level[top]),
        "channels": [scene.residuals.names[i] for i in rows],
    }


def _marks(scene: Scene, alarm: decide.Alarm) -> tuple[str, ...]:
    marks = []
    if scene.verdict != "supported":
        marks.append("extrapolated_threshold")
    timing = scene.fitted.timing
    block = max(8, round(40 * timing.peak_period / timing.sample_time))
    last = max(0, alarm.start - timing.window)  # the fault's own step is no sea
    before = scene.channels.values[max(0, last - block) : last]
    still = SEA * np.asarray(scene.fitted.agitation)
    if np.any((agitation(before) > still) & shows_sea(scene.channels.names)):
        marks.append("outside_fitted_envelope")
    return tuple(marks)


def _defect_event(scene: Scene, defect: Defect) -> Event:
    """Return the event of a defect that the alignment found."""
    grid, delay = scene.channels.grid, defect.mode == "delay"
    to_end = delay or defect.stop >= grid.stop - 2 * grid.sample_time
    return Event(
        kind="sensor_fault",
        subject=_group(scene, defect.subjects),
        mode=defect.mode,
        onset=defect.start,
        onset_interval=(defect.start, defect.start),
        detected=defect.stop if defect.detected is None else defect.detected,
        cleared=None if to_end else defect.stop,
        size=defect.value,
        size_unit=defect.unit,
        size_interval=defect.interval,
        evidence={"detector": "alignment", "peak": defect.value, "threshold": None, "channels": list(defect.subjects)},
        cannot_tell="whether the sensor or its logging failed: both look like this",
    )


def _group(scene: Scene, subjects: Sequence[str]) -> str:
    """Return the declared group that the channels make up, or the first channel."""
    for name, members in scene.run.clock.groups.items():
        if set(subjects) & set(members):
            return name
    return subjects[0]


def judged(statistics: Sequence[Statistic], posteriors: Sequence[Posterior], channels: Channels) -> float:
    """Return the share of the log's samples at which a verdict was possible."""
    if statistics:
        return float(np.isfinite(statistics[0].values).any(axis=1).mean()) if channels.grid.n else 0.0
    if posteriors and channels.grid.n:
        return max(len(p.time) for p in posteriors) / channels.grid.n
    return 0.0


def watched_until(statistics: Sequence[Statistic], channels: Channels) -> float:
    """Return the last time, s, at which any branch gave a statistic; the end of the log for a position-only bank."""
    seen = [np.flatnonzero(np.isfinite(s.values).any(axis=1)) for s in statistics]
    last = max((int(rows[-1]) for rows in seen if rows.size), default=-1) if statistics else channels.grid.n - 1
    return channels.grid.start + channels.grid.sample_time * (last + 1)


def verdict(events: Sequence[Event], share: float, blind: float) -> str:
    """Return nothing_found, fault_found or cannot_be_judged.

    Not to be judged: a verdict was possible at less than half of the log (``share``), or not over its last ``blind``
    detector windows (more than 4), in which anything may have happened.
    """
    if any(e.kind in FAULTS or e.kind == "unknown" for e in events):
        return "fault_found"
    return "cannot_be_judged" if share < LEAST_JUDGED or blind > LONGEST_BLIND else "nothing_found"
