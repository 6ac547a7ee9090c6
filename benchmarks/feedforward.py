"""What measured waves, heave and pitch, and wind are worth to the onset bank: `python benchmarks/feedforward.py`.

Loss of a line: for every seed, sea and variant one fit on a healthy log of 70 min, one log with a lost line (the line
goes round with the seed), one healthy log; medians over the seeds. Variants: ``none``; ``wave``: a probe at the vessel;
``bow``: one 100 m ahead; ``short``: one at the vessel in a short-crested sea (spread 25); ``side``: 100 m ahead in it;
``motion``: heave and pitch, on only where they explain enough; ``forced``: the same, on whatever they explain.
Squalls: `--squalls 10` of 460 kN from as many sides, wind logged: alarms should be none; `--wind-error .1`: its true
coefficients are that much larger than the vessel file's.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import time
from typing import Any

import numpy as np
from onset import AFTER, LEARN, ONSET, first, log_of, run_file, scenario

from mooringdx.config import ChannelSource, RunConfig
from mooringdx.hypotheses.onset_glr import OnsetGlr
from mooringdx.residuals.training import Training
from mooringdx.simulate import Scenario
from mooringdx.types import Channels

VARIANTS: dict[str, dict[str, Any]] = {
    "none": {},
    "wave": {"wave": 0.0},
    "bow": {"wave": 100.0},
    "short": {"wave": 0.0, "spread": 25.0},
    "side": {"wave": 100.0, "spread": 25.0},
    "motion": {"motion": True},
    "forced": {"motion": True, "mode": "always"},
}
LOGGED = {
    "wave": {"wave_elevation_1": "m"},
    "motion": {"heave": "m", "pitch": "deg"},
    "wind": {"wind_speed": "m/s", "wind_direction": "deg"},
}


def run_of(kinds: tuple[str, ...], mode: str = "auto") -> RunConfig:
    """Return the position-only run that also reads these kinds of sensor."""
    run = run_file()
    more = {name: ChannelSource(column=name, unit=unit) for kind in kinds for name, unit in LOGGED[kind].items()}
    bank = run.bank.model_copy(update={"feed_forward": mode})
    return run.model_copy(update={"channels": run.channels | more, "bank": bank})


def logged(made: Scenario, given: dict[str, Any]) -> Scenario:
    """Return a scenario whose log has what a variant measures."""
    body = made.model_dump(mode="json")
    body["sea"]["spread"] = given.get("spread")
    if "wave" in given:
        body["sensors"]["wave"] = {"noise": 0.05, "quantum": 0.001, "ahead": given["wave"]}
    if "motion" in given:
        body["sensors"]["motion"] = {"noise": 0.01, "quantum": 0.001}
    return Scenario.model_validate(body)


def fitted(channels: Channels, run: RunConfig) -> OnsetGlr:
    """Return the bank learned on a whole healthy log."""
    return OnsetGlr.fit([Training(channels, (slice(0, channels.grid.n),))], run)


def cell(sea: str, variant: str, seeds: range, hours: float, talk: bool) -> dict[str, Any]:
    """Walk one sea and variant."""
    given = VARIANTS[variant]
    run = run_of(tuple(k for k in ("wave", "motion") if k in given), given.get("mode", "auto"))
    delays, explained, false, right, on = [], [], 0, 0, 0
    for seed in seeds:
        bank = fitted(log_of(logged(scenario(sea, LEARN), given), seed, 7 * seed, run), run)
        line = f"line_{1 + seed % 8}"
        made = logged(scenario(sea, ONSET + AFTER, line), given)
        events = bank(log_of(made, seed, 7 * seed + 1, run))[1]
        false += sum(e.detected < ONSET for e in events)
        hit = first(events, ONSET)
        delays.append(np.inf if hit is None or hit.detected - ONSET > 1200.0 else hit.detected - ONSET)
        right += hit is not None and hit.subject == line
        if hours > 0.0:
            quiet = logged(scenario(sea, 3600.0 * hours), given)
            false += len(bank(log_of(quiet, seed, 7 * seed + 2, run))[1])
        best = max((f.explained[0] for f in bank.feeds), default=np.nan)
        explained.append(best)
        on += any(any(f.on) for f in bank.feeds)
        if talk:
            print(f"  {seed} {line}: {delays[-1]:.0f} s, R2 surge {best:.2f}, false {false}", flush=True)
    quantile = np.quantile(delays, [0.5, 0.9], method="higher")
    return {
        "sea": sea,
        "variant": variant,
        "found": f"{int(np.isfinite(delays).sum())}/{len(seeds)}",
        "right": right,
        "alarm s": float(np.median(delays)),
        "p90 s": float(quantile[1]),
        "R2 surge": f"{min(explained):.2f} to {max(explained):.2f}",
        "on": f"{on}/{len(seeds)}",
        "false": f"{false} in {len(seeds) * (hours + ONSET / 3600.0):.0f} h",
    }


def squall(seed: int, direction: float, error: float, wind: float, seen: bool) -> tuple[int, OnsetGlr]:
    """Return how many alarms a squall of 460 kN makes, wind ``seen`` or not, and the bank."""
    body = scenario("2.5", LEARN).model_dump(mode="json")
    mean = {"speed": wind, "direction": direction, "gust": 0.15 if wind else 0.0, "memory": 60.0}
    body |= {"rig": {"wind": error}, "wind": mean}
    body["sensors"]["wind"] = {"noise": 0.3, "quantum": 0.01, "logged": seen}
    run = run_of(("wind",) if seen else ())
    bank = fitted(log_of(Scenario.model_validate(body), seed, 7 * seed, run), run)
    angle = np.radians(direction) + np.pi - np.radians(225.0)
    along, across = 700.0 * np.cos(angle), 2200.0 * np.sin(angle)
    speed = float(np.sqrt(wind**2 + 4.6e5 / np.hypot(along, across)))
    trap = {"mode": "squall", "onset": ONSET, "ramp": 20.0, "size": speed, "direction": direction}
    body["record"]["duration"] = ONSET + AFTER
    return len(bank(log_of(Scenario.model_validate(body | {"traps": [trap]}), seed, 7 * seed + 1, run))[1]), bank


def main() -> None:
    """Print one row a sea and variant, or the squalls."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--hours", type=float, default=2.0)
    parser.add_argument("--seas", nargs="+", default=["2.5", "4"])
    parser.add_argument("--variants", nargs="+", default=["none", "wave", "bow", "motion", "forced"], choices=VARIANTS)
    parser.add_argument("--squalls", type=int, default=0)
    parser.add_argument("--wind", type=float, default=3.0, help="m/s, mean wind before the squall, with gusts")
    parser.add_argument("--wind-error", type=float, default=0.0)
    parser.add_argument("--unseen", action="store_true", help="squalls without an anemometer")
    parser.add_argument("--talk", action="store_true", help="one line a log")
    asked = parser.parse_args()
    if asked.squalls:
        alarmed = 0
        for i in range(asked.squalls):
            direction = (225.0 + 360.0 * i / asked.squalls) % 360.0
            count, bank = squall(asked.first + i, direction, asked.wind_error, asked.wind, not asked.unseen)
            alarmed += count > 0
            if asked.talk:
                print(
                    f"  {asked.first + i} from {direction:.0f} deg: {count} alarms, R2 of wind {bank.gusts}", flush=True
                )
        print(f"squalls of 460 kN that alarm: {alarmed} of {asked.squalls}")
        return
    for sea in asked.seas:
        for variant in asked.variants:
            start = time.perf_counter()
            row = cell(sea, variant, range(asked.first, asked.first + asked.seeds), asked.hours, asked.talk)
            told = ", ".join(f"{k} {v:.3g}" if isinstance(v, float) else f"{k} {v}" for k, v in row.items())
            print(f"{told} ({time.perf_counter() - start:.0f} s)", flush=True)


if __name__ == "__main__":
    main()
