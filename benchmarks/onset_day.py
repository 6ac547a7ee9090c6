"""Time the onset bank on one day of the FPSO at 1 Hz: `python benchmarks/onset_day.py`.

Eight lines, none, a step of the environment and three wave groups, with every onset of the last 15 min, through
`OnsetGlr.__call__` after one call that compiles. CPU time, minimum of the repeats. `--hours 24 --repeats 5 --seed 1`.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import resource
import time
from pathlib import Path

from mooringdx.config import load_run
from mooringdx.hypotheses.onset_glr import OnsetGlr
from mooringdx.pipeline import prepare
from mooringdx.residuals.training import Training
from mooringdx.simulate import Scenario, load_scenario, simulate
from mooringdx.types import Channels, replace

CONFIGS = Path(__file__).parents[1] / "configs"
SAMPLE, LEARN = 1.0, 4200.0


def healthy(duration: float, seed: int, weather: int) -> tuple[Channels, Training]:
    """Return a healthy log's positions, heading and thrust, and all of it as a no-fault window."""
    body = load_scenario(CONFIGS / "scenarios" / "fpso_line_lost.toml").model_dump(mode="json")
    body["record"] |= {"duration": duration, "sample_time": SAMPLE}
    body["faults"] = []
    log, _ = simulate(Scenario.model_validate(body), seed, weather)
    signals = {name: s for name, s in log.signals.items() if not name.startswith("tension")}
    channels = prepare(type(log)(signals, log.source), settings())
    return channels, Training(channels, (slice(0, channels.grid.n),))


def settings():
    """Return the position-only run at 1 Hz."""
    run = load_run(CONFIGS / "runs" / "fpso_position.toml")
    return run.model_copy(update={"clock": run.clock.model_copy(update={"sample_time": SAMPLE})})


def main() -> None:
    """Print the cost of a day and of a sample."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hours", type=float, default=24.0)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    bank = OnsetGlr.fit([healthy(LEARN, asked.seed, asked.seed)[1]], settings())
    day, _ = healthy(3600.0 * asked.hours, asked.seed, asked.seed + 1)
    n = 1800
    start = time.process_time()
    bank(replace(day, grid=replace(day.grid, n=n), values=day.values[:n], valid=day.valid[:n]))
    print(f"the first half hour, with what numba compiles or loads: {time.process_time() - start:.1f} s")
    times = []
    for _ in range(asked.repeats):
        start = time.process_time()
        _, events, _ = bank(day)
        times.append(time.process_time() - start)
    best, sec = min(times), day.grid.n
    print(
        f"{asked.hours:g} h at 1 Hz, {len(bank.mooring.names)} lines, none and all rivals: {best:.2f} s CPU "
        f"(worst of {asked.repeats}: {max(times):.2f} s), {1e6 * best / sec:.1f} us a sample, {len(events)} events"
    )
    print(f"largest memory of the process: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    main()
