"""All that `fit` learns: generators, the chain of detectors, levels with the rates they really give.

The whitening is a choice that the data justify, not a rite: none, ARMA, and ARMA + compression are each fitted on
four fifths of the no-fault record and judged on the fifth held back, five times; the one whose chain finds the
smallest faults at the asked rate is taken, unless the run file says otherwise.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from mooringdx import __version__, cause, residuals
from mooringdx.cause import Testimony
from mooringdx.chain import SHARES, Chain, Pieces, cut, fit_chain, held_back, segments
from mooringdx.checks import agitation, drift_check, whiteness_check
from mooringdx.config import RunConfig, rate_text
from mooringdx.detectors.covariance import covariance_of_means
from mooringdx.detectors.design import Design
from mooringdx.errors import ReportError
from mooringdx.residuals.training import Training
from mooringdx.results import decode, encode, json_bytes, read_json
from mooringdx.threshold import DRIFT_LIMIT, drift_ratio, fit_threshold, predicted_threshold, smallest_fault
from mooringdx.timing import Timing
from mooringdx.types import Array, Channels, Check, Residuals, Signatures, Threshold, Whitened, replace
from mooringdx.whiten.whitener import KINDS, Kind, Whitener

_KEPT = 4000
WITNESS_WINDOWS = 2
"""Detector windows over which the balance of forces is averaged, before and after: 20 peak periods."""
SHORT_GUARD = 3.0
"""On the short branch's level: it is there for faults of tens of sd, and the tail of a few uncompressed samples is
heavier than a short record shows (measured: at the fitted level it raised nearly all false alarms of the demo's sea).
Its printed rate is that of the level without the guard: an upper bound."""
Progress = Callable[[int, int], None] | None


@dataclass(frozen=True)
class Moments:
    """No-fault mean, (r,), and covariance of window means times the window, (r, r), of the raw residuals: for sizes."""

    mean: Array
    covariance: Array


@dataclass(frozen=True)
class Fitted:
    """The fitted walk from channels to levels.

    ``level``: (k, c), a thinned sample of the no-fault channels, to judge how a sensor is wrong; ``agitation``: (c,) sd
    of increments, the sea of the no-fault record. ``testimony``: what tells a line from its sensor, where a vessel is
    known and the record long enough.
    """

    timing: Timing
    stack: residuals.Stack
    chain: Chain
    raw: Moments
    thresholds: tuple[Threshold, ...]
    level: Array
    agitation: Array
    testimony: Testimony | None = None


@dataclass(frozen=True)
class Baseline:
    """What `fit` hands to `detect`.

    ``choice``: one mapping a whitening candidate; ``windows``: one mapping a log; ``fitted`` is None where only a
    position-only bank was asked for. ``banks``: what banks learned, by their words. ``verdict`` and ``reason`` are on
    the asked rate.
    """

    run: Mapping[str, Any]
    fitted: Fitted | None
    choice: tuple[Mapping[str, Any], ...]
    checks: tuple[Check, ...]
    windows: tuple[Mapping[str, Any], ...]
    verdict: str
    reason: str
    version: str = __version__
    banks: Mapping[str, Any] = field(default_factory=dict)

    @property
    def thresholds(self) -> tuple[Threshold, ...]:
        """The levels of all branches; none for a position-only bank."""
        return self.fitted.thresholds if self.fitted is not None else ()

    @classmethod
    def of_bank(
        cls, run: RunConfig, channels: Sequence[Channels], pieces: Sequence[Sequence[slice]], banks: Mapping[str, Any]
    ) -> Baseline:
        """Return the baseline of a run with position-only banks: no rate is asked, their priors are settings."""
        where = tuple(_where(c, p) for c, p in zip(channels, pieces, strict=True))
        reason = (
            "a position-only bank decides by probabilities; docs/figures.md has the false alarms it was measured at"
        )
        body = run.model_dump(mode="json")
        return cls(body, None, (), (), where, "not_applicable", reason, banks=banks)

    def config(self) -> RunConfig:
        """Return the run file that this was fitted with."""
        return RunConfig.model_validate(self.run)

    def no_fault_of(self, sha256: str) -> tuple[tuple[float, float], ...]:
        """Return the no-fault windows, s, of the log with this digest; empty when it was not fitted on."""
        return tuple((a, b) for w in self.windows if w["sha256"] == sha256 for a, b in w["windows"])

    def alarm_rate(self) -> dict[str, Any]:
        """Return asked, central and interval of the system's false-alarm rate (1/s) with its verdict."""
        if self.fitted is None:
            return {"verdict": self.verdict, "reason": self.reason}
        low = sum(t.rate_interval[0] for t in self.thresholds)
        high = sum(t.rate_interval[1] for t in self.thresholds)
        return {
            "asked": self.config().alarm.rate,
            "central": sum(t.central_rate for t in self.thresholds),
            "interval": [low, high],
            "unit": "1/s",
            "verdict": self.verdict,
            "reason": self.reason,
        }

    def summary(self) -> dict[str, Any]:
        """Return what `fit --json` prints."""
        keys = ("verdict", "reason", "choice", "checks", "windows", "run")
        levels = [
            {"branch": t.branch, "scaled_level": t.scaled_level, "interval": t.scaled_interval} for t in self.thresholds
        ]
        timing = self.fitted and self.fitted.timing
        rest = {key: getattr(self, key) for key in keys}
        return {"alarm_rate": self.alarm_rate(), "thresholds": levels, "timing": timing, **rest}

    def text(self) -> str:
        """Return what `fit` prints: the candidates with their smallest faults, the levels, the rate in words."""
        if self.fitted is None:
            return "\n".join([f"position-only bank: {self.reason}", *self._banks()])
        timing = self.fitted.timing
        seconds = timing.measured * timing.sample_time
        lines = [f"no-fault record {seconds:.0f} s, peak period {timing.peak_period:.3g} s; {_windows(timing)}"]
        for row in self.choice[:1]:
            if not row["smallest"]:
                return "\n".join([*lines, f"whitening: {row['whitening']}", *self._levels()])
        lines.append("smallest fault found in 95 % at the asked rate (in brackets: named alone one window later):")
        head = [("* " if row["taken"] else "") + row["whitening"] for row in self.choice]
        lines.append(" " * 48 + "".join(f"{h:>24s}" for h in head))
        for fault in self.choice[0]["smallest"]:
            lines.append(f"  {fault:46s}" + "".join(f"{row['smallest'][fault]:>24s}" for row in self.choice))
        return "\n".join([*lines, *self._levels(), *self._banks()])

    def _banks(self) -> list[str]:
        """Return what each fitted bank says of itself."""
        from mooringdx.hypotheses import HYPOTHESES

        made = ((word, HYPOTHESES[word].from_dict(body)) for word, body in self.banks.items() if word in HYPOTHESES)
        return [f"  {word}: {line}" for word, bank in made if hasattr(bank, "summary") for line in bank.summary()]

    def _levels(self) -> list[str]:
        lines = []
        for t in self.thresholds:
            low, high = t.scaled_interval
            lines.append(
                f"  {t.branch} branch: level {t.scaled_level:.3g} [{low:.3g}, {high:.3g}] for {rate_text(t.asked_rate)}"
            )
        lines.append(self.rate_sentence())
        lines += [f"! {c.name}, {c.subject}: {c.detail}; {c.remedy}" for c in self.checks if not c.passed]
        return lines

    def rate_sentence(self) -> str:
        """Return the false-alarm rate in words: asked, what the record supports, and the verdict on it."""
        rate = self.alarm_rate()
        low, high = (rate_text(r) for r in rate["interval"])
        return (
            f"False alarms: {rate_text(rate['asked'])} asked; this no-fault record supports {low} to {high} "
            f"(central {rate_text(rate['central'])}): {rate['verdict']}. {rate['reason']}"
        ).rstrip()


def _windows(t: Timing) -> str:
    parts = {"window": t.window, "short branch": t.short, "slow channel": t.slow, "reference follows over": t.memory}
    return ", ".join(f"{k} {v * t.sample_time:.3g} s" if v else f"{k} off" for k, v in parts.items())


def learn(
    training: Sequence[Training],
    stack: residuals.Stack,
    measured: Sequence[Residuals],
    pieces: Pieces,
    timing: Timing,
    run: RunConfig,
    progress: Progress = None,
) -> Baseline:
    """Fit every candidate chain, take the one that finds the smallest faults, and set its levels."""
    measured = [cut(measured[i], s) for i, s in pieces]
    pieces = [(i, slice(0, r.grid.n)) for i, r in enumerate(measured)]
    floor = stack.floor()
    raw = _moments(measured, pieces, timing.window, run, floor)
    trials: list[_Trial] = []
    for i, kind in enumerate(candidates(run)):
        start = trials[-1].chain.whitener if trials and trials[-1].chain.whitener.models else None
        trials.append(_trial(measured, pieces, kind, run, timing, raw, floor, start))
        if progress is not None:
            progress(i + 1, len(candidates(run)))
    best = prefer([t.merit for t in trials])
    taken = trials[best]
    choice = tuple({**t.row, "taken": i == best} for i, t in enumerate(trials))
    plain = [taken.chain.whitener.uncompressed()(r) for r in measured]
    main = taken.thresholds[0]
    channels = [t.channels for t in training]
    rows = np.vstack([t.channels.values[piece] for t in training for piece in t.pieces])
    fitted = Fitted(
        timing=timing,
        stack=stack,
        chain=taken.chain.with_levels(taken.thresholds),
        raw=raw,
        thresholds=taken.thresholds,
        level=rows[:: max(1, len(rows) // _KEPT)],
        agitation=np.max([agitation(t.channels.values[piece]) for t in training for piece in t.pieces], axis=0),
        testimony=_testimony(training, stack, timing, run),
    )
    return Baseline(
        run=run.model_dump(mode="json"),
        fitted=fitted,
        choice=choice,
        checks=(*_checks(measured, plain, pieces, taken.thresholds, timing), *_forces_check(training, stack, run)),
        windows=tuple(_where(c, t.pieces) for c, t in zip(channels, training, strict=True)),
        verdict=main.verdict,
        reason=main.reason,
    )


def _testimony(
    training: Sequence[Training], stack: residuals.Stack, timing: Timing, run: RunConfig
) -> Testimony | None:
    """Learn how much the balance of forces changes by itself; None without a vessel."""
    if stack.witness is None or not _forces_logged(training, run):
        return None
    asked = run.residuals.force_balance.window
    window = WITNESS_WINDOWS * timing.window if asked == "auto" else max(2, round(asked / timing.sample_time))
    stretches = []
    for t in training:
        forces = stack.witness(t.channels)
        axes = cause.horizontal(forces.units)
        stretches += [(forces.values[piece][:, axes], forces.valid[piece][:, axes]) for piece in t.pieces]
    return cause.learn(stretches, window, timing.window)


def _forces_logged(training: Sequence[Training], run: RunConfig) -> bool:
    """Tell whether a vessel's thrust is logged, if it has any: its controller answers a lost line by itself."""
    asked = ("thrust_surge", "thrust_sway") if run.mooring.model.get("thrust") else ()
    return all(name in t.channels.names for t in training for name in asked)


def prefer(merits: Sequence[float]) -> int:
    """Return the candidate to take: the last within a tenth of the best mean log size.

    The candidates stand in the order none, ARMA, ARMA + compression; where two find nearly the same faults the
    later is taken, because whitened and compressed statistics keep their rate in another sea, raw ones do not.
    """
    if not np.isfinite(merits).any():
        return len(merits) - 1
    near = [i for i, m in enumerate(merits) if m <= min(merits) + 0.1]
    return near[-1]


def candidates(run: RunConfig) -> tuple[Kind, ...]:
    """Return the whitening kinds to try."""
    if run.whitening.order == "auto" and run.detector.kind != "glrt":
        return ("arma",)  # the smallest fault by which to choose is known for the likelihood ratio only
    if run.whitening.order == "auto":
        return KINDS if run.whitening.compression.kind != "none" else KINDS[:2]
    if run.whitening.order == "none":
        return ("none",)
    return ("arma",) if run.whitening.compression.kind == "none" else ("arma+compression",)


@dataclass(frozen=True)
class _Trial:
    chain: Chain
    thresholds: tuple[Threshold, ...]
    row: Mapping[str, Any]
    merit: float


def _trial(
    measured: Sequence[Residuals],
    pieces: Pieces,
    kind: Kind,
    run: RunConfig,
    timing: Timing,
    raw: Moments,
    floor: Array,
    start: Whitener | None,
) -> _Trial:
    """Fit one candidate, its cross-fitted levels, and the smallest faults it would find."""
    chain = fit_chain(measured, pieces, kind, run, timing, floor, start)
    held = held_back(measured, pieces, kind, run, timing, chain, floor)
    shares = {d.branch: SHARES[d.branch] for d in chain.designs}
    shares["main"] += 1.0 - sum(shares.values())
    plain = [chain.whitener.uncompressed()(r) for r in measured]
    ratio = drift_ratio(segments(plain, pieces), timing.window)
    dof = {d.branch: chain.main_detector(d).dof if d.branch == "main" else 1 for d in chain.designs}
    thresholds = tuple(
        _level(d, held[d.branch], run, timing, shares[d.branch], ratio, dof[d.branch]) for d in chain.designs
    )
    if np.any(floor):
        thresholds = tuple(map(_as_believed, thresholds))
    main = thresholds[0]
    seen, alone = _smallest(chain.designs[0], main, measured[0].signatures, raw, timing)
    found = np.where(np.isfinite(alone), np.maximum(seen, alone), seen)
    signatures = measured[0].signatures
    sizes = {
        f.label: f"{a:.3g} ({b:.3g}) {u}" if np.isfinite(b) else f"{a:.3g} (never) {u}"
        for f, a, b, u in zip(signatures.faults, seen, alone, signatures.units, strict=True)
    }
    if run.detector.kind != "glrt":
        sizes = {}
    merit = float(np.mean(np.log(found))) if np.isfinite(found).all() else np.inf
    row = {"whitening": kind, "smallest": sizes, "merit": merit, "level": main.scaled_level, "drift": ratio}
    return _Trial(chain, thresholds, row, merit)


def _smallest(design: Design, main: Threshold, signatures: Signatures, raw: Moments, timing: Timing) -> Array:
    """Return the smallest fault per direction, (2, f): found by the chain, and named alone from the raw residuals."""
    f = len(signatures.faults)
    level, scale = np.broadcast_to(main.level, (f,)), np.broadcast_to(main.scale, (f,))
    found = smallest_fault(design.directions, design.sign, design.covariance, design.window, level, scale).found
    window = (np.asarray(raw.covariance), timing.window)
    named = smallest_fault(np.asarray(signatures.matrix), np.asarray(signatures.sign), *window, level, np.ones(f)).named
    return np.array([found, named])


def _level(
    design: Design, held: Sequence[Array], run: RunConfig, timing: Timing, share: float, drift: float, dof: int
) -> Threshold:
    """Return one branch's level: from held-back statistics, or from theory for a window too long to be tried."""
    rate, assurance = run.alarm.rate * share, run.alarm.assurance
    common: dict[str, Any] = {"samples": timing.measured, "drift_ratio": drift, "system_rate": run.alarm.rate}
    if design.branch == "slow":
        window = (design.window, timing.window)
        return predicted_threshold("slow", design.sign, *window, timing.sample_time, rate, assurance, **common)
    following = design.reference.tau is not None
    guard = SHORT_GUARD if design.branch == "short" else 1.0
    found = fit_threshold(
        design.branch,
        held,
        design.window,
        timing.sample_time,
        rate,
        assurance,
        following=following,
        dof=dof,
        **common,
    )
    low, high = found.scaled_interval
    return replace(
        found,
        level=guard * np.asarray(found.level),
        scaled_level=guard * found.scaled_level,
        scaled_interval=(guard * low, guard * high),
    )


def _as_believed(threshold: Threshold) -> Threshold:
    """Return the level for residuals believed no better than their floor: quiet ones are not scaled up to unit scatter.

    The printed rate is that of the level without this: an upper bound.
    """
    scale = np.maximum(np.asarray(threshold.scale), 1.0)
    return replace(threshold, level=np.asarray(threshold.level) * scale / np.asarray(threshold.scale), scale=scale)


def _moments(measured: Sequence[Residuals], pieces: Pieces, window: int, run: RunConfig, floor: Array) -> Moments:
    raw = [(measured[i].values[s], measured[i].valid[s]) for i, s in pieces]
    rows = np.vstack([values[valid.all(axis=1)] for values, valid in raw])
    zero = run.detector.covariance_about == "zero"
    return Moments(
        np.zeros(rows.shape[1]) if zero else rows.mean(axis=0),
        covariance_of_means(raw, window, run.detector.covariance_about) + window * np.diag(floor**2),
    )


def _checks(
    measured: Sequence[Residuals],
    plain: Sequence[Whitened],
    pieces: Pieces,
    thresholds: Sequence[Threshold],
    timing: Timing,
) -> tuple[Check, ...]:
    from mooringdx.whiten.whiteness import whiteness

    lags = max(8, round(2 * timing.peak_period / timing.sample_time))
    rows = []
    for r, name in enumerate(measured[0].names):
        before = whiteness(
            [np.where(measured[i].valid[s, r], measured[i].values[s, r], np.nan) for i, s in pieces], lags
        )
        after = whiteness([np.where(plain[i].valid[s, r], plain[i].values[s, r], np.nan) for i, s in pieces], lags)
        rows.append(whiteness_check(name, before.ljung_box, after.ljung_box))
    rows.append(drift_check(thresholds[0].drift_ratio, DRIFT_LIMIT))
    return tuple(rows)


def _forces_check(training: Sequence[Training], stack: residuals.Stack, run: RunConfig) -> tuple[Check, ...]:
    """Return the row on whether line and sensor can be told apart; none without a vessel."""
    if stack.witness is None:
        return ()
    passed = _forces_logged(training, run)
    detail = "thrust is logged, so the balance of forces is complete" if passed else "the thrust is not logged"
    remedy = "" if passed else "no line is told from its sensor; map thrust_surge and thrust_sway in [channels]"
    return (Check("line or sensor", "thrust", passed, detail, remedy=remedy),)


def _where(channels: Channels, pieces: Sequence[slice]) -> dict[str, Any]:
    grid = channels.grid
    windows = [[grid.start + grid.sample_time * p.start, grid.start + grid.sample_time * p.stop] for p in pieces]
    time = next((c.detail for c in channels.checks if c.name == "time column"), None)  # None: nothing to guess
    return {"log": channels.source.path, "sha256": channels.source.sha256, "time": time, "windows": windows}


def save(baseline: Baseline, logs: Sequence[Path], command: str, folder: Path | None = None) -> dict[str, bytes]:
    """Return run.json and baseline.json; the logs' paths are written relative to ``folder``, where these will stand."""
    import os
    import platform

    run = {
        "mooringdx": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "command": command,
        "configuration_digest": baseline.config().digest(),
        "logs": [str(p) if folder is None else Path(os.path.relpath(p, folder)).as_posix() for p in logs],
        "sha256": [w["sha256"] for w in baseline.windows],
        "time": [w["time"] for w in baseline.windows],
        "run": baseline.run,
    }
    fitted = baseline.fitted
    body = encode({k: v for k, v in baseline.__dict__.items() if k != "fitted"})
    body["fitted"] = None
    if fitted is not None:
        parts = {k: v for k, v in fitted.__dict__.items() if k not in {"stack", "chain"}}
        body["fitted"] = {**encode(parts), "stack": fitted.stack.to_dict(), "chain": fitted.chain.to_dict()}
    return {"run.json": json_bytes(run), "baseline.json": json_bytes(body)}


def load(folder: Path) -> Baseline:
    """Read the baseline of a folder, or raise a ReportError that says what is wrong with it."""
    path = folder / "baseline.json"
    body, run = read_json(path), read_json(folder / "run.json")
    if body.get("version") != __version__:
        raise ReportError(
            f"{path}: written by mooringdx {body.get('version')}, this is {__version__}; run `mooringdx fit` again"
        )
    if run["configuration_digest"] != RunConfig.model_validate(body["run"]).digest():
        raise ReportError(f"{folder}: baseline.json and run.json are of different configurations; fit again")
    return Baseline(
        run=body["run"],
        fitted=None if body["fitted"] is None else _fitted(body["fitted"]),
        choice=tuple(body["choice"]),
        checks=decode(tuple[Check, ...], body["checks"]),
        windows=tuple(body["windows"]),
        verdict=body["verdict"],
        reason=body["reason"],
        banks=body["banks"],
    )


def _fitted(body: Mapping[str, Any]) -> Fitted:
    return Fitted(
        timing=decode(Timing, body["timing"]),
        stack=residuals.Stack.from_dict(body["stack"]),
        chain=Chain.from_dict(body["chain"]),
        raw=decode(Moments, body["raw"]),
        thresholds=decode(tuple[Threshold, ...], body["thresholds"]),
        level=np.array(body["level"], dtype=np.float64),
        agitation=np.array(body["agitation"], dtype=np.float64),
        testimony=decode(Testimony | None, body["testimony"]),
    )
