"""Learned residuals: each chosen channel minus what a regularised linear model predicts from the others.

Equation: r_t(k) = x_t(k) - b_t - sum_i sum_l beta_til (x_i(k - l) - m_i) [- sum_i q_ti ((x_i(k) - m_i)^2 - v_i)],
ridge-fitted on the no-fault windows in standardised units. Signatures come from the model itself: *channel c is
wrong* by one unit moves r_c by one (if c is a target) and every other r_t by -sum_l beta_tcl, the step response
once all lags have passed, linearised at the no-fault mean; *line j is gone* is the same column downwards, at most
by the mean tension, while the other channels follow the vessel, which the model knows. So these residuals alone
cannot tell a parted line from its dead sensor: `position` can, where the vessel moves. Source: ridge regression
[Hastie2009, ch. 3.4]; the idea of redundancy between channels [Fang2015, sec. 2].
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mooringdx.config import RunConfig
from mooringdx.errors import ConfigError, FitError
from mooringdx.residuals.training import COMPASS, SIGNATURE_ERROR, Training, known, line_tensions, pooled
from mooringdx.types import Array, Channels, Fault, Mask, Residuals, Signatures, locked

_ROWS_PER_COLUMN = 20


@dataclass(frozen=True)
class Learned:
    """Fitted predictors. ``weights``: (targets, inputs, lags + 1); ``square``: (targets, inputs), zero when linear.

    ``mean``, ``variance``: (inputs,), of the no-fault window; ``constant``: (targets,); ``explained``: (targets,), R^2.
    A target's own column is zero.
    """

    targets: tuple[str, ...]
    inputs: tuple[str, ...]
    target_units: tuple[str, ...]
    input_units: tuple[str, ...]
    lag_step: int
    weights: Array
    square: Array
    mean: Array
    variance: Array
    constant: Array
    explained: Array
    lines: tuple[tuple[str, str, float], ...]

    @classmethod
    def fit(cls, training: Sequence[Training], run: RunConfig) -> Learned:
        """Fit one predictor a target on the pooled no-fault pieces.

        Raises ConfigError for unknown channels, FitError when there are fewer than 20 rows a coefficient.
        """
        part, first = run.residuals.learned, training[0].channels
        tensions = line_tensions(run.mooring, first)
        targets = tuple(part.channels) or tuple(tensions.values()) or first.names
        inputs = tuple(part.inputs) or first.names
        known((*targets, *inputs), first, "[residuals.learned]")
        if len(set(inputs)) < 2:
            raise ConfigError("[residuals.learned] needs at least two channels, to predict one from the others")
        order = {c: i for i, c in enumerate(inputs)}
        rows = pooled(training, inputs)
        mean, variance = rows.mean(axis=0), rows.var(axis=0)
        shape = (len(targets), len(inputs))
        weights, square = np.zeros((*shape, part.lags + 1)), np.zeros(shape)
        constant, explained = np.zeros(shape[0]), np.zeros(shape[0])
        for t, target in enumerate(targets):
            used = [c for c in inputs if c != target]
            blocks = [
                _design(x, target, used, mean[[order[c] for c in used]], variance[[order[c] for c in used]], run)
                for x in training
            ]
            beta = _ridge(np.vstack([b[0] for b in blocks]), np.concatenate([b[1] for b in blocks]), part.ridge, target)
            constant[t], explained[t] = beta[0], beta[-1]
            cut = len(used) * (part.lags + 1)
            for i, c in enumerate(used):
                weights[t, order[c]] = beta[1 + i * (part.lags + 1) : 1 + (i + 1) * (part.lags + 1)]
                if part.quadratic:
                    square[t, order[c]] = beta[1 + cut + i]
        unit = dict(zip(first.names, first.units, strict=True))
        level = {c: float(np.mean(np.vstack([t.rows((c,)) for t in training]))) for c in tensions.values()}
        lines = tuple((line, c, level[c]) for line, c in tensions.items() if c in (*targets, *inputs))
        units = tuple(unit[c] for c in targets), tuple(unit[c] for c in inputs)
        return cls(targets, inputs, *units, part.lag_step, weights, square, mean, variance, constant, explained, lines)

    def __call__(self, channels: Channels) -> Residuals:
        """Return measured minus predicted, valid where the target and all its inputs at all lags are."""
        values = np.empty((channels.grid.n, len(self.targets)))
        valid = np.empty(values.shape, dtype=np.bool_)
        columns = [channels.column(c) - m for c, m in zip(self.inputs, self.mean, strict=True)]
        good = [channels.valid[:, channels.names.index(c)] for c in self.inputs]
        for t, target in enumerate(self.targets):
            r = channels.column(target) - self.constant[t]
            ok = channels.valid[:, channels.names.index(target)].copy()
            for i in range(len(self.inputs)):
                for lag in np.flatnonzero(self.weights[t, i]):
                    _subtract(r, ok, self.weights[t, i, lag] * columns[i], good[i], int(lag) * self.lag_step)
                if self.square[t, i]:
                    r -= self.square[t, i] * (columns[i] ** 2 - self.variance[i])
            values[:, t], valid[:, t] = np.where(ok, r, np.nan), ok
        names = tuple(f"{c} - predicted" for c in self.targets)
        return Residuals(names, self.target_units, channels.grid, values, valid, self.signatures())

    def signatures(self) -> Signatures:
        """Return *channel c is wrong* for every channel and *line j is gone* for every declared line."""
        unit = dict(zip((*self.inputs, *self.targets), (*self.input_units, *self.target_units), strict=True))
        faults, rows, errors, total, sign = [], [], [], [], []
        for c in unit:
            faults.append(Fault("sensor_fault", c))
            rows.append(self._row(c))
            errors.append(np.zeros(len(self.targets)))
            total.append(np.nan)
            sign.append(0.0)
        units = list(unit.values())
        for line, tension, level in self.lines:
            faults.append(Fault("line_lost", line))
            rows.append(self._row(tension))
            errors.append(SIGNATURE_ERROR * np.array([1.0 if u == unit[tension] else 0.0 for u in self.target_units]))
            total.append(-level if level > 0 else np.nan)
            sign.append(-1.0)
            units.append(unit[tension])
        if {"north", "east"} <= set(self.inputs):
            slope = self.weights[:, [self.inputs.index(c) for c in ("north", "east")]].sum(axis=2)
            for angle in COMPASS:
                faults.append(Fault("environment", "position", f"offset along {angle:03.0f} deg"))
                rows.append(np.zeros(len(self.targets)))
                errors.append(SIGNATURE_ERROR * np.abs(slope @ [np.cos(np.radians(angle)), np.sin(np.radians(angle))]))
                total.append(np.nan)
                sign.append(0.0)
                units.append("m")
        names = tuple(f"{c} - predicted" for c in self.targets)
        shape = (len(faults), len(names))
        matrix, error = np.reshape(rows, shape), np.reshape(errors, shape)
        return Signatures(tuple(faults), names, matrix, tuple(units), np.array(total), np.array(sign), error)

    def _row(self, channel: str) -> Array:
        row = np.array([1.0 if t == channel else 0.0 for t in self.targets])
        if channel in self.inputs:
            row -= self.weights[:, self.inputs.index(channel)].sum(axis=1)
        return row

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-safe mapping."""
        return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in self.__dict__.items()}

    @classmethod
    def from_dict(cls, body: Mapping[str, Any]) -> Learned:
        """Rebuild what `to_dict` gave."""
        arrays = {"weights", "square", "mean", "variance", "constant", "explained"}
        fields = {k: locked(v) if k in arrays else v for k, v in body.items()}
        for key in ("targets", "inputs", "target_units", "input_units"):
            fields[key] = tuple(fields[key])
        fields["lines"] = tuple(tuple(x) for x in fields["lines"])
        return cls(**fields)


