"""The table of checks: check, value, limit, passed, remedy. Warnings are data, not scrolling lines."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mooringdx.types import Array, Channels, Check, Mask

WHITE = 0.05
SEA = 1.5
LEAST_JUDGED = 0.5


def agitation(values: Array) -> Array:
    """Return the sd of each channel's increments, (c,): the sea as the log shows it; 0 where too little is valid."""
    steps = np.diff(values, axis=0)
    count = np.isfinite(steps).sum(axis=0)
    spread = np.sqrt(np.nansum(steps**2, axis=0) / np.maximum(count, 1))
    return np.where(2 * count > len(steps), spread, 0.0)


def shows_sea(names: Sequence[str]) -> Mask:
    """Return which channels move with the waves, (c,): not what is commanded, nor wind and current."""
    return np.array(
        [not name.startswith(("thrust_", "thruster_", "wind_", "current_")) for name in names], dtype=np.bool_
    )


def roughness(values: Array, names: Sequence[str], reference: Array) -> float:
    """Return the sea of (n, c) channel values over the reference's, the median over channels, at least 1."""
    now = agitation(values)
    use = shows_sea(names) & (reference > 0) & (now > 0)
    return max(1.0, float(np.median(now[use] / reference[use]))) if use.any() else 1.0


def run_checks(channels: Channels, reference: Array, judged: float) -> tuple[Check, ...]:
    """Return the checks of one log against its baseline: how much is valid, and whether the sea is the fitted one."""
    rows = []
    share = float(channels.valid.mean())
    rows.append(
        Check(
            name="valid samples",
            subject="log",
            passed=share >= 0.9,
            detail=f"{100 * share:.1f} % of all samples are measured, not masked",
            value=share,
            limit=0.9,
            remedy="" if share >= 0.9 else "faults inside the masked stretches cannot be seen; look at the gaps above",
        )
    )
    fine = judged >= LEAST_JUDGED
    rows.append(
        Check(
            name="judged samples",
            subject="statistic",
            passed=fine,
            detail=f"the statistic had a value at {100 * judged:.1f} % of the log",
            value=judged,
            limit=LEAST_JUDGED,
            remedy=""
            if fine
            else "the log is shorter than a few windows, or lacks a channel that every residual needs",
        )
    )
    rows.append(_sea(channels, reference))
    return tuple(rows)


def watched_check(until: float, channels: Channels) -> Check:
    """Return the row on how far into the log the detectors could look."""
    blind = max(channels.grid.stop - until, 0.0)
    passed = blind <= 1.0 or blind <= 2.0 * channels.grid.sample_time
    return Check(
        name="watched to the end",
        subject="statistic",
        passed=passed,
        detail=f"the last {blind:.1f} s of the log gave no statistic"
        if not passed
        else "the statistic reaches the end",
        value=blind,
        limit=1.0,
        unit="s",
        remedy="" if passed else "a channel that every residual needs ends early; what happened then was not judged",
    )


def _sea(channels: Channels, reference: Array) -> Check:
    known = (reference > 0) & shows_sea(channels.names)
    ratio = np.where(known, agitation(channels.values) / np.where(reference > 0, reference, 1.0), 0.0)
    worst = int(np.argmax(ratio))
    passed = bool(ratio[worst] <= SEA)
    return Check(
        name="fitted envelope",
        subject=channels.names[worst],
        passed=passed,
        detail=f"increments are {ratio[worst]:.2f} times those of the no-fault record",
        value=float(ratio[worst]),
        limit=SEA,
        remedy=""
        if passed
        else "the sea is rougher than the fitted one: the stated rate does not hold; fit in this sea too",
    )


def whiteness_check(name: str, before: float, after: float) -> Check:
    """Return the row on one residual's whiteness: Ljung-Box over n before and after, as effect sizes."""
    passed = after <= WHITE
    return Check(
        name="whiteness",
        subject=name,
        passed=passed,
        detail=f"Ljung-Box/n {before:.3g} before and {after:.3g} after whitening",
        value=after,
        limit=WHITE,
        remedy="" if passed else "the window covariance carries the rest; a longer no-fault window whitens better",
    )


def drift_check(ratio: float, limit: float) -> Check:
    """Return the row on the drift flag R."""
    passed = not ratio > limit
    return Check(
        name="drift",
        subject="residuals",
        passed=passed,
        detail=f"R = {ratio:.2f}, long-window over short-window variance of the no-fault residuals",
        value=ratio,
        limit=limit,
        remedy=""
        if passed
        else "the sensors drift: shorten the baseline, or let the reference follow ([detector] adapt)",
    )
