"""A lost line from position alone: a step of force of unknown onset, against squalls and wave groups.

One filter (`mooringdx.observers.kalman`) that knows of no fault leaves innovations; a lost line j is a step of the
force by -alpha H_j u_j in it, from an onset k0 that nobody knows [PositionThesis; Basseville1993, ch. 7]:

    score = ln [sum_j,k0 w_j e^{L_j(k0)} / (1 + sum_k0 w_e e^{L_e(k0)} + sum_k0,D w_p e^{L_p(k0,D)})]

with w = rate x spacing, L_j for a line whose pull H_j u_j is known and is lost nearly whole and nearly along itself,
L_e for a step of the environment in any direction, L_p for a wave group of duration D: in
`mooringdx.hypotheses.onset.kernel`. All are divided by a temper by age (`mooringdx.hypotheses.onset.temper`), because
innovations are not as white as the filter assumes, times how much rougher the sea is than the one learned from. A gap
of a minute ends a walk: over it only the steady force is compared. Departures from the thesis: one filter with a bias
instead of a bank without, so that steady forces and currents are no fault; a wave group as a rival, without which slow
drift alarms hundreds of times a month.

What it cannot see: a squall or a current step along a line, as large as its pull, from the loss of that line; a line
lost before the record or in its first ten minutes; a line that keeps a good part of its pull and two lines lost at
once, unless [bank] partial and pairs ask for them, and then late; a sensor of position that jumps or drifts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from mooringdx.config import BankPart, RunConfig
from mooringdx.errors import ConfigError
from mooringdx.hypotheses.onset.bank import (
    GROUP,
    STEP_SHARE,
    Beat,
    beat,
    information,
    mean_drift,
    odds_of,
)
from mooringdx.hypotheses.onset.kernel import Odds
from mooringdx.hypotheses.onset.losses import Loss, losses, weights
from mooringdx.hypotheses.onset.temper import tempers
from mooringdx.hypotheses.onset.verdict import checks, events
from mooringdx.hypotheses.onset.walks import gaps, pieces, since_fit, stretches
from mooringdx.hypotheses.onset.witness import Witness
from mooringdx.observers.feedforward import (
    HARM,
    MEMORY,
    SLOW_MEAN,
    Feed,
    Ground,
    learned,
    removed,
    squared,
    told,
)
from mooringdx.observers.forces import PLACE, THRUST, WIND, place_and_force
from mooringdx.observers.identify import Identified, Record, identify
from mooringdx.observers.kalman import Filter, correlation
from mooringdx.observers.matrices import Noise, Plant, plant_of
from mooringdx.physics.frames import rotation
from mooringdx.physics.mooring import Mooring
from mooringdx.physics.vessel import vessel
from mooringdx.results import decode, encode
from mooringdx.types import Array, Channels, Check, Event, Posterior, locked, replace

BANK = "onset_glr"
_SLOWEST = 0.3
"""rad/s at full scale: no waves are slower than 21 s."""
_WEEK, _MONTH = 1.0 / 604800.0, 1.0 / 2592000.0


class NoFault(Protocol):
    """One log's channels and its no-fault pieces."""

    @property
    def channels(self) -> Channels:
        """The aligned channels."""

    @property
    def pieces(self) -> tuple[slice, ...]:
        """The no-fault pieces, half-open sample slices."""


