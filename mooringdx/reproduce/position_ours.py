"""The onset bank, this program's default for position alone, on the eight cases of [PositionThesis, chapter 5].

The vessel, its sea, the independent noise, 10 Hz, the start 2 m off and the current are those of
`mooringdx.reproduce.position_cases`. Two things differ, because `mooringdx.hypotheses.onset_glr` is another kind of
program. It hears nothing in its first ten minutes, so that a record begins 900 s earlier and the line breaks 900 s
later in it; and it learns its noise from 70 min of the whole vessel in the same sea and current, on random streams of
their own, one such record and one fit for each seed. "Learned without current" takes the fits of the calm water to the
cases with current: the filter then starts with a bias that is wrong by half a line's pull.

    delay: from the loss to the alarm; an alarm before the loss is a false one
    interval of a median: order statistics k and n + 1 - k with P(B(n, 1/2) < k) <= 0.025

What this cannot see: how it fares with a hull and lines other than those that it is told of; the plant is its model.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mooringdx.config import RunConfig, load_run
from mooringdx.hypotheses.onset_glr import OnsetGlr
from mooringdx.hypotheses.thesis_bank import NONE
from mooringdx.reproduce.fang2015 import setting
from mooringdx.reproduce.position_cases import CASES, Case, Trial, scenario, trial
from mooringdx.residuals.training import Training
from mooringdx.simulate.scenario import Scenario
from mooringdx.types import Array, Channels, Event, Grid, LogSource, Posterior, replace

NAMES = ("our default, own noise", "our default, learned without current")
EARLIER, LEARN, WARM = 900.0, 4200.0, 600.0
"""s: how much longer the records are before the loss, the no-fault record, and how long the bank hears nothing."""
_NAMES = ("north", "east", "heading", "thrust_surge", "thrust_sway", "thrust_yaw")
_UNITS = ("m", "m", "rad", "N", "N", "N m")


@dataclass(frozen=True)
class Heard:
    """What the bank said of one record. Delays in s from the loss to ``warned``, score over the warning level and
    staying there, and ``alarm``; None where never. ``named``: the line; ``probability`` of it when it is named;
    ``false``: alarms before the loss, in ``hours`` of listening before it.
    """

    warned: float | None
    alarm: float | None
    named: str | None
    probability: float
    false: int
    hours: float


@dataclass(frozen=True)
class Ours:
    """One case by one of `NAMES`. ``heard``: one a record."""

    case: Case
    name: str
    heard: tuple[Heard, ...]

    def delays(self, which: str = "alarm") -> list[float]:
        """Return the delays to ``warned`` or ``alarm``, s, infinite where never."""
        return [np.inf if getattr(h, which) is None else float(getattr(h, which)) for h in self.heard]

    @property
    def right(self) -> int:
        """Count the records in which the lost line was named."""
        return sum(h.named == self.case.line for h in self.heard)

    @property
    def probability(self) -> float:
        """Return the median probability of the named line; NaN where none was named."""
        sure = [h.probability for h in self.heard if h.named is not None]
        return float(np.median(sure)) if sure else np.nan

    @property
    def false(self) -> int:
        """Count the alarms before the loss."""
        return sum(h.false for h in self.heard)

    @property
    def hours(self) -> float:
        """Return the time listened to before the loss, h."""
        return sum(h.hours for h in self.heard)


def earlier(case: Case) -> Case:
    """Return a case whose line breaks `EARLIER` later in its record."""
    return replace(case, onset=case.onset + EARLIER)


def longer(base: Scenario, case: Case) -> Scenario:
    """Return the scenario of a case with `EARLIER` seconds before the thesis's own record."""
    return scenario(base, earlier(case), base.record.duration + EARLIER)


def channels_of(record: Trial) -> Channels:
    """Return a record as an aligned log: north, east, heading and the thrust as the controller logs it."""
    values = np.column_stack([record.measured, record.thrust])
    grid = Grid(0.0, float(record.time[1] - record.time[0]), len(values))
    source = LogSource(path="simulated", format="simulated", bytes=0, sha256="")
    return Channels(_NAMES, _UNITS, grid, values, np.isfinite(values), source)


def run_file(base: Scenario) -> RunConfig:
    """Return configs/runs/fpso_position.toml, defaults and all, on the records' clock and for their vessel."""
    run = load_run(setting("runs", "fpso_position"))
    clock = run.clock.model_copy(update={"sample_time": base.record.sample_time})
    mooring = run.mooring.model_copy(update={"vessel": base.vessel, "model": base.model})
    return run.model_copy(update={"clock": clock, "mooring": mooring})


