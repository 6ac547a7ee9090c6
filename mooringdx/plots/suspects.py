"""Which residuals and which statistics an event speaks of, so that a reader sees those first."""

from __future__ import annotations

import numpy as np

from mooringdx.types import Array, Detection, Event, Signatures


def rows(signatures: Signatures, event: Event) -> list[int]:
    """Return the signature rows of an event: same kind and subject, else same subject."""
    exact = [i for i, f in enumerate(signatures.faults) if (f.kind, f.subject) == (event.kind, event.subject)]
    return exact or [i for i, f in enumerate(signatures.faults) if f.subject == event.subject]


def _scatter(column: Array) -> float:
    """Return the median absolute deviation of the valid samples, 0 without any."""
    ok = column[np.isfinite(column)]
    return float(np.median(np.abs(ok - np.median(ok)))) if ok.size else 0.0


def residuals_of(detection: Detection, event: Event) -> list[str]:
    """Return the residuals that an event moves, the strongest first (in units of their own scatter)."""
    found = detection.residuals
    if found is None:
        return []
    index = rows(found.signatures, event)
    if not index:
        hit = [n for n in found.names if event.subject in n]
        return hit or list(found.names[:2])
    with np.errstate(invalid="ignore", divide="ignore"):
        some = found.values[:: max(1, found.values.shape[0] // 20_000)]
        spread = np.array([_scatter(column) for column in some.T])
        effect = np.abs(found.signatures.matrix[index]).max(axis=0) / np.where(spread > 0, spread, np.inf)
    order = np.argsort(-effect, kind="stable")
    return [found.names[i] for i in order if effect[i] >= 0.25 * effect[order[0]] and effect[i] > 0]


def residual_order(detection: Detection) -> tuple[list[str], list[str]]:
    """Return (residuals of any event, all others), each in the order to show them."""
    if detection.residuals is None:
        return [], []
    first: list[str] = []
    for event in detection.events:
        first += [name for name in residuals_of(detection, event) if name not in first]
    if not first:
        first = list(detection.residuals.names[:1])
    return first, [name for name in detection.residuals.names if name not in first]
