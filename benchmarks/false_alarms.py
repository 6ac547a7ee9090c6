"""Count false alarms against the asked rate: fit on one healthy hour, count on hundreds of fresh ones.

Six channels of ARMA(6, 4) colour with a spectral peak at 1.5 s, sampled at 0.1 s, an independent noise stream each.
The system is whitening with compression and three branches: main (15 s, reference following), short (2 s,
uncompressed), slow (10 min, frozen reference); the asked rate is shared .8 : .1 : .1. One alarm is counted from where
any statistic exceeds its level until all have stayed under 0.7 of it for two windows. The true rate is
not known but counted, so that "covers" has two readings: the printed interval overlaps the 95 % interval of the
count (stated), and it holds the counted rate itself (strict).

    python benchmarks/false_alarms.py            # 20 fits x 300 h
    python benchmarks/false_alarms.py --rate 1/hour --fits 10 --hours 40
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np
from scipy.stats import chi2

from mooringdx.config import parse_rate, rate_text
from mooringdx.detectors import Glrt
from mooringdx.detectors.covariance import covariance_of_means
from mooringdx.detectors.design import Design
from mooringdx.detectors.reference import Reference
from mooringdx.threshold import DRIFT_LIMIT, count_alarms, crossfit, drift_ratio, fit_threshold, predicted_threshold
from mooringdx.types import Fault, Grid, Residuals, Signatures, replace
from mooringdx.whiten import fit_whitener

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
from colours import arma64, simulate

SAMPLE_TIME, PEAK_PERIOD, LINES = 0.1, 1.5, 6
WINDOWS = {"main": 150, "short": 20, "slow": 6000}
SHARES = {"main": 0.8, "short": 0.1, "slow": 0.1}
MEMORY, HYSTERESIS, RECORD_HOURS = 6000.0, 0.7, 20
NAMES = tuple(f"channel_{i + 1}" for i in range(LINES))
SIGNATURES = Signatures(
    faults=tuple(Fault("sensor_fault", name, "bias") for name in NAMES),
    residuals=NAMES,
    matrix=np.eye(LINES),
    units=("N",) * LINES,
    total=np.full(LINES, np.nan),
    sign=np.zeros(LINES),
)


def healthy(hours, stream):
    """Return residuals of ``hours``, every channel from a noise stream of its own."""
    n = round(hours * 3600 / SAMPLE_TIME)
    colour = arma64(PEAK_PERIOD, SAMPLE_TIME)
    values = np.stack([simulate(*colour, n, np.random.default_rng(s)) for s in stream.spawn(LINES)], axis=1)
    return measured(values)


def measured(values):
    grid = Grid(0.0, SAMPLE_TIME, len(values))
    return Residuals(NAMES, ("N",) * LINES, grid, values, np.ones(values.shape, bool), SIGNATURES)


class System:
    """Whitener and three branches, fitted on no-fault pieces."""

    def __init__(self, pieces, order):
        self.whitener = fit_whitener(pieces, "arma+compression", order, peak_period=PEAK_PERIOD)
        walks = {id(r): self.walk(r) for r, _ in pieces}
        self.segments = {
            key: [(walks[id(r)][key].values[rows], walks[id(r)][key].valid[rows]) for r, rows in pieces]
            for key in ("main", "plain")
        }
        self.designs = {
            "main": self._design("main", "main", WINDOWS["main"], WINDOWS["main"], MEMORY),
            "short": self._design("short", "plain", WINDOWS["short"], WINDOWS["short"], MEMORY),
            "slow": self._design("slow", "plain", WINDOWS["slow"], WINDOWS["main"], None),
        }

    def walk(self, residuals):
        """Return the residuals whitened with and without compression."""
        return {"main": self.whitener(residuals), "plain": self.whitener.uncompressed()(residuals)}

    def _design(self, branch, key, window, covariance_window, memory):
        segments = self.segments[key]
        good = np.concatenate([z[valid.all(axis=1)] for z, valid in segments])
        reference = Reference(good.mean(axis=0), good.std(axis=0), memory, 2 * window)
        signatures = (self.whitener if key == "main" else self.whitener.uncompressed()).mapped(SIGNATURES)
        return Design.of(signatures, covariance_of_means(segments, covariance_window), window, reference, None, branch)

    def statistics(self, residuals, branches):
        """Return the statistic (n, lines) of each branch."""
        walk = self.walk(residuals)
        return {b: Glrt(self.designs[b])(walk["main" if b == "main" else "plain"]).values for b in branches}


def fit(hour, rate, assurance):
    """Return the fitted system, its thresholds by branch, and the drift ratio."""
    whole = System([(hour, slice(0, hour.grid.n))], "bic")
    orders = [m.order for m in whole.whitener.models]
    order = max(set(orders), key=orders.count)

    def fit_fold(train):
        system = System([(hour, rows) for _, rows in train], order)

        def apply(_, rows):
            values = system.statistics(hour, ("main", "short"))
            return np.hstack([values["main"][rows], values["short"][rows]])

        return apply

    held = crossfit([hour.grid.n], fit_fold)
    ratio = drift_ratio(whole.segments["plain"], WINDOWS["main"])
    common = {"samples": hour.grid.n, "drift_ratio": ratio, "system_rate": rate}
    thresholds = {
        b: fit_threshold(b, [g[:, part] for g in held], WINDOWS[b], SAMPLE_TIME, rate * SHARES[b], assurance, **common)
        for b, part in (("main", slice(0, LINES)), ("short", slice(LINES, None)))
    }
    thresholds["slow"] = predicted_threshold(
        "slow",
        SIGNATURES.sign,
        WINDOWS["slow"],
        WINDOWS["main"],
        SAMPLE_TIME,
        rate * SHARES["slow"],
        assurance,
        **common,
    )
    whole.designs = {b: replace(d, level=thresholds[b].level) for b, d in whole.designs.items()}
    return whole, thresholds, ratio


def count(system, thresholds, hours, stream):
    """Return the alarms of all branches together, and of each alone, over ``hours`` of fresh healthy record."""
    found = dict.fromkeys(("system", *WINDOWS), 0)
    for part, spawned in zip(chunks(hours), stream.spawn(len(chunks(hours))), strict=True):
        values = system.statistics(healthy(part, spawned), WINDOWS)
        ratio = {b: np.fmax.reduce(values[b] / thresholds[b].level, axis=1) for b in WINDOWS}
        ratio["system"] = np.fmax.reduce(list(ratio.values()))
        for key, r in ratio.items():
            found[key] += count_alarms(r, HYSTERESIS, 2 * WINDOWS["main"])
    return found


def chunks(hours):
    return [RECORD_HOURS] * (hours // RECORD_HOURS) + ([hours % RECORD_HOURS] if hours % RECORD_HOURS else [])


def drifting(hour, stream):
    """Return the hour with Ornstein-Uhlenbeck drift of .3 sd and 2 h memory on one channel."""
    rng = np.random.default_rng(stream)
    keep = np.exp(-SAMPLE_TIME / 7200.0)
    steps = rng.standard_normal(hour.grid.n) * np.sqrt(1.0 - keep**2)
    steps[0] = rng.standard_normal()
    values = np.array(hour.values)
    values[:, 0] += 0.3 * values[:, 0].std() * simulate_ou(keep, steps)
    return measured(values)


def simulate_ou(keep, steps):
    from scipy.signal import lfilter

    return lfilter([1.0], [1.0, -keep], steps)


def poisson(n, confidence=0.95):
    """Return the exact interval of a Poisson mean."""
    tail = 0.5 * (1.0 - confidence)
    return (chi2.ppf(tail, 2 * n) / 2 if n else 0.0), chi2.isf(tail, 2 * n + 2) / 2


def one(stream, args):
    hour_stream, count_stream, drift_stream = stream.spawn(3)
    hour = healthy(args.fit_hours, hour_stream)
    system, thresholds, ratio = fit(hour, args.rate, args.assurance)
    drift = drifting(hour, drift_stream)
    whitener = fit_whitener([(drift, slice(0, drift.grid.n))], "arma", system.whitener.models[0].order)
    z = whitener(drift)
    found = count(system, thresholds, args.hours, count_stream)
    seconds = args.hours * 3600.0
    low, high = (x / seconds / args.rate for x in poisson(found["system"]))
    interval = [sum(t.rate_interval[i] for t in thresholds.values()) / args.rate for i in (0, 1)]
    achieved = found["system"] / seconds / args.rate
    return {
        "found": found,
        "achieved": achieved,
        "counted": (low, high),
        "interval": interval,
        "central": sum(t.central_rate for t in thresholds.values()) / args.rate,
        "overlaps": interval[0] <= high and low <= interval[1],
        "holds": interval[0] <= achieved <= interval[1],
        "steady": ratio,
        "drift": drift_ratio([(z.values, z.valid)], WINDOWS["main"]),
        "level": {b: t.scaled_level for b, t in thresholds.items()},
        "shape": thresholds["main"].tail["shape"],
        "verdict": thresholds["main"].verdict,
    }


def summary(rows, hours, expected):
    achieved = np.array([r["achieved"] for r in rows])
    n, total = len(rows), sum(r["found"]["system"] for r in rows)
    low, high = (x / n / expected for x in poisson(total))
    least, median, most = np.quantile(achieved, (0.1, 0.5, 0.9))
    covers, strict = (sum(r[key] for r in rows) for key in ("overlaps", "holds"))
    drift, steady = (sum(r[key] > DRIFT_LIMIT for r in rows) for key in ("drift", "steady"))
    print(f"verdict of the fits      {', '.join(sorted({r['verdict'] for r in rows}))}")
    print(f"achieved at most asked   {(achieved <= 1.0).sum()} of {n}")
    print(f"achieved at most 3 x     {(achieved <= 3.0).sum()} of {n} (largest {achieved.max():.2f})")
    print(f"median [10 %, 90 %]      {median:.2f} [{least:.2f}, {most:.2f}]")
    print(f"all together             {total} in {n * hours} h: {total / n / expected:.2f} x [{low:.2f}, {high:.2f}]")
    print(f"interval covers          {covers} of {n} (strict {strict} of {n})")
    print(f"drift flagged            {drift} of {n}; steady flagged {steady} of {n}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rate", type=parse_rate, default=parse_rate("1/day"), help='asked of the system, "1/day"')
    parser.add_argument("--fits", type=int, default=20)
    parser.add_argument("--hours", type=int, default=300, help="counted for each fit")
    parser.add_argument("--fit-hours", type=float, default=1.0)
    parser.add_argument("--assurance", type=float, default=0.9)
    parser.add_argument("--seed", type=int, default=20260)
    args = parser.parse_args()
    started = time.process_time()
    expected = args.rate * args.hours * 3600.0
    print(f"asked {rate_text(args.rate)}: {expected:.1f} alarms in {args.hours} h; seed {args.seed}")
    print("fit  alarms (main short slow)  achieved/asked [95 %]  printed interval  central  R steady, drift  levels")
    rows = []
    for i, stream in enumerate(np.random.SeedSequence(args.seed).spawn(args.fits)):
        row = one(stream, args)
        rows.append(row)
        parts = " ".join(f"{row['found'][b]:4d}" for b in WINDOWS)
        levels = " ".join(f"{v:.1f}" for v in row["level"].values())
        print(
            f"{i + 1:3d}  {row['found']['system']:4d}  ({parts})     {row['achieved']:6.2f} [{row['counted'][0]:.2f}, "
            f"{row['counted'][1]:.2f}]   [{row['interval'][0]:7.3f}, "
            f"{row['interval'][1]:5.2f}]  {row['central']:6.3f}  "
            f"{row['steady']:8.2f} {row['drift']:8.1f}  {levels}  shape {row['shape']:.2f}",
            flush=True,
        )
    summary(rows, args.hours, expected)
    print(f"CPU {time.process_time() - started:.0f} s")


if __name__ == "__main__":
    main()
