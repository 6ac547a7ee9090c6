"""Score adrift-or-moved against labelled tracks, beside a plain rule and a fixed circle.

Each open warning is matched to at most one label: the first whose days [last inside, end of the drift or five days
after the first day outside] it overlaps. Delays count from the first day outside and use only fixes up to that day.
Labels are kinematic (made from the tracks): every figure flatters rules that look at the same track; the text says so.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from mooringdx.assess.intervals import poisson
from mooringdx.config import Positive, RunConfig, load_run, read_toml, validate
from mooringdx.errors import LogError
from mooringdx.hypotheses.adrift import Verdict, events, judge
from mooringdx.hypotheses.adrift.nouns import HOLDING, NOT_HOLDING
from mooringdx.types import Array, Event, Grid, LogSource, Mask

DAY = 86400.0
LOST, MOVED, WARNED, NONE = COLUMNS = ("mooring_lost", "moved", "warning only", "none")
ROWS = {
    "adrift": "adrift",
    "drag_then_hold": "dragged, then held",
    "moved_step_redeployment": "moved and holding (redeployed)",
}
MATCH_DAYS = 5


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Site(_Strict):
    """One buoy site: ``log`` relative to the data folder; ``tuned_on`` where the settings were chosen."""

    name: str
    log: str
    tuned_on: bool = False


class PlainRule(_Strict):
    """Beyond ``circle`` km of the median of ``history`` days, and ``moves`` daily moves over ``speed`` km a day."""

    circle: Positive = 8.0
    history: Annotated[int, Field(ge=1)] = 45
    speed: Positive = 4.3
    moves: Annotated[int, Field(ge=1)] = 3


class AdriftPlan(_Strict):
    """A plan of kind "adrift"."""

    kind: str
    run: str
    truth: str
    sites: list[Site]
    plain_rule: PlainRule = PlainRule()


@dataclass(frozen=True)
class Label:
    """One row of the truth file; days since 1970-01-01."""

    kind: str
    last_inside: float
    first_outside: float
    end: float

    @property
    def lost(self) -> bool:
        """Whether the mooring does not hold: adrift or dragging."""
        return self.kind in ("adrift", "drag_then_hold")


@dataclass(frozen=True)
class Track:
    """One site's track and verdict. ``day``: (n,), since 1970-01-01; ``north``, ``east``: (n,), m, NaN = no fix."""

    site: Site
    day: Array
    north: Array
    east: Array
    verdict: Verdict
    events: tuple[Event, ...]
    plain: Mask
    circle: Mask
    grid: Grid
    source: LogSource

    @property
    def years(self) -> float:
        """Buoy-years of fixes."""
        return float(np.count_nonzero(self.verdict.seen)) / 365.25


@dataclass(frozen=True)
class Row:
    """How one label was answered; delays in days from the first day outside, None for never."""

    label: Label
    called: str
    warned: int | None
    not_holding: int | None
    moved: int | None
    held_after: int | None
    day_2: float
    plain: int | None
    circle: int | None


@dataclass(frozen=True)
class Score:
    """One site: its labels answered, and the warnings and alarms that answer none (indices of ``track.events``)."""

    track: Track
    rows: tuple[Row, ...]
    ambiguous: tuple[Row, ...]
    other_warnings: tuple[int, ...]
    other_alarms: tuple[int, ...]
    other_plain: int
    other_circle: int


def assess_adrift(path: Path, out: Path, data: Path) -> tuple[str, dict[str, Any]]:
    """Carry out a plan of kind "adrift": tables, figures, assess.json and assess.md in ``out``."""
    from mooringdx.assess.adrift_figures import figures
    from mooringdx.assess.adrift_tables import markdown, summary, text
    from mooringdx.results import json_bytes, write_files

    plan = validate(AdriftPlan, read_toml(path), path)
    run = load_run(path.parent / plan.run)
    scores = [score(read_track(data / site.log, site, run, plan.plain_rule), read_labels(data / plan.truth, site.name))
              for site in plan.sites]  # fmt: skip
    result = summary(scores, run)
    body = text(scores)
    files = {"assess.json": json_bytes(result), "assess.md": markdown(body, scores).encode()}
    write_files(out, {**files, **figures(scores)})
    return body, result


def read_track(path: Path, site: Site, run: RunConfig, rule: PlainRule) -> Track:
    """Read and align one site's log and judge it day by day."""
    from mooringdx.logs import read_log
    from mooringdx.logs.align import align

    channels = align(read_log(path, run.channels, run.log.time, run.log.csv), run.clock)
    if channels.grid.epoch_ns is None:
        raise LogError(f"{path}: the labels name dates but the log's time has none; use a time column with dates")
    columns = [channels.names.index(name) for name in ("north", "east")]
    valid = channels.valid[:, columns].all(axis=1)
    north, east = (np.where(valid, channels.values[:, i], np.nan) for i in columns)
    settings = run.bank.adrift
    verdict = judge(channels.grid.time, north, east, settings)
    day = np.floor((channels.grid.time + channels.grid.epoch_ns / 1e9) / DAY)
    plain, circle = plain_rule(day, north, east, rule)
    found = events(verdict, settings)
    return Track(site, day, north, east, verdict, found, plain, circle, channels.grid, channels.source)


