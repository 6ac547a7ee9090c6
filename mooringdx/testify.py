"""Ask the balance of forces whether a line or its sensor changed, once the tensions have named the pair.

Staged, because one likelihood over tensions and forces together lets a small error of the line's model outvote the
forces: first the tensions say which line (or its sensor), then the environment is held against it with the error that
a displaced vessel may have in the statics, then `mooringdx.cause` weighs line against sensor. A change that grows is
asked about again in the last window of its alarm, where it is largest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mooringdx import cause, decide
from mooringdx.cause import Cause, Testimony
from mooringdx.types import Array, Event, Residuals, Rival, Signatures, replace

Index = NDArray[np.intp]
_NOTABLE = 0.05


@dataclass(frozen=True)
class Hearing:
    """What is known of one alarm: ``onset`` (best, first, last) and ``stop``, samples; ``rows`` of the residuals.

    ``rough``: how much the sea is beyond the fitted one, 1 within it; the forces scatter with it.
    """

    residuals: Residuals
    forces: Residuals
    testimony: Testimony | None
    covariance: Array
    rows: Index
    onset: tuple[int, int, int]
    stop: int
    rough: float = 1.0


@dataclass(frozen=True)
class Told:
    """The verdict on one pair: the rows of line and sensor among the residuals' signatures; when it was told."""

    cause: Cause | None
    line: int
    sensor: int
    at: int


def tell(hearing: Hearing, chosen: decide.Name) -> Told | None:
    """Weigh line against sensor; None where the tensions did not leave just that question."""
    pair = _pair(hearing.residuals.signatures, chosen, hearing.rows)
    if pair is None:
        return None
    known = hearing.testimony
    if known is None:
        return Told(None, *pair, hearing.onset[2])
    window, first = known.window, hearing.onset[2] + known.settle
    near = slice(first, min(first + window, hearing.stop))
    told = _ask(hearing, window, pair, near, known.near)
    if told is not None and told.index >= cause.LEAST_INDEX and told.gate <= 1.0:
        return Told(told, *pair, near.stop)
    far = slice(hearing.stop - window, hearing.stop)
    if far.start > near.stop:
        later = _ask(hearing, window, pair, far, known.far)
        if later is not None and later.verdict != "untold":
            return Told(later, *pair, far.stop)
    return Told(told, *pair, near.stop)


def _pair(signatures: Signatures, chosen: decide.Name, rows: Index) -> tuple[int, int] | None:
    """Return the line's and the sensor's row when the winner's class holds one of each."""
    twins = [r for r, _ in chosen.rivals if decide.alike(signatures, chosen.winner, r, rows)]
    members = [chosen.winner, *twins]
    lines = [r for r in members if signatures.faults[r].kind.startswith("line_")]
    sensors = [r for r in members if signatures.faults[r].kind == "sensor_fault"]
    return (lines[0], sensors[0]) if lines and sensors else None


def _ask(hearing: Hearing, window: int, pair: tuple[int, int], after: slice, covariance: Array) -> Cause | None:
    """Judge one window after the change against the one before it; None where the forces were not seen."""
    before = slice(max(0, hearing.onset[1] - window), hearing.onset[1])
    found = []
    axes = cause.horizontal(hearing.forces.units)
    for noun, columns in ((hearing.residuals, hearing.rows), (hearing.forces, axes)):
        means = [cause.mean_over(noun.values[:, columns], noun.valid[:, columns], p, window) for p in (before, after)]
        if means[0] is None or means[1] is None:
            return None
        found.append(means[1] - means[0])
    signatures, forces = hearing.residuals.signatures, hearing.forces.signatures
    direction, error = (m[pair[0]][hearing.rows] for m in (signatures.matrix, signatures.error))
    value, _ = decide.estimate(found[0], window, direction, error, hearing.covariance)
    lines = [forces.faults.index(signatures.faults[r]) if signatures.faults[r] in forces.faults else -1 for r in pair]
    if min(lines) < 0:
        return None
    line, sensor = (value * forces.matrix[r][axes] for r in lines)
    return cause.judge(
        found[1], covariance * hearing.rough**2, line, sensor, np.abs(value) * forces.error[lines[0]][axes]
    )


def applied(event: Event, told: Told, signatures: Signatures, time: float) -> Event:
    """Return the event with the cause that the forces told, or as untold. ``time``: s, of the verdict."""
    line, sensor = signatures.faults[told.line], signatures.faults[told.sensor]
    evidence = {**event.evidence, **_figures(told, time)}
    names = f"{decide.plain(line)} or {decide.plain(sensor)}"
    twins = {(line.kind, line.subject), (sensor.kind, sensor.subject)}
    others = tuple(r for r in event.rivals if (r.kind, r.subject) not in twins and not r.why_not.startswith("moves"))
    found = told.cause
    if found is None or found.verdict == "untold":
        share = 0.5 if found is None else 1.0 / (1.0 + np.exp(-np.clip(found.score, -30.0, 30.0)))
        why = _why_untold(found)
        pair = [Rival(line.kind, line.subject, share, why), Rival(sensor.kind, sensor.subject, 1.0 - share, why)]
        if found is not None and found.gate > 1.0:
            pair.append(Rival("environment", "force", 0.5, "the force changed across the line as well"))
        return replace(
            event, kind="unknown", subject=line.subject, mode=None, probability=None, rivals=(*pair, *others),
            cannot_tell=f"{names}: {why}", evidence=evidence,
        )  # fmt: skip
    winner, loser = (line, sensor) if found.verdict == "line" else (sensor, line)
    rest = max(1.0 - found.probability, float(1.0 / (1.0 + np.exp(min(abs(found.score), 700.0)))))
    why = f"the balance of forces speaks against it, discrimination index {found.index:.1f}"
    rival = (Rival(loser.kind, loser.subject, rest, why),) if rest >= _NOTABLE else ()
    return replace(
        event, kind=winner.kind, subject=winner.subject, mode=winner.mode, probability=found.probability,
        rivals=(*rival, *others), cannot_tell=None, evidence=evidence, named=time,
    )  # fmt: skip


def _why_untold(found: Cause | None) -> str:
    if found is None:
        return "the balance of forces was not seen before and after the change, or a known force is not logged"
    if found.gate > 1.0:
        return f"the environment changed at the same time (force across the line {found.gate:.1f} times its limit)"
    return (
        f"discrimination index {found.index:.1f} is below {cause.LEAST_INDEX:g}, the forces cannot tell the two apart"
    )


def _figures(told: Told, time: float) -> Mapping[str, Any]:
    if told.cause is None:
        return {"discrimination": None}
    found = told.cause
    figures = {"discrimination": found.index, "log_likelihood_ratio": found.score, "environment_gate": found.gate}
    return {**figures, "cause_told": time}
