"""Parity relations that the engineer declares: r_i = f_i(channels), zero while nothing is wrong.

Equation: r = f(x); a wrong channel c moves the mean of r by (df/dx_c) per unit, taken at the no-fault median. A
lost line j takes its tension out of every relation that holds it: the direction of "tension_j is wrong", only
downwards, at most by the pretension. The two are one class to these relations; a residual that sees the vessel move
tells them apart. Source: parity relations of [Fang2015, eq. 1-6]; that a declared relation beats a learned one on
short records is measured in docs/figures.md.

Expressions hold + - * / ** ( ), channel names, and numbers with a unit in brackets: "(tension_SB - tension_PS)/2 -
30 [N/m] * sway".
"""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import mooringdx.channels as catalogue
from mooringdx.config import RunConfig
from mooringdx.errors import ConfigError
from mooringdx.residuals.training import SIGNATURE_ERROR, Training, known, line_tensions, pooled
from mooringdx.types import Channels, Fault, Residuals, Signatures

_ALLOWED = "allowed: + - * / ** ( ), channels, 30 [N/m]"
_OPERATORS: Mapping[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
}


def evaluate(node: ast.AST, names: Mapping[str, Any], number: Callable[[float, str], Any]) -> Any:
    """Evaluate an expression tree; ``number(value, unit)`` makes a constant. Raises ConfigError on anything else."""
    if isinstance(node, ast.Expression):
        return evaluate(node.body, names, number)
    if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
        left, right = evaluate(node.left, names, number), evaluate(node.right, names, number)
        return _OPERATORS[type(node.op)](left, right)
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.USub, ast.UAdd)):
        value = evaluate(node.operand, names, number)
        return -value if isinstance(node.op, ast.USub) else value
    if isinstance(node, ast.Name):
        return names[node.id]
    if isinstance(node, ast.Subscript) and isinstance(node.value, ast.Constant):
        value = node.value.value
        if isinstance(value, (int, float)):
            return number(float(value), ast.unparse(node.slice).replace(" ", ""))
    if isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
        return number(float(node.value), "")
    raise ConfigError(f"'{ast.unparse(node)}' is not allowed in a parity relation; {_ALLOWED}")


def parse(name: str, text: str) -> ast.Expression:
    """Return the tree of one relation, or raise a ConfigError that names it."""
    try:
        return ast.parse(text.strip(), mode="eval")
    except SyntaxError as error:
        raise ConfigError(f'[residuals.parity] {name} = "{text}": cannot be read: {error.msg}') from None


