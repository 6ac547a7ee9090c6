"""Whitener, detectors and levels as one fitted thing, and the cross-fitted trial of a candidate.

The branches: *main* looks at the (perhaps compressed) whitened residuals over the detector window; *short* at the
uncompressed ones over 1.3 peak periods, for large faults; *slow* at the uncompressed ones over 400 against the
frozen no-fault mean, for what the following reference of the others would swallow. The asked rate is shared 0.8 :
0.1 : 0.1 among those that run.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from mooringdx.config import RunConfig
from mooringdx.detectors import DETECTORS
from mooringdx.detectors.covariance import covariance_of_means
from mooringdx.detectors.cusum import Cusum
from mooringdx.detectors.design import Design
from mooringdx.detectors.glrt import Glrt
from mooringdx.detectors.glrt_unknown import GlrtUnknown
from mooringdx.detectors.reference import Reference
from mooringdx.registry import resolve
from mooringdx.results import decode, encode
from mooringdx.threshold import folds
from mooringdx.timing import Timing
from mooringdx.types import Array, Fault, Grid, Mask, Residuals, Signatures, Statistic, Threshold, Whitened, replace
from mooringdx.whiten import Whitener, fit_whitener
from mooringdx.whiten.arma import Order
from mooringdx.whiten.whitener import Kind

SHARES: Mapping[str, float] = {"main": 0.8, "slow": 0.1, "short": 0.1}
Pieces = Sequence[tuple[int, slice]]


@dataclass(frozen=True)
class Walk:
    """What a chain gives for one log: whitened (as the main branch sees it), uncompressed, and the statistics."""

    whitened: Whitened
    plain: Whitened
    statistics: tuple[Statistic, ...]


@dataclass(frozen=True)
class Chain:
    """A whitener with one detector design a branch."""

    whitener: Whitener
    detector: str
    designs: tuple[Design, ...]
    design_size: float | None = None

    def __call__(self, measured: Residuals) -> Walk:
        """Walk one log's residuals to the statistics of all branches."""
        z, plain = self.whitener(measured), self.whitener.uncompressed()(measured)
        statistics = []
        for design in self.designs:
            main = design.branch == "main"
            detector = self.main_detector(design) if main else Glrt(design)
            found = detector(z if main else plain)
            statistics.append(replace(found, values=found.values.astype(np.float32)))
        return Walk(z, plain, tuple(statistics))

    def main_detector(self, design: Design) -> Glrt | GlrtUnknown | Cusum:
        """Return the main branch's detector; a cumulative sum takes its own design size unless told."""
        kind = resolve(self.detector, DETECTORS, "detector")
        if kind is not Cusum:
            return kind(design)
        return Cusum(design, np.full(len(design.labels), self.design_size) if self.design_size else None)

    def with_levels(self, thresholds: Sequence[Threshold]) -> Chain:
        """Return the chain whose following references are held while its own alarms stand."""
        level = {t.branch: t.level for t in thresholds}
        return replace(self, designs=tuple(replace(d, level=level[d.branch]) for d in self.designs))

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-safe mapping."""
        rest = encode({k: getattr(self, k) for k in ("detector", "designs", "design_size")})
        return {"whitener": self.whitener.to_dict(), **rest}

    @classmethod
    def from_dict(cls, body: Mapping[str, Any]) -> Chain:
        """Rebuild what `to_dict` gave."""
        designs = decode(tuple[Design, ...], body["designs"])
        return cls(Whitener.from_dict(body["whitener"]), body["detector"], designs, body["design_size"])


def fit_chain(
    measured: Sequence[Residuals],
    pieces: Pieces,
    kind: Kind,
    run: RunConfig,
    timing: Timing,
    floor: Array,
    start: Whitener | None = None,
) -> Chain:
    """Fit whitener, references and covariances on the no-fault ``pieces`` (log, samples).

    ``floor``: (r,), sd to which each residual is believed however quiet it was. ``start``: the whitener of a record
    that holds these pieces; its orders are kept, which saves the search.
    """
    order: Order | Literal["bic"] = run.whitening.order if isinstance(run.whitening.order, tuple) else "bic"
    stretches = [(measured[i], s) for i, s in pieces]
    whitener = fit_whitener(
        stretches, kind, order, run.whitening.compression, peak_period=timing.peak_period, start=start
    )
    plain = [whitener.uncompressed()(r) for r in measured]
    z = [whitener(r) for r in measured] if kind == "arma+compression" else plain
    about = run.detector.covariance_about
    raw = measured[0].signatures
    designs = [believed(_design("main", z, pieces, timing.window, timing.memory, about), raw, floor)]
    if timing.short:
        designs.append(believed(_design("short", plain, pieces, timing.short, timing.memory, about), raw, floor))
    if timing.slow:
        slow = believed(
            replace(_design("slow", plain, pieces, timing.window, 0, about), window=timing.slow), raw, floor
        )
        designs.append(drifting(slow, plain[0].signatures, run.detector.slow_drift))
    return Chain(whitener, run.detector.kind, tuple(designs), run.detector.design_size)


def _design(
    branch: str, z: Sequence[Whitened], pieces: Pieces, window: int, memory: int, about: Literal["mean", "zero"]
) -> Design:
    stretches = segments(z, pieces)
    covariance = covariance_of_means(stretches, window, about)
    good = np.vstack([values[valid.all(axis=1)] for values, valid in stretches])
    mean = np.zeros(good.shape[1]) if about == "zero" else good.mean(axis=0)
    reference = Reference(mean, good.std(axis=0), float(memory) if memory else None, 2 * window)
    return Design.of(z[0].signatures, covariance, window, reference, None, branch)


def believed(design: Design, signatures: Signatures, floor: Array) -> Design:
    """Return a design whose window means are believed to ``floor``, (r,), sd of the raw residuals, at best.

    ``signatures``: of the raw residuals; against the design's directions they give each residual's gain through the
    whitener.
    """
    if not np.any(floor):
        return design
    raw = np.max(np.abs(np.asarray(signatures.matrix)), axis=0)
    gain = np.max(np.abs(np.asarray(design.directions)), axis=0) / np.where(raw > 0, raw, 1.0)
    return replace(design, covariance=design.covariance + design.window * np.diag((gain * floor) ** 2))


def drifting(design: Design, signatures: Signatures, drift: float) -> Design:
    """Return a design that allows every healthy tension sensor a slow drift of sd ``drift``, N.

    The mean over W samples then has covariance Q/W + drift^2 sum_i g_i g_i', g_i the direction of a biased sensor i.
    """
    rows = [i for i, f in enumerate(signatures.faults) if _biased_tension(f) and signatures.units[i] == "N"]
    if not drift or not rows:
        return design
    moves = np.asarray(signatures.matrix)[rows]
    return replace(design, covariance=design.covariance + design.window * drift**2 * moves.T @ moves)


def _biased_tension(fault: Fault) -> bool:
    return fault.kind == "sensor_fault" and fault.subject.startswith("tension_")


def segments(z: Sequence[Whitened], pieces: Pieces) -> list[tuple[Array, Mask]]:
    """Return the no-fault stretches as (values, valid)."""
    return [(z[i].values[s], z[i].valid[s]) for i, s in pieces]


def held_back(
    measured: Sequence[Residuals], pieces: Pieces, kind: Kind, run: RunConfig, timing: Timing, full: Chain, floor: Array
) -> dict[str, list[Array]]:
    """Return the cross-fitted no-fault statistics of every branch: {branch: [(n_i, f) a held-back stretch]}."""
    held: dict[str, list[Array]] = {design.branch: [] for design in full.designs}
    stretches = [cut(measured[i], s) for i, s in pieces]

    def fit_fold(train: list[tuple[int, slice]]) -> Callable[[int, slice], Array]:
        chain = fit_chain(stretches, train, kind, run, timing, floor, full.whitener)
        walks = [chain(r) for r in stretches]

        def apply(segment: int, stretch: slice) -> Array:
            for statistic in walks[segment].statistics:
                held[statistic.branch].append(statistic.values[stretch])
            return np.zeros((0, 1))

        return apply

    folds.crossfit([r.grid.n for r in stretches], fit_fold)
    return held


def cut(measured: Residuals, piece: slice) -> Residuals:
    """Return the residuals of one piece on a grid of its own."""
    grid = measured.grid
    own = Grid(grid.start + grid.sample_time * piece.start, grid.sample_time, piece.stop - piece.start, grid.epoch_ns)
    return replace(measured, grid=own, values=measured.values[piece], valid=measured.valid[piece])
