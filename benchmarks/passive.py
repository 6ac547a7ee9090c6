"""Time one step of one passive observer against C compiled on the spot, in one run.

Nine observers of the eight-line vessel fpso200 over a record at 10 Hz; the innovations and last states are compared
first. CPU time, minimum of short interleaved blocks, because the machine may be busy. Both return arrays of their own:
with C writing over the same ones each time, the ratio told whether the allocator had pages at hand.

    python benchmarks/passive.py
"""

from __future__ import annotations

import argparse
import ctypes
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

from mooringdx.observers.matrices import plant_of
from mooringdx.observers.passive import passive, single_losses, watch
from mooringdx.physics.rig import mooring_of
from mooringdx.physics.vessel import load_vessel

VESSEL = Path(__file__).parents[1] / "configs" / "vessels" / "fpso200.toml"
C_SOURCE = r"""
#include <math.h>
typedef struct { double wave[6], K1[6], K2[3], K3[3], K4[3], decay, D[9], W[9]; } P;
static inline void slope(const double *restrict x, const double *restrict y, double seen, const double *restrict held,
                         double c, double s, const P *restrict p, double *restrict o) {
    double e[3];
    for (int i = 0; i < 3; i++) e[i] = seen * (y[i] - x[6 + i] - x[3 + i]);
    o[6] = c * x[12] - s * x[13] + p->K2[0] * e[0];
    o[7] = s * x[12] + c * x[13] + p->K2[1] * e[1];
    o[8] = x[14] + p->K2[2] * e[2];
    for (int i = 0; i < 3; i++) {
        o[i] = x[3 + i] + p->K1[i] * e[i];
        o[3 + i] = -p->wave[i] * x[i] - p->wave[3 + i] * x[3 + i] + p->K1[3 + i] * e[i];
        o[9 + i] = -p->decay * x[9 + i] + p->K3[i] * e[i];
    }
    double n = x[9] + p->K4[0] * e[0], m = x[10] + p->K4[1] * e[1];
    double f[3] = {held[0] + c * n + s * m, held[1] + c * m - s * n, held[2] + x[11] + p->K4[2] * e[2]};
    for (int i = 0; i < 3; i++) f[i] -= p->D[3*i] * x[12] + p->D[3*i+1] * x[13] + p->D[3*i+2] * x[14];
    for (int i = 0; i < 3; i++) o[12 + i] = p->W[3*i] * f[0] + p->W[3*i+1] * f[1] + p->W[3*i+2] * f[2];
}
void bank(double *restrict state, const double *restrict meas, const double *restrict force, double dt,
          const double *restrict shares, const P *restrict p, const double *restrict fair,
          const double *restrict anch, double start, double step, const double *restrict tab, long points,
          long n, long h, long lines, double *restrict innovation, double *restrict position, double *restrict bias) {
    double a[15], b[15], w[15], d[15], at[15], y[3] = {0, 0, 0};
    for (long k = 0; k < n; k++) {
        int whole = isfinite(meas[3*k]) && isfinite(meas[3*k+1]) && isfinite(meas[3*k+2]);
        if (whole) for (int i = 0; i < 3; i++) y[i] = meas[3*k+i];
        for (long i = 0; i < h; i++) {
            double *x = state + 15 * i, psi = whole ? y[2] : x[8], c = cos(psi), s = sin(psi);
            long q = 3 * (k * h + i);
            for (int m = 0; m < 3; m++) {
                innovation[q + m] = whole ? y[m] - x[6 + m] - x[3 + m] : NAN;
                position[q + m] = x[6 + m];
                bias[q + m] = x[9 + m];
            }
            double pull[3] = {0, 0, 0}, ce = cos(x[8]), se = sin(x[8]);
            for (long j = 0; j < lines; j++) {
                double an = ce * fair[2*j] - se * fair[2*j+1], ae = se * fair[2*j] + ce * fair[2*j+1];
                double N = anch[2*j] - x[6] - an, E = anch[2*j+1] - x[7] - ae, r = sqrt(N * N + E * E);
                double at_ = (r - start) / step, v;
                const double *t = tab + j * points;
                if (at_ <= 0) v = t[0];
                else { long g = (long)at_; if (g > points - 2) g = points - 2; v = t[g] + (at_ - g) * (t[g+1] - t[g]); }
                v *= shares[i * lines + j] / r;
                pull[0] += v * N; pull[1] += v * E; pull[2] += v * (an * E - ae * N);
            }
            double held[3] = {force[3*k] + c * pull[0] + s * pull[1], force[3*k+1] + c * pull[1] - s * pull[0],
                              force[3*k+2] + pull[2]};
            slope(x, y, whole, held, c, s, p, a);
            for (int m = 0; m < 15; m++) at[m] = x[m] + 0.5 * dt * a[m];
            slope(at, y, whole, held, c, s, p, b);
            for (int m = 0; m < 15; m++) at[m] = x[m] + 0.5 * dt * b[m];
            slope(at, y, whole, held, c, s, p, w);
            for (int m = 0; m < 15; m++) at[m] = x[m] + dt * w[m];
            slope(at, y, whole, held, c, s, p, d);
            for (int m = 0; m < 15; m++) x[m] += dt / 6.0 * (a[m] + 2 * b[m] + 2 * w[m] + d[m]);
        }
    }
}
"""