def channel_names(tree: ast.Expression) -> list[str]:
    """Return the channels of a relation, in order of appearance; names inside a unit do not count."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Call):
            raise ConfigError(f"'{ast.unparse(node)}' is not allowed in a parity relation; {_ALLOWED}")
    units = {id(x) for s in ast.walk(tree) if isinstance(s, ast.Subscript) for x in ast.walk(s.slice)}
    found = [n for n in ast.walk(tree) if isinstance(n, ast.Name) and id(n) not in units]
    return list(dict.fromkeys(n.id for n in sorted(found, key=lambda n: n.col_offset)))


@dataclass(frozen=True)
class Parity:
    """Declared relations. ``gradient``: (relations, channels), at the no-fault median; ``median``: (channels,)."""

    relations: tuple[tuple[str, str], ...]
    channels: tuple[str, ...]
    units: tuple[str, ...]
    unit_of: tuple[str, ...]
    gradient: tuple[tuple[float, ...], ...]
    lines: tuple[tuple[str, str], ...]
    median: tuple[float, ...]

    @classmethod
    def fit(cls, training: Sequence[Training], run: RunConfig) -> Parity:
        """Check names and units of every relation and take its derivatives at the no-fault median."""
        declared = tuple(run.residuals.parity.items())
        if not declared:
            raise ConfigError('[residuals] use = ["parity"] needs relations: parity = { r1 = "tension_1 + tension_2" }')
        trees = {name: parse(name, text) for name, text in declared}
        used = tuple(dict.fromkeys(c for tree in trees.values() for c in channel_names(tree)))
        first = training[0].channels
        known(used, first, "[residuals.parity]")
        si = {c: first.units[first.names.index(c)] for c in used}
        units = tuple(_unit(name, text, trees[name], si) for name, text in declared)
        median = np.median(pooled(training, used), axis=0)
        gradient = tuple(tuple(_derivative(trees[name], used, median)) for name, _ in declared)
        lines = tuple((line, t) for line, t in line_tensions(run.mooring, first).items() if t in used)
        return cls(declared, used, units, tuple(si[c] for c in used), gradient, lines, tuple(median.tolist()))

    def __call__(self, channels: Channels) -> Residuals:
        """Return one residual a relation, valid where all its channels are."""
        columns = {name: channels.column(name) for name in self.channels}
        valid = {name: channels.valid[:, channels.names.index(name)] for name in self.channels}
        values = np.empty((channels.grid.n, len(self.relations)))
        good = np.empty(values.shape, dtype=np.bool_)
        for i, (name, text) in enumerate(self.relations):
            tree = parse(name, text)
            values[:, i] = evaluate(tree, columns, _si)
            good[:, i] = np.logical_and.reduce([valid[c] for c in channel_names(tree)])
        names = tuple(name for name, _ in self.relations)
        good &= np.isfinite(values)
        return Residuals(names, self.units, channels.grid, np.where(good, values, np.nan), good, self.signatures())

    def signatures(self) -> Signatures:
        """Return *channel c is wrong* for each channel and *line j is gone* for each declared line."""
        gradient = np.array(self.gradient)
        faults = [Fault("sensor_fault", c) for c in self.channels]
        rows = [gradient[:, i] for i in range(len(self.channels))]
        units, total, sign = list(self.unit_of), [np.nan] * len(faults), [0.0] * len(faults)
        for line, tension in self.lines:
            column = self.channels.index(tension)
            faults.append(Fault("line_lost", line))
            rows.append(gradient[:, column])
            units.append(self.unit_of[column])
            total.append(-abs(self.median[column]) or np.nan)
            sign.append(-1.0)
        names = tuple(name for name, _ in self.relations)
        matrix = np.array(rows)
        share = np.array([SIGNATURE_ERROR if f.kind == "line_lost" else 0.0 for f in faults])
        error = share[:, None] * np.abs(matrix)
        return Signatures(tuple(faults), names, matrix, tuple(units), np.array(total), np.array(sign), error)

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-safe mapping."""
        return dict(self.__dict__)

    @classmethod
    def from_dict(cls, body: Mapping[str, Any]) -> Parity:
        """Rebuild what `to_dict` gave."""
        deep: dict[str, Any] = {k: tuple(tuple(x) if isinstance(x, list) else x for x in v) for k, v in body.items()}
        return cls(**deep)


def _si(value: float, unit: str) -> float:
    if not unit:
        return value
    return float(catalogue.quantity(value, unit).to_base_units().magnitude)


def _unit(name: str, text: str, tree: ast.Expression, si: Mapping[str, str]) -> str:
    import pint

    ones = {c: catalogue.quantity(1.0, unit) for c, unit in si.items()}
    try:
        result = evaluate(tree, ones, catalogue.quantity)
    except pint.DimensionalityError as error:
        where = ", ".join(f"{c} [{unit}]" for c, unit in si.items() if c in text)
        raise ConfigError(
            f'[residuals.parity] {name} = "{text}": {error}; channels are {where}; '
            "give constants a unit, as in 30 [N/m]"
        ) from None
    return str(catalogue.unit_text(result))


def _derivative(tree: ast.Expression, used: Sequence[str], at: Any) -> list[float]:
    step = 1e-30
    out = []
    for i in range(len(used)):
        point = {c: complex(at[k], step if k == i else 0.0) for k, c in enumerate(used)}
        out.append(float(np.imag(evaluate(tree, point, _si)) / step))
    return out
