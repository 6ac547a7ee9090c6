"""One verdict from tensions and position on the FPSO, how right and how soon: `python benchmarks/fusion.py`.

For every seed and sea state: one fit on a healthy log of 70 min, then for every line one log in which it is lost, one
in which its gauge dies. Weather and noise are drawn anew for each. `--seeds 12 --first 1 --seas 2.5 --talk`. A share
stands with its 95 % interval (Clopper and Pearson), logs on one fit count as independent. `--levels` asks position
alone at known onsets, and prints what other levels to confirm and to refute would have given.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import time
from pathlib import Path
from typing import Any

import numpy as np
from onset import LEARN, ONSET, SAMPLE, SEAS, scenario
from scipy.stats import beta

from mooringdx.baseline import Baseline
from mooringdx.config import RunConfig, load_run
from mooringdx.hypotheses.onset.witness import Witness, ratio
from mooringdx.hypotheses.onset_glr import OnsetGlr
from mooringdx.pipeline import detect, fit, prepare
from mooringdx.residuals.training import Training
from mooringdx.simulate import Scenario, simulate
from mooringdx.types import Array, Event

RUN = Path(__file__).parents[1] / "configs" / "runs" / "fpso_both.toml"
AFTER = 600.0
LINES = range(1, 9)


def faults(kind: str, line: int) -> list[dict[str, Any]]:
    if kind == "line_lost":
        return [{"kind": "line_lost", "subject": f"line_{line}", "onset": ONSET}]
    return [{"kind": "sensor_fault", "subject": f"tension_{line}", "mode": "dead", "onset": ONSET}]


def walk(made: Scenario, seed: int, weather: int, run: RunConfig, baseline: Baseline) -> tuple[Event, ...]:
    """Return the events of one simulated log."""
    log, _ = simulate(made, seed, weather)
    return detect(prepare(log, run), baseline, name="fusion").events


def judged(events: tuple[Event, ...], kind: str, line: int) -> dict[str, Any]:
    """Hold the events of one log against its fault."""
    late = [e for e in events if e.detected >= ONSET]
    out: dict[str, Any] = {"early": len(events) - len(late), "more": max(len(late) - 1, 0), "found": bool(late)}
    if not late:
        return out | {"right": False, "unknown": False, "line": False, "position": "none"}
    event = min(late, key=lambda e: e.detected)
    subject = f"{'line' if kind == 'line_lost' else 'tension'}_{line}"
    position = event.evidence.get("position", {})
    told = event.evidence.get("cause_told") or event.named or event.detected
    return out | {
        "right": event.kind == kind and event.subject == subject,
        "unknown": event.kind == "unknown",
        "line": event.subject.endswith(f"_{line}"),
        "delay": event.detected - ONSET,
        "told": told - ONSET,
        "position": position.get("verdict", "not asked"),
        "position_told": position["told"] - ONSET if position.get("told") is not None else np.nan,
        "words": f"{event.kind} {event.mode or ''} {event.subject}, {len(late)} events",
        "tension": event.evidence.get("tension", {}).get("verdict"),
        "tension_told": event.evidence.get("tension", {}).get("cause_told"),
    }


def share(hits: int, n: int) -> str:
    low = float(beta.ppf(0.025, hits, n - hits + 1)) if hits else 0.0
    high = float(beta.ppf(0.975, hits + 1, n - hits)) if hits < n else 1.0
    return f"{hits}/{n} ({100 * low:.1f} to {100 * high:.1f} %)"


def times(values: list[float]) -> str:
    good = np.array([v for v in values if np.isfinite(v)])
    return f"median {np.median(good):.0f} s, 95 % {np.quantile(good, 0.95):.0f} s, n {len(good)}" if good.size else "-"


def show(sea: str, kind: str, rows: list[dict[str, Any]]) -> None:
    n = len(rows)
    wrong = "refuted" if kind == "line_lost" else "confirmed"
    right = "confirmed" if kind == "line_lost" else "refuted"
    print(f"Hs {sea} {kind}: right line {share(sum(r['line'] for r in rows), n)}", end="")
    print(f", right cause {share(sum(r['right'] for r in rows), n)}", end="")
    print(f", none named {sum(r['unknown'] for r in rows)}, early {sum(r['early'] for r in rows)}", end="")
    print(f", further {sum(r['more'] for r in rows)}")
    print(f"  found {times([r.get('delay', np.nan) for r in rows])}; ", end="")
    print(f"within 10 s {share(sum(r.get('delay', np.inf) <= 10.0 for r in rows), n)}; ", end="")
    print(f"cause told {times([r.get('told', np.nan) for r in rows])}")
    print(f"  position: {right} {share(sum(r['position'] == right for r in rows), n)}", end="")
    print(f", {wrong} {share(sum(r['position'] == wrong for r in rows), n)}", end="")
    print(f"; {right} {times([r['position_told'] for r in rows if r['position'] == right])}", end="")
    alone = [r["tension_told"] - ONSET for r in rows if r.get("tension_told")]
    agreed = "line" if kind == "line_lost" else "sensor"
    said = [r.get("tension") for r in rows]
    print(f"\n  balance of forces alone: {agreed} {said.count(agreed)}, either {said.count('either')}", end="")
    print(f" of {n}; told {times(alone)}", flush=True)


def cell(sea: str, seeds: range, run: RunConfig, talk: bool) -> None:
    """Walk one sea state."""
    found: dict[str, list[dict[str, Any]]] = {"line_lost": [], "sensor_fault": []}
    spent = []
    for seed in seeds:
        log, _ = simulate(scenario(sea, LEARN), seed, 100 * seed)
        start = time.perf_counter()
        baseline = fit([prepare(log, run)], run, extrapolate=True)
        spent.append(time.perf_counter() - start)
        for i, kind in enumerate(found):
            for line in LINES:
                made = scenario(sea, ONSET + AFTER, faults=faults(kind, line))
                row = judged(walk(made, seed, 100 * seed + 10 * i + line, run, baseline), kind, line)
                found[kind].append(row)
                if talk and not (row["right"] and row["more"] == 0 and row["early"] == 0):
                    print(f"  {seed} {kind} {line}: {row}", flush=True)
    print(f"Hs {sea}: {len(seeds)} fits, {np.median(spent):.0f} s each")
    for kind, rows in found.items():
        show(sea, kind, rows)


def crossed(nats: Array, confirm: float, refute: float) -> tuple[int, float]:
    """Return +1 confirmed, -1 refuted or 0, and the s at which."""
    at = np.flatnonzero((nats >= confirm) | (nats <= refute))
    return (int(np.sign(nats[at[0]])), float(at[0])) if at.size else (0, np.nan)


def levels(sea: str, seeds: range, run: RunConfig) -> None:
    """Ask position of every line: at many onsets of a healthy log of 150 min, and of every line's loss."""
    alone = run.model_copy(update={"residuals": run.residuals.model_copy(update={"use": []})})
    still: list[Array] = []
    gone: list[Array] = []

    def witness(made: Scenario, seed: int, weather: int, bank: OnsetGlr) -> Witness:
        log, _ = simulate(made, seed, weather)
        return bank.walked(prepare(log, alone))[3]

    for seed in seeds:
        log, _ = simulate(scenario(sea, LEARN), seed, 100 * seed)
        channels = prepare(log, alone)
        bank = OnsetGlr.fit([Training(channels, (slice(0, channels.grid.n),))], alone)
        asked = witness(scenario(sea, 9000.0), seed, 100 * seed + 99, bank)
        for line in LINES:
            name = f"line_{line}"
            still += [ratio(asked.sights[0], name, np.array([k]), k + 900, asked.odds) for k in range(700, 8000, 400)]
            lost = witness(scenario(sea, ONSET + 420.0, name), seed, 100 * seed + line, bank)
            gone.append(ratio(lost.sights[0], name, np.array([round(ONSET)]), round(ONSET) + 400, lost.odds))
    for confirm, refute in ((7.0, -7.0), (7.0, -6.0), (7.0, -5.0), (5.0, -5.0), (4.6, -4.6)):
        told = [[crossed(nats, confirm, refute) for nats in part] for part in (still, gone)]
        print(f"Hs {sea}, {confirm:+g} and {refute:+g}:", end="")
        for words, part, sign in (("healthy, refuted", told[0], -1), ("lost, confirmed", told[1], 1)):
            print(f" {words} {times([t for s, t in part if s == sign])}", end="")
            print(f", the other {share(sum(s == -sign for s, _ in part), len(part))};", end="")
        print(flush=True)


def main() -> None:
    """Print three rows a sea state and fault."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--seas", nargs="+", default=["1.5", "2.5", "4"], choices=list(SEAS))
    parser.add_argument("--levels", action="store_true", help="position alone, at other levels")
    parser.add_argument("--talk", action="store_true", help="one line a log that did not go right")
    asked = parser.parse_args()
    run = load_run(RUN)
    run = run.model_copy(update={"clock": run.clock.model_copy(update={"sample_time": SAMPLE})})
    for sea in asked.seas:
        seeds = range(asked.first, asked.first + asked.seeds)
        if asked.levels:
            levels(sea, seeds, run)
        else:
            cell(sea, seeds, run, asked.talk)


if __name__ == "__main__":
    main()
