"""A plan on simulated logs, read and checked: its cells, what each fit is made of, what a seed draws and moves.

A cell's log and its training log are one rig in one sea: ``both`` and ``draw`` change the two alike. A drawn key is
uniform between its limits, from a stream of (seed, key), so that equal keys of two cells are equal rigs.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from mooringdx.config import Positive, RunConfig, read_toml, validate, with_vessel
from mooringdx.errors import ConfigError
from mooringdx.simulate import Scenario, load_scenario
from mooringdx.simulate.streams import stream

Body = dict[str, Any]
Seeds = tuple[Annotated[int, Field(ge=0)], Annotated[int, Field(ge=1)]]
TRAIN = "train"


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

    ``subject`` "rotate" moves the faults one line or gauge further with every seed and repetition, and gives a trap the
    direction of such a line; a further fault goes ``apart`` lines on from the first, one entry a log in turn.
    ``variant`` overrides keys of the run file, ``train`` those of the plan's. ``both`` changes the cell's scenario and
    its training's alike; ``draw``: key of a scenario, such as "rig.inertia", to the limits between which a seed draws
    it, for both too. ``repeat`` logs a seed. Cells with the same ``weather`` word see the same waves and noise.
    """

    name: str
    scenario: str
    change: Body = {}
    both: Body = {}
    draw: dict[str, tuple[float, float]] = {}
    train: Body = {}
    subject: Literal["fixed", "rotate"] = "fixed"
    apart: list[Annotated[int, Field(ge=0)]] = []
    variant: Body = {}
    score: Expect = Expect()
    seeds: Seeds | None = None
    repeat: Annotated[int, Field(ge=1)] = 1
    weather: str | None = None


class Plan(_Strict):
    """A plan of kind "simulated"; ``seeds``: the first and how many; paths are relative to the plan's file.

    ``variant``, ``both``: those of every cell, under its own.
    """

    kind: str
    run: str
    train: Train
    seeds: Seeds
    cells: Annotated[list[Cell], Field(min_length=1)]
    variant: Body = {}
    both: Body = {}
    processes: Annotated[int, Field(ge=1)] | None = None


@dataclass(frozen=True)
class Lesson:
    """What a fit is made of. ``word``: of its weather. Cells with the same lesson share the fits."""

    run: RunConfig
    training: Body
    draw: Mapping[str, tuple[float, float]]
    word: str


@dataclass(frozen=True)
class Job:
    """A plan with its files read. ``scenarios``: one a cell; ``lesson_of``: its lesson, an index a cell."""

    plan: Plan
    path: Path
    scenarios: tuple[Body, ...]
    lessons: tuple[Lesson, ...]
    lesson_of: tuple[int, ...]

    def lesson(self, cell: int) -> Lesson:
        """Return what the fits of a cell are made of."""
        return self.lessons[self.lesson_of[cell]]


def load(path: Path) -> Job:
    """Read a plan with its run file and scenarios; every fault in them is one ConfigError sentence."""
    plan = validate(Plan, read_toml(path), path)
    names = [cell.name for cell in plan.cells]
    for name in names:
        if names.count(name) > 1:
            raise ConfigError(f"{path}: two cells are named '{name}'; each needs a name of its own")
    lessons: list[Lesson] = []
    lesson_of, scenarios = [], []
    for cell in plan.cells:
        both = merged(plan.both, cell.both)
        scenarios.append(_scenario(path.parent / cell.scenario, merged(both, cell.change), cell.draw))
        lesson = _lesson(plan, cell, both, path)
        if lesson not in lessons:
            lessons.append(lesson)
        lesson_of.append(lessons.index(lesson))
    return Job(plan, path, tuple(scenarios), tuple(lessons), tuple(lesson_of))


