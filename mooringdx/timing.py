"""How long the windows are: every time scales with the peak period of the waves, unless the run file says otherwise.

Defaults at peak period Tp: detector window 10 Tp, short branch 1.3 Tp, reference memory and slow channel 400 Tp.
They are the figures of a model basin at Tp 1.5 s (15 s, 2 s, 10 min) carried to other vessels by the one time that
their seas share.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mooringdx.config import DetectorPart
from mooringdx.errors import FitError
from mooringdx.types import Array

MAIN, SHORT, SLOW = 10.0, 1.3, 400.0
_NOISE = 3.0
LEAST_SLOW, LEAST_DRIFTING = 3.0, 1.5
"""Slow windows that the no-fault record must hold; fewer where the run file says how far a healthy sensor drifts."""


@dataclass(frozen=True)
class Timing:
    """Windows in samples; zero where a branch is off. ``peak_period`` in s, ``memory`` of the following reference."""

    sample_time: float
    peak_period: float
    window: int
    short: int
    slow: int
    memory: int
    measured: int


def design(part: DetectorPart, sample_time: float, pieces: Sequence[Array]) -> Timing:
    """Return the windows for a no-fault record.

    Parameters
    ----------
    part : [detector] of the run file.
    sample_time : s.
    pieces : no-fault channels, (n_i, c) each, NaN where invalid.
    """
    measured = sum(len(p) for p in pieces)
    period = peak_period(pieces, sample_time) if part.peak_period == "auto" else float(part.peak_period)

    def samples(value: float | str, factor: float) -> int:
        if value == "off":
            return 0
        seconds = factor * period if value == "auto" else float(value)
        return max(2, round(seconds / sample_time))

    window = samples(part.window, MAIN)
    short = samples(part.short_window, SHORT)
    slow = samples(part.slow_window, SLOW)
    memory = samples(part.adapt, SLOW)
    if part.short_window == "auto" and 2 * short > window:
        short = 0
    if part.slow_window == "auto" and measured < (LEAST_DRIFTING if part.slow_drift else LEAST_SLOW) * slow:
        slow = 0
    if part.adapt == "auto" and measured < 2 * memory:
        memory = 0
    return Timing(sample_time, period, window, short, slow, memory, measured)


def peak_period(pieces: Sequence[Array], sample_time: float) -> float:
    """Return the period of the waves in s: the top of the channels' summed spectra of the rate of change.

    Each channel counts with unit variance. The rate of change keeps slow drift from winning; half-overlapping Hann
    windows of an eighth of the record keep noise from it; gaps are bridged by straight lines. Raises FitError when no
    channel moves.
    """
    length = max((len(p) for p in pieces), default=0)
    size = min(length, max(64, length // 8))
    total = np.zeros(size // 2 + 1)
    taper = np.hanning(size)
    for piece in pieces:
        for column in map(_bridged, piece.T):
            for start in range(0, len(column) - size + 1, max(1, size // 2)):
                block = column[start : start + size]
                spread = np.std(block)
                if spread > 0:
                    total += np.abs(np.fft.rfft(taper * (block - block.mean()) / spread)) ** 2
    frequency = np.fft.rfftfreq(size, sample_time)
    usable = (frequency > 2.0 / (size * sample_time)) & (frequency < 0.25 / sample_time)
    if not np.any(total[usable] > 0):
        raise FitError(
            "no channel moves in the no-fault window, so no wave period can be found; check the mapping and the "
            "window, or give [detector] peak_period in s"
        )
    floor = float(np.median(total[(frequency > 0.2 / sample_time) & (frequency < 0.25 / sample_time)]))
    above = np.maximum(total - _NOISE * floor, 0.0)  # weighed by frequency squared, white noise would win
    smooth = np.convolve(above if above[usable].any() else total, np.ones(3) / 3.0, mode="same") * frequency**2
    return float(1.0 / frequency[usable][np.argmax(smooth[usable])])


def _bridged(column: Array) -> Array:
    """Return a channel with its gaps bridged by straight lines; all zero where nothing is finite."""
    good = np.isfinite(column)
    if not good.any():
        return np.zeros_like(column)
    at = np.arange(len(column))
    return np.asarray(np.interp(at, at[good], column[good]))
