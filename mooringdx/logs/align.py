"""Put every signal of a log on one uniform clock, with what was wrong in the data as checks and defects.

Order of work: stamps, range and spikes on each signal's own clock; holds; the clock lag of a group (holds left out),
and the group shifted by it; the uniform clock (see `resample`); holds judged against the other channels; per-log
zero. Alarming holds are masked: nobody may read a frozen camera as a vessel at rest. The alignment looks at most four
sample times ahead of a sample when it decimates, and less than the largest gap when it interpolates.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from mooringdx.config import ClockPart, window_seconds
from mooringdx.errors import ConfigError, LogError
from mooringdx.logs.defects import Cleaned, check_rows, clean, find_gaps
from mooringdx.logs.lag import BAND, find_lags, lag_groups, wave_frequency
from mooringdx.logs.resample import DECIMATE, HALF, resample
from mooringdx.logs.stuck import Hold, find_holds, held_mask, judge_holds
from mooringdx.registry import did_you_mean
from mooringdx.types import Array, Channels, Check, Defect, Grid, Mask, RawLog, Signal

MOST_CELLS = 1_000_000_000
MOST_FINER = 20.0
IN_PHASE = 0.98
SHORTEST_HOLD = 0.25
COMMANDS = ("thrust_", "thruster_")
"""Channels that rightly stand still: an actuator at its limit is not stuck."""


def align(log: RawLog, clock: ClockPart) -> Channels:
    """Return the log's signals on one uniform clock.

    Parameters
    ----------
    log : signals named by the channel catalogue, in SI units.
    clock : the [clock] part of a run file.

    Raises
    ------
    LogError : the log holds no usable sample, or its span at this sample time is absurdly long.
    ConfigError : clock.zero or clock.groups names a channel that the log has not, or the zero window holds no sample.
    """
    _known(clock, log.signals)
    cleaned, defects = clean(log.signals, clock.spike_sd, clock.max_gap)
    grid = common_grid(cleaned, clock.sample_time, log)
    values, valid = _on_grid(cleaned, grid, clock.max_gap)
    names = tuple(cleaned)
    holds = _holds(cleaned, clock)
    usable = valid & ~held_mask(holds, names, grid)
    waves = wave_frequency(names, values, valid, grid.sample_time)
    lags = find_lags(
        names,
        grid,
        values,
        usable,
        lag_groups(names, clock.groups),
        clock.lag_band if clock.lag_band is not None else BAND * waves,
        clock.max_lag,
    )
    if lags:
        cleaned, holds = _shifted(cleaned, holds, lags)
        values, valid = _on_grid(cleaned, grid, clock.max_gap)
    period = 1.0 / waves if waves > 0.0 else 0.0
    stuck = judge_holds(holds, names, grid, values, valid, clock.groups, clock.stuck_after, period)
    values, valid = _masked(values, valid, stuck, names, grid)
    _subtract_zero(values, valid, names, grid, clock)
    gaps = find_gaps(cleaned, grid.start, float(grid.time[-1]), clock.max_gap)
    found = tuple(sorted((*defects, *gaps, *stuck, *lags), key=lambda d: (d.start, d.mode, d.subjects)))
    span = grid.n * grid.sample_time
    return Channels(
        names=names,
        units=tuple(c.signal.unit for c in cleaned.values()),
        grid=grid,
        values=values,
        valid=valid,
        source=log.source,
        checks=(*log.checks, *check_rows(cleaned, found, span), _rate_row(cleaned, clock), _usable_row(names, valid)),
        defects=found,
    )


def common_grid(cleaned: Mapping[str, Cleaned], sample_time: float, log: RawLog) -> Grid:
    """Return the uniform clock over the union of all signals.

    It starts at the first multiple of ``sample_time`` inside; where signals tick at that very period it takes their
    phase, so that nothing is interpolated that need not be.
    """
    spans = [(float(c.signal.time[0]), float(c.signal.time[-1])) for c in cleaned.values() if c.signal.time.size]
    if not spans:
        raise LogError(
            f"{log.source.path}: no usable sample in {', '.join(cleaned) or 'any signal'}; try `mooringdx inspect`"
        )
    first, last = min(a for a, _ in spans), max(b for _, b in spans)
    finest = min((c.period for c in cleaned.values() if np.isfinite(c.period) and c.period > 0), default=sample_time)
    if finest > MOST_FINER * sample_time:
        raise LogError(
            f"{log.source.path}: the log steps {finest:.4g} s but [clock] sample_time is {sample_time:g} s; check the "
            f"unit of time in [log], or raise sample_time to about {finest:.4g}"
        )
    if (last - first) / sample_time * len(cleaned) > MOST_CELLS:
        raise LogError(
            f"{log.source.path}: spans {last - first:.4g} s, at sample_time {sample_time:g} s too many samples; "
            "check the unit of time in [log], look for a clock jump with `mooringdx inspect`, or raise sample_time"
        )
    phase = _phase(cleaned, sample_time)
    start = phase + np.ceil((first - phase) / sample_time - 1e-6) * sample_time
    n = int(np.floor((last - start) / sample_time + 1e-6)) + 1
    return Grid(float(start), sample_time, max(n, 1), log.epoch_ns)


def _phase(cleaned: Mapping[str, Cleaned], sample_time: float) -> float:
    stamps = [c.signal.time[:10_000] for c in cleaned.values() if abs(c.period / sample_time - 1.0) < 0.01]
    if not stamps:
        return 0.0
    mean = complex(np.mean(np.exp(2j * np.pi * (np.concatenate(stamps) % sample_time) / sample_time)))
    phase = float(np.angle(mean)) / (2.0 * np.pi) * sample_time
    return phase if abs(mean) > IN_PHASE and abs(phase) > 1e-6 * sample_time else 0.0


def _on_grid(cleaned: Mapping[str, Cleaned], grid: Grid, max_gap: float) -> tuple[Array, Mask]:
    values = np.empty((grid.n, len(cleaned)))
    valid = np.empty((grid.n, len(cleaned)), dtype=np.bool_)
    for k, c in enumerate(cleaned.values()):
        s = c.signal
        values[:, k], valid[:, k] = resample(s.time, s.values, c.period, grid.start, grid.sample_time, grid.n, max_gap)
    return values, valid


def _holds(cleaned: Mapping[str, Cleaned], clock: ClockPart) -> tuple[Hold, ...]:
    least = SHORTEST_HOLD * clock.stuck_after
    return tuple(
        h
        for name, c in cleaned.items()
        if not name.startswith(COMMANDS)
        for h in find_holds(c.signal, c.period, max(least, 3.0 * c.period), clock.max_gap)
    )


def _shifted(
    cleaned: Mapping[str, Cleaned], holds: Sequence[Hold], lags: Sequence[Defect]
) -> tuple[dict[str, Cleaned], tuple[Hold, ...]]:
    """Take each lag off the stamps of its group."""
    by = {name: lag.value for lag in lags for name in lag.subjects}
    moved = {
        name: replace(c, signal=replace(c.signal, time=c.signal.time - by[name])) if name in by else c
        for name, c in cleaned.items()
    }
    late = (by.get(h.channel, 0.0) for h in holds)
    return moved, tuple(replace(h, start=h.start - d, stop=h.stop - d) for h, d in zip(holds, late, strict=True))


def _masked(
    values: Array, valid: Mask, stuck: Sequence[Defect], names: tuple[str, ...], grid: Grid
) -> tuple[Array, Mask]:
    for d in stuck:
        if d.alarming:
            rows = slice(grid.index(d.start), min(grid.index(d.stop + 1e-9) + 1, grid.n))
            for name in d.subjects:
                values[rows, names.index(name)] = np.nan
                valid[rows, names.index(name)] = False
    return values, valid


def _subtract_zero(values: Array, valid: Mask, names: tuple[str, ...], grid: Grid, clock: ClockPart) -> None:
    if clock.zero is None:
        return
    rows = grid.window(window_seconds(clock.zero.window, grid.epoch_ns))
    for name in clock.zero.channels:
        k = names.index(name)
        inside = values[rows, k][valid[rows, k]]
        if inside.size == 0:
            raise ConfigError(
                f"clock.zero: no usable sample of '{name}' in its window; "
                f"choose one inside [{grid.start:g}, {grid.stop:g}) s where the log has data"
            )
        values[:, k] -= np.median(inside)


def _known(clock: ClockPart, signals: Mapping[str, Signal]) -> None:
    asked = [("clock.zero", n) for n in (clock.zero.channels if clock.zero else ())]
    asked += [(f"clock.groups.{group}", n) for group, members in clock.groups.items() for n in members]
    for where, name in asked:
        if name not in signals:
            raise ConfigError(f"{where}: no channel '{name}' in this run{did_you_mean(name, signals)}")


def _rate_row(cleaned: Mapping[str, Cleaned], clock: ClockPart) -> Check:
    slow = [n for n, c in cleaned.items() if c.period > 1.01 * clock.max_gap]
    fast = [n for n, c in cleaned.items() if c.period <= clock.sample_time / DECIMATE * (1.0 + 1e-9)]
    text = f"low-passed when decimating (looks {HALF * clock.sample_time:g} s ahead): {', '.join(fast) or 'none'}"
    slowest = max((c.period for c in cleaned.values() if np.isfinite(c.period)), default=0.0)
    remedy = f"raise clock.max_gap to {1.5 * slowest:.3g} s, or leave these channels out" if slow else ""
    return Check("sampling", ", ".join(slow) or "all", not slow, text, slowest, clock.max_gap, "s", remedy)


def _usable_row(names: tuple[str, ...], valid: Mask) -> Check:
    share = 100.0 * valid.mean(axis=0)
    worst = int(np.argmin(share))
    text = ", ".join(f"{n} {s:.1f} %" for n, s in zip(names, share, strict=True) if s < 99.95) or "all samples usable"
    passed = bool(share[worst] >= 50.0)
    remedy = "" if passed else "too little of this channel is real data; leave it out or mend the log"
    return Check("usable samples", names[worst], passed, text, float(share[worst]), 50.0, "%", remedy)
