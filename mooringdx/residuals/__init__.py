"""Residual generators, one a file: what is near zero while nothing is wrong, and how each fault moves it.

``GENERATORS`` maps the word of ``[residuals] use`` to the class; each has ``fit(training, run)`` and ``__call__``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mooringdx.config import RunConfig
from mooringdx.errors import ConfigError
from mooringdx.registry import did_you_mean, resolve
from mooringdx.residuals.force_balance import ForceBalance
from mooringdx.residuals.learned import Learned
from mooringdx.residuals.parity import Parity
from mooringdx.residuals.position import Position
from mooringdx.residuals.tension import Tension
from mooringdx.residuals.training import Training
from mooringdx.types import Array, Channels, Fault, Residuals, Signatures

GENERATORS: Mapping[str, Any] = {
    "parity": Parity,
    "learned": Learned,
    "position": Position,
    "tension": Tension,
    "force_balance": ForceBalance,
}


@dataclass(frozen=True)
class Stack:
    """Several generators side by side: their residuals joined, their signatures merged fault by fault.

    ``faults``: labels, kinds or subjects to keep; empty keeps all. ``witness``: the force balance, which no detector
    watches where tensions are: it is asked afterwards whether a line or its sensor changed.
    """

    parts: tuple[Any, ...]
    faults: tuple[str, ...] = ()
    witness: Any = None

    def __call__(self, channels: Channels) -> Residuals:
        """Return all residuals on the grid of ``channels``."""
        pieces = [part(channels) for part in self.parts]
        return Residuals(
            names=tuple(name for p in pieces for name in p.names),
            units=tuple(unit for p in pieces for unit in p.units),
            grid=channels.grid,
            values=np.hstack([p.values for p in pieces]),
            valid=np.hstack([p.valid for p in pieces]),
            signatures=keep(merge([p.signatures for p in pieces]), self.faults),
        )

    def floor(self) -> Array:
        """Return the sd to which each residual is believed however quiet the no-fault record was, (r,), its units."""
        known = [p.floor() if isinstance(p, Tension) else np.zeros(len(p.signatures().residuals)) for p in self.parts]
        return np.concatenate(known)

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-safe mapping from which `from_dict` rebuilds the stack."""
        words = {cls: word for word, cls in GENERATORS.items()}
        parts = [{"generator": words[type(part)], **part.to_dict()} for part in self.parts]
        witness = None if self.witness is None else self.witness.to_dict()
        return {"parts": parts, "faults": list(self.faults), "witness": witness}

    @classmethod
    def from_dict(cls, body: Mapping[str, Any]) -> Stack:
        """Rebuild a stack that `to_dict` wrote."""
        parts = []
        for part in body["parts"]:
            rest = {key: value for key, value in part.items() if key != "generator"}
            parts.append(resolve(part["generator"], GENERATORS, "residual generator").from_dict(rest))
        witness = None if body["witness"] is None else ForceBalance.from_dict(body["witness"])
        return cls(tuple(parts), tuple(body["faults"]), witness)


def fit(training: Sequence[Training], run: RunConfig) -> Stack:
    """Fit every generator that the run file uses on the no-fault windows.

    Raises ConfigError for an unknown generator, channel or fault, FitError where the windows are too short.
    """
    if not run.residuals.use:
        raise ConfigError(f"[residuals] use is empty; allowed: {', '.join(GENERATORS)}")
    fitted = {word: resolve(word, GENERATORS, "residual generator").fit(training, run) for word in run.residuals.use}
    witness = fitted.pop("force_balance") if len(fitted) > 1 and "force_balance" in fitted else None
    return Stack(tuple(fitted.values()), tuple(run.residuals.faults), witness)


def merge(pieces: Sequence[Signatures]) -> Signatures:
    """Join signatures side by side; a fault that one generator does not see has zeros there.

    Of two totals the larger stands (one that knows how the vessel gives way), of two signs the first that restricts.
    """
    faults: dict[Fault, int] = {}
    for piece in pieces:
        for fault in piece.faults:
            faults.setdefault(fault, len(faults))
    width = sum(len(p.residuals) for p in pieces)
    matrix, error = np.zeros((len(faults), width)), np.zeros((len(faults), width))
    total, sign = np.full(len(faults), np.nan), np.zeros(len(faults))
    units = [""] * len(faults)
    left = 0
    for piece in pieces:
        for i, fault in enumerate(piece.faults):
            row = faults[fault]
            matrix[row, left : left + len(piece.residuals)] = piece.matrix[i]
            error[row, left : left + len(piece.residuals)] = piece.error[i]
            units[row] = units[row] or piece.units[i]
            if np.isnan(total[row]) or abs(piece.total[i]) > abs(total[row]):
                total[row] = piece.total[i]
            sign[row] = piece.sign[i] if sign[row] == 0 else sign[row]
        left += len(piece.residuals)
    names = tuple(name for p in pieces for name in p.residuals)
    return Signatures(tuple(faults), names, matrix, tuple(units), total, sign, error)


def keep(signatures: Signatures, wanted: Sequence[str]) -> Signatures:
    """Return the signatures whose label, kind or subject is in ``wanted`` (all when empty) and that move anything."""
    names = {word for f in signatures.faults for word in (f.label, f.kind, f.subject)}
    for word in wanted:
        if word not in names:
            raise ConfigError(f"[residuals] faults: unknown '{word}'{did_you_mean(word, sorted(names))}")
    moves = np.any(signatures.matrix != 0.0, axis=1)
    rows = [
        i
        for i, f in enumerate(signatures.faults)
        if moves[i] and (not wanted or {f.label, f.kind, f.subject} & set(wanted))
    ]
    return Signatures(
        tuple(signatures.faults[i] for i in rows),
        signatures.residuals,
        signatures.matrix[rows],
        tuple(signatures.units[i] for i in rows),
        signatures.total[rows],
        signatures.sign[rows],
        signatures.error[rows],
    )
