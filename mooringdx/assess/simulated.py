"""Carry out a plan on simulated logs: for each seed fit once on a healthy log, then detect on every cell's logs.

A seed is a rig (its model errors: anchors, line weight, gauge gains); the weather and the noise of every log are
drawn anew from (seed, cell, repetition), those of the training log from (seed, "train"), so that no log that is scored
shares a wave with the log that was learned on. Cells with the same ``variant`` of the run file share one fit. What
is kept of a log is its events and its truth: memory does not grow with the length of the plan.

What it cannot see: how far the simulator is from the sea. Rig, weather and faults are those of the scenario files;
a rate measured here is a rate for them.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from mooringdx.baseline import Baseline
from mooringdx.config import Positive, RunConfig, read_toml, validate, with_vessel
from mooringdx.errors import ConfigError, FitError
from mooringdx.pipeline import detect, fit, prepare
from mooringdx.simulate import Scenario, load_scenario, simulate
from mooringdx.types import Detection, Event, RawLog

Body = dict[str, Any]
Progress = Callable[[int, int], None]
Seeds = tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=1)]]
_THREADS = "OPENBLAS_NUM_THREADS"


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Train(_Strict):
    """The healthy log to fit on; ``window``, s, replaces the run file's no-fault window."""

    scenario: str
    duration: Positive | None = None
    window: tuple[float, float] | None = None
    change: Body = {}


class Expect(_Strict):
    """What is right for a cell's fault; everything has a default in the log's truth.

    ``kinds``, ``modes``: names that are right, ``modes`` scored apart. ``within``: s from the onset in which an alarm
    counts as found. ``full``: an event's size in N for a fault of size 1 (a total loss): it is scored as a share of it,
    like an event that gives a share itself; a bias or a drift is scored as it stands. ``truth``: row of the confusion
    table.
    """

    kinds: list[str] = []
    modes: list[str] = []
    subject: str | None = None
    within: Positive | None = None
    full: float | None = None
    truth: str = ""


class Cell(_Strict):
    """One cell of the plan: a scenario with changes, and how its logs are scored.

    ``subject`` "rotate" moves the faults one line or gauge further with every seed. ``variant`` overrides keys of the
    run file. ``repeat`` logs a seed. Cells with the same ``weather`` word see the same waves and noise (paired).
    """

    name: str
    scenario: str
    change: Body = {}
    subject: Literal["fixed", "rotate"] = "fixed"
    variant: Body = {}
    score: Expect = Expect()
    seeds: Seeds | None = None
    repeat: Annotated[int, Field(ge=1)] = 1
    weather: str | None = None


class Plan(_Strict):
    """A plan of kind "simulated"; ``seeds``: the first and how many; paths are relative to the plan's file."""

    kind: str
    run: str
    train: Train
    seeds: Seeds
    cells: Annotated[list[Cell], Field(min_length=1)]
    processes: Annotated[int, Field(ge=1)] | None = None


@dataclass(frozen=True)
class Job:
    """A plan with its files read. ``scenarios``: one a cell; ``runs``: one a variant, ``variant_of``: index a cell."""

    plan: Plan
    path: Path
    training: Body
    scenarios: tuple[Body, ...]
    runs: tuple[RunConfig, ...]
    variant_of: tuple[int, ...]


@dataclass(frozen=True)
class Walked:
    """What is kept of one log: its events and its truth.

    ``cell``: index in the plan. ``hours`` of log clock in which a verdict was possible. ``refused``: why the training
    log could not be fitted, empty where it could.
    """

    cell: int
    seed: int
    repeat: int
    weather: int
    hours: float
    truth: Mapping[str, Any]
    events: tuple[Event, ...]
    refused: str = ""


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


def load(path: Path) -> Job:
    """Read a plan with its run file and scenarios; every fault in them is one ConfigError sentence."""
    plan = validate(Plan, read_toml(path), path)
    names = [cell.name for cell in plan.cells]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"{path}: two cells are named '{name}'; each needs a name of its own")
    source = path.parent / plan.run
    body = with_vessel(read_toml(source), source)
    if plan.train.window is not None:
        body = merged(body, {"baseline": {"window": list(plan.train.window)}})
    variants: list[Body] = []
    for cell in plan.cells:
        if cell.variant not in variants:
            variants.append(cell.variant)
    record = {} if plan.train.duration is None else {"record": {"duration": plan.train.duration}}
    return Job(
        plan=plan,
        path=path,
        training=_scenario(path.parent / plan.train.scenario, merged(record, plan.train.change)),
        scenarios=tuple(_scenario(path.parent / cell.scenario, cell.change) for cell in plan.cells),
        runs=tuple(validate(RunConfig, merged(body, variant), path) for variant in variants),
        variant_of=tuple(variants.index(cell.variant) for cell in plan.cells),
    )


