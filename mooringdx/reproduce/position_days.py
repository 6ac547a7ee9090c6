"""Twelve hours in which nothing breaks: what the records of 1000 s of [PositionThesis, chapter 5] could not show.

    alarm: a lost line, whichever, is held for 20 s; it ends when "none" is held for 20 s
    rate per day with the 95 % Poisson interval of its count; wrong: share of the time with any line held for lost

Three seas without current: the thesis's own (dead ahead, 2.5 m, 7 s), the same 15 deg off the bow, and 4 m, 9 s ahead.
The bank of the thesis has the covariances of its own sea in all of them and the notch of 7 s, as a bank has that was
set up once; "covariances of this sea" learns both anew in the third. `mooringdx.hypotheses.onset_glr` learns from
70 min of each sea, drawn apart. All hear the same records but "shared noise", whose noise is the same on all axes. The
first ten minutes count for none of them.

What this cannot see: rates under one in 12 h, squalls, a current that turns, a gap in the log.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mooringdx.assess.intervals import poisson
from mooringdx.hypotheses.thesis_bank import NONE, ThesisBank
from mooringdx.reproduce.position_cases import BENCHES, CASES, HOLD, Trial, fit_bank, said, scenario, twins
from mooringdx.reproduce.position_ours import NAMES, WARM, channels_of, taught
from mooringdx.simulate.scenario import Scenario
from mooringdx.types import Array, Mask

LENGTH = 43200.0
RELEARNED = "printed, own noise, covariances of this sea"


@dataclass(frozen=True)
class Water:
    """One sea. ``height``, m; ``period``, s, of the peak; ``direction``: from, deg true; the bow points to 225."""

    name: str
    height: float
    period: float
    direction: float


WATERS = (
    Water("2.5 m, 7 s, dead ahead", 2.5, 7.0, 225.0),
    Water("2.5 m, 7 s, 15 deg off the bow", 2.5, 7.0, 240.0),
    Water("4 m, 9 s, dead ahead", 4.0, 9.0, 225.0),
)


@dataclass(frozen=True)
class Night:
    """What one bank said in one sea: ``alarms`` in ``hours``, ``wrong``: share of the time; ``method``: dht, mle or
    onset.
    """

    water: Water
    bench: str
    method: str
    alarms: int
    hours: float
    wrong: float

    @property
    def rate(self) -> tuple[float, float, float]:
        """Alarms a day: central, and the 95 % interval."""
        low, high = poisson(self.alarms, self.hours)
        return 24.0 * self.alarms / self.hours, 24.0 * low, 24.0 * high


def in_water(base: Scenario, water: Water) -> Scenario:
    """Return the scenario in a sea, nothing lost and no current."""
    change = {"height": water.height, "peak_period": water.period, "direction": water.direction}
    return base.model_copy(update={"sea": base.sea.model_copy(update=change)})


def alarms(lost: Mask, step: float, hold: float = HOLD) -> int:
    """Count how often ``lost``, (n,), is true for ``hold`` s, anew only after it was false for as long."""
    edge = np.flatnonzero(np.diff(lost.astype(np.int8))) + 1
    starts = np.concatenate([[0], edge])
    runs = np.diff(np.concatenate([starts, [lost.size]]))
    count, standing = 0, False
    for first, length in zip(starts, runs, strict=True):
        if length * step >= hold - 1e-9:
            count += bool(lost[first]) and not standing
            standing = bool(lost[first])
    return count


def thesis_night(bank: ThesisBank, record: Trial, water: Water, bench: str) -> list[Night]:
    """Return what the thesis's bank says of a record without a loss, by both methods."""
    step = float(record.time[1] - record.time[0])
    weighed, skip = said(bank, record), round(WARM / step)
    out = []
    for method, choice in (("dht", weighed.most_probable), ("mle", weighed.most_likely)):
        lost = choice[skip:] != bank.hypotheses.index(NONE)
        out.append(Night(water, bench, method, alarms(lost, step), lost.size * step / 3600.0, float(lost.mean())))
    return out


