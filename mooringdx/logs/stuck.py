"""Find channels that are held while the others move.

A *hold* is a stretch over which a signal stays within 1e-4 of its standard deviation. It says nothing by itself:
every basin run holds still at its start. Channels x held together (one, or several of a group) are stuck when the
channels y outside that are tied to them in the rest of the log move meanwhile. Both directions are tried, on signals
below twice the wave peak frequency 1/Tp and on the same between half and twice of it (so that slow sensor offsets do
not hide the waves), with samples at -Tp/4, 0, Tp/4 as regressors (motions and tensions are out of phase in waves):

    y ~ b0 + sum b x     range of y over the hold                        >  L sd(y - fit)
    x ~ b0 + sum b y     range of the fit of x over the hold             >  L sd(x - fit)

    envelope of y ~ b0 + sum b envelope of x   (wave envelopes)  above b0  >  5 sd of the residual

with L = max(5, 2 sqrt(2 ln N)), N the independent samples in the hold, so that the residual alone does not range that
far. The envelopes do not mind a channel whose delay wanders, as that of a camera that falls behind before it stops.
The sd is cross-fitted over four contiguous folds, and a tie counts only where it explains half the variance so: a
chance fit of slow signals is no redundancy. No residual is taken as smaller than 5 % of the channel's own sd, and the
last half period of a hold (of an envelope: one period) carries no evidence: motion after it leaks back.

A signal that repeats values between updates (a slow sensor in a fast log) is held only beyond five of its own update
intervals. A channel that never changes, or one that nothing else in the log explains, cannot be judged.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from mooringdx.logs.lag import bridge, low_pass
from mooringdx.types import Array, Defect, Grid, Mask, Signal

Index = NDArray[np.int64]

TOLERANCE = 1e-4
RANGE_SD = 5.0
UPDATES = 5.0
LEAST_ROWS = 100
LEAST_SHARE = 0.5
FOLDS = 4
MOST_ROWS = 50_000
MOST_HOLDS = 50
LEAST_SD = 0.05


@dataclass(frozen=True)
class Hold:
    """One stretch [start, stop), s, over which ``channel`` kept its value; ``update``: its usual interval, s."""

    channel: str
    start: float
    stop: float
    update: float

    @property
    def length(self) -> float:
        """Length of the hold, s."""
        return self.stop - self.start


def find_holds(signal: Signal, period: float, least: float, max_gap: float) -> tuple[Hold, ...]:
    """Return the holds of one cleaned signal of at least ``least`` s and five update intervals, longest first."""
    if signal.time.size < 3:
        return ()
    spread = float(np.std(signal.values))
    if spread == 0.0:
        return (Hold(signal.name, float(signal.time[0]), float(signal.time[-1]), period),)
    gap = max(max_gap, 1.5 * period)
    start, stop = hold_runs(signal.time, signal.values, TOLERANCE * spread, gap)
    length = signal.time[stop] - signal.time[start]
    update = float(np.median(length)) + period
    long = np.flatnonzero(length >= max(least, UPDATES * update))
    long = long[np.argsort(-length[long], kind="stable")]
    return tuple(Hold(signal.name, float(signal.time[start[k]]), float(signal.time[stop[k]]), update) for k in long)


@numba.njit(cache=True)
def hold_runs(time: Array, values: Array, tolerance: float, gap: float) -> tuple[Index, Index]:
    """Return the first and last sample of each run that stays within ``tolerance`` of its first value, (r,) each."""
    n = values.size
    start = np.empty(n, dtype=np.int64)
    stop = np.empty(n, dtype=np.int64)
    runs = 0
    i = 0
    while i < n:
        j = i + 1
        while j < n and abs(values[j] - values[i]) <= tolerance and time[j] - time[j - 1] <= gap:
            j += 1
        start[runs] = i
        stop[runs] = j - 1
        runs += 1
        i = j
    return start[:runs].copy(), stop[:runs].copy()


def judge_holds(
    holds: Sequence[Hold],
    names: Sequence[str],
    grid: Grid,
    values: Array,
    valid: Mask,
    groups: Mapping[str, Sequence[str]],
    stuck_after: float,
    peak_period: float,
) -> tuple[Defect, ...]:
    """Return one defect for each stretch that one or several channels are held.

    Parameters
    ----------
    holds : of all channels. names, values, valid : (c,), (n, c), (n, c) on ``grid``, before any hold is masked.
    groups : name -> channels that fail together.
    stuck_after : s, a shorter hold never alarms. peak_period : s, of the waves; 0 where unknown.
    """
    longest = [h for name in names for h in [x for x in holds if x.channel == name][:MOST_HOLDS]]
    clusters = _clusters(sorted(longest, key=lambda h: (h.start, names.index(h.channel))), grid, groups)
    held = held_mask(holds, names, grid)
    judged = [c for c in clusters if min(h.length for h in c) >= max(stuck_after, 3.0 * grid.sample_time)]
    if not judged:
        return tuple(_as_defect(c, None) for c in clusters)
    bands = _bands(values, valid, grid, peak_period)
    usable = valid & ~held
    tap = max(1, round(0.25 * peak_period / grid.sample_time)) if peak_period > 0.0 else 0
    scene = _Scene(
        tuple(names), grid, bands, _envelope(bands, grid, peak_period), valid, usable, tap, stuck_after, peak_period
    )
    return tuple(_as_defect(c, _evidence(c, scene) if c in judged else None) for c in clusters)


@dataclass(frozen=True)
class _Scene:
    """All that judging a hold needs: channels on the grid, where valid, where also not held, the tap in samples."""

    names: tuple[str, ...]
    grid: Grid
    bands: tuple[Array, ...]
    envelope: Array
    valid: Mask
    usable: Mask
    tap: int
    stuck_after: float
    peak_period: float


def _clusters(holds: Sequence[Hold], grid: Grid, groups: Mapping[str, Sequence[str]]) -> list[list[Hold]]:
    """Return holds of one stretch together: of a group that overlap by half, else that start and end as one."""
    close = max(2.0 * grid.sample_time, 0.1)
    clusters: list[list[Hold]] = []
    for hold in holds:
        for cluster in clusters:
            first = cluster[0]
            overlap = min(first.stop, hold.stop) - max(first.start, hold.start)
            grouped = _together(first.channel, hold.channel, groups)
            same = abs(first.start - hold.start) <= close and abs(first.stop - hold.stop) <= close
            if hold.channel not in [h.channel for h in cluster] and (
                same or (grouped and overlap > 0.5 * max(first.length, hold.length))
            ):
                cluster.append(hold)
                break
        else:
            clusters.append([hold])
    return clusters


def held_mask(holds: Sequence[Hold], names: Sequence[str], grid: Grid) -> Mask:
    """Return where each channel is held, (n, c)."""
    held = np.zeros((grid.n, len(names)), dtype=np.bool_)
    for hold in holds:
        held[_span(hold.start, hold.stop, grid), names.index(hold.channel)] = True
    return held


def _span(start: float, stop: float, grid: Grid) -> slice:
    return slice(grid.index(start), min(grid.index(stop + 1e-9) + 1, grid.n))


def _together(a: str, b: str, groups: Mapping[str, Sequence[str]]) -> bool:
    return any(a in members and b in members for members in groups.values())


def _bands(values: Array, valid: Mask, grid: Grid, peak_period: float) -> tuple[Array, ...]:
    """Return the channels (n, c) below twice the wave frequency, and the same without what is under half of it."""
    columns = [bridge(values[:, k], valid[:, k]) for k in range(values.shape[1])]
    if peak_period <= 4.0 * grid.sample_time:
        return (np.column_stack(columns),)
    below = np.column_stack([low_pass(c, 2.0 / peak_period, grid.sample_time) for c in columns])
    slow = np.column_stack([low_pass(c, 0.5 / peak_period, grid.sample_time) for c in columns])
    return below, below - slow


def _envelope(bands: tuple[Array, ...], grid: Grid, peak_period: float) -> Array:
    """Return the wave envelopes (n, c), sqrt(2) of the rms over one period; empty without a wave band."""
    if len(bands) < 2:
        return np.zeros((0, 0))
    width = max(1, round(peak_period / grid.sample_time))
    total = np.cumsum(np.pad(bands[1] ** 2, ((width // 2 + 1, width - width // 2 - 1), (0, 0)), mode="edge"), axis=0)
    return np.asarray(np.sqrt(2.0 * np.maximum(total[width:] - total[:-width], 0.0) / width))


def _evidence(cluster: Sequence[Hold], scene: _Scene) -> tuple[float, float, str, float] | None:
    """Return (range, limit, by which channel, when passed or NaN) of the strongest tie; None where nothing is tied."""
    x = [scene.names.index(h.channel) for h in cluster]
    span = _span(max(h.start for h in cluster), min(h.stop for h in cluster), scene.grid)
    others = [k for k in range(len(scene.names)) if k not in x]
    live = [k for k in others if scene.usable[span, k].mean() > 0.5]
    found = [_tie(x, k, k, span, scene, band) for k in live for band in scene.bands]
    found += [_tie(live, k, None, span, scene, band) for k in x for band in scene.bands if live]
    found += [_envelope_tie(x, k, span, scene) for k in live if scene.envelope.size]
    seen = [f for f in found if f is not None]
    return max(seen, key=lambda f: (np.isfinite(f[3]), f[0] / f[1])) if seen else None


def _tie(
    regressors: Sequence[int], target: int, moving: int | None, span: slice, scene: _Scene, values: Array
) -> tuple[float, float, str, float] | None:
    """Fit ``target`` on ``regressors`` where all move, and see how far the hold's live side ranges over ``span``.

    ``moving``: the live channel itself when the held channels are the regressors, None when the live channels are.
    """
    rows, taps = _taps(scene.usable, regressors, scene.tap)
    rows &= scene.usable[:, target]
    if np.count_nonzero(rows) < max(LEAST_ROWS, 10 * len(regressors)):
        return None
    picked = np.flatnonzero(rows)
    picked = picked[:: max(1, picked.size // MOST_ROWS)]
    design = np.column_stack([values[picked + t][:, list(regressors)] for t in taps])
    weights, sd, share = _fit(design, values[picked, target])
    if share < LEAST_SHARE or not sd > 0.0:
        return None
    inside = _inside(span, scene, 2)
    if moving is not None:
        inside = inside[scene.valid[inside, moving]]
        told = values[inside, moving]
    else:
        seen, _ = _taps(scene.valid, regressors, scene.tap)
        inside = inside[seen[inside]]
        told = np.column_stack([values[inside + t][:, list(regressors)] for t in taps]) @ weights
    if told.size < 3:
        return None
    so_far = (np.maximum.accumulate(told) - np.minimum.accumulate(told)) / sd
    lasted = scene.grid.time[inside] - scene.grid.time[span.start]
    independent = 4.0 * lasted / scene.peak_period if scene.peak_period > 0.0 else lasted / scene.grid.sample_time
    limit = np.maximum(RANGE_SD, 2.0 * np.sqrt(2.0 * np.log(np.maximum(independent, 1.0))))
    over = np.flatnonzero((so_far > limit) & (lasted >= scene.stuck_after - 1e-9))
    when = float(scene.grid.time[inside[over[0]]]) if over.size else float("nan")
    by = scene.names[moving] if moving is not None else "the other channels"
    return float(so_far[-1]), float(limit[-1]), by, when


def _inside(span: slice, scene: _Scene, taps: int) -> Index:
    """Return the samples of a hold without its last ``taps`` quarter periods, which later motion leaks into."""
    stop = span.stop if span.stop >= scene.grid.n else max(span.start, span.stop - taps * scene.tap)
    return np.arange(span.start, stop, dtype=np.int64)


def _envelope_tie(
    held: Sequence[int], moving: int, span: slice, scene: _Scene
) -> tuple[float, float, str, float] | None:
    """Fit the wave envelope of ``moving`` on those of ``held``: how far is it above its level with them at rest?"""
    rows = scene.usable[:, list(held)].all(axis=1) & scene.usable[:, moving]
    if np.count_nonzero(rows) < max(LEAST_ROWS, 10 * len(held)):
        return None
    picked = np.flatnonzero(rows)
    picked = picked[:: max(1, picked.size // MOST_ROWS)]
    x, y = scene.envelope[picked][:, list(held)], scene.envelope[picked, moving]
    weights, sd, share = _fit(x, y)
    inside = _inside(span, scene, 4)
    inside = inside[scene.valid[inside, moving]]
    if share < LEAST_SHARE or not sd > 0.0 or inside.size < 3:
        return None
    at_rest = float(y.mean() - x.mean(axis=0) @ weights)
    above = (scene.envelope[inside, moving] - at_rest) / sd
    lasted = scene.grid.time[inside] - scene.grid.time[span.start]
    over = np.flatnonzero((above > RANGE_SD) & (lasted >= scene.stuck_after - 1e-9))
    when = float(scene.grid.time[inside[over[0]]]) if over.size else float("nan")
    return float(above.max()), RANGE_SD, scene.names[moving] + " (wave envelope)", when


def _taps(usable: Mask, columns: Sequence[int], tap: int) -> tuple[Mask, tuple[int, ...]]:
    """Return where all columns are usable at every tap, and the taps (samples)."""
    good = np.asarray(usable[:, list(columns)].all(axis=1), dtype=np.bool_)
    if tap == 0 or good.size <= 2 * tap:
        return good, (0,)
    out = np.zeros_like(good)
    out[tap:-tap] = good[tap:-tap] & good[: -2 * tap] & good[2 * tap :]
    return out, (-tap, 0, tap)


def _fit(regressors: Array, target: Array) -> tuple[Array, float, float]:
    """Return the slopes of target on regressors, the cross-fitted residual sd and share of variance explained."""
    scale = np.std(regressors, axis=0)
    scale[scale == 0.0] = 1.0
    x, y = (regressors - regressors.mean(axis=0)) / scale, target - target.mean()
    errors = np.empty_like(y)
    for fold in np.array_split(np.arange(y.size), FOLDS):
        rest = np.ones(y.size, dtype=np.bool_)
        rest[fold] = False
        xm, ym = x[rest].mean(axis=0), float(y[rest].mean())
        errors[fold] = y[fold] - ym - (x[fold] - xm) @ _ridge(x[rest] - xm, y[rest] - ym)
    mse, variance = float(np.mean(errors**2)), float(np.mean(y**2))
    sd = float(np.sqrt(max(mse, LEAST_SD**2 * variance)))
    return _ridge(x, y) / scale, sd, 1.0 - mse / variance if variance > 0.0 else 0.0


def _ridge(x: Array, y: Array) -> Array:
    gram = x.T @ x
    gram[np.diag_indices_from(gram)] += 1e-6 * max(float(np.trace(gram)) / gram.shape[0], 1e-300)
    return np.asarray(np.linalg.solve(gram, x.T @ y))


def _as_defect(cluster: Sequence[Hold], seen: tuple[float, float, str, float] | None) -> Defect:
    start, stop = min(h.start for h in cluster), max(h.stop for h in cluster)
    alarming = seen is not None and bool(np.isfinite(seen[3]))
    detail = f"held for {stop - start:.3g} s"
    if seen is not None:
        detail += f" while {seen[2]} moved by {seen[0]:.1f} residual sd (limit {seen[1]:.1f})"
    return Defect(
        mode="stuck",
        subjects=tuple(h.channel for h in cluster),
        start=start,
        stop=stop,
        value=stop - start,
        unit="s",
        detail=detail,
        alarming=alarming,
        detected=seen[3] if seen is not None and alarming else None,
    )
