"""Find the clock lag of one group of channels against another.

For every pair of a channel x of the group and a channel y of the others, low-passed below the waves,

    r(tau) = corr( x(t), y(t - tau) ),   |tau| <= max_lag,

over the whole log. The lag is that of the pair with the largest |r|; it is reported if |r| > 0.8, |lag| > 0.25 s and
|r| is at least 0.1 above the largest |r| within 0.25 s of zero. A positive lag means that the group's stamps are
late. Its 95 % interval is that of a delay between two band-limited Gaussian signals [Carter1987]: var = (1 - r^2) /
(r^2 N w^2), N = 2 B T the independent samples of the record, w the rms angular frequency of the low-passed signal.

Why below the waves: in a narrow band of period Tp a lag of tau and one of tau - Tp look the same. What this cannot
see: lags short against the slowest motion (under about 1 s in a minute of basin log), a lag that comes and goes, and,
between two groups only, which of the two clocks is wrong: the group declared first is named, and no group is
compared with one already found late. A physical delay below the
waves looks the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from mooringdx.types import Array, Defect, Grid, Mask

Spectrum = NDArray[np.complex128]

LEAST_R = 0.8
LEAST_LAG = 0.25
LEAST_GAIN = 0.1
BAND = 0.5
LEAST_SHARE = 0.5
LEAST_PERIODS = 3.0
OVERSAMPLE = 8.0
WAVY = ("wave_elevation", "heave", "pitch", "roll", "down")
MOTIONS = ("surge", "sway", "heave", "yaw", "roll", "pitch", "heading", "north", "east", "down")


@dataclass(frozen=True)
class Lag:
    """The best alignment of a pair: ``lag`` s (positive: the group is late), |r| there and near zero lag."""

    lag: float
    r: float
    r_zero: float


def lag_groups(names: Sequence[str], declared: Mapping[str, Sequence[str]]) -> dict[str, tuple[str, ...]]:
    """Return the groups to test: those declared, or the motions where tensions stand beside them."""
    if declared:
        return {g: tuple(m for m in members if m in names) for g, members in declared.items()}
    motions = tuple(n for n in names if n in MOTIONS)
    tensions = any(n.startswith("tension_") for n in names)
    return {"motions": motions} if motions and tensions else {}


def wave_frequency(names: Sequence[str], values: Array, valid: Mask, sample_time: float) -> float:
    """Return the waves' peak frequency, Hz: of a wave gauge, heave, pitch, roll, else the fastest; 0 if none."""
    for kind in WAVY:
        for k, name in enumerate(names):
            if name.startswith(kind) and (peak := _peak(values[:, k], valid[:, k], sample_time)) > 0.0:
                return peak
    return max((_peak(values[:, k], valid[:, k], sample_time) for k in range(len(names))), default=0.0)