def read_labels(path: Path, site: str) -> list[Label]:
    """Read the labels of one site; raises LogError where a date or column is wrong."""

    def day(text: str) -> float:
        return float((date.fromisoformat(text) - date(1970, 1, 1)).days)

    out = []
    try:
        with path.open(newline="", encoding="utf-8") as lines:
            for row in csv.DictReader(lines):
                if row["site"] == site:
                    first, end = day(row["first_day_outside"]), row["last_day_of_drift_segment"]
                    out.append(
                        Label(row["label"], day(row["last_day_inside"]), first, day(end) if end else first + MATCH_DAYS)
                    )
    except FileNotFoundError:
        raise LogError(f"{path}: no such file; give the folder of the labelled logs with --data") from None
    except (KeyError, ValueError) as error:
        raise LogError(f"{path}: not a table of labels: {error}") from None
    return out


def plain_rule(day: Array, north: Array, east: Array, rule: PlainRule) -> tuple[Mask, Mask]:
    """Return where the plain rule and where the fixed circle raise an alarm, (n,) each; both causal.

    The centre is the median, per axis, of the fixes of the ``history`` days before.
    """
    fixes = np.flatnonzero(np.isfinite(north) & np.isfinite(east))
    d, x, y = day[fixes], north[fixes] / 1000.0, east[fixes] / 1000.0
    speed = np.concatenate([[0.0], np.hypot(np.diff(x), np.diff(y)) / np.diff(d)])
    plain, circle = (np.zeros(day.size, dtype=np.bool_) for _ in range(2))
    for k in range(1, d.size):
        first = int(np.searchsorted(d, d[k] - rule.history))
        if first == k:
            continue
        outside = np.hypot(x[k] - np.median(x[first:k]), y[k] - np.median(y[first:k])) > rule.circle
        circle[fixes[k]] = outside
        plain[fixes[k]] = outside and k >= rule.moves and bool(np.all(speed[k - rule.moves + 1 : k + 1] > rule.speed))
    return plain, circle


def score(track: Track, labels: list[Label]) -> Score:
    """Match warnings to labels and answer each label."""
    spans = _spans(track)
    owner: dict[int, Label] = {}
    for label in labels:
        for i, (first, last) in enumerate(spans):
            if i not in owner and first <= label.end and last >= label.last_inside:
                owner[i] = label
    rows = [_answer(track, label, [i for i in owner if owner[i] is label]) for label in labels]
    other = tuple(i for i in range(len(spans)) if i not in owner)
    return Score(
        track=track,
        rows=tuple(r for r in rows if r.label.kind in ROWS),
        ambiguous=tuple(r for r in rows if r.label.kind not in ROWS),
        other_warnings=other,
        other_alarms=tuple(i for i in other if track.events[i].kind == LOST),
        other_plain=_other_clusters(track.day[track.plain], labels),
        other_circle=_other_clusters(track.day[track.circle], labels),
    )


def _spans(track: Track) -> list[tuple[float, float]]:
    """Return first and last day of every open warning."""
    rows = [np.flatnonzero((track.verdict.episode == i) & track.verdict.seen) for i in range(len(track.events))]
    return [(float(track.day[r[0]]), float(track.day[r[-1]])) for r in rows]


def _answer(track: Track, label: Label, matched: list[int]) -> Row:
    verdict, day = track.verdict, track.day
    mine = np.isin(verdict.episode, matched) & verdict.seen
    held = verdict.call == HOLDING
    lost = mine & (verdict.call == NOT_HOLDING)
    kinds = {track.events[i].kind for i in matched}
    called = LOST if LOST in kinds else MOVED if MOVED in kinds else WARNED if kinds else NONE
    day_2 = int(np.searchsorted(day, label.first_outside + 2.0, side="right")) - 1

    def delay(rows: Mask, since: float = -np.inf) -> int | None:
        hit = np.flatnonzero(rows & (day >= since))
        return int(day[hit[0]] - label.first_outside) if hit.size else None

    near = (day >= label.last_inside) & (day <= label.end)
    return Row(
        label=label,
        called=called,
        warned=delay(mine),
        not_holding=delay(lost),
        moved=delay(mine & held & ~verdict.near, label.first_outside),
        held_after=delay(mine & held, float(day[np.flatnonzero(lost)[-1]])) if lost.any() else None,
        day_2=float(verdict.not_holding[day_2]),
        plain=delay(track.plain & near),
        circle=delay(track.circle & near),
    )


def _other_clusters(alarms: Array, labels: list[Label], apart: float = 45.0) -> int:
    """Count runs of alarm days, joined where less than ``apart`` days lie between, that meet no label."""
    starts = np.flatnonzero(np.diff(alarms, prepend=-np.inf) > apart)
    ends = np.append(starts[1:], alarms.size) - 1
    return sum(
        not any(alarms[a] <= label.end and alarms[b] >= label.last_inside for label in labels)
        for a, b in zip(starts, ends, strict=True)
    )


def other_rate(count: int, years: float) -> dict[str, float]:
    """Return a count per buoy-year with its exact 95 % interval."""
    low, high = poisson(count, years)
    return {"count": count, "years": years, "per_year": count / years, "low": low, "high": high}
