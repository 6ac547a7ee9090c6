"""From a statistic and its level to events: one event a fault, with name, rivals, onset, size.

Alarm: some g_j rises to its level; it clears when all g_j have stayed under ``hysteresis`` times their levels for
``hold`` samples (two thresholds, so that one fault is one event). Name: not at the alarm but one window after it,
when the window holds the fault alone [Fang2015, eq. 18-19, mended: normalised, at alarm + window]. Each fault is
weighed by the likelihood of the window mean m under N(v Gamma_j, C_j), C_j = Q/n + v^2 diag(E_j^2), v its
best size, E_j what its signature is known to. For small faults this is g_j, as printed; for a fault of a hundred
standard deviations it keeps a slightly wrong model of the right cause from losing to a wrong cause.
Every fault within ln 20 of the best is a rival; probabilities are the normalised likelihoods, equal priors. Onset:
the i0 that maximises (sum_{i0..k} u_i)^2 / (2 (k - i0 + 1) G'Q^-1 G), u = G'Q^-1 (z - mu0), with the interval where
the log-likelihood is within 1.92 of its top [Basseville1993, sec. 2.4]. Size: generalised least squares from
*uncompressed* residual means, v = G'Q^-1 rbar / (G'Q^-1 G), sd = (m G'Q^-1 G)^-1/2 for m samples, because
compressed means saturate.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from mooringdx.types import Array, Fault, Mask, Rival, Signatures, Statistic, Threshold, replace

RIVAL_GAP = math.log(20.0)
POOR_FIT = 10.0
"""Chi-square over its degrees of freedom above which the best cause is said to explain the residuals poorly."""


@dataclass(frozen=True)
class Alarm:
    """One stretch in alarm of one or more branches: samples [start, stop), stop None while it stands at the end."""

    branch: str
    start: int
    stop: int | None
    peak: float
    peak_at: int
    branches: tuple[str, ...] = ()
    peak_branch: str = "main"


def peak_ratio(statistic: Statistic, threshold: Threshold) -> Array:
    """Return the largest statistic over its level at every sample, (n,); NaN where no fault has a value."""
    out: Array = _peak_ratio(statistic.values, np.asarray(threshold.level))
    return out


@njit(cache=True)
def _peak_ratio(values: Array, level: Array) -> Array:
    out = np.full(values.shape[0], np.nan)
    for k in range(values.shape[0]):
        for j in range(values.shape[1]):
            x = values[k, j] / level[j]
            if x == x and not (out[k] >= x):
                out[k] = x
    return out


@njit(cache=True)
def _alarm_bounds(ratio: Array, hysteresis: float, hold: int, least: int) -> NDArray[np.int64]:
    """Return (m, 2) samples; a stop of -1 means still standing. NaN neither raises nor clears."""
    out = []
    start, low, last_high = -1, 0, -1
    for k in range(ratio.size):
        x = ratio[k]
        if x != x:
            continue
        if start < 0:
            if x >= 1.0:
                start, low, last_high = k, 0, k
        elif x < hysteresis:
            low += 1
            if low >= hold:
                if last_high - start + 1 >= least:
                    out.append((start, last_high + 1))
                start = -1
        else:
            low, last_high = 0, k
    if start >= 0 and last_high - start + 1 >= least:
        out.append((start, -1))
    bounds = np.empty((len(out), 2), np.int64)
    for i in range(len(out)):
        bounds[i, 0], bounds[i, 1] = out[i]
    return bounds


def alarms(branch: str, ratio: Array, hysteresis: float, hold: int, least: int = 1) -> list[Alarm]:
    """Return the alarms of one branch.

    Parameters
    ----------
    ratio : (n,), statistic over level, NaN where no verdict is allowed.
    hysteresis : share of the level under which the statistic must stay to clear.
    hold : samples it must stay there.
    least : shortest alarm that counts, samples.
    """
    found = []
    for start, stop in _alarm_bounds(ratio, hysteresis, hold, least):
        last = ratio.size if stop < 0 else int(stop)
        stretch = np.nan_to_num(ratio[start:last], nan=-1.0)
        at = int(start) + int(np.argmax(stretch))
        found.append(
            Alarm(branch, int(start), None if stop < 0 else int(stop), float(ratio[at]), at, (branch,), branch)
        )
    return found


def merge(found: Sequence[Alarm], gap: int) -> list[Alarm]:
    """Join alarms of all branches that overlap or lie within ``gap`` samples: one fault, one alarm."""
    out: list[Alarm] = []
    for alarm in sorted(found, key=lambda a: (a.start, a.branch)):
        last = out[-1] if out else None
        if last is None or (last.stop is not None and alarm.start > last.stop + gap):
            out.append(alarm)
            continue
        stop = None if last.stop is None or alarm.stop is None else max(last.stop, alarm.stop)
        top = alarm if alarm.peak > last.peak else last
        names = tuple(dict.fromkeys((*last.branches, *alarm.branches)))
        out[-1] = Alarm(last.branch, last.start, stop, top.peak, top.peak_at, names, top.peak_branch)
    return out


@dataclass(frozen=True)
class Name:
    """The winner's row among the signatures, its probability and the rivals with theirs, best first.

    ``misfit``: what the winner leaves unexplained, chi-square over its degrees of freedom, model error allowed for.
    """

    winner: int
    probability: float
    rivals: tuple[tuple[int, float], ...]
    misfit: float = 0.0


def name(scores: Array) -> Name | None:
    """Turn log-likelihoods, (f,), into the winner with its rivals; None when none is finite."""
    scores = np.where(np.isfinite(scores), scores, -np.inf)
    top = int(np.argmax(scores))
    if not np.isfinite(scores[top]):
        return None
    weight = np.exp(scores - scores[top])
    share = weight / weight.sum()
    order = [int(i) for i in np.argsort(-scores, kind="stable") if scores[i] > scores[top] - RIVAL_GAP and i != top]
    return Name(top, float(share[top]), tuple((i, float(share[i])) for i in order))


def weigh(mean: Array, count: int, signatures: Signatures, covariance: Array) -> tuple[Array, Array]:
    """Return the log-likelihood of every fault and its misfit, (f,) each; -inf for a fault that moves nothing here.

    Parameters
    ----------
    mean : (r,), window mean of the residuals less their reference. count : samples in it.
    signatures : of these r residuals. covariance : (r, r), samples times the covariance of a window mean.
    """
    f = len(signatures.faults)
    scores, misfits = np.full(f, -np.inf), np.full(f, np.inf)
    for j, direction in enumerate(signatures.matrix):
        if not np.any(direction):
            continue
        value, spread = estimate(mean, count, direction, signatures.error[j], covariance)
        if value * signatures.sign[j] < 0:
            value, spread = 0.0, covariance / count
        rest = mean - value * direction
        square = float(rest @ np.linalg.solve(spread, rest))
        scores[j] = -0.5 * (square + np.linalg.slogdet(spread)[1])
        misfits[j] = square / max(len(mean) - 1, 1)
    return scores, misfits


def unmoved(mean: Array, spread: Array) -> float:
    """Return the log-likelihood of a window mean, (r,), about zero with covariance ``spread``, (r, r)."""
    return -0.5 * float(mean @ np.linalg.solve(spread, mean) + np.linalg.slogdet(spread)[1])


def level_alike(scores: Array, mean: Array, signatures: Signatures, covariance: Array) -> Array:
    """Return the scores with faults that move these residuals in one direction made equal: one class, no winner in it.

    Without this the one whose signature is known more exactly would win by that alone. A fault that admits only the
    other sign of the size is no member.
    """
    out = scores.copy()
    rows = np.arange(len(signatures.residuals))
    side = np.sign(signatures.matrix @ np.linalg.solve(covariance, mean))
    for a in range(len(scores)):
        for b in range(len(scores)):
            fits = signatures.sign[b] * side[b] >= 0 and signatures.sign[a] * side[a] >= 0
            if a != b and fits and alike(signatures, a, b, rows):
                out[a] = max(out[a], scores[b])
    return out


def estimate(mean: Array, count: int, direction: Array, error: Array, covariance: Array) -> tuple[float, Array]:
    """Return the best size of one fault and the covariance of the mean around it, its signature's error included."""
    spread = covariance / count
    value = 0.0
    for _ in range(8):
        weight = np.linalg.solve(spread, direction)
        value = float(weight @ mean) / float(weight @ direction)
        spread = covariance / count + np.diag((value * error) ** 2)
    return value, spread


