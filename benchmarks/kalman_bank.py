"""Time nine 15-state Kalman filters against nine of filterpy: `python benchmarks/kalman_bank.py`.

The eight-line vessel fpso200 at 1 Hz, the same matrices and data for both; states and covariances are compared first,
over 10,000 steps. Like for like is nine filters that carry their covariance. The onset bank needs less, and that is
printed apart: steady gains, solved once, and one filter for all nine hypotheses. CPU time, minimum of blocks in turn.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import time
from pathlib import Path

import numpy as np
from filterpy.kalman import KalmanFilter

from mooringdx.observers.kalman import Filter
from mooringdx.observers.matrices import Noise, model, plant_of
from mooringdx.physics.vessel import load_vessel

VESSEL = Path(__file__).parents[1] / "configs" / "vessels" / "fpso200.toml"
NOISE = Noise((2.9e10, 2.4e10, 9e12), (2.5e7, 2.5e7, 1e10), (0.05, 0.05, 0.001), (0.005, 0.005, 5e-5), 0.9, 0.1)
FILTERS, STEP, HEADING = 9, 1.0, 0.4


def peer(m, start):
    """Return filterpy's filter with the matrices of ``m``."""
    out = KalmanFilter(dim_x=15, dim_z=3, dim_u=3)
    out.F, out.B, out.Q, out.H, out.R = m.F, m.G, m.Q, m.C, m.R
    out.x, out.P = np.zeros(15), 4.0 * np.array(m.P)
    out.x[:3] = start
    return out


def run(filters, measured, force):
    """Step filterpy's filters over a record."""
    for each, u in zip(filters, force, strict=True):
        for y, f in zip(measured, u, strict=True):
            each.update(y)
            each.predict(u=f)
    return filters


def timed(work):
    start = time.process_time()
    work()
    return time.process_time() - start


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=10_000, help="steps over which both are compared")
    parser.add_argument("--block", type=int, default=300, help="steps of a timed block of filterpy")
    parser.add_argument("--repeats", type=int, default=15)
    args = parser.parse_args()
    plant = plant_of(load_vessel(VESSEL).dynamics)
    m, filtering, rng = model(plant, NOISE, STEP, HEADING), Filter(plant, NOISE, STEP), np.random.default_rng(0)
    n, start = args.samples, 4.0 * np.array(m.P)
    force = rng.standard_normal((FILTERS, n, 3)) * np.sqrt(NOISE.force)
    measured = np.cumsum(rng.standard_normal((n, 3)), axis=0) * np.sqrt(np.diag(m.P))[:3]

    def ours(k, one):
        return filtering(measured[:k], force[one, :k], models=[m], turning=False, start_covariance=start)

    def theirs(k, count):
        return run([peer(m, measured[0]) for _ in range(count)], measured[:k], force[:count, :k])

    def steady(k, one):
        return filtering(measured[:k], force[one, :k], models=[m], turning=False)

    mine, other = ours(n, 0), theirs(n, 1)[0]
    state = float(np.max(np.abs(mine.final - other.x) / np.maximum(np.abs(other.x), np.sqrt(np.diag(other.P)))))
    root = np.sqrt(np.diag(other.P))
    spread = float(np.max(np.abs(mine.final_covariance - other.P) / np.outer(root, root)))
    print(f"after {n} steps, largest relative difference: state {state:.1e}, covariance {spread:.1e}")
    k = args.block
    work = {
        "nine filters, filterpy": lambda: theirs(k, FILTERS),
        "nine filters, ours": lambda: [ours(n, i) for i in range(FILTERS)],
        "nine filters, ours, steady gain": lambda: [steady(n, i) for i in range(FILTERS)],
        "one filter for nine hypotheses": lambda: steady(n, 0),
    }
    times = {name: [] for name in work}
    for _ in range(args.repeats + 1):
        for name, each in work.items():
            times[name].append(timed(each))
    best = {name: 1e6 * min(t[1:]) / (k if "filterpy" in name else n) for name, t in times.items()}
    peers = best["nine filters, filterpy"]
    for name, cost in best.items():
        count = 1 if name.startswith("one") else FILTERS
        print(
            f"{name:32s} {cost:8.2f} us a sample, {cost / count:6.2f} a filter step, {cost / FILTERS:7.2f} a "
            f"hypothesis   {peers / cost:7.1f} x as fast as filterpy"
        )


if __name__ == "__main__":
    main()