def _scenario(path: Path, change: Body) -> Body:
    """Return a scenario's content with a plan's change, checked."""
    body: Body = merged(load_scenario(path).model_dump(mode="json"), change)
    validate(Scenario, body, path)
    return body


def merged(body: Any, change: Any) -> Any:
    """Return ``body`` under ``change``: tables key by key, lists of tables item by item, the rest replaced."""
    if isinstance(body, Mapping) and isinstance(change, Mapping):
        return {**body, **{k: merged(body[k], v) if k in body else v for k, v in change.items()}}
    both = isinstance(body, list) and isinstance(change, list)
    if both and change and all(isinstance(x, Mapping) for x in [*body, *change]):
        head = [merged(a, b) for a, b in zip(body, change, strict=False)]
        return [*head, *body[len(change) :], *change[len(body) :]]
    return change


def rotated(body: Body, by: int, lines: Sequence[str]) -> Body:
    """Return a scenario's content with every fault of a line or its gauge moved ``by`` lines on, round the vessel."""
    faults = []
    for fault in body["faults"]:
        stem, _, name = str(fault["subject"]).partition("_")
        if stem in ("line", "tension") and name in lines:
            name = lines[(lines.index(name) + by) % len(lines)]
            fault = {**fault, "subject": f"{stem}_{name}"}
        faults.append(fault)
    return {**body, "faults": faults}


def line_names(run: RunConfig) -> tuple[str, ...]:
    """Return the names of the lines without their stem: those of [mooring] lines, else those with a tension channel."""
    named = [line.removeprefix("line_") for line in run.mooring.lines]
    return tuple(named or [c.removeprefix("tension_") for c in run.channels if c.startswith("tension_")])


def weather_seed(seed: int, word: str, repeat: int = 0) -> int:
    """Return the seed of a log's weather and noise: another one for every seed, word and repetition."""
    return int.from_bytes(hashlib.sha256(f"{seed}/{word}/{repeat}".encode()).digest()[:6], "big")


def seeds_of(plan: Plan, cell: Cell) -> range:
    """Return the seeds of a cell."""
    first, count = cell.seeds or plan.seeds
    return range(first, first + count)


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
    """Fit every variant on the seed's training log and walk the seed's log of every cell."""
    fits: dict[int, Baseline | str] = {}
    out = []
    for i, cell in enumerate(job.plan.cells):
        if seed not in seeds_of(job.plan, cell):
            continue
        variant = job.variant_of[i]
        if variant not in fits:
            fits[variant] = _fit(job, job.runs[variant], seed)
        out += [_walk(job, i, seed, repeat, fits[variant]) for repeat in range(cell.repeat)]
    return out


def _fit(job: Job, run: RunConfig, seed: int) -> Baseline | str:
    log, _ = _simulated(job.training, seed, weather_seed(seed, "train"), job.path)
    try:
        return fit([prepare(log, run)], run, extrapolate=True)
    except FitError as error:
        return str(error)


def _walk(job: Job, cell: int, seed: int, repeat: int, baseline: Baseline | str) -> Walked:
    log, truth, weather = make(job, cell, seed, repeat)
    kept = {key: truth[key] for key in ("healthy_until", "faults", "traps")}
    kept["duration"] = truth["scenario"]["record"]["duration"]
    if isinstance(baseline, str):
        return Walked(cell, seed, repeat, weather, 0.0, kept, (), baseline)
    run = job.runs[job.variant_of[cell]]
    found = detect(prepare(log, run), baseline, name=f"{job.plan.cells[cell].name}, seed {seed}")
    return Walked(cell, seed, repeat, weather, _watched(found) / 3600.0, kept, found.events)


def _watched(found: Detection) -> float:
    """Return the seconds in which any branch gave a statistic."""
    if not found.statistics:
        return found.channels.grid.n * found.channels.grid.sample_time
    seen = np.zeros(found.channels.grid.n, dtype=np.bool_)
    for statistic in found.statistics:
        seen |= np.isfinite(statistic.values).any(axis=1)
    return float(np.count_nonzero(seen)) * found.channels.grid.sample_time


def make(job: Job, cell: int, seed: int, repeat: int = 0) -> tuple[RawLog, dict[str, Any], int]:
    """Return one log of a plan with its truth and the seed of its weather: the one that runs.csv names."""
    asked = job.plan.cells[cell]
    body = job.scenarios[cell]
    if asked.subject == "rotate":
        body = rotated(body, seed + repeat, line_names(job.runs[job.variant_of[cell]]))
    weather = weather_seed(seed, asked.weather or asked.name, repeat)
    log, truth = _simulated(body, seed, weather, job.path)
    return log, truth, weather


def _simulated(body: Body, seed: int, weather: int, path: Path) -> tuple[RawLog, dict[str, Any]]:
    return simulate(validate(Scenario, body, path), seed, weather)
