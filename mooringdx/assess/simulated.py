"""Carry out a plan on simulated logs: for each seed fit once on a healthy log, then detect on every cell's logs.

A seed is a rig (its model errors: anchors, line weight, gauge gains, and what the plan draws); the weather and the
noise of every log are drawn anew from (seed, cell, repetition), those of a training log from (seed, "train" and what it
departs in), so that no log that is scored shares a wave with the log that was learned on. Cells with the same run file
and the same training share one fit. A log shows the channels that the run file names and no others. What
is kept of a log is its events and its truth: memory does not grow with the length of the plan.

What it cannot see: how far the simulator is from the sea. Rig, weather and faults are those of the scenario files;
a rate measured here is a rate for them.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from mooringdx.assess.simulated_plan import (
    Body,
    Job,
    Lesson,
    drawn,
    load,
    rotated,
    round_vessel,
    seeds_of,
    weather_seed,
)
from mooringdx.baseline import Baseline
from mooringdx.config import RunConfig, validate
from mooringdx.errors import FitError
from mooringdx.pipeline import detect, fit, prepare
from mooringdx.simulate import Scenario, simulate
from mooringdx.simulate.streams import stream
from mooringdx.types import Channels, Detection, Event, RawLog, replace

Progress = Callable[[int, int], None]
_THREADS = "OPENBLAS_NUM_THREADS"


@dataclass(frozen=True)
class Walked:
    """What is kept of one log: its events and its truth.

    ``cell``: index in the plan. ``hours`` of log clock in which a verdict was possible. ``refused``: why the training
    log could not be fitted, empty where it could. ``leading``: the line that a bank held likeliest when it raised each
    event, empty without a bank. ``lines``: round the vessel, without their stem.
    """

    cell: int
    seed: int
    repeat: int
    weather: int
    hours: float
    truth: Mapping[str, Any]
    events: tuple[Event, ...]
    refused: str = ""
    leading: tuple[str, ...] = ()
    lines: tuple[str, ...] = ()


def assess_simulated(path: Path, out: Path, data: Path, progress: Progress | None = None) -> tuple[str, dict[str, Any]]:
    """Carry out a plan of kind "simulated": assess.md, assess.json and runs.csv (every log) in ``out``.

    ``data`` is not used: the logs are made here. ``progress`` is called with seeds done and seeds in all.
    """
    from mooringdx.assess.simulated_tables import files, summary, text
    from mooringdx.results import write_files

    del data
    job = load(path)
    walked = run_job(job, progress)
    result = summary(job, walked)
    body = text(result)
    write_files(out, files(job, walked, body, result))
    return body, result


def run_job(job: Job, progress: Progress | None = None) -> list[Walked]:
    """Walk every log of the plan, seeds spread over processes; the order and the content depend on the plan alone."""
    seeds = sorted({s for cell in job.plan.cells for s in seeds_of(job.plan, cell)})
    count = min(job.plan.processes or os.cpu_count() or 1, len(seeds))
    out: list[Walked] = []

    def gather(parts: Iterator[list[Walked]]) -> None:
        for done, part in enumerate(parts, start=1):
            out.extend(part)
            if progress is not None:
                progress(done, len(seeds))

    if count == 1:
        gather(walk_seed(job, seed) for seed in seeds)
    else:
        with _one_thread(), ProcessPoolExecutor(count, mp_context=get_context("spawn")) as pool:
            gather(pool.map(walk_seed, [job] * len(seeds), seeds))
    return sorted(out, key=lambda w: (w.cell, w.seed, w.repeat))


@contextmanager
def _one_thread() -> Iterator[None]:
    """Keep linear algebra in the processes started here to one thread each: they are as many as the cores."""
    before = os.environ.get(_THREADS)
    os.environ[_THREADS] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[_THREADS]
        else:
            os.environ[_THREADS] = before


def walk_seed(job: Job, seed: int) -> list[Walked]:
    """Fit every lesson on the seed's training log and walk the seed's logs of every cell."""
    fits: dict[int, Baseline | str] = {}
    out = []
    for i, cell in enumerate(job.plan.cells):
        if seed not in seeds_of(job.plan, cell):
            continue
        lesson = job.lesson_of[i]
        if lesson not in fits:
            fits[lesson] = _fit(job.lessons[lesson], seed, job.path)
        out += [_walk(job, i, seed, repeat, fits[lesson]) for repeat in range(cell.repeat)]
    return out


def _fit(lesson: Lesson, seed: int, path: Path) -> Baseline | str:
    log, _ = _simulated(drawn(lesson.training, lesson.draw, seed), seed, weather_seed(seed, lesson.word), path)
    try:
        return fit([seen(log, lesson.run)], lesson.run, extrapolate=True)
    except FitError as error:
        return str(error)


def seen(log: RawLog, run: RunConfig) -> Channels:
    """Return the channels that the run file names, on its clock."""
    return prepare(replace(log, signals={name: s for name, s in log.signals.items() if name in run.channels}), run)


def _walk(job: Job, cell: int, seed: int, repeat: int, baseline: Baseline | str) -> Walked:
    log, truth, weather = make(job, cell, seed, repeat)
    kept = {key: truth[key] for key in ("healthy_until", "faults", "traps")}
    kept["duration"] = truth["scenario"]["record"]["duration"]
    lines = round_vessel(truth["scenario"])
    if isinstance(baseline, str):
        return Walked(cell, seed, repeat, weather, 0.0, kept, (), baseline, lines=lines)
    found = detect(seen(log, job.lesson(cell).run), baseline, name=f"{job.plan.cells[cell].name}, seed {seed}")
    hours = _watched(found) / 3600.0
    return Walked(cell, seed, repeat, weather, hours, kept, found.events, leading=_leading(found), lines=lines)


def _watched(found: Detection) -> float:
    """Return the seconds in which any branch gave a statistic."""
    if not found.statistics:
        return found.channels.grid.n * found.channels.grid.sample_time
    judged = np.zeros(found.channels.grid.n, dtype=np.bool_)
    for statistic in found.statistics:
        judged |= np.isfinite(statistic.values).any(axis=1)
    return float(np.count_nonzero(judged)) * found.channels.grid.sample_time


def _leading(found: Detection) -> tuple[str, ...]:
    """Return the line that the first bank held likeliest at each event's alarm, as "line_4"."""
    for posterior in found.posteriors:
        of = [(i, name.split()[1]) for i, name in enumerate(posterior.hypotheses) if " line_" in name]
        if of:
            rows = np.searchsorted(posterior.time, [e.detected + 1e-6 for e in found.events], side="right") - 1
            best = posterior.probability[np.maximum(rows, 0)][:, [i for i, _ in of]].argmax(axis=1)
            return tuple(of[k][1] for k in best)
    return ()


def make(job: Job, cell: int, seed: int, repeat: int = 0) -> tuple[RawLog, dict[str, Any], int]:
    """Return one log of a plan with its truth and the seed of its weather: the one that runs.csv names."""
    asked = job.plan.cells[cell]
    body = drawn(job.scenarios[cell], asked.draw, seed)
    if asked.subject == "rotate":
        apart = int(stream(seed, f"apart {repeat}").choice(asked.apart)) if asked.apart else None
        body = rotated(body, seed + repeat, round_vessel(body), apart)
    weather = weather_seed(seed, asked.weather or asked.name, repeat)
    log, truth = _simulated(body, seed, weather, job.path)
    return log, truth, weather


def _simulated(body: Body, seed: int, weather: int, path: Path) -> tuple[RawLog, dict[str, Any]]:
    return simulate(validate(Scenario, body, path), seed, weather)
