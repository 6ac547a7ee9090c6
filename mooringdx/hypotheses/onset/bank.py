"""The onset bank on plain arrays: its clock and odds, and one walk over what a filter left unexplained.

The table of times is for a vessel at sea, in waves of 6 to 10 s: onsets 5 s apart for 180 s and 20 s apart for 900 s,
wave groups of 20, 40, 80 s, a warm-up of 10 min, a name 60 s after the alarm. A model's times follow Froude's law: all
of these, and the rates of the priors, are of the full-scale clock and divided by the vessel file's time_scale.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mooringdx.hypotheses.onset.kernel import (
    FREE,
    OWN,
    PULSES,
    ROW,
    WIDTH,
    Index,
    Odds,
    Rig,
    Slots,
    Tuned,
    in_earth,
    walk,
    weighed,
)
from mooringdx.observers.kalman import Estimate
from mooringdx.observers.matrices import STATES, Model, Noise
from mooringdx.physics.mooring import Mooring
from mooringdx.types import Array

FINE = 5.0
_FINE_END, _END, _PULSES, _CONFIRM, _WARM = 36, 180, (4, 8, 16), 12, 120
"""In fine spacings: 180 s, 900 s, 20, 40 and 80 s, 60 s, 10 min."""
ALPHA_SD = 0.15
"""Sd of the share of a line's pull that a break takes; 1 is all of it."""
BETA_SD = 0.1
"""Sd of the force across the line, as a share of its pull: 6 deg; a choice, for models that are not exact."""
STEP_SHARE = 0.22
"""Sd of an environmental step as a share of the lines' mean horizontal tension: 100 kN of 460 kN."""
GROUP = 1.5
"""Sd of a wave group's force over the mean drift force of each axis."""


@dataclass(frozen=True)
class Beat:
    """Times in samples ``step`` s apart: spacing of onsets, their two ends, wave groups, naming and warm-up."""

    step: float
    fine: int
    fine_end: int
    end: int
    pulses: tuple[int, int, int]
    confirm: int
    warm: int


def beat(step: float, time_scale: float) -> Beat:
    """Return the bank's times for samples ``step`` s apart of a log whose seconds are ``time_scale`` at full scale."""
    fine = max(1, round(FINE / (time_scale * step)))
    a, b, c = (fine * x for x in _PULSES)
    return Beat(step, fine, fine * _FINE_END, fine * _END, (a, b, c), fine * _CONFIRM, fine * _WARM)


@dataclass(frozen=True)
class Trace:
    """What one walk found, on its own samples.

    ``score``: (n,), NaN before the first; ``probability``: (n, lines + 3); ``alarm``: first sample at or over the
    level, -1 where none; ``named``: the last sample walked; ``when``: (s,), sample of each onset, -1 where
    free; ``logs``: (s, lines + 4), `weighed` there; ``z``: (s, 3) and ``lam``: (s, 3, 3), what each onset has gathered;
    ``pulls``: (s, lines, 3), N, N, N m, of each line at the onset.
    """

    score: Array
    probability: Array
    alarm: int
    named: int
    when: Index
    logs: Array
    z: Array
    lam: Array
    pulls: Array


def odds_of(
    times: Beat,
    time_scale: float,
    lines: int,
    rates: tuple[float, float, float],
    temper: float,
    step: Array,
    group: Array,
) -> Odds:
    """Return the numbers of the hypotheses; ``rates``: 1/s at full scale, of all lines, of a step, of a wave group."""
    spacing = times.fine * times.step * time_scale
    line, environment, pulse = rates
    return Odds(
        times.fine,
        times.fine_end,
        times.end,
        np.array(times.pulses, dtype=np.int64),
        float(np.log(line * spacing / lines)),
        float(np.log(environment * spacing)),
        float(np.log(pulse * spacing / PULSES)),
        temper,
        ALPHA_SD,
        BETA_SD,
        np.ascontiguousarray(step),
        np.ascontiguousarray(group),
    )


def tuned(models: Sequence[Model]) -> Tuned:
    """Return the matrices of a filter's models, stacked."""
    return Tuned(
        np.array([m.heading for m in models]),
        np.stack([m.F for m in models]),
        np.stack([m.G for m in models]),
        np.stack([m.F @ m.K for m in models]),
        np.stack([np.linalg.inv(m.S) for m in models]),
    )


def empty(times: Beat | Odds, lines: int) -> Slots:
    """Return slots without an onset; raise ValueError where there are too few, or an onset outlives its pulse's end."""
    most = 2 + times.fine_end // times.fine + (times.end - times.fine_end) // (4 * times.fine) + 2
    if most > WIDTH or any(int(length) % (4 * times.fine) for length in times.pulses):
        raise ValueError(f"{most} onsets are kept and {WIDTH} at most; a wave group lasts a multiple of 4 spacings")
    return Slots(
        np.full(WIDTH, -1, dtype=np.int64),
        np.full((PULSES, WIDTH), -1, dtype=np.int64),
        np.zeros(STATES * ROW),
        np.zeros((OWN + PULSES * FREE) * WIDTH),
        np.zeros(lines * ROW),
    )