@dataclass(frozen=True)
class OnsetGlr:
    """The bank, fitted.

    ``place``: (3,), m, m, rad, of the no-fault window; ``origin``: (2,), m; ``wind``: force coefficients (3,);
    ``known``: channels whose force is known; ``bias``: (3,), N, N, N m, the filter's start. ``thin``: samples of the
    log's clock in one of the bank's, ``step``: s of the latter. ``rates``: 1/s at full scale, of all lines, an
    environmental step, a wave group. ``temper``: (ages,), what evidence is divided by, one number each fine spacing
    of an onset's age; ``drift``: (2,), N, the mean slow drift in surge and what stands for it in sway. Of the filter on
    the no-fault window: ``nis``, 3 when consistent, ``acf``, the largest autocorrelation of its innovations,
    ``spread``, the mean z'Lam^-1 z/2. ``feeds``: forces learned from waves or motions; ``gusts``: R^2 of the wind's
    force. ``pairs``, ``partial``: as in the run file.
    """

    mooring: Mooring
    plant: Plant
    noise: Noise
    place: tuple[float, float, float]
    origin: tuple[float, float]
    wind: tuple[float, float, float]
    known: tuple[str, ...]
    bias: Array
    thin: int
    step: float
    time_scale: float
    rates: tuple[float, float, float]
    temper: Array
    warning: float
    alarm: float
    drift: tuple[float, float]
    nis: float
    acf: float
    spread: float
    feeds: tuple[Feed, ...] = ()
    gusts: tuple[float, float, float] | None = None
    pairs: float = 0.0
    partial: tuple[float, ...] = ()

    @classmethod
    def fit(cls, training: Sequence[NoFault], run: RunConfig) -> OnsetGlr:
        """Identify the noise on the longest no-fault piece, and how far its innovations are from white.

        Raises ConfigError without a vessel file, positions or heading, FitError where the window is too short.
        """
        from mooringdx.physics.rig import mooring_of

        if not run.mooring.model:
            raise ConfigError(f'[bank] {BANK} needs a vessel file; name one under [mooring] vessel, such as "fpso200"')
        ship = vessel(run.mooring.model)
        used = _known(training[0].channels)
        longest, piece = max(((t, p) for t in training for p in t.pieces), key=lambda x: x[1].stop - x[1].start)
        grid = longest.channels.grid
        thin = max(1, round(1.0 / (ship.time_scale * grid.sample_time)))
        draft = cls(
            mooring=mooring_of(ship),
            plant=plant_of(ship.dynamics),
            noise=Noise((1.0,) * 3, (1.0,) * 3, (1.0,) * 3, (1.0,) * 3, 1.0, 0.1),
            place=(0.0, 0.0, 0.0),
            origin=(float(run.mooring.origin[0]), float(run.mooring.origin[1])),
            wind=(ship.wind.surge, ship.wind.sway, ship.wind.yaw),
            known=used,
            bias=np.zeros(3),
            thin=thin,
            step=thin * grid.sample_time,
            time_scale=ship.time_scale,
            rates=_rates(run.bank, used),
            temper=_flat(run.bank),
            warning=run.bank.warning,
            alarm=run.bank.alarm,
            drift=(0.0, 0.0),
            nis=np.nan,
            acf=np.nan,
            spread=np.nan,
            pairs=run.bank.pairs,
            partial=tuple(run.bank.partial),
        )
        piece = draft._whole(longest.channels, piece)
        eta, force = draft.inputs(longest.channels, piece)
        plain = draft._identified(eta, force)
        return plain if run.bank.feed_forward == "off" else plain._fed(longest.channels, piece, run.bank)

    def _whole(self, channels: Channels, piece: slice) -> slice:
        """Return the longest stretch of a piece without a gap of ten seconds, or, where that is short, of a minute."""
        eta, _ = self.inputs(channels, piece)
        best = slice(0, len(eta))
        for longest in (2 * self.beat.fine, self.beat.confirm):
            best = max(stretches(eta, longest), key=lambda part: part.stop - part.start, default=best)
            if 2 * (best.stop - best.start) >= len(eta):
                break
        return slice(piece.start + self.thin * best.start, piece.start + self.thin * best.stop)

    def _fed(self, channels: Channels, piece: slice, bank: BankPart) -> OnsetGlr:
        """Weigh the forces of wind, waves and motions on the no-fault piece, and learn anew what is left with them."""
        new = self
        eta, force = self.inputs(channels, piece)
        skip = min(self.beat.warm, len(eta) // 4)
        if set(WIND) <= set(self.known):
            calm = replace(self, known=tuple(c for c in self.known if c not in WIND))
            bare = calm.inputs(channels, piece)[1]
            gusts = removed(Ground(self.filtering(self.mooring), eta, bare, self.bias, skip), force - bare)
            new = replace(self, gusts=gusts)
            if min(gusts[:2]) < HARM:
                calm = replace(calm, gusts=gusts, rates=_rates(bank, calm.known), temper=_flat(bank))
                new, force = calm._identified(eta, bare), bare
        feeds = learned(
            Ground(new.filtering(new.mooring), eta, force, new.bias, skip),
            channels.names,
            lambda names: new._squares(channels, piece, names),
            1.0 / (self.time_scale * self.step),
            bank.feed_forward == "always",
        )
        new = replace(new, feeds=feeds)
        used = [name for feed in new.feeds if any(feed.on) for name in feed.channels]
        if not used:
            return new
        fed = replace(new, known=(*new.known, *used), temper=_flat(bank))
        return fed._identified(*fed.inputs(channels, piece))

    def _squares(self, channels: Channels, piece: slice, names: Sequence[str]) -> Array:
        columns = [channels.names.index(c) for c in names]
        values = np.where(channels.valid[piece][:, columns], channels.values[piece][:, columns], np.nan)
        return squared(values, self.step / self.thin, SLOW_MEAN / self.time_scale, self.thin)

    def _identified(self, eta: Array, force: Array) -> OnsetGlr:
        good = eta[np.isfinite(eta).all(axis=1)]
        middle = np.median(good, axis=0) if len(good) else np.zeros(3)
        place = (float(middle[0]), float(middle[1]), float(middle[2]))
        found = self._noise(Record(eta, force, np.zeros(eta.shape), self.step), middle)
        new = replace(
            self, noise=found.noise, place=place, bias=locked(found.bias), drift=mean_drift(found.noise), nis=found.nis
        )
        filtering = new.filtering(new.mooring)
        models = filtering.models(eta[:, 2])
        estimate = filtering(eta, force, bias=new.bias, models=models)
        temper, seen = tempers(estimate, models, new.mooring, new.odds, new.beat, float(self.temper[0]))
        return replace(new, spread=seen, temper=locked(temper), acf=correlation(estimate.innovation, new._lags()))

    def _noise(self, record: Record, middle: Array) -> Identified:
        """Return the noise of a record; where what was taken for waves is too slow for any, sought above that.

        A large vessel in a small sea moves less with the waves than its fixes scatter, and slow motion is then the
        largest there is.
        """
        stiffness = self.mooring.stiffness(middle)
        found = identify(record, self.plant, self.mooring, stiffness, middle)
        slowest = _SLOWEST * self.time_scale
        if found.noise.frequency >= slowest:
            return found
        least = np.diag(np.diag(self.plant.inertia)) * (slowest / 3.0) ** 2
        return identify(record, self.plant, self.mooring, np.maximum(stiffness, least), middle)

    @property
    def beat(self) -> Beat:
        """The bank's times, in its samples."""
        return beat(self.step, self.time_scale)

    @property
    def odds(self) -> Odds:
        """The numbers of the hypotheses."""
        pull = float(np.mean(self.mooring.pulls(np.asarray(self.place))[0]))
        step, group = (STEP_SHARE * pull) ** 2 * np.eye(2), np.diag((GROUP * np.asarray(self.drift)) ** 2)
        each = weights(self.losses, self.pairs)
        return odds_of(self.beat, self.time_scale, each, self.rates, self.temper, step, group)

    @property
    def losses(self) -> tuple[Loss, ...]:
        """What may be gone."""
        return losses(self.mooring.names, self.pairs, self.partial)

    def filtering(self, mooring: Mooring) -> Filter:
        """Return the filter that knows of no fault, with the lines of ``mooring``."""
        return Filter(self.plant, self.noise, self.step, mooring, self.place)

    def inputs(self, channels: Channels, piece: slice = slice(None)) -> tuple[Array, Array]:
        """Return eta from the neutral place and the known force in body axes, (m, 3) each, every ``thin``-th sample.

        Forces are averaged over what is left out, because the filter holds them from sample to sample.
        """
        eta, force = place_and_force(channels, self.origin, self.known, self.wind, piece)
        n = len(eta) // self.thin
        thinned = force[: n * self.thin].reshape(n, self.thin, 3).mean(axis=1)
        for feed in self.feeds:
            if any(feed.on):
                squares = self._squares(channels, piece, feed.channels)
                thinned = thinned + feed.force(squares, self.step, MEMORY / self.time_scale)
        return eta[: n * self.thin : self.thin], thinned

    def __call__(self, channels: Channels) -> tuple[Posterior, tuple[Event, ...], tuple[Check, ...]]:
        """Return the posterior on the log's clock, one event a lost line, and checks.

        After a line is named the filter starts anew at its onset, without that line, and the bank after a warm-up.
        """
        posterior, found, rows, _ = self.walked(channels)
        return posterior, found, rows

    def walked(self, channels: Channels) -> tuple[Posterior, tuple[Event, ...], tuple[Check, ...], Witness]:
        """Return what a call returns, and a witness whom other evidence may ask about a line and an onset."""
        _known(channels)
        if missing := [name for name in self.known if name not in channels.names]:
            raise ConfigError(
                f"[bank] {BANK}: the log has no '{missing[0]}', which the no-fault log had; map it, or fit anew"
            )
        eta, force = self.inputs(channels)
        walked, sights = pieces(self, eta, force)
        n = len(eta)
        weighed = self.losses
        score, probability = np.full(n, np.nan), np.zeros((n, len(weighed) + 3))
        for one in walked:
            rows = slice(one.first + one.skip, one.first + len(one.trace.score))
            score[rows], probability[rows] = one.trace.score[one.skip :], one.after()
        grid = channels.grid
        row = np.minimum(np.arange(grid.n) // self.thin, n - 1)
        judged = np.isfinite(score[row])
        names = ("no fault", *(loss.name for loss in weighed), "environment", "wave group")
        posterior = Posterior(BANK, names, grid.time[judged], probability[row][judged])
        clock = (grid.start, self.step)
        found = events(walked, weighed, self.odds, self.beat, clock, self.warning, self.alarm)
        named = [round((e.onset - clock[0]) / clock[1]) for e in found]
        unseen, compared = gaps(self, eta, force, clock, named)
        found = (*found, *unseen)
        told_of = checks(walked, score, self.observability(), self.warning, clock)
        squares = [
            self._squares(channels, slice(None), f.channels) if any(f.on) else np.zeros((0, 0)) for f in self.feeds
        ]
        told_of = (*told_of, *since_fit(self, walked, sights), *compared, *told(self.feeds, self.gusts, squares))
        return posterior, found, told_of, Witness(sights, self.odds, self.beat, clock)

    def observability(self) -> dict[str, dict[str, Any]]:
        """Return, a line, the information rate ``r``, nats/s at full scale, if its loss is ``observable``, and why.

        r = H^2 / (2 S_F along the line), S_F the white force that was identified: the sea of the no-fault window.
        """
        horizontal, _, direction = self.mooring.pulls(np.asarray(self.place))
        one = self.filtering(self.mooring).model(self.place[2])
        lam = information(one, self.mooring.fairleads.mean(axis=0), self.beat.end)[:2, :2] / self.temper[-1]
        turn = rotation(self.place[2])[:2, :2]
        white = turn @ np.diag(self.noise.force[:2]) @ turn.T
        spacing = 4.0 * self.beat.fine * self.step * self.time_scale
        needed = float(np.log(len(horizontal) / (self.rates[0] * spacing))) + self.alarm
        out = {}
        for name, pull, u in zip(self.mooring.names, horizontal, direction, strict=True):
            rate = float(pull**2 / (2.0 * u @ white @ u)) / self.time_scale
            score = float(0.5 * pull**2 * u @ lam @ u)
            seen = rate >= 0.1 and score >= needed
            why = f"{rate:.2g} nats/s, evidence after 15 min {score:.3g} of the {needed:.3g} that an alarm needs"
            out[name] = {
                "r": rate,
                "observable": seen,
                "margin": min(rate / 0.1, score / needed),
                "sentence": f"{name}: {why}" + ("" if seen else "; not observable in this sea"),
            }
        return out

    def _lags(self) -> int:
        """Return how many lags of a second at full scale, up to a minute, the innovations are held to be white over."""
        return max(1, round(60.0 / (self.time_scale * self.step)))

    def summary(self) -> tuple[str, ...]:
        """Return what the fit found, in lines: consistency, whiteness, temper, the weakest line, feed-forward."""
        rows = self.observability()
        weakest = min(rows.values(), key=lambda row: row["r"])
        minute = self.temper[min(12, len(self.temper) - 1)]
        out = [
            f"innovations: mean normalised square {self.nis:.2f} (3 when consistent), largest autocorrelation over "
            f"1 to 60 s {self.acf:.3f} (0 when white)",
            f"evidence divided by {self.temper[1]:.2f} at 5 s, {minute:.2f} at 60 s, {self.temper[-1]:.2f} at 15 min "
            "of full scale",
            f"weakest line: {weakest['sentence']}",
        ]
        return (*out, *(f"feed-forward: {feed.sentence}" for feed in self.feeds))

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-safe mapping; it holds the lines' tables, so that no statics are solved again."""
        body: dict[str, Any] = encode(self)
        return body

    @classmethod
    def from_dict(cls, body: Mapping[str, Any]) -> OnsetGlr:
        """Rebuild what `to_dict` gave."""
        out: OnsetGlr = decode(cls, body)
        return out


def _flat(bank: BankPart) -> Array:
    return np.full(2, float(bank.temper))


def _known(channels: Channels) -> tuple[str, ...]:
    for name in PLACE:
        if name not in channels.names:
            raise ConfigError(f"[bank] {BANK}: the log has no '{name}'; map north, east and heading in [channels]")
    return tuple(c for c in (*THRUST, *WIND) if c in channels.names)


def _rates(bank: BankPart, known: Sequence[str]) -> tuple[float, float, float]:
    auto = _MONTH if "wind_speed" in known else _WEEK
    step = auto if bank.environment_rate is None else bank.environment_rate
    return bank.line_rate, step, bank.pulse_rate