def part(signatures: Signatures, rows: NDArray[np.intp]) -> Signatures:
    """Return the signatures of some of the residuals, by index."""
    names = tuple(signatures.residuals[i] for i in rows)
    matrix, error = signatures.matrix[:, rows], signatures.error[:, rows]
    return replace(signatures, residuals=names, matrix=matrix, error=error)


def alike(signatures: Signatures, first: int, second: int, rows: NDArray[np.intp]) -> bool:
    """Tell whether two faults move the valid residuals (``rows``, indices) in the same direction."""
    a, b = signatures.matrix[first][rows], signatures.matrix[second][rows]
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    return size > 0 and abs(float(a @ b)) > (1.0 - 1e-6) * size


def rivals(signatures: Signatures, chosen: Name, rows: NDArray[np.intp]) -> tuple[Rival, ...]:
    """Return the rivals as the report names them, each with why it came second."""
    out = []
    for row, probability in chosen.rivals:
        fault = signatures.faults[row]
        if alike(signatures, chosen.winner, row, rows):
            why = "moves the logged residuals in the same direction: these channels cannot tell the two apart"
        else:
            why = f"{chosen.probability / max(probability, 1e-300):.1f} times less likely one window after the alarm"
        out.append(Rival(fault.kind, fault.subject, probability, why))
    return tuple(out)