def _subtract(r: Array, ok: Mask, term: Array, good: Mask, lag: int) -> None:
    """Subtract ``term`` delayed by ``lag`` samples, in place; the first ``lag`` samples become invalid."""
    if lag == 0:
        r -= term
        ok &= good
        return
    r[lag:] -= term[:-lag]
    ok[lag:] &= good[:-lag]
    ok[:lag] = False


def _design(
    training: Training, target: str, used: Sequence[str], mean: Array, variance: Array, run: RunConfig
) -> tuple[Array, Array]:
    """Return (rows, 1 + coefficients) regressors with a leading one, and the (rows,) target, of one log."""
    part, channels = run.residuals.learned, training.channels
    depth = part.lags * part.lag_step
    columns = [channels.names.index(c) for c in used]
    x = channels.values[:, columns] - mean
    good: Mask = np.asarray(channels.valid[:, columns].all(axis=1), dtype=np.bool_)
    y, y_good = channels.column(target), channels.valid[:, channels.names.index(target)]
    xs, ys = [], []
    for piece in training.pieces:
        rows = np.arange(piece.start + depth, piece.stop)
        lagged = [rows - lag * part.lag_step for lag in range(part.lags + 1)]
        seen = np.array([y_good[rows], *(good[at] for at in lagged)])
        rows = rows[np.flatnonzero(seen.all(axis=0))]
        terms = [x[rows - lag * part.lag_step, i] for i in range(len(used)) for lag in range(part.lags + 1)]
        if part.quadratic:
            terms += [x[rows, i] ** 2 - variance[i] for i in range(len(used))]
        xs.append(np.column_stack([np.ones(len(rows)), *terms]))
        ys.append(y[rows])
    return np.vstack(xs), np.concatenate(ys)


def _ridge(design: Array, target: Array, ridge: float, name: str) -> Array:
    """Return (constant, coefficients ..., R^2) of a ridge regression in standardised units."""
    rows, width = design.shape
    if rows < _ROWS_PER_COLUMN * width:
        raise FitError(
            f"learned residual of '{name}': {rows} no-fault rows for {width} coefficients; it needs "
            f"{_ROWS_PER_COLUMN * width}: lengthen [baseline] window or lower [residuals.learned] lags"
        )
    centre, sd = design[:, 1:].mean(axis=0), design[:, 1:].std(axis=0)
    sd = np.where(sd > 0, sd, 1.0)
    z, y = (design[:, 1:] - centre) / sd, target - target.mean()
    gram = z.T @ z / rows + ridge * np.eye(width - 1)
    beta = np.linalg.solve(gram, z.T @ y / rows)
    spread = float(np.var(y))
    explained = 1.0 - float(np.var(y - z @ beta)) / spread if spread > 0 else 0.0
    beta = beta / sd
    return np.concatenate([[target.mean() - centre @ beta], beta, [explained]])