def taught(base: Scenario, case: Case, key: tuple[int, ...], duration: float = LEARN) -> OnsetGlr:
    """Return the bank fitted on ``duration`` s of the whole vessel in the current of ``case``, drawn by ``key``."""
    whole = replace(CASES[0], pull=case.pull)
    record = channels_of(trial(scenario(base, whole, duration), key, shared=False))
    return OnsetGlr.fit([Training(record, (slice(0, record.grid.n),))], run_file(base))


def heard(events: Sequence[Event], onset: float) -> Heard:
    """Return what ``events`` say of a loss at ``onset``, s. An alarm that did not stand is one all the same."""
    late = sorted((e for e in events if e.detected >= onset), key=lambda e: e.detected)
    false, hours = len(events) - len(late), (onset - WARM) / 3600.0
    if not late:
        return Heard(None, None, None, np.nan, false, hours)
    one = late[0]
    warned = max(float(one.evidence["warning"]) - onset, 0.0)
    return Heard(warned, one.detected - onset, one.subject, float(one.probability or 0.0), false, hours)


def ours_table(base: Scenario, seed: int, records: int) -> tuple[tuple[Ours, ...], tuple[OnsetGlr, ...]]:
    """Return one row a case and name, and a bank a case, that of the first seed.

    Record and teaching record share no random stream. Without a current the second of `NAMES` is the first.
    """
    pulls = sorted({case.pull for case in CASES})
    banks = {p: [taught(base, replace(CASES[0], pull=p), (seed, 200, k)) for k in range(records)] for p in pulls}
    rows = []
    for case in CASES:
        plan, onset, found = longer(base, case), case.onset + EARLIER, {name: list[Heard]() for name in NAMES}
        for k in range(records):
            channels = channels_of(trial(plan, (seed, k), shared=False))
            found[NAMES[0]].append(heard(banks[case.pull][k](channels)[1], onset))
            calm = heard(banks[0.0][k](channels)[1], onset) if case.pull else found[NAMES[0]][-1]
            found[NAMES[1]].append(calm)
        rows += [Ours(case, name, tuple(found[name])) for name in NAMES]
    return tuple(rows), tuple(banks[case.pull][0] for case in CASES)


def line_score(said: Posterior, lines: int) -> Array:
    """Return the bank's score, (n,): log odds of a lost line against all else; NaN while it hears nothing.

    ``said.probability``: no fault, ``lines`` lines, environment and wave group, in this order.
    """
    lost = said.probability[:, 1 : 1 + lines].sum(axis=1)
    rest = said.probability[:, 0] + said.probability[:, 1 + lines :].sum(axis=1)
    out = np.full(len(lost), np.nan)
    heard_it = (lost > 0.0) & (rest > 0.0)
    out[heard_it] = np.log(lost[heard_it]) - np.log(rest[heard_it])
    return out


def median_interval(values: Sequence[float], level: float = 0.95) -> tuple[float, float]:
    """Return the interval of a median by order statistics; the extremes where so few values allow no better."""
    from scipy.special import bdtr

    x = np.sort(np.asarray(values, dtype=np.float64))
    k = 0
    while k + 1 < (len(x) + 1) // 2 and bdtr(k, len(x), 0.5) <= (1.0 - level) / 2.0:
        k += 1
    k = max(k - 1, 0)
    return float(x[k]), float(x[len(x) - 1 - k])


def seconds(values: Sequence[float]) -> str:
    """Return a median and its interval in words, e.g. ``35 s [31, 40]``."""
    low, high = median_interval(values)
    middle = float(np.median(values))
    ends = ", ".join(f"{x:.0f}" if np.isfinite(x) else "never" for x in (low, high))
    return f"{middle:.0f} s [{ends}]" if np.isfinite(middle) else f"never [{ends}]"


def ours_cell(row: Ours) -> str:
    """Return a row's outcome in words."""
    false = f"{row.false} false alarms in {row.hours:.1f} h"
    if row.case.line == NONE:
        return false
    n = len(row.heard)
    found = sum(h.alarm is not None for h in row.heard)
    return f"{seconds(row.delays())} ({found} of {n}); named right {row.right}, p {row.probability:.2f}; {false}"


def ours_record(row: Ours) -> dict[str, Any]:
    """Return a row as JSON."""
    out: dict[str, Any] = {"case": row.case.name, "bench": row.name, "records": len(row.heard)}
    out |= {"false_alarms": row.false, "hours": row.hours}
    if row.case.line == NONE:
        return out
    for which in ("warned", "alarm"):
        delays = row.delays(which)
        ends = (float(np.median(delays)), *median_interval(delays))
        out[which] = dict(zip(("median", "low", "high"), (x if np.isfinite(x) else None for x in ends), strict=True))
    found = sum(h.alarm is not None for h in row.heard)
    return out | {"found": found, "named_right": row.right, "probability": row.probability if found else None}
