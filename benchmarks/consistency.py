"""Whether the observers' innovations are as their covariance says, on a sea like the one learned from.

`python benchmarks/consistency.py --seeds 10 --sea 2.5`: for every seed the noise is identified on 70 min without
faults, and each filter then runs over 70 min more of other weather. Mean normalised innovation squared (3 when
consistent) and the largest autocorrelation of any axis over lags of 1 to 60 s (0 when white; 4200 scatter by 0.015).
"""

from __future__ import annotations

import argparse
import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from onset import LEARN, SEAS, log_of, run_file, scenario

from mooringdx.hypotheses.onset_glr import OnsetGlr
from mooringdx.observers.ekf import Vessel, ekf
from mooringdx.observers.kalman import Estimate, correlation
from mooringdx.observers.ukf import ukf
from mooringdx.residuals.training import Training

START, LAGS = 600, 60


def estimates(sea: str, seed: int) -> dict[str, Estimate]:
    """Return what each filter makes of 70 min of a sea that it was fitted to."""
    run = run_file()
    learn = log_of(scenario(sea, LEARN), seed, 7 * seed, run)
    bank = OnsetGlr.fit([Training(learn, (slice(0, learn.grid.n),))], run)
    eta, force = bank.inputs(log_of(scenario(sea, LEARN + START), seed, 7 * seed + 3, run))
    vessel = Vessel(bank.plant, bank.noise, bank.step, bank.mooring)
    kalman = bank.filtering(bank.mooring)
    return {
        "kalman": kalman(eta, force, bias=bank.bias, models=kalman.models(eta[:, 2])),
        "extended": ekf(vessel, eta, force),
        "unscented": ukf(vessel, eta, force),
    }


def main() -> None:
    """Print one row a filter."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--sea", default="2.5", choices=list(SEAS))
    asked = parser.parse_args()
    rows: dict[str, list[tuple[float, float]]] = {}
    for seed in range(asked.first, asked.first + asked.seeds):
        for name, one in estimates(asked.sea, seed).items():
            row = (float(np.nanmean(one.nis[START:])), correlation(one.innovation[START:], LAGS))
            rows.setdefault(name, []).append(row)
    for name, found in rows.items():
        nis, acf = np.array(found).T
        print(f"Hs {asked.sea} m, {name}: NIS {nis.mean():.3f} ({nis.min():.3f} to {nis.max():.3f}), ", end="")
        print(f"max|acf| {acf.max():.3f} at most, median {np.median(acf):.3f}, n = {len(nis)} of 70 min", flush=True)


if __name__ == "__main__":
    main()