def evidence(slots: Slots) -> tuple[Array, Array]:
    """Return z, (s, 3), and Lam, (s, 3, 3), of every slot."""
    z0, z1, a, b, d, z2, c, e, f = slots.sums[: OWN * WIDTH].reshape(OWN, WIDTH)
    return np.column_stack([z0, z1, z2]), np.stack([a, b, c, b, d, e, c, e, f], axis=1).reshape(WIDTH, 3, 3)


def over(
    estimate: Estimate, models: Sequence[Model], mooring: Mooring, odds: Odds, times: Beat, alarm: float, warning: float
) -> Trace:
    """Walk over a filter's innovations to the first alarm that still stands when it is named, or to the end.

    Alarms that have sunk under ``warning`` by then are passed over; they stay visible in ``score``.
    """
    innovation, place = estimate.innovation, estimate.position
    n, lines = len(place), len(mooring.names)
    score, probability = np.full(n, np.nan), np.zeros((n, lines + 3))
    probability[:, 0] = 1.0
    slots = empty(times, lines)
    rig = Rig(mooring.anchors, mooring.fairleads, mooring.start, mooring.step, mooring.horizontal)
    rest = (
        times.warm, innovation, place, tuned(models), rig, mooring.fairleads.mean(axis=0), odds, slots, score,
        probability,
    )  # fmt: skip
    at, first = -1, 0
    while first < n:
        at = walk(first, n, alarm, *rest)
        if at >= n:
            at = -1
            break
        stop = min(at + times.confirm, n - 1)
        walk(at + 1, stop + 1, np.inf, *rest)
        first = stop + 1
        if score[stop] >= warning:
            break
        at = -1
    named = first - 1 if at >= 0 else n - 1
    logs = np.empty((slots.when.size, lines + 1 + PULSES))
    weighed(named, slots, odds, in_earth(odds.group, float(place[named, 2])), logs)
    pulls = slots.pulls.reshape(lines, 3, WIDTH).transpose(2, 0, 1)
    return Trace(score, probability, at, named, slots.when, logs, *evidence(slots), pulls)


def spread(estimate: Estimate, models: Sequence[Model], mooring: Mooring, odds: Odds, times: Beat) -> float:
    """Return the mean of z'Lam^-1 z/2 (north, east) over a no-fault record: 1 where innovations are as assumed.

    NaN where the record is too short for an onset to grow old.
    """
    innovation, place = estimate.innovation, estimate.position
    n, lines = len(place), len(mooring.names)
    slots = empty(times, lines)
    rig = Rig(mooring.anchors, mooring.fairleads, mooring.start, mooring.step, mooring.horizontal)
    rest = (
        times.warm, innovation, place, tuned(models), rig, mooring.fairleads.mean(axis=0), odds, slots, np.zeros(n),
        np.zeros((n, lines + 3)),
    )  # fmt: skip
    values = []
    for first in range(0, n - times.confirm, times.confirm):
        walk(first, first + times.confirm, np.inf, *rest)
        old = (slots.when >= 0) & (first + times.confirm - slots.when > times.pulses[0])
        each, information = evidence(slots)
        for z, lam in zip(each[old, :2], information[old, :2, :2], strict=True):
            values.append(0.5 * float(z @ np.linalg.solve(lam, z)))
    return float(np.mean(values)) if values else np.nan


def information(one: Model, middle: Array, samples: int) -> Array:
    """Return Lam of a step ``samples`` old, (3, 3): north and east at the fairleads' ``middle``, moment."""
    c, s = np.cos(one.heading), np.sin(one.heading)
    north, east = c * middle[0] - s * middle[1], s * middle[0] + c * middle[1]
    G = one.G @ np.array([[c, s, 0.0], [-s, c, 0.0], [-east, north, 1.0]])
    inverse, lost = np.linalg.inv(one.S), one.F @ (np.eye(STATES) - one.K @ one.C)
    d, out = G, np.zeros((3, 3))
    for _ in range(samples):
        rho = one.C @ d
        out += rho.T @ inverse @ rho
        d = lost @ d + G
    return out


def mean_drift(noise: Noise) -> tuple[float, float]:
    """Return the drift force, N, in surge and sway, whose slow part has the white intensity that was identified.

    The slow drift is the squared envelope of the waves times a coefficient: exponential, so that its sd is its mean,
    and of two-sided intensity mean^2 2 pi integral S^2 dw / (integral S dw)^2 in a sea of density S, here a JONSWAP one
    with the peak that the filter found [Newman1974; Hasselmann1973].
    """
    from mooringdx.physics.waves import density

    omega = np.linspace(0.3, 6.0, 2000) * noise.frequency
    sea = density("jonswap", omega, 1.0, 2.0 * np.pi / noise.frequency)
    memory = 2.0 * np.pi * np.trapezoid(sea**2, omega) / np.trapezoid(sea, omega) ** 2
    return float(np.sqrt(noise.force[0] / memory)), float(np.sqrt(noise.force[1] / memory))
