"""Four banks to compare the onset bank with: nine Kalman filters, one for each lost line and one for none.

    imm          states and probabilities pass between hypotheses at the rate of the priors     (temper 2)
    shared_bias  a known force: the bias of a filter of whole lines, its mean over 15 min, 2 min old   (temper 4)
    live_bias    each filter has a bias of its own                                    (temper 1, floor 1e-9)
    no_bias      no filter has one: the unexplained force is taken for zero           (temper 1, floor 1e-9)

All stand on one identification of the noise (`mooringdx.observers.identify`) and one kernel
(`mooringdx.hypotheses.peers.kernel`); Bayes' rule and floor as in `mooringdx.hypotheses.dht` [PositionThesis, section
4.6.2]. The last is what the thesis asks for as its next step. An alarm: log odds of all lines over ``alarm``, named a
minute later, over under ``warning``. `benchmarks/banks.py` has what each is worth.

What they cannot see: no rival explains a group of waves, a squall or a step of the current, so these are lost lines to
them. To `shared_bias` a loss is a lasting force: after a quarter of an hour it is known, and the alarm clears though
the line stays lost. `live_bias` sees a loss only before its biases have followed and by the stiffness that is gone,
`no_bias` takes a steady current of half a line's pull for a loss.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mooringdx.config import RunConfig
from mooringdx.hypotheses.onset_glr import NoFault, OnsetGlr
from mooringdx.hypotheses.peers.kernel import Lines, Rule, Stack, weigh
from mooringdx.hypotheses.peers.sight import inputs
from mooringdx.hypotheses.peers.verdict import crossed, events
from mooringdx.observers.kalman import Filter, held
from mooringdx.observers.matrices import Model, Noise
from mooringdx.observers.passive import single_losses
from mooringdx.results import decode, encode
from mooringdx.types import Array, Channels, Check, Event, Posterior, replace

TEMPER: Mapping[str, float] = {"imm": 2.0, "shared_bias": 4.0, "live_bias": 1.0, "no_bias": 1.0}
STILL = 1e-12
"""Share of the bias's intensity that is left where a filter is to have no bias."""


