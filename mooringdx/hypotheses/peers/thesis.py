"""The thesis's bank on a user's log: passive observers, weighed by Bayes' rule (DHT) or by likelihood (MLE).

    observers    `mooringdx.observers.passive`, one for each lost line and one for none  [PositionThesis, eq. 3.19]
    dht          p_i, a floor of 1e-9 a sample                                          [PositionThesis, eq. 3.27]
    mle          K_i with a memory of 100 s (text) or 10 s (listing), shown as e^-K_i / sum   [PositionThesis, eq. 4.10]
    alarm        a line is the likeliest for 20 s; before the first 100 s of a log it is not asked

``equations`` "printed" or "mended" and ``values`` "text" or "listing" as in `mooringdx.observers.passive`; the
covariances as in `mooringdx.hypotheses.peers.taught`. What a log and a vessel file give is taken from them and not from
the thesis: the waves' peak frequency is the identified one, inertia and damping are the vessel file's at low frequency
(as printed they are those of infinite and of wave frequency), and the bank steps with the log, the memory kept in s.

What it cannot see: as in `mooringdx.hypotheses.thesis_bank`; most of all an unexplained force from a lost line. So a
check tells where a live bias, as mended, exceeds 0.3 of a line's horizontal pull: from about a half on, as printed, the
bank believes in a loss that never was.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from mooringdx.config import RunConfig
from mooringdx.errors import FitError
from mooringdx.hypotheses.dht import FLOOR, dht
from mooringdx.hypotheses.mle import FORGETTING, mle
from mooringdx.hypotheses.onset_glr import NoFault, OnsetGlr
from mooringdx.hypotheses.peers.sight import inputs
from mooringdx.hypotheses.peers.taught import DURATION, SEED, SETTLE, no_fault, simulated
from mooringdx.hypotheses.peers.verdict import events, held
from mooringdx.observers.passive import BIAS_TIME, Passive, passive, single_losses, watch
from mooringdx.results import decode, encode
from mooringdx.types import Array, Channels, Check, Event, Posterior, locked, replace

HOLD, SETTLED, PRINTED_STEP = 20.0, 100.0, 0.1
"""s at full scale: that a line must win for; before which nothing is asked; between samples in the thesis."""
BANNER, LASTING = 0.3, 100.0
"""Share of a line's horizontal pull from which an unexplained force may pass for its loss; s over which it is averaged:
the memory of the text's MLE."""
_BLOCK = 36_000


