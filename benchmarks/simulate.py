"""How fast the simulator is against real time: `python benchmarks/simulate.py`, one process, one core.

Whole records at 10 Hz, from the draw of the waves to the rounded log. Cold is the first record of a process (compiled
loops are read from the cache, the lines' tables solved); warm is the best of three after it.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import platform
import time
from pathlib import Path

from mooringdx.simulate import load_scenario, simulate

SCENARIOS = Path(__file__).parents[1] / "configs" / "scenarios"
NAMES = ("fang_healthy", "fang_leak_4h", "fang_storm", "fpso_line_lost")


def main() -> None:
    print(f"{platform.machine()}, Python {platform.python_version()}, {os.cpu_count()} cores")
    print(f"{'scenario':16s} {'record s':>9s} {'cold s':>8s} {'warm s':>8s} {'x real time':>12s}")
    for name in NAMES:
        scenario = load_scenario(SCENARIOS / f"{name}.toml")
        took = []
        for _ in range(4):
            start = time.perf_counter()
            simulate(scenario, 1)
            took.append(time.perf_counter() - start)
        span = scenario.record.duration + scenario.record.settle
        warm = min(took[1:])
        print(f"{name:16s} {span:9.0f} {took[0]:8.2f} {warm:8.3f} {span / warm:12,.0f}")


if __name__ == "__main__":
    main()
