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
_FINE_END, _END, _PULSES, _CONFIRM, _WARM, _AGAIN = 36, 180, (4, 8, 16), 12, 120, 60
_DELAY = 60
"""In fine spacings: 180 s, 900 s, 20, 40 and 80 s, 60 s, 10 min, 5 min; 5 min."""
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
    """Times in samples ``step`` s apart: spacing of onsets, their two ends, wave groups, naming and warm-up.

    ``again``: the warm-up after a line was named.
    """

    step: float
    fine: int
    fine_end: int
    end: int
    pulses: tuple[int, int, int]
    confirm: int
    warm: int
    again: int


def beat(step: float, time_scale: float) -> Beat:
    """Return the bank's times for samples ``step`` s apart of a log whose seconds are ``time_scale`` at full scale."""
    fine = max(1, round(FINE / (time_scale * step)))
    a, b, c = (fine * x for x in _PULSES)
    return Beat(step, fine, fine * _FINE_END, fine * _END, (a, b, c), fine * _CONFIRM, fine * _WARM, fine * _AGAIN)


@dataclass(frozen=True)
class Trace:
    """What one walk found, on its own samples.

    ``score``: (n,), NaN before the first; ``probability``: (n, losses + 3); ``alarm``: first sample at or over the
    level, -1 where none; ``named``: the last sample walked; ``when``: (s,), sample of each onset, -1 where
    free; ``logs``: (s, losses + 4), `weighed` there; ``z``: (s, 3) and ``lam``: (s, 3, 3), what each onset has
    gathered; ``pulls``: (s, losses, 3), N, N, N m, what each takes at the onset; ``rise``: (n,), by how much
    evidence was lowered because the sea was rougher than the one learned from.
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
    rise: Array


def odds_of(
    times: Beat,
    time_scale: float,
    weights: Array,
    rates: tuple[float, float, float],
    temper: Array,
    step: Array,
    group: Array,
) -> Odds:
    """Return the numbers of the hypotheses.

    ``weights``: (losses,), of each loss, in the rate of all lines. ``rates``: 1/s at full scale, of all lines, of a
    step, of a wave group. ``temper``: what evidence is divided by, one number each fine spacing of an onset's age.
    """
    spacing = times.fine * times.step * time_scale
    line, environment, pulse = rates
    return Odds(
        times.fine,
        times.fine_end,
        times.end,
        np.array(times.pulses, dtype=np.int64),
        np.log(line * spacing * weights),
        float(np.log(environment * spacing)),
        float(np.log(pulse * spacing / PULSES)),
        np.interp(np.arange(times.end + 1.0), times.fine * np.arange(len(temper)), temper),
        ALPHA_SD,
        BETA_SD,
        float(times.warm),
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


def rig_of(mooring: Mooring, shares: Array | None = None) -> Rig:
    """Return the lines for the loops; ``shares``: (losses, lines), one whole line each when None."""
    lost = np.eye(len(mooring.names)) if shares is None else np.ascontiguousarray(shares, np.float64)
    return Rig(mooring.anchors, mooring.fairleads, mooring.start, mooring.step, mooring.horizontal, lost)


def empty(times: Beat | Odds, losses: int) -> Slots:
    """Return slots without an onset; raise ValueError where there are too few, or an onset outlives its pulse's end."""
    most = 2 + times.fine_end // times.fine + (times.end - times.fine_end) // (4 * times.fine) + 2
    if most > WIDTH or any(int(length) % (4 * times.fine) for length in times.pulses):
        raise ValueError(f"{most} onsets are kept and {WIDTH} at most; a wave group lasts a multiple of 4 spacings")
    return Slots(
        np.full(WIDTH, -1, dtype=np.int64),
        np.full((PULSES, WIDTH), -1, dtype=np.int64),
        np.zeros(STATES * ROW),
        np.zeros((OWN + PULSES * FREE) * WIDTH),
        np.zeros(losses * ROW),
        np.ones(2 + times.fine * _DELAY),
    )


def evidence(slots: Slots) -> tuple[Array, Array]:
    """Return z, (s, 3), and Lam, (s, 3, 3), of every slot."""
    z0, z1, a, b, d, z2, c, e, f = slots.sums[: OWN * WIDTH].reshape(OWN, WIDTH)
    return np.column_stack([z0, z1, z2]), np.stack([a, b, c, b, d, e, c, e, f], axis=1).reshape(WIDTH, 3, 3)


def over(
    estimate: Estimate,
    models: Sequence[Model],
    mooring: Mooring,
    odds: Odds,
    times: Beat,
    alarm: float,
    shares: Array | None = None,
    quiet: int | None = None,
) -> Trace:
    """Walk over a filter's innovations to the first alarm that still stands when it is named, or to the end.

    ``shares``: as `rig_of` takes them. ``quiet``: samples before the first onset, the warm-up when None.

    Alarms that have sunk under ``alarm`` by then are passed over; they stay visible in ``score``.
    """
    innovation, place = estimate.innovation, estimate.position
    rig = rig_of(mooring, shares)
    n, losses = len(place), len(rig.shares)
    score, probability, rise = np.full(n, np.nan), np.zeros((n, losses + 3)), np.ones(n)
    probability[:, 0] = 1.0
    slots = empty(times, losses)
    rest = (
        times.warm if quiet is None else quiet, innovation, place, tuned(models), rig, mooring.fairleads.mean(axis=0),
        odds, slots, score, probability, rise,
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
        if score[stop] >= alarm:
            break
        at = -1
    named = first - 1 if at >= 0 else n - 1
    logs = np.empty((slots.when.size, losses + 1 + PULSES))
    last = float(slots.rough[1])
    weighed(named, slots, odds, in_earth(odds.group, float(place[named, 2])) * last, logs)
    pulls = slots.pulls.reshape(losses, 3, WIDTH).transpose(2, 0, 1)
    return Trace(score, probability, at, named, slots.when, logs, *evidence(slots), pulls, rise)


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