def _peak(values: Array, valid: Mask, sample_time: float) -> float:
    """Return where the smoothed spectrum of the rate of change is largest, Hz; 0 where there is none."""
    x = bridge(values, valid)
    if np.count_nonzero(valid) < 64 or not np.any(x):
        return 0.0
    change = np.diff(x)
    power = np.abs(np.fft.rfft(change * np.hanning(change.size))) ** 2
    width = max(1, change.size // 512)
    smooth = np.convolve(power, np.ones(width) / width, mode="same")
    return float(np.fft.rfftfreq(change.size, sample_time)[np.argmax(smooth)])


def bridge(values: Array, valid: Mask) -> Array:
    """Return the channel (n,) with straight lines over what is not valid, for filters only."""
    if not valid.any():
        return np.zeros(values.size)
    if valid.all():
        return values
    at = np.arange(values.size)
    return np.asarray(np.interp(at, at[valid], values[valid]))


def low_pass(values: Array, edge: float, sample_time: float) -> Array:
    """Return ``values`` (n,) below ``edge`` Hz, zero phase, with a raised-cosine edge from 0.8 to 1.2 of it.

    The ends are continued by odd reflection, which keeps level and slope.
    """
    n = values.size
    reach = min(n - 1, int(4.0 / (edge * sample_time)))
    head, tail = 2.0 * values[0] - values[reach:0:-1], 2.0 * values[-1] - values[-2 : -reach - 2 : -1]
    longer = np.concatenate((head, values, tail))
    size = 1 << int(np.ceil(np.log2(longer.size)))
    f = np.fft.rfftfreq(size, sample_time)
    ramp = np.clip((1.2 * edge - f) / (0.4 * edge), 0.0, 1.0)
    gain = 0.5 - 0.5 * np.cos(np.pi * ramp)
    return np.asarray(np.fft.irfft(np.fft.rfft(longer, size) * gain, size)[reach : reach + n])


@dataclass(frozen=True)
class _Slow:
    """A low-passed channel, (m,), its weights (``whole`` where all are 1) and the spectra that every pair needs."""

    values: Array
    weight: Array
    whole: bool
    spectra: tuple[Spectrum, ...]
    sums: tuple[Array, Array]


def slow_channel(values: Array, usable: Mask, edge: float, sample_time: float, size: int) -> _Slow:
    """Return one channel (m,) below ``edge`` Hz ready for `pair_lag`; ``size`` of the transforms."""
    weight = usable.astype(np.float64)
    x = low_pass(bridge(values, usable), edge, sample_time)
    x = x - (np.sum(x * weight) / max(float(np.sum(weight)), 1.0))
    parts = (x * weight, weight, x * x * weight)
    spectra = tuple(np.fft.rfft(p, size) for p in parts)
    sums = (np.concatenate(([0.0], np.cumsum(x))), np.concatenate(([0.0], np.cumsum(x * x))))
    return _Slow(x, weight, bool(usable.all()), spectra, sums)


def _cross(x: Spectrum, y: Spectrum, most: int, size: int) -> Array:
    """Return sum_t x(t) y(t - k), |k| <= most."""
    c = np.fft.irfft(x * np.conj(y), size)
    return np.concatenate((c[size - most :], c[: most + 1]))


def _moments(x: _Slow, y: _Slow, most: int, size: int) -> tuple[Array, Array, Array, Array, Array]:
    """Return over the overlap at each lag: weight, sums of x and of y, sums of their squares."""
    if not (x.whole and y.whole):
        (xs, xw, xx), (ys, yw, yy) = x.spectra, y.spectra
        pairs = ((xw, yw), (xs, yw), (xw, ys), (xx, yw), (xw, yy))
        one, two, three, four, five = (_cross(a, b, most, size) for a, b in pairs)
        return one, two, three, four, five
    n = x.values.size
    k = np.arange(-most, most + 1)
    start, stop = np.maximum(k, 0), n + np.minimum(k, 0)
    of_x = [c[stop] - c[start] for c in x.sums]
    of_y = [c[stop - k] - c[start - k] for c in y.sums]
    return (stop - start).astype(np.float64), of_x[0], of_y[0], of_x[1], of_y[1]


def pair_lag(x: _Slow, y: _Slow, sample_time: float, most: int, size: int) -> Lag | None:
    """Return the lag of ``x`` against ``y`` within ``most`` samples either side; None where too little is left."""
    count, sx, sy, sxx, syy = _moments(x, y, most, size)
    if count.min() < LEAST_SHARE * (x.values.size - most):
        return None
    mx, my = sx / count, sy / count
    vx, vy = sxx / count - mx * mx, syy / count - my * my
    if min(vx.min() / max(vx.max(), 1e-300), vy.min() / max(vy.max(), 1e-300)) <= 1e-9:
        return None
    r = np.abs(_cross(x.spectra[0], y.spectra[0], most, size) / count - mx * my) / np.sqrt(vx * vy)
    best = int(np.argmax(r))
    zero = max(1, int(LEAST_LAG / sample_time))
    near_zero = float(r[max(0, most - zero) : most + zero + 1].max())
    return Lag((best - most + _vertex(r, best)) * sample_time, float(min(r[best], 1.0)), near_zero)


def _vertex(r: Array, best: int) -> float:
    if best in (0, r.size - 1):
        return 0.0
    a, b, c = r[best - 1], r[best], r[best + 1]
    bend = a - 2.0 * b + c
    return float(0.5 * (a - c) / bend) if bend < 0.0 else 0.0


def lag_sd(x: _Slow, r: float, sample_time: float) -> float:
    """Return the standard deviation of the lag of a pair with correlation ``r``, s."""
    n = x.values.size
    power = np.abs(np.fft.rfft(x.values * x.weight * np.hanning(n))) ** 2
    f = np.fft.rfftfreq(n, sample_time)
    total = float(power[1:].sum())
    rms = 2.0 * np.pi * np.sqrt(float(np.sum(f[1:] ** 2 * power[1:])) / total)
    seconds = float(np.sum(x.weight)) * sample_time
    independent = 2.0 * f[1] * total**2 / float(np.sum(power[1:] ** 2)) * seconds
    r = min(r, 1.0 - 1e-9)
    return float(np.sqrt((1.0 - r * r) / (r * r * independent)) / rms)


def find_lags(
    names: Sequence[str],
    grid: Grid,
    values: Array,
    usable: Mask,
    groups: Mapping[str, Sequence[str]],
    edge: float,
    max_lag: float,
) -> tuple[Defect, ...]:
    """Return one alarming defect for each group whose stamps are late or early against all channels outside it.

    Parameters
    ----------
    names, values, usable : (c,), (n, c), (n, c): aligned channels and where they may be used (valid and not held).
    groups : name -> members. edge : Hz, upper edge of the band. max_lag : s.
    """
    if edge <= 0.0 or grid.n * grid.sample_time * edge < LEAST_PERIODS:
        return ()
    step = max(1, int(1.0 / (OVERSAMPLE * edge * grid.sample_time)))
    sample_time = step * grid.sample_time
    m = grid.n // step
    most = min(round(max_lag / sample_time), m // 4)
    size = 1 << int(np.ceil(np.log2(m + most + 1)))
    if most < 2:
        return ()
    blocks = np.mean(usable[: m * step].reshape(m, step, -1), axis=1) > 0.5
    slow = {
        name: slow_channel(
            bridge(values[:, k], usable[:, k])[: m * step].reshape(m, step).mean(axis=1),
            blocks[:, k],
            edge,
            sample_time,
            size,
        )
        for k, name in enumerate(names)
        if usable[:, k].any()
    }
    found: list[Defect] = []
    for group, members in groups.items():
        lagging = {n for defect in found for n in defect.subjects}
        inside = [n for n in members if n in slow and n not in lagging]
        pairs = [
            (lag, a, b)
            for a in inside
            for b in slow
            if b not in members
            and b not in lagging
            and (lag := pair_lag(slow[a], slow[b], sample_time, most, size)) is not None
        ]
        if pairs:
            best, a, b = max(pairs, key=lambda p: p[0].r)
            if best.r > LEAST_R and abs(best.lag) > LEAST_LAG and best.r > best.r_zero + LEAST_GAIN:
                sd = lag_sd(slow[a], best.r, sample_time)
                found.append(_as_defect(group, [n for n in members if n in names], best, sd, (a, b), grid))
    return tuple(found)


def _as_defect(group: str, members: Sequence[str], lag: Lag, sd: float, pair: tuple[str, str], grid: Grid) -> Defect:
    half = float(np.hypot(1.96 * sd, 0.5 * grid.sample_time))
    word = "late" if lag.lag > 0.0 else "early"
    return Defect(
        mode="delay",
        subjects=tuple(members),
        start=grid.start,
        stop=grid.stop,
        value=lag.lag,
        unit="s",
        detail=(
            f"stamps of group '{group}' are {abs(lag.lag):.2f} s {word}: "
            f"{pair[0]} against {pair[1]}, r {lag.r:.2f}, {lag.r_zero:.2f} near zero lag"
        ),
        alarming=True,
        interval=(lag.lag - half, lag.lag + half),
    )
