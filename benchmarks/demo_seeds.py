"""Try the demo's run file on fresh seeds of its simulator: every line, a dead gauge, biases, two faults, healthy hours.

Each seed is fitted on its own first 20 minutes and judged on what follows. Shares come with n and exact 95 % intervals.

    python benchmarks/demo_seeds.py            # 6 seeds
    python benchmarks/demo_seeds.py --seeds 20 --healthy-hours 6
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from mooringdx.assess.intervals import binomial, poisson
from mooringdx.baseline import Baseline
from mooringdx.config import RunConfig, load_run
from mooringdx.pipeline import detect, fit, prepare
from mooringdx.simulate import Scenario, load_scenario, simulate
from mooringdx.types import Channels, Detection

ROOT = Path(__file__).parents[1]
LINE = {"kind": "line_lost", "subject": "line_4", "onset": 1320.0}
DEAD = {"kind": "sensor_fault", "subject": "tension_2", "onset": 1320.0, "mode": "dead"}


def made(base: Scenario, run: RunConfig, seed: int, faults: list[dict[str, Any]], duration: float = 1500.0) -> Channels:
    body = base.model_dump() | {"faults": faults}
    body["record"] = body["record"] | {"duration": duration}
    log, _ = simulate(Scenario.model_validate(body), seed)
    return prepare(log, run)


def named(found: Detection) -> list[tuple[str, str]]:
    return [(e.kind, e.subject) for e in found.events]


def share(name: str, hits: list[bool]) -> None:
    low, high = binomial(sum(hits), len(hits))
    print(f"{name:58s} {sum(hits):3d} of {len(hits):3d}   95 % {low:.2f} to {high:.2f}")


def with_rate(run: RunConfig, rate: str) -> RunConfig:
    return RunConfig.model_validate(run.model_dump(mode="json") | {"alarm": {"rate": rate}})


def healthy(run: RunConfig, base: Scenario, seeds: list[int], hours: float, rate: str) -> None:
    asked = with_rate(run, rate)
    count, upper = 0, 0.0
    for seed in seeds:
        channels = made(base, asked, seed, [], 1320.0 + 3600.0 * hours)
        baseline = fit([channels], asked)
        count += sum(e.detected > 1260.0 for e in detect(channels, baseline, name="healthy").events)
        upper += baseline.alarm_rate()["interval"][1] * 3600.0 / len(seeds)
    low, high = poisson(count, hours * len(seeds))
    print(
        f"healthy, {rate} asked: {count} alarms in {hours * len(seeds):g} h, {low:.3g} to {high:.3g} an hour; "
        f"printed upper limit {upper:.3g} an hour; {baseline.verdict}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("--first", type=int, default=101)
    parser.add_argument("--healthy-hours", type=float, default=2.0)
    options = parser.parse_args()
    run, base = load_run(ROOT / "configs/runs/demo.toml"), load_scenario(ROOT / "configs/scenarios/demo.toml")
    seeds = list(range(options.first, options.first + options.seeds))
    right: dict[str, list[bool]] = {}
    for seed in seeds:
        quiet = made(base, run, seed, [])
        baseline: Baseline = fit([quiet], run)
        right.setdefault("healthy 25 min: nothing", []).append(not detect(quiet, baseline, name="q").events)
        for line in range(1, 7):
            found = detect(made(base, run, seed, [LINE | {"subject": f"line_{line}"}]), baseline, name="l")
            right.setdefault("line lost: that line alone, no rival", []).append(
                named(found) == [("line_lost", f"line_{line}")] and not found.events[0].rivals
            )
            right.setdefault("line lost: onset within 5 s", []).append(
                bool(found.events) and abs(found.events[0].onset - 1320.0) < 5.0
            )
            right.setdefault("line lost: onset interval holds the onset", []).append(
                bool(found.events) and found.events[0].onset_interval[0] <= 1320.0 <= found.events[0].onset_interval[1]
            )
        found = detect(made(base, run, seed, [DEAD]), baseline, name="d")
        right.setdefault("dead gauge: that gauge alone, no line", []).append(
            named(found) == [("sensor_fault", "tension_2")] and not found.events[0].rivals
        )
        right.setdefault("dead gauge: mode dead", []).append([e.mode for e in found.events] == ["dead"])
        found = detect(made(base, run, seed, [DEAD, LINE | {"onset": 1400.0}]), baseline, name="t")
        second = {(r.kind, r.subject) for e in found.events[1:] for r in e.rivals} | set(named(found)[1:])
        right.setdefault("dead gauge, line 4 lost 80 s later: both, no more", []).append(
            named(found) == [("sensor_fault", "tension_2"), ("line_lost", "line_4")]
        )
        right.setdefault("  the same, or line 4 with its gauge as a pair", []).append(
            len(found.events) == 2
            and named(found)[0] == ("sensor_fault", "tension_2")
            and ("line_lost", "line_4")
            in second - {("unknown", "line_4")}
            <= {("line_lost", "line_4"), ("sensor_fault", "tension_4")}
        )
    for name, hits in right.items():
        share(name, hits)
    for rate in ("1/hour", "1/day", "1/month"):
        healthy(run, base, seeds, options.healthy_hours, rate)


if __name__ == "__main__":
    main()