def _lesson(plan: Plan, cell: Cell, both: Body, path: Path) -> Lesson:
    """Return what a cell's fits are made of; only one that departs from the plan's training has weather of its own."""
    train = validate(Train, merged(plan.train.model_dump(), cell.train), path)
    source = path.parent / plan.run
    window = {} if train.window is None else {"baseline": {"window": list(train.window)}}
    body = merged(merged(read_toml(source), window), merged(plan.variant, cell.variant))
    record = {} if train.duration is None else {"record": {"duration": train.duration}}
    change = merged(merged(record, both), train.change)
    training = _scenario(path.parent / train.scenario, change, cell.draw)
    own = bool(cell.train or cell.both or cell.draw)
    key = hashlib.sha256(json.dumps([training, sorted(cell.draw.items())], sort_keys=True).encode()).hexdigest()
    run = validate(RunConfig, with_vessel(body, source), path)
    return Lesson(run, training, cell.draw, f"{TRAIN} {key[:12]}" if own else TRAIN)


def _scenario(path: Path, change: Body, draw: Mapping[str, tuple[float, float]]) -> Body:
    """Return a scenario's content with a plan's change, checked, at both limits of what is drawn too."""
    body: Body = merged(load_scenario(path).model_dump(mode="json"), change)
    for end in (0, 1):
        validate(Scenario, merged(body, nested({key: limits[end] for key, limits in draw.items()})), path)
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


def nested(flat: Mapping[str, Any]) -> Body:
    """Return tables for keys with dots: {"rig.inertia": 1} is {"rig": {"inertia": 1}}."""
    out: Body = {}
    for key, value in flat.items():
        for word in reversed(key.split(".")):
            value = {word: value}
        out = merged(out, value)
    return out


def drawn(body: Body, draw: Mapping[str, tuple[float, float]], seed: int) -> Body:
    """Return a scenario's content with what a seed draws, evenly between the limits, in place."""
    values = {key: float(stream(seed, f"draw {key}").uniform(*limits)) for key, limits in draw.items()}
    out: Body = merged(body, nested(values))
    return out


def round_vessel(body: Body) -> tuple[str, ...]:
    """Return the lines of a scenario's vessel without their stem, in the order of their azimuth."""
    azimuth = azimuths(body)
    return tuple(sorted(azimuth, key=lambda name: azimuth[name]))


def azimuths(body: Body) -> dict[str, float]:
    """Return where each line goes to, deg true; lines without their stem."""
    mooring = body["model"]["mooring"]
    if mooring.get("azimuth"):
        return {line.removeprefix("line_"): float(x) % 360.0 for line, x in mooring["azimuth"].items()}
    ends = {line.removeprefix("line_"): x for line, x in mooring["anchors"].items()}
    return {name: float(np.degrees(np.arctan2(east, north))) % 360.0 for name, (north, east) in ends.items()}


def rotated(body: Body, by: int, lines: Sequence[str], apart: int | None = None) -> Body:
    """Return a scenario's content with every fault of a line or its gauge moved ``by`` lines on, round the vessel.

    ``apart``: faults after the first stand so many lines on from it. A trap with a direction comes from a line's.
    """
    faults: list[Body] = []
    first: int | None = None
    for fault in body["faults"]:
        stem, _, name = str(fault["subject"]).partition("_")
        if stem in ("line", "tension") and name in lines:
            at = lines.index(name) + by if apart is None or first is None else first + apart
            first = at if first is None else first
            fault = {**fault, "subject": f"{stem}_{lines[at % len(lines)]}"}
        faults.append(fault)
    traps = body.get("traps", [])
    if any(trap.get("direction") is not None for trap in traps):
        towards = azimuths(body)[lines[by % len(lines)]]
        traps = [t if t.get("direction") is None else {**t, "direction": towards} for t in traps]
    return {**body, "faults": faults, "traps": traps}


def weather_seed(seed: int, word: str, repeat: int = 0) -> int:
    """Return the seed of a log's weather and noise: another one for every seed, word and repetition."""
    return int.from_bytes(hashlib.sha256(f"{seed}/{word}/{repeat}".encode()).digest()[:6], "big")


def seeds_of(plan: Plan, cell: Cell) -> range:
    """Return the seeds of a cell."""
    first, count = cell.seeds or plan.seeds
    return range(first, first + count)
