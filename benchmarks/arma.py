"""Time the ARMA(6, 4) fit against statsmodels' innovations MLE on the same record, and compare the likelihoods.

    OPENBLAS_NUM_THREADS=1 python benchmarks/arma.py [--seeds 3] [--n 10000]

CPU time (user + system) of this process, kernels compiled before; one BLAS thread, because idle ones spin and count.
statsmodels is timed from the start that our search has (the two regressions), without which it raises on such a record.
"behind": its exact log-likelihood at our coefficients below that of its own optimum started from ours, and below that
of where it was timed to ("same start"; negative where it ended lower).
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from mooringdx.whiten import Arma, fit_arma
from mooringdx.whiten.search import long_residual, projected, regression
from mooringdx.whiten.squares import evaluate, unbroken


def cpu(work: Callable[[], Any]) -> tuple[float, Any]:
    begun = time.process_time()
    out = work()
    return time.process_time() - begun, out


def exact_loglik(record: np.ndarray, model: Arma) -> float:
    """Exact Gaussian log-likelihood of a zero-mean record, the innovation's variance at its best."""
    from statsmodels.tsa.innovations.arma_innovations import arma_innovations

    e, v = arma_innovations(record, -model.ar, model.ma.copy(), sigma2=1.0)
    n = len(record)
    return float(-0.5 * (n * np.log(2 * np.pi * np.mean(e**2 / v)) + np.sum(np.log(v)) + n))


def _regressions(record: np.ndarray) -> Arma:
    """Our search's first start: Hannan and Rissanen's regressions, brought inside the stable region."""
    runs = unbroken([record / record.std()], (6, 4))
    theta = projected(6, regression(runs, long_residual(runs), 6, 4))
    sd = record.std() * np.sqrt(evaluate(runs, 6, theta).squares / runs.rows)
    return Arma(theta[:6], theta[6:], 0.0, float(sd))


def _peer(record: np.ndarray, start: Arma) -> Arma:
    from statsmodels.tsa.arima.estimators.innovations import innovations_mle

    given = np.concatenate([-start.ar, start.ma, [start.sd**2]])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found, _ = innovations_mle(
            record, order=(6, 0, 4), demean=False, start_params=given, enforce_invertibility=False
        )
    return Arma(ar=-found.ar_params, ma=found.ma_params, mean=0.0, sd=float(np.sqrt(found.sigma2)))


def main() -> None:
    sys.path[0] = str(
        Path(__file__).resolve().parents[1] / "tests"
    )  # in place of this folder, whose names shadow others
    from colours import arma64, simulate

    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--n", type=int, default=10_000)
    asked = parser.parse_args()
    ar, ma = arma64(1.5, 0.1)
    fit_arma([simulate(ar, ma, 2000, np.random.default_rng(0))], (6, 4))
    print(f"ARMA(6,4), {asked.n} samples, Ts 0.1 s, Tp 1.5 s; CPU s")
    print(
        "seed   ours (6,4)   ours BIC of 9 -> order   statsmodels   ratio   exact loglik: ours   its optimum   behind"
    )
    ratios = []
    for seed in range(asked.seeds):
        record = simulate(ar, ma, asked.n, np.random.default_rng(seed))
        k = np.arange(asked.n)
        record = record - np.polyval(np.polyfit(k, record, 1), k)
        fast, model = min((cpu(lambda r=record: fit_arma([r], (6, 4))) for _ in range(5)), key=lambda x: x[0])
        grid, best = cpu(lambda r=record: fit_arma([r], "bic"))
        first = _regressions(record)
        slow, timed = cpu(lambda r=record, m=first: _peer(r, m))
        _, found = cpu(lambda r=record, m=model: _peer(r, m))
        here, optimum, reached = (exact_loglik(record, m) for m in (model, found, timed))
        ratios.append(slow / fast)
        print(
            f"{seed:4d} {fast:12.4f} {grid:14.3f} -> {best.order!s:8} {slow:13.2f} {slow / fast:7.0f} {here:14.3f}"
            f" {optimum - here:20.3f} {reached - here:20.3f}"
        )
    print(f"ratio: median {np.median(ratios):.0f}, least {min(ratios):.0f}")


if __name__ == "__main__":
    main()
