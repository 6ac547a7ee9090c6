"""Put one signal on the uniform clock: a symmetric low-pass when decimating, straight lines when not.

Decimating (period at most sample_time / 1.5), normalised convolution [Knutsson1993]:

    y(T) = sum_i w_i h(t_i - T) x_i / sum_i w_i h(t_i - T),   h(u) = sinc(0.8 u / Ts) cos^2(pi u / (8 Ts)),  |u| <= 4 Ts

x_i at t_i the samples, w_i the time that each stands for (at most 1.5 periods, so that a gap has no weight), Ts the
new sample time. The half-amplitude frequency is 0.8 of the new Nyquist frequency. Being symmetric it has no delay; it
**looks 4 Ts ahead**, which is the price of a detection time that is not late by a filter's phase. Where under 97 % of
the weight |h| is real (beside a gap) a local straight line with positive weights cos^2 over 1.5 Ts takes its place,
which keeps level and slope; under 50 % the sample is not valid.

Otherwise: linear interpolation between neighbours no further apart than the largest gap and than 2.5 nominal periods
(one missing sample); in longer holes only what lies within half a period of a real sample is valid. A grid sample
that falls on a logged one (within 5 % of Ts) is valid whatever lies around it.
"""

from __future__ import annotations

import numba
import numpy as np

from mooringdx.types import Array, Mask

HALF = 4
TABLE = 1024
DECIMATE = 1.5
NEAR = 1.5
ON_STAMP = 0.05
FULL = 0.97
REAL = 0.5
ONE_MISSING = 2.5


def kernel_table() -> Array:
    """Return h on [0, HALF] sample times, `TABLE` points a sample time (one more at the end)."""
    u = np.arange(HALF * TABLE + 2) / TABLE
    h = np.sinc(0.8 * u) * np.cos(np.pi * np.minimum(u, HALF) / (2 * HALF)) ** 2
    return np.asarray(h, dtype=np.float64)


def resample(
    time: Array, values: Array, period: float, start: float, sample_time: float, n: int, max_gap: float
) -> tuple[Array, Mask]:
    """Return values (NaN where not valid) and validity on ``start + k sample_time``, k < n.

    Parameters
    ----------
    time, values : (m,), s strictly increasing, finite.
    period : nominal spacing of ``time``, s.
    start, sample_time : s, of the grid. n : its samples.
    max_gap : s, holes longer than this are never bridged.
    """
    if time.size == 0:
        return np.full(n, np.nan), np.zeros(n, dtype=np.bool_)
    if time.size > 1 and period <= sample_time / DECIMATE * (1.0 + 1e-9):
        table = kernel_table()
        area = 2.0 * sample_time * float(np.sum(np.abs(table[: HALF * TABLE]))) / TABLE
        return _convolve(time, values, period, start, sample_time, n, table, area)
    reach = max_gap
    if np.isfinite(period) and period <= 1.01 * max_gap:
        reach = max(max_gap, 1.5 * period)
    return _interpolate(time, values, period, start, sample_time, n, reach * (1.0 + 1e-9))


@numba.njit(cache=True)
def _convolve(
    time: Array, values: Array, period: float, start: float, sample_time: float, n: int, table: Array, area: float
) -> tuple[Array, Mask]:
    m = time.size
    out = np.full(n, np.nan)
    valid = np.zeros(n, dtype=np.bool_)
    most = 1.5 * period
    low = 0
    for k in range(n):
        at = start + k * sample_time
        while low < m and time[low] < at - HALF * sample_time:
            low += 1
        top = 0.0
        weight = 0.0
        real = 0.0
        s0 = s1 = s2 = r0 = r1 = 0.0
        i = low
        while i < m and time[i] <= at + HALF * sample_time:
            left = min(time[i] - time[i - 1], most) if i > 0 else period
            right = min(time[i + 1] - time[i], most) if i < m - 1 else period
            w = 0.5 * (left + right)
            u = (time[i] - at) / sample_time
            place = abs(u) * TABLE
            j = int(place)
            h = table[j] + (place - j) * (table[j + 1] - table[j])
            top += w * h * values[i]
            weight += w * h
            real += w * abs(h)
            if abs(u) < NEAR:
                g = w * np.cos(0.5 * np.pi * u / NEAR) ** 2
                s0 += g
                s1 += g * u
                s2 += g * u * u
                r0 += g * values[i]
                r1 += g * u * values[i]
            i += 1
        if real >= FULL * area:
            out[k] = top / weight
            valid[k] = True
        elif real >= REAL * area and s0 > 0.0:
            spread = s0 * s2 - s1 * s1
            out[k] = (s2 * r0 - s1 * r1) / spread if spread > 1e-9 * s0 * s0 else r0 / s0
            valid[k] = True
    return out, valid


@numba.njit(cache=True)
def _interpolate(
    time: Array, values: Array, period: float, start: float, sample_time: float, n: int, reach: float
) -> tuple[Array, Mask]:
    m = time.size
    out = np.full(n, np.nan)
    valid = np.zeros(n, dtype=np.bool_)
    on = ON_STAMP * sample_time
    same = 1e-6 * sample_time
    right = 0
    for k in range(n):
        at = start + k * sample_time
        while right < m and time[right] < at:
            right += 1
        if right < m and time[right] - at <= same:
            out[k] = values[right]
            valid[k] = True
            continue
        if 0 < right < m:
            span = time[right] - time[right - 1]
            near = min(at - time[right - 1], time[right] - at) <= 0.5 * period * (1.0 + 1e-9)
            if span <= reach and (span <= ONE_MISSING * period or near):
                share = (at - time[right - 1]) / span
                out[k] = values[right - 1] + share * (values[right] - values[right - 1])
                valid[k] = True
                continue
        if right > 0 and at - time[right - 1] <= on:
            out[k] = values[right - 1]
            valid[k] = True
        elif right < m and time[right] - at <= on:
            out[k] = values[right]
            valid[k] = True
    return out, valid
