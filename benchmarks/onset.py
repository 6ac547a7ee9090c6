"""How soon and how surely the onset bank finds a lost line, and how often in vain: `python benchmarks/onset.py`.

For every seed and sea state: one fit on a healthy log of 70 min, one log with a lost line (the line goes round with the
seed), one healthy log. Weather and noise are drawn anew for each. `--seeds 8 --first 1 --hours 4 --seas 2.5 --talk`.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np

from mooringdx.config import RunConfig, load_run
from mooringdx.hypotheses.onset_glr import OnsetGlr
from mooringdx.pipeline import prepare
from mooringdx.residuals.training import Training
from mooringdx.simulate import Scenario, load_scenario, simulate
from mooringdx.types import Channels, Event

CONFIGS = Path(__file__).parents[1] / "configs"
SEAS = {"1.5": (1.5, 6.0), "2.5": (2.5, 7.0), "4": (4.0, 9.0), "5.5": (5.5, 10.5)}
SAMPLE, LEARN, ONSET, AFTER = 0.5, 4200.0, 1200.0, 1260.0


def scenario(sea: str, duration: float, line: str | None = None, **change: Any) -> Scenario:
    """Return the FPSO in a sea, with a line lost at ``ONSET`` or healthy."""
    body = load_scenario(CONFIGS / "scenarios" / "fpso_line_lost.toml").model_dump(mode="json")
    height, period = SEAS[sea]
    body["sea"] |= {"height": height, "peak_period": period}
    body["record"] |= {"duration": duration, "sample_time": SAMPLE}
    body["faults"] = [] if line is None else [{"kind": "line_lost", "subject": line, "onset": ONSET}]
    return Scenario.model_validate(body | change)


def run_file() -> RunConfig:
    """Return the position-only run on the simulator's clock."""
    run = load_run(CONFIGS / "runs" / "fpso_position.toml")
    return run.model_copy(update={"clock": run.clock.model_copy(update={"sample_time": SAMPLE})})


def log_of(made: Scenario, seed: int, weather: int, run: RunConfig) -> Channels:
    """Return a simulated log's positions, heading and thrust on the run's clock."""
    log, _ = simulate(made, seed, weather)
    signals = {name: s for name, s in log.signals.items() if not name.startswith("tension")}
    return prepare(type(log)(signals, log.source), run)


def first(events: tuple[Event, ...], after: float) -> Event | None:
    """Return the first event that was detected after ``after``, s."""
    late = [e for e in events if e.detected >= after]
    return min(late, key=lambda e: e.detected) if late else None


def cell(sea: str, seeds: range, hours: float, run: RunConfig, talk: bool) -> dict[str, Any]:
    """Walk one sea state."""
    alarms, warned, right, found, false, watched, shares = [], [], 0, 0, 0, 0.0, []
    for seed in seeds:
        channels = log_of(scenario(sea, LEARN), seed, 7 * seed, run)
        bank = OnsetGlr.fit([Training(channels, (slice(0, channels.grid.n),))], run)
        line = f"line_{1 + seed % 8}"
        _, events, _ = bank(log_of(scenario(sea, ONSET + AFTER, line), seed, 7 * seed + 1, run))
        false += sum(e.detected < ONSET for e in events)
        hit = first(events, ONSET)
        if hit is not None and hit.detected - ONSET <= 1200.0:
            found += 1
            right += hit.subject == line
            alarms.append(hit.detected - ONSET)
            warned.append(max(hit.evidence["warning"] - ONSET, 0.0))
            shares.append(hit.size if hit.size is not None else np.nan)
        watched += ONSET / 3600.0
        extra = 0
        if hours > 0.0:
            _, quiet, _ = bank(log_of(scenario(sea, 3600.0 * hours), seed, 7 * seed + 2, run))
            extra = len(quiet)
            watched += hours
        false += extra
        if talk:
            said = "missed" if hit is None else f"{hit.subject} {hit.detected - ONSET:.0f} s p {hit.probability:.2f}"
            s = np.sqrt(np.asarray(bank.noise.force)) / 1e3
            s, noise = np.sqrt(np.asarray(bank.noise.force)) / 1e3, bank.noise
            print(f"  {seed} {line}: {said}; false {extra}; sqrt S_F {s[0]:.0f} {s[1]:.0f} kN s^.5", end="")
            print(
                f", temper {bank.temper[4]:.2f} to {bank.temper[-1]:.2f}, nis {bank.nis:.2f}, w0 {noise.frequency:.2f}",
                flush=True,
            )
    rates = [row["r"] for row in bank.observability().values()]
    return {
        "sea": sea,
        "r": f"{min(rates):.2g}-{max(rates):.2g}",
        "found": f"{found}/{len(seeds)}",
        "right": f"{right}/{found}",
        "warning s": float(np.median(warned)) if warned else np.nan,
        "alarm s": float(np.median(alarms)) if alarms else np.nan,
        "p90 s": float(np.quantile(alarms, 0.9)) if alarms else np.nan,
        "share": float(np.nanmedian(shares)) if shares else np.nan,
        "false": f"{false} in {watched:.0f} h",
    }


def main() -> None:
    """Print one row a sea state."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--seas", nargs="+", default=["1.5", "2.5", "4"], choices=list(SEAS))
    parser.add_argument("--talk", action="store_true", help="one line a log")
    asked = parser.parse_args()
    run = run_file()
    for sea in asked.seas:
        start = time.perf_counter()
        row = cell(sea, range(asked.first, asked.first + asked.seeds), asked.hours, run, asked.talk)
        told = ", ".join(f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items())
        print(f"{told} ({time.perf_counter() - start:.0f} s)", flush=True)


if __name__ == "__main__":
    main()