def compiled():
    """Return the C function, or None where there is no C compiler."""
    folder = Path(tempfile.mkdtemp())
    (folder / "bank.c").write_text(C_SOURCE)
    line = ["cc", "-O3", "-march=native", "-fno-math-errno", "-shared", "-fPIC", "bank.c", "-o", "bank.so", "-lm"]
    try:
        subprocess.run(line, cwd=folder, check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError):
        return None
    return ctypes.CDLL(str(folder / "bank.so")).bank


def timed(work):
    start = time.process_time()
    work()
    return time.process_time() - start


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--samples", type=int, default=2_000)
    parser.add_argument("--repeats", type=int, default=150)
    args = parser.parse_args()
    n, rng = args.samples, np.random.default_rng(0)
    ship = load_vessel(VESSEL)
    lines, o, shares = mooring_of(ship), passive(plant_of(ship.dynamics), 0.9), single_losses(8)
    measured = np.array([0.0, 0.0, -2.36]) + [0.5, 0.5, 0.01] * rng.standard_normal((n, 3))
    force, h = 1e5 * rng.standard_normal((n, 3)), len(shares)
    numbers = np.concatenate(
        [x.ravel() for x in (o.wave, o.K1, o.K2, o.K3, o.K4, np.array([o.decay]), o.damping, o.inverse)]
    )
    tables = [np.ascontiguousarray(x) for x in (lines.fairleads, lines.anchors, lines.horizontal)]
    c, p = compiled(), lambda a: a.ctypes.data_as(ctypes.c_void_p)
    real, whole = ctypes.c_double, ctypes.c_long

    def in_c():
        out, state = [np.empty((n, h, 3)) for _ in range(3)], np.zeros((h, 15))
        state[:, 6:9] = measured[0]
        c(p(state), p(measured), p(force), real(0.1), p(shares), p(numbers), p(tables[0]), p(tables[1]),
          real(lines.start), real(lines.step), p(tables[2]), whole(tables[2].shape[1]), whole(n), whole(h),
          whole(len(lines.anchors)), *(p(x) for x in out))  # fmt: skip
        return out, state

    def ours():
        return watch(o, lines, shares, measured, force, 0.1)

    found = ours()
    work = {"numba": ours}
    if c is not None:
        out, state = in_c()
        np.testing.assert_allclose(found.innovation, out[0], rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(found.final, state, rtol=1e-9, atol=1e-9)
        work["C"] = in_c
    times = {name: [] for name in work}
    for _ in range(args.repeats + 1):
        for name, each in work.items():
            times[name].append(timed(each))
    cost = {name: 1e9 / (n * h) * min(t[1:]) for name, t in times.items()}
    for name, value in cost.items():
        against = f"{value / cost['C']:5.2f} x C" if "C" in cost else "no C compiler"
        print(f"{name:8s} {value:7.1f} ns a hypothesis step   {against}")


if __name__ == "__main__":
    main()
