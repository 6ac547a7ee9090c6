"""The whole method as a sentence: prepare a log, fit a baseline on its no-fault windows, detect on any log."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from mooringdx import __version__, fusion, residuals
from mooringdx.baseline import Baseline, learn
from mooringdx.checks import run_checks, watched_check
from mooringdx.config import RunConfig, window_seconds
from mooringdx.diagnose import find, judged, verdict, watched_until
from mooringdx.errors import ConfigError, FitError
from mooringdx.hypotheses import HYPOTHESES
from mooringdx.logs import in_si
from mooringdx.logs.align import align
from mooringdx.registry import resolve
from mooringdx.residuals.training import Training
from mooringdx.scene import Scene
from mooringdx.timing import design
from mooringdx.types import Channels, Detection, Event, RawLog, replace

Progress = Callable[[int, int], None] | None


def prepare(log: RawLog, run: RunConfig) -> Channels:
    """Put a log's signals on one uniform clock, with what was wrong in them as checks and defects."""
    return align(in_si(log), run.clock)


def fit(
    channels: Sequence[Channels], run: RunConfig, *, extrapolate: bool = False, progress: Progress = None
) -> Baseline:
    """Learn the baseline on the no-fault window of each log.

    Raises ConfigError for what the run file asks wrongly, FitError for a window that cannot carry the asked rate.
    """
    if not run.residuals.use and not run.bank.use:
        raise ConfigError("nothing to do: [residuals] use and [bank] use are both empty")
    kinds = {word: resolve(word, HYPOTHESES, "bank") for word in run.bank.use}
    learning = {word: kind for word, kind in kinds.items() if hasattr(kind, "fit")}
    training = [Training(c, no_fault(c, run) if run.residuals.use or learning else ()) for c in channels]
    banks = {word: kind.fit(training, run).to_dict() for word, kind in learning.items()}
    if not run.residuals.use:
        return Baseline.of_bank(run, channels, [t.pieces for t in training], banks)
    stack = residuals.fit(training, run)
    measured = [stack(c) for c in channels]
    pieces = [(i, piece) for i, t in enumerate(training) for piece in t.pieces]
    rows = [t.channels.values[piece] for t in training for piece in t.pieces]
    timing = design(run.detector, run.clock.sample_time, rows)
    baseline = replace(learn(training, stack, measured, pieces, timing, run, progress), banks=banks)
    if baseline.verdict == "invalid" and not extrapolate:
        raise FitError(f"{baseline.reason}; or accept an unsupported rate with --extrapolate")
    return baseline


def no_fault(channels: Channels, run: RunConfig) -> tuple[slice, ...]:
    """Return the no-fault pieces of one log: its window, cut to the log."""
    if run.baseline is None:
        raise ConfigError("[baseline] window is missing: give the part of the log in which nothing was wrong")
    grid = channels.grid
    window = window_seconds(run.baseline.window, grid.epoch_ns)
    piece = grid.window(window)
    past = max(window[1] - grid.stop, grid.start - window[0])
    if piece.stop > piece.start and past > 0.1 * (window[1] - window[0]):
        raise ConfigError(
            f"[baseline] window [{window[0]:g}, {window[1]:g}] s reaches past the log, which spans [{grid.start:g}, "
            f"{grid.stop:g}] s; give a part of the log, in s, in which nothing was wrong"
        )
    if piece.stop - piece.start < 2:
        raise ConfigError(
            f"[baseline] window [{window[0]:g}, {window[1]:g}] s lies outside the log, "
            f"which spans [{grid.start:g}, {grid.stop:g}] s"
        )
    return (piece,)


def detect(channels: Channels, baseline: Baseline, *, name: str, command: str = "") -> Detection:
    """Walk one log through the fitted chain and the position-only banks to events and a verdict."""
    run = baseline.config()
    measured = walk = forces = None
    events: list[Event] = []
    checks = [*channels.checks, *baseline.checks]
    if baseline.fitted is not None:
        measured = baseline.fitted.stack(channels)
        walk = baseline.fitted.chain(measured)
        witness = baseline.fitted.stack.witness
        forces = witness(channels) if witness is not None else None
        events += find(Scene(channels, measured, walk, baseline.fitted, run, baseline.verdict, forces))
        checks += run_checks(channels, baseline.fitted.agitation, judged(walk.statistics, (), channels))
        checks.append(watched_check(watched_until(walk.statistics, channels), channels))
    posteriors = []
    seen: dict[str, object] = {}
    known = None if measured is None or baseline.fitted is None else fusion.gauges(channels, measured, baseline.fitted)
    for word in run.bank.use:
        kind = resolve(word, HYPOTHESES, "bank")
        bank = kind.from_dict(baseline.banks[word]) if word in baseline.banks else kind(getattr(run.bank, word))
        if known is not None and hasattr(bank, "walked"):
            posterior, found, rows, asked = bank.walked(channels)
            fused, said = fusion.fuse(events, found, asked, known, fusion.REACH / bank.time_scale)
            events, found, rows = list(fused), (), (*rows, *said)
        else:
            posterior, found, rows = bank(channels)
        seen.update(bank.observability() if hasattr(bank, "observability") else {})
        posteriors.append(posterior)
        events += found
        checks += rows
    events.sort(key=lambda e: (e.onset, e.detected, e.subject))
    statistics = walk.statistics if walk else ()
    blind = 0.0
    if baseline.fitted is not None:
        window = baseline.fitted.timing.window * channels.grid.sample_time
        blind = (channels.grid.stop - watched_until(statistics, channels)) / window
    outcome = verdict(events, judged(statistics, posteriors, channels), blind)
    return Detection(
        name=name,
        verdict=outcome,
        channels=channels,
        residuals=measured,
        whitened=walk.whitened if walk else None,
        statistics=statistics,
        thresholds=baseline.thresholds,
        posteriors=tuple(posteriors),
        events=tuple(events),
        checks=tuple(checks),
        no_fault=baseline.no_fault_of(channels.source.sha256),
        alarm_rate=baseline.alarm_rate(),
        choice=baseline.choice,
        run=baseline.run,
        provenance={
            "mooringdx": __version__,
            "numpy": np.__version__,
            "configuration_digest": run.digest(),
            "command": command,
            "log": channels.source.path,
            "log_sha256": channels.source.sha256,
            "baseline_logs": [dict(w) for w in baseline.windows],
        },
        forces=forces,
        observability=seen,
    )
