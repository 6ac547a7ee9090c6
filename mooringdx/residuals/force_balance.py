"""Force balance: the force that nothing known explains, by measured tensions and by the mooring's model.

    b_A:  M nu' = -D nu + R'(b_A + sum_j (H_j/T_j)(x) T_m,j u_j) + tau      measured tensions, share H/T by the model
    b_B:  M nu' = -D nu + R'(b_B + sum_j H_j(x) u_j) + tau                   the intact mooring's model
    common c = (b_A + b_B)/2,      difference d = b_B - b_A = sum_j (H_j/T_j) (T_m,j - T_j) u_j + what is transient

Each b is the bias state of a Kalman filter (`mooringdx.observers.kalman`), so positions need not be differentiated
twice. tau: logged thrust and wind force. With v the change of T_m,j - T_j, N, and u_j towards the anchor, with the
fairlead's lever arm as its third row:

    line j lost:        b_A 0,                b_B (H/T) u v,   c +(H/T) u v / 2          (v < 0)
    buoyancy lost:      b_A (h - H/T) u v,    b_B h u v,       c (2 h - H/T) u v / 2   (v > 0; h = dH/dT of the damage)
    sensor j wrong:     b_A -(H/T) u v,       b_B 0,           c -(H/T) u v / 2
    environment f:      both f,                                c f, d 0

so d holds what the tension residuals hold and says *which* line, c says *line or sensor*. Source: [Fang2015, eq. 4-5],
mended: the current is no position and the acceleration no earth-axes one; in place of r12, which needs double
differencing, the pair of filters. What it cannot see: a line from a force of the environment along it with no tension
sensor on it; anything quicker than the filter's memory; a lost thruster, which looks like the environment.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from mooringdx.config import RunConfig
from mooringdx.errors import ConfigError
from mooringdx.observers.forces import (
    PLACE,
    THRUST,
    WIND,
    Sight,
    measured_force,
    place_and_force,
    quickened,
    sights,
)
from mooringdx.observers.identify import Record, identify
from mooringdx.observers.kalman import Filter, held
from mooringdx.observers.matrices import Noise, Plant, plant_of
from mooringdx.physics.mooring import Mooring
from mooringdx.physics.vessel import VesselModel, vessel
from mooringdx.residuals.training import COMPASS, SIGNATURE_ERROR, Training, known, line_tensions, pooled
from mooringdx.types import Array, Channels, Fault, Mask, Residuals, Signatures, locked, replace

_UNITS = ("N", "N", "N m")
_AXES = ("force north", "force east", "moment yaw")
_BETWEEN = 0.4
"""Half the way from one compass direction to the next, as a share of the force: sin 22.5 deg."""
_ARM = 0.2
"""Lever arm of the environment's force, as a share of the vessel's length: a choice."""
_SETTLE = 4.0
"""Time constants of the filter until its start is forgotten."""


@dataclass(frozen=True)
class ForceBalance:
    """Two filters and what they show of each fault.

    ``origin``: (2,), m. ``wind``: force coefficients (3,). ``bias``: (3,), the start. ``mean``: of the residuals on
    the no-fault windows. ``settle``: s, the start that is masked. ``nis``: of the filters on the no-fault window.
    """

    sights: tuple[Sight, ...]
    mooring: Mooring
    plant: Plant
    noise: Noise
    place: tuple[float, float, float]
    origin: tuple[float, float]
    wind: tuple[float, float, float]
    known: tuple[str, ...]
    bias: Array
    mean: Array
    stiffness: Array
    settle: float
    length: float
    difference: bool
    nis: float

    @classmethod
    def fit(cls, training: Sequence[Training], run: RunConfig) -> ForceBalance:
        """Identify the noise on the longest no-fault piece, and take the residuals' means over all.

        Raises ConfigError without a vessel file, positions or heading, FitError where the window is too short.
        """
        from mooringdx.physics.rig import mooring_of

        first = training[0].channels
        if not run.mooring.model:
            raise ConfigError(
                '[residuals] force_balance needs a vessel file; name one under [mooring] vessel, such as "cybership3"'
            )
        known(PLACE, first, "[residuals.force_balance]")
        ship = vessel(run.mooring.model)
        tensions = _tensions(run, ship, first)
        origin = (float(run.mooring.origin[0]), float(run.mooring.origin[1]))
        place = _no_fault_place(training, origin)
        mooring = mooring_of(ship)
        used = tuple(c for c in (*THRUST, *WIND) if c in first.names)
        draft = cls(
            sights=sights(ship, mooring, place, tensions),
            mooring=mooring,
            plant=plant_of(ship.dynamics),
            noise=Noise((1.0,) * 3, (1.0,) * 3, (1.0,) * 3, (1.0,) * 3, 1.0, 0.1),
            place=(float(place[0]), float(place[1]), float(place[2])),
            origin=origin,
            wind=(ship.wind.surge, ship.wind.sway, ship.wind.yaw),
            known=used,
            bias=np.zeros(3),
            mean=np.zeros(3),
            stiffness=mooring.stiffness(place),
            settle=0.0,
            length=ship.hull.length,
            difference=bool(tensions) and "tension" not in run.residuals.use,
            nis=np.nan,
        )
        return draft._identified(training, run)

    def _identified(self, training: Sequence[Training], run: RunConfig) -> ForceBalance:
        longest, piece = max(((t, p) for t in training for p in t.pieces), key=lambda x: x[1].stop - x[1].start)
        eta, force, _ = self._inputs(longest.channels)
        step = longest.channels.grid.sample_time
        record = Record(eta[piece], force[piece], np.zeros((piece.stop - piece.start, 3)), step)
        found = identify(record, self.plant, self.mooring, self.stiffness, np.asarray(self.place))
        noise = quickened(found.noise, _memory(run, found.noise.frequency), self.plant)
        memory = max(f.model(self.place[2]).memory for f in replace(self, noise=noise)._filters(step))
        fitted = replace(
            self, noise=noise, bias=locked(found.bias), settle=_SETTLE * memory, nis=found.nis,
            mean=np.zeros(3 if not self.difference else 6),
        )  # fmt: skip
        rows = []
        for one in training:
            out = fitted(one.channels)
            rows += [out.values[p][out.valid[p].all(axis=1)] for p in one.pieces]
        levels = np.vstack(rows)
        return replace(fitted, mean=locked(levels.mean(axis=0))) if len(levels) else fitted

    @property
    def measured(self) -> bool:
        """Whether any line's tension is logged."""
        return any(sight.tension for sight in self.sights)

    @property
    def names(self) -> tuple[str, ...]:
        """The residuals' names."""
        common = tuple(f"common {axis}" if self.measured else f"unexplained {axis}" for axis in _AXES)
        return common + (tuple(f"difference {axis}" for axis in _AXES) if self.difference else ())

    def __call__(self, channels: Channels) -> Residuals:
        """Return the common force and, where no tension residual is used, the difference, less their no-fault mean."""
        by_tension, by_model, valid = self.biases(channels)
        common = by_model if by_tension is None else 0.5 * (by_tension + by_model)
        values = common if not self.difference or by_tension is None else np.hstack([common, by_model - by_tension])
        values = np.where(valid[:, None], values - self.mean, np.nan)
        good = np.repeat(valid[:, None], values.shape[1], axis=1)
        units = _UNITS * (values.shape[1] // 3)
        return Residuals(self.names, units, channels.grid, values, good, self.signatures())

    def biases(self, channels: Channels) -> tuple[Array | None, Array, Mask]:
        """Return b_A (None without logged tensions) and b_B, (n, 3), N, N, N m, earth axes; where they hold, (n,)."""
        eta, force, good = self._inputs(channels)
        step = channels.grid.sample_time
        given, balanced = self._filters(step)
        by_model = balanced(eta, force, bias=self.bias).bias
        valid = _settled(good & np.isfinite(by_model[:, 0]), int(np.ceil(self.settle / step)))
        if not self.measured:
            return None, by_model, valid
        pulls = np.full((len(eta), len(self.sights)), np.nan)
        for i, sight in enumerate(self.sights):
            if sight.tension:
                pulls[:, i] = channels.column(sight.tension)
        rig = self.mooring
        lines = measured_force(
            held(eta), pulls, rig.fairleads, rig.anchors, rig.start, rig.step, rig.horizontal, rig.tension
        )
        return given(eta, force, lines, bias=self.bias).bias, by_model, valid

    def _filters(self, step: float) -> tuple[Filter, Filter]:
        """Return filter A, whose line forces are given, and B, which has the mooring's model."""
        plain = Filter(self.plant, self.noise, step, None, self.place)
        return plain, replace(plain, mooring=self.mooring)

    def _inputs(self, channels: Channels) -> tuple[Array, Array, Mask]:
        """Return eta (n, 3) from the neutral place, known force in body axes (n, 3), and where all channels hold."""
        eta, force = place_and_force(channels, self.origin, self.known, self.wind)
        names = (*PLACE, *self.known, *(s.tension for s in self.sights if s.tension))
        columns = [channels.names.index(c) for c in names]
        good: Mask = np.asarray(channels.valid[:, columns].all(axis=1), dtype=np.bool_)
        return eta, force, good

    def signatures(self) -> Signatures:
        """Return what each line, tension sensor, position sensor and the environment do to the residuals."""
        rows = [*self._line_rows(), *self._sensor_rows(), *self._environment_rows()]
        width = len(self.names)
        matrix = np.array([row[1][:width] for row in rows])
        error = np.array([row[2][:width] for row in rows])
        faults, units = tuple(row[0] for row in rows), tuple(row[3] for row in rows)
        total, sign = np.array([row[4] for row in rows]), np.array([row[5] for row in rows])
        return Signatures(faults, self.names, matrix, units, total, sign, error)

    def _line_rows(self) -> list[_Row]:
        out = []
        for s in self.sights:
            pull, share = np.asarray(s.pull), s.share if s.tension else 0.0
            for fault, slope, total in (
                (Fault("line_lost", s.line), s.share, s.lost),
                (Fault("line_weakened", s.line, "buoyancy"), s.slope, s.weakened),
            ):
                if not np.isfinite(total):
                    continue
                row = np.concatenate([(slope - 0.5 * share) * pull, share * pull])
                out.append((fault, row, self._error(row), "N", total, float(np.sign(total))))
        return out

    def _sensor_rows(self) -> list[_Row]:
        out = []
        for s in self.sights:
            if s.tension:
                row = s.share * np.concatenate([-0.5 * np.asarray(s.pull), np.asarray(s.pull)])
                out.append((Fault("sensor_fault", s.tension), row, self._error(row), "N", np.nan, 0.0))
        for i, name in enumerate(PLACE):
            k = self.stiffness[:, i]
            row = np.concatenate([(0.5 if self.measured else 1.0) * k, k])
            out.append((Fault("sensor_fault", name), row, self._error(row), "m" if i < 2 else "rad", np.nan, 0.0))
        return out

    def _environment_rows(self) -> list[_Row]:
        out = []
        for angle in COMPASS:
            along = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle)), 0.0])
            error = np.array([_BETWEEN, _BETWEEN, _ARM * self.length])
            fault = Fault("environment", "force", f"force along {angle:03.0f} deg")
            doubt = SIGNATURE_ERROR * np.array([1.0, 1.0, _ARM * self.length])
            out.append((fault, np.concatenate([along, np.zeros(3)]), np.concatenate([error, doubt]), "N", np.nan, 0.0))
        return out

    def _error(self, row: Array) -> Array:
        """Return the sd to which a row is known: a share of the horizontal force, with the vessel's arm in yaw."""
        out = np.empty(row.size)
        for i in range(0, row.size, 3):
            size = SIGNATURE_ERROR * float(np.hypot(row[i], row[i + 1]))
            out[i : i + 3] = size, size, max(SIGNATURE_ERROR * abs(row[i + 2]), size * _ARM * self.length)
        return out

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-safe mapping; it holds the lines' tables, so that no statics are solved again."""
        return {key: _plain(value) for key, value in self.__dict__.items()}

    @classmethod
    def from_dict(cls, body: Mapping[str, Any]) -> ForceBalance:
        """Rebuild what `to_dict` gave."""
        fields = dict(body)
        for key in ("bias", "mean", "stiffness"):
            fields[key] = locked(body[key])
        for key in ("place", "origin", "wind", "known"):
            fields[key] = tuple(body[key])
        fields["sights"] = tuple(Sight(**_tuples(s)) for s in body["sights"])
        rig = {**body["mooring"], "names": tuple(body["mooring"]["names"])}
        arrays = {k: locked(v) for k, v in rig.items() if isinstance(v, list)}
        fields["mooring"] = Mooring(**{**rig, **arrays})
        fields["plant"] = Plant(**{k: locked(v) for k, v in body["plant"].items()})
        fields["noise"] = Noise(**_tuples(body["noise"]))
        return cls(**fields)


