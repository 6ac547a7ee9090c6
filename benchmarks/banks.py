"""Every position-only bank on the same records: alarms in vain, delays, names. `python benchmarks/banks.py`.

For every sea: one fit on a healthy log of 70 min a seed, one log with a lost line a seed (the line goes round with the
seed), and healthy logs of up to 12 h, all of the FPSO with its controller and a wandering current, two fixes a second.
Weather and noise are drawn anew for each. Found: an alarm within 900 s of the loss. Intervals are exact, 95 %.
`--seeds 8 --first 1 --hours 24 --seas 1.5 2.5 4 --banks imm onset_glr`; `thesis_dht:mended:no_fault` names equations
and covariances.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mooringdx.assess.intervals import binomial, poisson
from mooringdx.config import RunConfig, load_run
from mooringdx.hypotheses import HYPOTHESES
from mooringdx.hypotheses.onset_glr import OnsetGlr
from mooringdx.pipeline import prepare
from mooringdx.residuals.training import Training
from mooringdx.simulate import Scenario, load_scenario, simulate
from mooringdx.types import Channels, Event, Posterior

CONFIGS = Path(__file__).parents[1] / "configs"
SEAS = {"1.5": (1.5, 6.0), "2.5": (2.5, 7.0), "4": (4.0, 9.0), "5.5": (5.5, 10.5)}
SAMPLE, LEARN, ONSET, WITHIN, LONGEST, WARM = 0.5, 4200.0, 1200.0, 900.0, 12.0, 600.0
BANKS = (
    "onset_glr", "imm", "shared_bias", "live_bias", "no_bias", "thesis_dht", "thesis_mle",
    "thesis_dht:printed:no_fault", "thesis_mle:printed:no_fault", "thesis_dht:mended", "thesis_mle:mended",
)  # fmt: skip


@dataclass
class Tally:
    """What one bank said in one sea. ``delays``: s; ``wrong``: share of healthy time with a line likelier than none."""

    delays: list[float] = field(default_factory=list)
    faults: int = 0
    right: int = 0
    false: int = 0
    watched: float = 0.0
    wrong: list[float] = field(default_factory=list)
    spent: float = 0.0


def scenario(sea: str, duration: float, line: str | None = None) -> Scenario:
    """Return the FPSO in a sea, with a line lost at ``ONSET`` or healthy."""
    body = load_scenario(CONFIGS / "scenarios" / "fpso_line_lost.toml").model_dump(mode="json")
    height, period = SEAS[sea]
    body["sea"] |= {"height": height, "peak_period": period}
    body["record"] |= {"duration": duration, "sample_time": SAMPLE}
    body["faults"] = [] if line is None else [{"kind": "line_lost", "subject": line, "onset": ONSET}]
    return Scenario.model_validate(body)


def run_file(bank: str, temper: float | None) -> RunConfig:
    """Return the position-only run on the simulator's clock for ``bank``, such as thesis_dht:mended:no_fault."""
    word, *options = bank.split(":")
    body = load_run(CONFIGS / "runs" / "fpso_position.toml").model_dump(mode="json")
    body["clock"]["sample_time"] = SAMPLE
    body["bank"]["use"] = [word]
    body["bank"]["thesis"] |= dict(zip(("equations", "covariance", "values"), options, strict=False))
    if temper is not None:
        body["bank"]["peers"]["temper"] = temper
    return RunConfig.model_validate(body)


def log_of(made: Scenario, seed: int, weather: int, run: RunConfig) -> Channels:
    """Return a simulated log's positions, heading and thrust on the run's clock."""
    log, _ = simulate(made, seed, weather)
    signals = {name: s for name, s in log.signals.items() if not name.startswith("tension")}
    return prepare(type(log)(signals, log.source), run)


def astray(posterior: Posterior) -> float:
    """Return the share of the time after ten minutes in which a lost line is the likeliest hypothesis."""
    names = np.array([name.startswith("line_lost") for name in posterior.hypotheses])
    rows = posterior.time >= posterior.time[0] + WARM
    return float(names[np.argmax(posterior.probability[rows], axis=1)].mean())