@dataclass(frozen=True)
class Peer:
    """A fitted bank. ``memory``, ``delay``: s at full scale, of the shared bias; ``base``: what was identified."""

    word: str
    base: OnsetGlr
    temper: float
    floor: float
    memory: float
    delay: float

    @property
    def hypotheses(self) -> tuple[str, ...]:
        """Every line's loss, and none."""
        return (*(f"line_lost {line}" for line in self.base.mooring.names), "no fault")

    @property
    def rule(self) -> Rule:
        """How the filters are weighed."""
        base, h = self.base, len(self.hypotheses)
        mixed = self.word == "imm"
        transition = np.zeros((0, 0))
        if mixed:
            chance = base.rates[0] / (h - 1) * base.step * base.time_scale
            transition = np.eye(h)
            transition[-1, :-1] = transition[:-1, -1] = chance
            transition -= np.diag(transition.sum(axis=1) - 1.0)
        return Rule(transition, mixed, 0.0 if mixed else self.floor, 1.0 / self.temper, base.beat.warm)

    def __call__(self, channels: Channels) -> tuple[Posterior, tuple[Event, ...], tuple[Check, ...]]:
        """Return the posterior on the log's clock, one event an alarm, and a check that says what this bank is."""
        base, grid = self.base, channels.grid
        eta, force = inputs(base, channels, self.word)
        p = self.weighed(eta, force)
        alarms = crossed(p, base.alarm, base.warning, base.beat.confirm)
        note = "; after a quarter of an hour it takes a loss for a steady force" if self.word == "shared_bias" else ""
        lag = (self.memory + self.delay) / base.time_scale if self.word == "shared_bias" else base.beat.end * base.step
        found = events(alarms, p, base.mooring.names, (grid.start, base.step), self.word, lag, base.alarm, note)
        row = np.minimum(np.arange(grid.n) // base.thin, len(p) - 1)
        return Posterior(self.word, self.hypotheses, grid.time, p[row]), found, (self._check(len(found)),)

    def weighed(self, eta: Array, force: Array) -> Array:
        """Return the probabilities, (n, lines + 1), of places, (n, 3), and known forces in body axes, (n, 3)."""
        base, h = self.base, len(self.hypotheses)
        own = self.word in ("imm", "live_bias")
        noise = base.noise if own else replace(base.noise, bias=_triple(STILL * np.asarray(base.noise.bias)))
        known = self._shared(eta, force) if self.word == "shared_bias" else np.zeros(eta.shape)
        start = np.full(h, self.rule.floor)
        start[-1] = 1.0 - start[:-1].sum()
        bias = base.bias if own else np.zeros(3)
        lines = self._lines()
        out: Array = weigh(
            np.ascontiguousarray(eta), np.ascontiguousarray(force), known, np.array(bias), start,
            self._stack(noise, eta[:, 2]), lines, self.rule,
        )[0]  # fmt: skip
        return out

    def _lines(self) -> Lines:
        m = self.base.mooring
        return Lines(m.fairleads, m.anchors, m.start, m.step, m.horizontal, single_losses(len(m.names)))

    def _stack(self, noise: Noise, headings: Array) -> Stack:
        mooring = self.base.mooring
        rigs = (*(mooring.without([name]) for name in mooring.names), mooring)
        models = [Filter(self.base.plant, noise, self.base.step, m, self.base.place).models(headings) for m in rigs]

        def each(key: str) -> Array:
            return np.stack([np.stack([getattr(one, key) for one in row]) for row in models])

        spread = each("S")
        return Stack(
            np.array([one.heading for one in models[0]]), each("F"), each("G"), each("K"),
            np.asarray(np.linalg.inv(spread), dtype=np.float64),
            np.asarray(np.linalg.slogdet(spread)[1], dtype=np.float64), each("stiffness"),
        )  # fmt: skip

    def _shared(self, eta: Array, force: Array) -> Array:
        """Return the bias of a filter of whole lines, (n, 3), earth axes, its running mean, delayed."""
        base = self.base
        whole = Filter(base.plant, base.noise, base.step, base.mooring, base.place)
        models: tuple[Model, ...] = whole.models(eta[:, 2])
        bias = held(whole(eta, force, bias=base.bias, models=models).bias)
        span, late = (max(1, round(x / (base.time_scale * base.step))) for x in (self.memory, self.delay))
        long = np.concatenate([np.tile(base.bias, (span + late, 1)), bias])
        total = np.concatenate([np.zeros((1, 3)), np.cumsum(long, axis=0)])
        last = span + np.arange(len(eta)) + 1
        return np.ascontiguousarray((total[last] - total[last - span]) / span)

    def _check(self, count: int) -> Check:
        detail = f"{count} alarms; no rival of this bank is a group of waves, a squall or a step of the current"
        remedy = 'it is there to compare with: decide by [bank] use = ["onset_glr"], which weighs these'
        return Check("a bank to compare with", self.word, False, detail, remedy=remedy)

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-safe mapping."""
        body: dict[str, Any] = encode(self)
        return body


@dataclass(frozen=True)
class Family:
    """What a run file's word stands for: fits and rebuilds the bank of that ``word``."""

    word: str

    def fit(self, training: Sequence[NoFault], run: RunConfig) -> Peer:
        """Identify the noise on the longest no-fault piece, as `OnsetGlr.fit` does, with its errors."""
        return self.upon(OnsetGlr.fit(training, run), training, run)

    def upon(self, base: OnsetGlr, training: Sequence[NoFault], run: RunConfig) -> Peer:
        """Return the bank on what the onset bank has identified on the same ``training``, of which it needs no more."""
        del training
        asked = run.bank.peers
        temper = TEMPER[self.word] if asked.temper == "auto" else asked.temper
        return Peer(self.word, base, temper, asked.floor, asked.memory, asked.delay)

    def from_dict(self, body: Mapping[str, Any]) -> Peer:
        """Rebuild what `Peer.to_dict` gave."""
        out: Peer = decode(Peer, body)
        return out


def _triple(values: Array) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