def cannot_tell(signatures: Signatures, chosen: Name, rows: NDArray[np.intp]) -> str | None:
    """Return a sentence that names what these channels cannot tell apart, or None."""
    twins = [signatures.faults[r] for r, _ in chosen.rivals if alike(signatures, chosen.winner, r, rows)]
    if not twins:
        return None
    best = signatures.faults[chosen.winner]
    names = " or ".join(plain(f) for f in (best, *twins))
    return f"{names}: the logged channels see them alike; {remedy(best, twins)}"


def plain(fault: Fault) -> str:
    """Return a fault in words: "line_4 lost", "sensor tension_4 wrong"."""
    words = {"line_lost": "{} lost", "sensor_fault": "sensor {} wrong", "environment": "the environment moved the {}"}
    return words.get(fault.kind, fault.kind.replace("_", " ") + " {}").format(fault.subject)


def remedy(best: Fault, twins: Sequence[Fault]) -> str:
    """Return which channel would tell the faults apart."""
    kinds = {best.kind, *(t.kind for t in twins)}
    if kinds == {"line_lost", "sensor_fault"}:
        return 'a logged position (north, east) with [residuals] use "position" tells a line from its sensor'
    if kinds == {"sensor_fault"}:
        return "a third channel that measures the same quantity tells them apart"
    return "wind and current channels, or tensions, tell them apart"


@njit(cache=True)
def _onset_scores(u: Array, good: Mask, energy: float, first: int, last: int) -> Array:
    """Return the log-likelihood of an onset at each sample of [first, last], for data up to ``last``."""
    out = np.full(last - first + 1, -np.inf)
    total, count = 0.0, 0
    for i in range(last, first - 1, -1):
        if good[i]:
            total += u[i]
            count += 1
        if count > 0:
            out[i - first] = total * total / (2.0 * count * energy)
    return out


def onset(
    u: Array, good: Mask, energy: float, first: int, last: int, latest: int, roughness: float = 1.0
) -> tuple[int, int, int]:
    """Return the most likely onset sample and its 95 % interval, searched in [first, latest] with data up to ``last``.

    Parameters
    ----------
    u : (n,), score G'Q^-1 (z - mu0) of the named fault. good : (n,), where it counts.
    energy : G'Q^-1 G. roughness : variance of one sample of ``u`` over ``energy``; above 1 where neighbours are
        correlated so that single samples scatter more than window means say, which widens the interval.
    """
    scores = _onset_scores(u, good, energy, first, last)[: latest - first + 1]
    best = int(np.argmax(scores))
    near = np.flatnonzero(scores >= scores[best] - 1.92 * max(1.0, roughness))
    return first + best, first + int(near[0]), first + int(near[-1])


def size(
    values: Array, valid: Mask, signatures: Signatures, winner: int, covariance: Array
) -> tuple[float, tuple[float, float]] | None:
    """Return the size of a fault and its 95 % interval from uncompressed residuals after the onset.

    Parameters
    ----------
    values : (m, r), residuals less their no-fault mean. valid : (m, r). signatures : of these residuals; ``winner``
        the fault's row. covariance : (r, r), samples times the covariance of a window mean.
    """
    rows = valid.all(axis=1)
    direction = signatures.matrix[winner]
    if not rows.any() or not np.any(direction):
        return None
    mean = values[rows].mean(axis=0)
    value, spread = estimate(mean, int(rows.sum()), direction, signatures.error[winner], covariance)
    half = 1.96 / math.sqrt(float(direction @ np.linalg.solve(spread, direction)))
    return value, (value - half, value + half)


def sensor_mode(before: Array, after: Array, residual: Array) -> str:
    """Return how a named sensor is wrong: dead, drift, noise, gain or bias.

    Parameters
    ----------
    before, after : the channel in the no-fault window and after the onset, SI, finite.
    residual : its own residual after the onset, less the no-fault mean.
    """
    if after.size < 8 or before.size < 8:
        return "bias"
    level, spread = float(np.mean(before)), float(np.std(before))
    if abs(np.mean(after)) < 0.05 * abs(level) and np.std(after) < 0.3 * spread and abs(level) > 3 * spread:
        return "dead"
    time = np.linspace(-1.0, 1.0, residual.size)
    half = residual.size // 2
    step = float(np.mean(residual))
    slope = float(np.dot(time, residual) / np.dot(time, time))
    rest = float(np.std(residual - step - slope * time))
    error = rest / math.sqrt(max(half, 1))
    if abs(step) < 2 * error and rest > 0:
        return "noise"
    if abs(slope) > 0.6 * abs(step) and abs(slope) > 6 * error:
        return "drift"
    swing = after - after.mean()
    gain = float(np.dot(swing, residual - step) / max(np.dot(swing, swing), 1e-300))
    explained = gain**2 * float(np.var(swing)) / max(rest**2, 1e-300)
    itself = abs(gain - 1.0) < 0.05  # the residual is the channel's own motion, as an offset from neutral is
    return "gain" if abs(gain) > 0.1 and explained > 0.6 and not itself else "bias"