_Row = tuple[Fault, Array, Array, str, float, float]
"""A fault, its row and the row's error (both (6,)), unit of size, total, sign."""


def _tuples(body: Mapping[str, Any]) -> dict[str, Any]:
    known = {k: np.nan if v is None else v for k, v in body.items()}  # JSON has no NaN
    return {k: tuple(v) if isinstance(v, list) else v for k, v in known.items()}


def _plain(value: Any) -> Any:
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, (Mooring, Plant, Noise, Sight)):
        return {k: _plain(v) for k, v in asdict(value).items()}
    if isinstance(value, tuple):
        return [_plain(v) for v in value]
    return value


def _memory(run: RunConfig, frequency: float) -> float:
    """Return the s over which the bias follows a force: a fifth of the window over which it is averaged."""
    window = run.residuals.force_balance.window
    return 0.2 * (20.0 * 2.0 * np.pi / frequency if window == "auto" else float(window))


def _settled(good: Mask, settle: int) -> Mask:
    """Return ``good`` less the ``settle`` samples after the start and after every gap longer than that."""
    out = good.copy()
    edges = np.flatnonzero(np.diff(np.concatenate([[True], good, [True]]).astype(np.int8)))
    out[: (int(np.argmax(good)) if good.any() else 0) + settle] = False
    for start, stop in edges.reshape(-1, 2):
        if stop - start > settle:
            out[stop : stop + settle] = False
    return out


def _tensions(run: RunConfig, ship: VesselModel, channels: Channels) -> dict[str, str]:
    """Return {line of the vessel: its tension channel}, for those that are logged."""
    found = line_tensions(run.mooring, channels)
    if run.mooring.lines:
        for line in run.mooring.lines:
            if line not in ship.mooring.lines:
                raise ConfigError(
                    f"[mooring] lines: '{line}' is no line of vessel {ship.name}; "
                    f"allowed: {', '.join(ship.mooring.lines)}"
                )
    return {line: channel for line, channel in found.items() if line in ship.mooring.lines}


def _no_fault_place(training: Sequence[Training], origin: tuple[float, float]) -> Array:
    """Return the mean of the no-fault places, (3,), from the neutral place, heading in [-pi, pi)."""
    rows = pooled(training, PLACE)
    angle = np.arctan2(np.sin(rows[:, 2]).mean(), np.cos(rows[:, 2]).mean())
    return np.array([rows[:, 0].mean() - origin[0], rows[:, 1].mean() - origin[1], angle])