def lost(tally: Tally, events: tuple[Event, ...], line: str) -> None:
    """Count what was said of a log with ``line`` lost at ``ONSET``."""
    tally.false += sum(e.detected < ONSET for e in events)
    tally.watched += ONSET / 3600.0
    tally.faults += 1
    late = sorted((e for e in events if e.detected >= ONSET), key=lambda e: e.detected)
    standing = [e for e in events if e.detected < ONSET and (e.cleared is None or e.cleared > ONSET)]
    if standing or not late or late[0].detected - ONSET > WITHIN:
        return
    tally.delays.append(late[0].detected - ONSET)
    tally.right += late[0].subject == line


def sea_of(sea: str, seeds: range, hours: float, runs: dict[str, RunConfig]) -> dict[str, Tally]:
    """Walk one sea state with every bank."""
    tallies = {bank: Tally() for bank in runs}
    logs = max(1, round(np.ceil(hours / LONGEST)))
    for seed in seeds:
        plain = next(iter(runs.values()))
        learn = log_of(scenario(sea, LEARN), seed, 7 * seed, plain)
        line = f"line_{1 + seed % 8}"
        broken = log_of(scenario(sea, ONSET + 1200.0, line), seed, 7 * seed + 1, plain)
        share = min(LONGEST, hours / logs)
        healthy = (
            log_of(scenario(sea, 3600.0 * share), seed, 7 * seed + 2, plain) if seed - seeds.start < logs else None
        )
        training = [Training(learn, (slice(0, learn.grid.n),))]
        base = OnsetGlr.fit(training, plain)  # one identification serves all
        for bank, run in runs.items():
            begun, tally = time.perf_counter(), tallies[bank]
            kind = HYPOTHESES[run.bank.use[0]]
            fitted = base if kind is OnsetGlr else kind.upon(base, training, run)
            lost(tally, fitted(broken)[1], line)
            if healthy is not None:
                posterior, found, _ = fitted(healthy)
                tally.false += len(found)
                tally.watched += share
                tally.wrong.append(astray(posterior))
            tally.spent += time.perf_counter() - begun
    return tallies


def row(bank: str, tally: Tally) -> str:
    """Return one line of the table."""
    days = tally.watched / 24.0
    low, high = poisson(tally.false, days)
    few, most = binomial(len(tally.delays), tally.faults)
    median = float(np.median([*tally.delays, *[np.inf] * (tally.faults - len(tally.delays))]))
    wrong = float(np.mean(tally.wrong)) if tally.wrong else np.nan
    cells: list[Any] = [
        f"{bank:<28}",
        f"{tally.false / days:6.1f} [{low:.1f}, {high:.1f}]".ljust(22),
        f"{tally.watched:.0f} h".rjust(6),
        f"{wrong:6.1%}",
        f"{len(tally.delays)}/{tally.faults} [{few:.2f}, {most:.2f}]".rjust(20),
        ("missed" if np.isinf(median) else f"{median:.0f} s").rjust(8),
        f"{tally.right}/{len(tally.delays)}".rjust(6),
        f"{tally.spent:.0f} s".rjust(6),
    ]
    return "  ".join(cells)


def main() -> None:
    """Print a table a sea state."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--hours", type=float, default=12.0, help="healthy hours a sea, in logs of up to 12 h")
    parser.add_argument("--seas", nargs="+", default=["1.5", "2.5", "4"], choices=list(SEAS))
    parser.add_argument("--banks", nargs="+", default=list(BANKS))
    parser.add_argument("--temper", type=float, default=None, help="of imm, shared_bias, live_bias, no_bias")
    asked = parser.parse_args()
    runs = {bank: run_file(bank, asked.temper) for bank in asked.banks}
    head = (
        "bank".ljust(28),
        "false alarms a day".ljust(22),
        " hours",
        " wrong",
        "found in 900 s".rjust(20),
        "  median",
    )
    for sea in asked.seas:
        tallies = sea_of(sea, range(asked.first, asked.first + asked.seeds), asked.hours, runs)
        print(f"\nHs {sea} m\n" + "  ".join((*head, " right", "  cost")))
        for bank, tally in tallies.items():
            print(row(bank, tally), flush=True)


if __name__ == "__main__":
    main()