def ours_night(base: Scenario, record: Trial, water: Water, key: tuple[int, ...]) -> Night:
    """Return what the onset bank says of a record without a loss; every alarm counts, also one that did not stand."""
    bank = taught(in_water(base, water), CASES[0], key)
    channels = channels_of(record)
    posterior, events, _ = bank(channels)
    skip = round(WARM / channels.grid.sample_time)
    late = posterior.time >= channels.grid.time[skip]
    chance: Array = posterior.probability[late, 1 : 1 + len(bank.mooring.names)].sum(axis=1)
    hours = chance.size * channels.grid.sample_time / 3600.0
    return Night(water, NAMES[0], "onset", len(events), hours, float(np.mean(chance > 0.5)))


def nights(
    base: Scenario, banks: Mapping[str, ThesisBank], seed: int, count: int = 1, length: float = LENGTH
) -> tuple[Night, ...]:
    """Return what every bank says in every sea, ``count`` records of ``length`` s each added up."""
    out: list[Night] = []
    for i, water in enumerate(WATERS):
        sea = in_water(base, water)
        used = {bench.name: banks[bench.name] for bench in (BENCHES[0], BENCHES[2], BENCHES[4])}
        if water.period != base.sea.peak_period:
            used[RELEARNED] = fit_bank(sea, BENCHES[2], seed)
        for k in range(count):
            plan, key = scenario(sea, CASES[0], length), (seed, 300 + i, k)
            own, shared = twins(plan, key)
            for name, bank in used.items():
                out += thesis_night(bank, shared if name == BENCHES[0].name else own, water, name)
            out.append(ours_night(base, own, water, (seed, 400 + i, k)))
    return tuple(pooled(out))


def pooled(found: Sequence[Night]) -> list[Night]:
    """Return one night for each sea, bench and method: alarms and hours added up, shares weighed by hours."""
    out: dict[tuple[Water, str, str], Night] = {}
    for night in found:
        key = (night.water, night.bench, night.method)
        old = out.get(key)
        hours = night.hours + (old.hours if old else 0.0)
        wrong = (night.wrong * night.hours + (old.wrong * old.hours if old else 0.0)) / hours
        out[key] = Night(*key, night.alarms + (old.alarms if old else 0), hours, wrong)
    return list(out.values())


def night_cells(found: Sequence[Night]) -> list[list[str]]:
    """Return a line a bank and method: its name, and every sea's alarms a day, interval and share of time wrong."""
    lines = dict.fromkeys((n.bench, n.method) for n in found)
    titles = {"dht": ", DHT", "mle": ", MLE", "onset": ""}
    out = []
    for bench, method in lines:
        row = [bench + titles[method]]
        for water in WATERS:
            own = [n for n in found if (n.water, n.bench, n.method) == (water, bench, method)]
            row.append(told(own[0]) if own else "not run")
        out.append(row)
    return out


def told(night: Night) -> str:
    """Return one night in words."""
    rate, low, high = night.rate
    wrong = f"{100.0 * night.wrong:.{1 if night.wrong < 0.1 else 0}f}"
    return f"{rate:.0f} a day [{low:.1f}, {high:.1f}] ({night.alarms} in {night.hours:.1f} h); wrong {wrong} %"


def night_record(night: Night) -> dict[str, Any]:
    """Return one night as JSON."""
    rate, low, high = night.rate
    return {
        "sea": night.water.name, "bench": night.bench, "method": night.method, "alarms": night.alarms,
        "hours": night.hours, "per_day": rate, "per_day_low": low, "per_day_high": high, "wrong": night.wrong,
    }  # fmt: skip


def pick_night(found: Sequence[Night], water: int, bench: str, method: str) -> Night:
    """Return the night of a sea, by its place in `WATERS`, a bench and a method."""
    return next(n for n in found if (n.water, n.bench, n.method) == (WATERS[water], bench, method))
