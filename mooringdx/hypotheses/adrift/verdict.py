"""From a track in m and s to a verdict a day: units, missing days, and the settings as the loops take them."""

from __future__ import annotations

from typing import Any

import numpy as np

from mooringdx.config import AdriftPart
from mooringdx.hypotheses.adrift.nouns import HYPOTHESES, LEARNING, WARNING, Numbers, Verdict
from mooringdx.types import Array, Mask

DAY = 86400.0  # s
KM = 1000.0  # m


def numbers(settings: AdriftPart) -> Numbers:
    """Return the settings as scalars and triples."""
    values: dict[str, Any] = {name: getattr(settings, name) for name in Numbers._fields}
    typed: dict[str, Any] = {k: np.array(v, dtype=np.float64) if isinstance(v, tuple) else v for k, v in values.items()}
    return Numbers(**typed)


def judge(time: Array, north: Array, east: Array, settings: AdriftPart) -> Verdict:
    """Judge a track of daily positions: in service, warning, not holding, or holding at a new place.

    Parameters
    ----------
    time : (n,), s, rising; days may be missing, or stand with a position that is not finite.
    north, east : (n,), m, about any origin.
    settings : [bank.adrift] of the run file.

    Returns
    -------
    Verdict with n rows; causal: the verdict on a prefix is the prefix of the verdict. Turning or shifting the track
    changes nothing but the neutral point. A day without a fix keeps the last verdict, until the silence is longer than
    ``lost_gap`` under warning or ``expired_gap`` without: then nothing is known and the next fix starts to learn.

    Raises
    ------
    ValueError where the shapes differ or time does not rise.
    """
    time, north, east = (np.asarray(v, dtype=np.float64) for v in (time, north, east))
    if time.ndim != 1 or time.shape != north.shape or time.shape != east.shape:
        raise ValueError(f"time {time.shape}, north {north.shape} and east {east.shape} differ")
    if np.any(np.diff(time) <= 0.0):
        raise ValueError("time does not rise")
    seen = np.isfinite(north) & np.isfinite(east)
    if not seen.any():
        return _nothing(time, seen)
    from mooringdx.hypotheses.adrift.kernel import run

    fixes = np.flatnonzero(seen)
    origin = north[fixes[0]], east[fixes[0]]
    trace = run(time[fixes] / DAY, (north[fixes] - origin[0]) / KM, (east[fixes] - origin[1]) / KM, numbers(settings))
    last = np.cumsum(seen) - 1
    started = last >= 0
    row = np.maximum(last, 0)
    patience = np.where(trace.call[row] >= WARNING, settings.lost_gap, settings.expired_gap) * DAY
    stale = started & (time - time[fixes][row] > patience)

    def length(values: Array) -> Array:
        return np.asarray(np.where(started, values[row] * KM, np.nan))

    known = started & ~stale
    probability = np.where(known[:, None], trace.probability[row], np.eye(len(HYPOTHESES))[LEARNING])
    return Verdict(
        time=time,
        seen=seen,
        neutral=np.column_stack([length(trace.centre[:, i]) + origin[i] for i in (0, 1)]),
        radius=length(trace.radius),
        limit=length(trace.limit),
        offset=length(trace.offset),
        cusum=np.where(started, trace.cusum[row], 0.0),
        rise=np.where(started, time[fixes][trace.rise[row]], np.nan),
        call=np.where(known, trace.call[row], np.where(started, LEARNING, -1)),
        episode=np.where(known, trace.episode[row], -1),
        near=known & trace.near[row],
        probability=probability,
    )


def _nothing(time: Array, seen: Mask) -> Verdict:
    n = time.size
    blank, none = np.full(n, np.nan), np.full(n, -1)
    unknown = np.tile(np.eye(len(HYPOTHESES))[0], (n, 1))
    return Verdict(
        time, seen, np.full((n, 2), np.nan), blank, blank, blank, np.zeros(n), blank, none, none, seen, unknown
    )
