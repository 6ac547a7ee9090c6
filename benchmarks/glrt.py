"""Time the moving-window likelihood ratio against C compiled on the spot and against plain numpy, in one run.

8 channels, 8 directions, window of 150 samples. Every variant writes all 8 statistics of each sample; "max and argmax"
the largest and its column. CPU time, median of interleaved repeats; all results are compared first.

    python benchmarks/glrt.py
"""

from __future__ import annotations

import argparse
import ctypes
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np
from numba import njit

from mooringdx.detectors.window import moving_window

R, F, WINDOW = 8, 8, 150
C_SOURCE = r"""
#include <string.h>
#define R 8
#define F 8
void glrt(const double *restrict z, const double *restrict w, long n, long m, double *restrict out, int most,
          double *restrict best, long *restrict which) {
    double s[R] = {0};
    for (long k = 0; k < n; k++) {
        if (k % 8192 == 0) {
            memset(s, 0, sizeof s);
            for (long q = k < m ? 0 : k - m; q < k; q++) for (int i = 0; i < R; i++) s[i] += z[q * R + i];
        }
        for (int i = 0; i < R; i++) s[i] += z[k * R + i] - (k >= m ? z[(k - m) * R + i] : 0.0);
        double p[F] = {0};
        for (int i = 0; i < R; i++) for (int j = 0; j < F; j++) p[j] += s[i] * w[i * F + j];
        for (int j = 0; j < F; j++) p[j] = 0.5 * p[j] * p[j];
        if (!most) { for (int j = 0; j < F; j++) out[k * F + j] = p[j]; continue; }
        double b = p[0]; long a = 0;
        for (int j = 1; j < F; j++) if (p[j] > b) { b = p[j]; a = j; }
        best[k] = b; which[k] = a;
    }
}
"""


def compiled():
    """Return the C function, or None where there is no C compiler."""
    folder = Path(tempfile.mkdtemp())
    (folder / "glrt.c").write_text(C_SOURCE)
    line = ["cc", "-O3", "-march=native", "-ffast-math", "-shared", "-fPIC", "glrt.c", "-o", "glrt.so"]
    try:
        subprocess.run(line, cwd=folder, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return ctypes.CDLL(str(folder / "glrt.so")).glrt


@njit
def largest(values, best, which):
    for k in range(values.shape[0]):
        b, a = values[k, 0], 0
        for j in range(1, values.shape[1]):
            if values[k, j] > b:
                b, a = values[k, j], j
        best[k] = b
        which[k] = a


def plain(z, weights):
    total = np.concatenate([np.zeros((1, R)), np.cumsum(z, axis=0)])
    return 0.5 * ((total[WINDOW:] - total[:-WINDOW]) @ weights.T) ** 2


def timed(work):
    start = time.process_time()
    work()
    return time.process_time() - start


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=1_000_000)
    parser.add_argument("--repeats", type=int, default=7)
    args = parser.parse_args()
    n, rng = args.samples, np.random.default_rng(0)
    z, valid = rng.standard_normal((n, R)), np.ones((n, R), bool)
    mix = rng.standard_normal((R, R)) + 3 * np.eye(R)
    directions, covariance = rng.standard_normal((F, R)), mix @ mix.T
    w = directions @ np.linalg.inv(covariance)
    weights = w / np.sqrt(WINDOW * (w * directions).sum(axis=1))[:, None]
    columns = np.ascontiguousarray(weights.T)
    out, c_out = np.empty((n, F)), np.empty((n, F))
    best, which = np.empty(n), np.empty(n, np.int64)
    start, level, frozen = (np.zeros(R), np.ones(R)), np.full(F, np.inf), np.zeros(n, bool)
    c, pointer = compiled(), lambda a: a.ctypes.data_as(ctypes.c_void_p)

    def ours(memory=0.0):
        pace = (memory, 2 * WINDOW, 60_000, 6000)
        moving_window(z, valid, directions, np.zeros(F), covariance, WINDOW, start, pace, level, False, out, frozen)

    def in_c(most):
        size = ctypes.c_long(n), ctypes.c_long(WINDOW)
        c(pointer(z), pointer(columns), *size, pointer(c_out), ctypes.c_int(most), pointer(best), pointer(which))

    work = {
        "numba, all 8": ours,
        "numba, max and argmax": lambda: (ours(), largest(out, best, which)),
        "numba, all 8, following reference": lambda: ours(1 / 6000),
        "numpy, all 8 (cumulative sum)": lambda: plain(z, weights),
    }
    if c is not None:
        work |= {"C, all 8": lambda: in_c(0), "C, max and argmax": lambda: in_c(1)}
    ours()
    np.testing.assert_allclose(out[WINDOW - 1 :], plain(z, weights), rtol=1e-6, atol=1e-8)
    if c is not None:
        in_c(0)
        np.testing.assert_allclose(out[WINDOW - 1 :], c_out[WINDOW - 1 :], rtol=1e-9, atol=1e-9)
    times = {name: [] for name in work}
    for _ in range(args.repeats + 1):
        for name, each in work.items():
            times[name].append(timed(each))
    cost = {name: 1e9 / n * float(np.median(t[1:])) for name, t in times.items()}
    for name, value in cost.items():
        base = cost.get("C, max and argmax" if "max" in name else "C, all 8")
        against = f"{value / base:6.2f} x C" if base else "no C compiler"
        print(f"{name:36s} {value:7.1f} ns a sample (least {1e9 / n * min(times[name]):.1f})  {against}")


if __name__ == "__main__":
    main()