@dataclass(frozen=True)
class Thesis:
    """A fitted bank. ``covariances``: (lines + 1, 3, 3), the last of none, by the way that ``covariance`` names.

    ``base``: what was identified on the no-fault window; its filter is not used.
    """

    word: str
    base: OnsetGlr
    equations: str
    values: str
    covariance: str
    covariances: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "covariances", locked(self.covariances))

    @property
    def hypotheses(self) -> tuple[str, ...]:
        """Every line's loss, and none."""
        return (*(f"line_lost {line}" for line in self.base.mooring.names), "no fault")

    @property
    def step(self) -> float:
        """Time between samples of the log, s."""
        return self.base.step / self.base.thin

    def observer(self, equations: str | None = None) -> Passive:
        """Return the observer's numbers, by ``equations`` or those of the bank."""
        base = self.base
        made = passive(base.plant, base.noise.frequency, self.values, equations or self.equations)
        return replace(made, decay=base.time_scale / BIAS_TIME, K3=made.K3 * base.time_scale)

    def inputs(self, channels: Channels, piece: slice = slice(None)) -> tuple[Array, Array]:
        """Return places and known forces, (n, 3) each, at every sample of the log."""
        return inputs(replace(self.base, thin=1, step=self.step), channels, self.word, piece)

    def __call__(self, channels: Channels) -> tuple[Posterior, tuple[Event, ...], tuple[Check, ...]]:
        """Return the posterior, one event a time that a line is held for 20 s, and checks."""
        base, grid = self.base, channels.grid
        eta, force = self.inputs(channels)
        p = self.weighed(eta, force)
        choice = np.argmax(p, axis=1)
        choice[: round(SETTLED / (base.time_scale * self.step))] = len(base.mooring.names)
        alarms = held(choice, round(HOLD / (base.time_scale * self.step)), len(base.mooring.names))
        clock = (grid.start, self.step)
        found = events(alarms, p, base.mooring.names, clock, self.word, self.memory, None)
        rows = (self._taught(), self._banner(eta, force, grid.start), self._method(len(found)))
        return Posterior(self.word, self.hypotheses, grid.time, p), found, rows

    @property
    def memory(self) -> float:
        """s, of the likelihoods that MLE adds up; for DHT that of the text, which it has no word for."""
        return PRINTED_STEP / (1.0 - FORGETTING[self.values]) / self.base.time_scale

    def weighed(self, eta: Array, force: Array) -> Array:
        """Return the probabilities, (n, lines + 1); for MLE e^-K over its sum, which the thesis does not form."""
        h = len(self.hypotheses)
        out, last = np.empty((len(eta), h)), np.full(h, 1.0 / h) if self.word == "thesis_dht" else np.zeros(h)
        keep = FORGETTING[self.values] ** (self.step * self.base.time_scale / PRINTED_STEP)
        shares = single_losses(h - 1)
        for block, innovation in self._innovations(self.observer(), shares, eta, force):
            if self.word == "thesis_dht":
                out[block] = dht(innovation, self.covariances, FLOOR[self.values], last)
                last = out[block][-1]
                continue
            # The recursive form ran behind the printed figures, whatever eq. 4.10 says.
            cost = mle(innovation, self.covariances, keep, start=last)
            last = cost[-1]
            worth = np.exp(cost.min(axis=1, keepdims=True) - cost)
            out[block] = worth / worth.sum(axis=1, keepdims=True)
        return out

    def _innovations(
        self, observer: Passive, shares: Array, eta: Array, force: Array, bias: bool = False
    ) -> Iterator[tuple[slice, Array]]:
        """Yield the innovations (or the biases), (m, h, 3), in blocks, so that a long log costs no more memory."""
        seen = np.flatnonzero(np.isfinite(eta).all(axis=1))
        state = np.zeros((len(shares), 15))
        state[:, 6:9] = eta[seen[0]] if seen.size else 0.0
        for first in range(0, len(eta), _BLOCK):
            block = slice(first, min(first + _BLOCK, len(eta)))
            one = watch(observer, self.base.mooring, shares, eta[block], force[block], self.step, state)
            state = one.final
            yield block, one.bias if bias else one.innovation

    def _taught(self) -> Check:
        how = {
            "simulated": f"{DURATION:.0f} s of simulation a hypothesis in the observers' own plant, driven by the "
            f"identified noise, seed {SEED}",
            "no_fault": "the no-fault window, its second moments about zero taken for every hypothesis",
        }
        detail = f"error covariance: from {how[self.covariance]}; equations {self.equations}, values {self.values}"
        return Check("error covariance", self.word, True, detail)

    def _banner(self, eta: Array, force: Array, start: float) -> Check:
        """Return whether an unexplained force comes near to a line's pull, by an observer whose bias is alive."""
        base = self.base
        whole = single_losses(len(base.mooring.names))[-1:]
        pull = float(np.mean(base.mooring.pulls(np.asarray(base.place))[0]))
        alive = self._innovations(self.observer("mended"), whole, eta, force, bias=True)
        bias = np.concatenate([b[:, 0, :2] for _, b in alive])
        skip, m = (round(x / (base.time_scale * self.step)) for x in (SETTLE, LASTING))
        if len(bias) <= skip:
            return Check("unexplained force", self.word, True, "the log is too short to tell")
        total = np.cumsum(bias, axis=0)[skip - m :]
        size = np.hypot(*((total[m:] - total[:-m]) / m).T)
        over = np.flatnonzero(size > BANNER * pull)
        when = f", first at {start + self.step * (skip + over[0]):.0f} s" if over.size else ""
        worst = float(size.max() / pull)
        return Check(
            "unexplained force", self.word, not over.size,
            f"up to {worst:.2f} of a line's pull over {LASTING / base.time_scale:.0f} s, more than {BANNER:g} "
            f"for {over.size / size.size:.0%} of the log{when}",
            worst, BANNER, "1",
            "a force this large is a lost line to this bank, whatever it is; decide by onset_glr" if over.size else "",
        )  # fmt: skip

    def _method(self, count: int) -> Check:
        detail = f"{count} alarms of a published method, here to be reproduced: it alarms often on long logs"
        return Check("a bank to compare with", self.word, False, detail, remedy='decide by [bank] use = ["onset_glr"]')

    def summary(self) -> tuple[str, ...]:
        """Return what the fit found, in lines: where the error covariance of each hypothesis is from."""
        return (self._taught().detail,)

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-safe mapping."""
        body: dict[str, Any] = encode(self)
        return body


@dataclass(frozen=True)
class ThesisFamily:
    """What a run file's word stands for: "thesis_dht" or "thesis_mle"."""

    word: Literal["thesis_dht", "thesis_mle"]

    def fit(self, training: Sequence[NoFault], run: RunConfig) -> Thesis:
        """Identify the noise as `OnsetGlr.fit` does, with its errors, and learn the error covariances."""
        return self.upon(OnsetGlr.fit(training, run), training, run)

    def upon(self, base: OnsetGlr, training: Sequence[NoFault], run: RunConfig) -> Thesis:
        """Return the bank on what the onset bank has identified on the same ``training``.

        Raise FitError where the observer runs away on the log's clock, whose samples are then too far apart.
        """
        asked = run.bank.thesis
        h = len(base.mooring.names) + 1
        draft = Thesis(self.word, base, asked.equations, asked.values, asked.covariance, np.zeros((h, 3, 3)))
        with np.errstate(all="ignore"):
            found = _simulated(draft) if asked.covariance == "simulated" else _no_fault(draft, training)
        if not (np.isfinite(found).all() and (np.abs(found) < 1e12).all()):
            raise FitError(
                f"[bank] {self.word}: the passive observers run away at {draft.step:g} s a sample in waves of "
                f"{base.noise.frequency:.2g} rad/s; give a smaller [clock] sample_time"
            )
        return replace(draft, covariances=locked(found))

    def from_dict(self, body: Mapping[str, Any]) -> Thesis:
        """Rebuild what `Thesis.to_dict` gave."""
        out: Thesis = decode(Thesis, body)
        return out


def _simulated(draft: Thesis) -> Array:
    base = draft.base
    place = np.asarray(base.place)
    rest = (base.plant, base.noise, place, draft.step, base.time_scale, draft.equations)
    return simulated(draft.observer(), base.mooring, *rest)


def _no_fault(draft: Thesis, training: Sequence[NoFault]) -> Array:
    longest, piece = max(((t, p) for t in training for p in t.pieces), key=lambda x: x[1].stop - x[1].start)
    eta, force = draft.inputs(longest.channels, piece)
    skip = round(SETTLE / (draft.base.time_scale * draft.step))
    one = no_fault(draft.observer(), draft.base.mooring, eta, force, draft.step, skip)
    return np.tile(one, (len(draft.hypotheses), 1, 1))
