"""Position residual: the offset from the mooring's neutral position, and where each lost line would send the vessel.

Equations, in the horizontal plane. Neutral x0 = median of the no-fault positions; r = x - x0. The tension of line j
falls by s_j per metre towards its anchor: T_j = T_j0 - s_j a_j'(x - x0), fitted on block means of the no-fault
window (or a_j declared as azimuth), so the mooring's stiffness is K = sum_j s_j a_j a_j' (horizontal part of the
tension taken as the whole: right for a taut line, a few per cent too stiff for a slack one). A lost line leaves K_j
= K - s_j a_j a_j' and an unbalanced force -T_j0 a_j, hence the offset -K_j^-1 a_j T_j0. The size v of a line's loss
is counted, as the tension residuals do, against the intact line *at the displaced place*: v = -T_j0 (1 + s_j a_j'
K_j^-1 a_j) for a whole line, and since K_j^-1 a_j = (1 + s_j a_j' K_j^-1 a_j) K^-1 a_j, the offset is K^-1 a_j v. A
wrong position sensor moves its own axis. The environment moves both in any direction: four directions stand for
all. Thrusters that hold position shrink the offset: then this residual sees less. Source: quasi-static balance of
the mooring, [Fang2015, eq. 4] without dynamics.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mooringdx.config import RunConfig
from mooringdx.errors import ConfigError
from mooringdx.residuals.training import COMPASS, SIGNATURE_ERROR, Training, known, line_tensions, pooled
from mooringdx.types import Array, Channels, Fault, Residuals, Signatures, locked

_BLOCKS = 60
_BETWEEN = 0.4
"""Half the way from one compass direction to the next, as a share of the offset: sin 22.5 deg."""


@dataclass(frozen=True)
class Position:
    """Fitted neutral point and the offset (two axes) per newton of each line's lost tension."""

    channels: tuple[str, ...]
    units: tuple[str, ...]
    neutral: Array
    lines: tuple[tuple[str, str, float], ...]
    response: Array

    @classmethod
    def fit(cls, training: Sequence[Training], run: RunConfig) -> Position:
        """Take the neutral point and each line's direction and stiffness from the no-fault windows."""
        part, first = run.residuals.position, training[0].channels
        axes = tuple(part.channels)
        if len(axes) != 2:
            raise ConfigError(f"[residuals.position] channels takes two horizontal axes, got {list(axes)}")
        known(axes, first, "[residuals.position]")
        units = tuple(first.units[first.names.index(c)] for c in axes)
        if part.neutral == "baseline":
            neutral = np.median(pooled(training, axes), axis=0)
        else:
            neutral = np.asarray(part.neutral, dtype=np.float64)
        tensions = line_tensions(run.mooring, first)
        lines, response = _line_response(training, axes, tensions, run.mooring.azimuth)
        return cls(axes, units, locked(neutral), lines, locked(response))

    def __call__(self, channels: Channels) -> Residuals:
        """Return the offset on both axes, m."""
        columns = [channels.names.index(c) for c in self.channels]
        values, valid = channels.values[:, columns] - self.neutral, channels.valid[:, columns]
        names = tuple(f"{c} offset" for c in self.channels)
        return Residuals(names, self.units, channels.grid, values, valid, self.signatures())

    def signatures(self) -> Signatures:
        """Return *axis is wrong*, *environment* in four directions, and *line j is gone* where known."""
        faults = [Fault("sensor_fault", c) for c in self.channels]
        rows, errors = [np.eye(2)[i] for i in range(2)], [np.zeros(2), np.zeros(2)]
        units, total, sign = list(self.units), [np.nan, np.nan], [0.0, 0.0]
        for angle in COMPASS:
            faults.append(Fault("environment", "position", f"offset along {angle:03.0f} deg"))
            rows.append(np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))]))
            errors.append(np.full(2, _BETWEEN))
            units.append(self.units[0])
            total.append(np.nan)
            sign.append(0.0)
        for (line, _, level), row in zip(self.lines, self.response, strict=True):
            faults.append(Fault("line_lost", line))
            rows.append(row)
            errors.append(np.full(2, SIGNATURE_ERROR * float(np.hypot(row[0], row[1]))))
            units.append("N")
            total.append(-level if level > 0 else np.nan)
            sign.append(-1.0)
        names = tuple(f"{c} offset" for c in self.channels)
        matrix, error = np.array(rows), np.array(errors)
        return Signatures(tuple(faults), names, matrix, tuple(units), np.array(total), np.array(sign), error)

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-safe mapping."""
        return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in self.__dict__.items()}

    @classmethod
    def from_dict(cls, body: Mapping[str, Any]) -> Position:
        """Rebuild what `to_dict` gave."""
        return cls(
            tuple(body["channels"]),
            tuple(body["units"]),
            locked(body["neutral"]),
            tuple((a, b, float(c)) for a, b, c in body["lines"]),
            locked(np.asarray(body["response"], dtype=np.float64).reshape(-1, 2)),
        )


def _line_response(
    training: Sequence[Training], axes: tuple[str, ...], tensions: Mapping[str, str], azimuth: Mapping[str, float]
) -> tuple[tuple[tuple[str, str, float], ...], Array]:
    """Return the lines (with the size of their whole loss, N) and the offset (lines, 2), m per N of tension change."""
    if len(tensions) < 3 or axes != ("north", "east"):
        return (), np.zeros((0, 2))
    names = (*axes, *tensions.values())
    means = np.vstack([_block_means(t, names) for t in training])
    design = np.column_stack([np.ones(len(means)), means[:, :2] - means[:, :2].mean(axis=0)])
    slope = np.linalg.lstsq(design, means[:, 2:], rcond=None)[0][1:].T
    stiffness = np.hypot(slope[:, 0], slope[:, 1])
    toward = -slope / np.where(stiffness > 0, stiffness, 1.0)[:, None]
    for i, line in enumerate(tensions):
        if line in azimuth:
            toward[i] = np.cos(np.radians(azimuth[line])), np.sin(np.radians(azimuth[line]))
    parts = stiffness[:, None, None] * toward[:, :, None] * toward[:, None, :]
    grown = np.ones(len(tensions))
    for i in range(len(tensions)):
        rest = parts.sum(axis=0) - parts[i]
        if np.linalg.cond(rest) > 1e6:
            return (), np.zeros((0, 2))
        grown[i] += stiffness[i] * float(toward[i] @ np.linalg.solve(rest, toward[i]))
    level = np.vstack([t.rows(tuple(tensions.values())) for t in training]).mean(axis=0)
    whole = level * grown
    lines = tuple((line, t, float(x)) for (line, t), x in zip(tensions.items(), whole, strict=True))
    return lines, np.linalg.solve(parts.sum(axis=0), toward.T).T


def _block_means(training: Training, names: Sequence[str]) -> Array:
    """Return the means of about 60 equal blocks of the no-fault rows: slow motion without the waves."""
    rows = training.rows(names)
    size = max(1, len(rows) // _BLOCKS)
    whole = len(rows) // size
    return np.asarray(rows[: whole * size].reshape(whole, size, len(names)).mean(axis=1))
