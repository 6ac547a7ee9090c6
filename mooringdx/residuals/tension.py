"""Tension residual: each measured tension minus that of the intact line at the measured place of its fairlead.

Equations. x_j: horizontal distance from fairlead to anchor at the measured north, east and heading; T(x): tension of
the intact line by its statics, a table; u_j = dx_j/dt, the fairlead's speed away from the anchor.

    r_j(k) = T_measured,j - T(x_j)                                            calibrate "none"   [Fang2015, eq. 6]
           - o_j                                                                        "offset"
           - o_j - g_j (T(x_j) - T(x_j0))                                               "linear"
           - o_j - g_j (T(x_j) - T(x_j0)) - c_j u_j - q_j u_j |u_j|                     "dynamic"

o, g, c, q from the no-fault window, x_j0 the distance at its middle. An anchor some cm off, a line a few per cent too
heavy and a gauge's gain all shift T(x) and scale it: offset and gain hold both, and stay right where the vessel was not
while they were learned, which free slopes along north, east and heading do not. Noise of the position would shrink g of
a line that lies across the motion; so the normal equations weigh with T at the mean of the distances one sample before
and after, whose noise is another (instrumental variables). c, q: drag on the line. u is the slope of a straight line
through 2 h + 1 distances; all of r is then h samples late, because a filter of the speed alone would be out of step
with the waves, and the gain would make up for it, wrongly. h is what leaves least on the no-fault window; drag that
takes out under 3 % is left out, and the delay with it.

Signatures, v = change of measured minus intact tension, N: line j and its sensor both move r_j by v (one class here:
the force balance tells them apart), a wrong north, east or heading by -dT_j/dx. After a real fault the vessel also
moves, which moves the others by what their statics are wrong: their rows are known to SIGNATURE_ERROR of the change
of T.
Share of buoyancy lost: s with mean of T(x, s) - T(x, 0) over the distances of the window = v.
Not seen: heave and roll of the fairlead, current on the line, lines of one vessel that differ in their sections; a line
of less stiffness where it hangs slack (EA hardly shows there).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mooringdx.config import RunConfig
from mooringdx.errors import ConfigError, FitError
from mooringdx.physics.mooring import Mooring
from mooringdx.physics.rig import fault_tables, mooring_of
from mooringdx.physics.vessel import VesselModel, vessel
from mooringdx.registry import did_you_mean
from mooringdx.residuals import statics
from mooringdx.residuals.training import COMPASS, SIGNATURE_ERROR, Training, line_tensions, pooled
from mooringdx.types import Array, Channels, Fault, Mask, Residuals, Signatures, locked, replace

AXES = ("north", "east", "heading")

_WIDEST = 8  # samples on either side that a speed is taken over
_WORTH = 0.97  # drag stays when it leaves less than this share of the residual's sd
_ROWS_PER_COEFFICIENT = 20


@dataclass(frozen=True)
class Tension:
    """Statics of the logged lines and what the no-fault window taught of them.

    ``lines``: (line, channel). ``origin``: north, east of the neutral place in the log, m. ``tables``: (levels, k), N,
    at distances ``start + step * arange(k)``, m, with ``levels`` shares of buoyancy lost; row 0 is the intact line.
    ``coefficients``: (n, 4): offset N, gain, N s/m, N s2/m2. ``half``: h, samples. ``centre``: (3,) the middle of the
    no-fault places, from the origin. ``reference``: (n,), T(x_j0). ``response``: (n, 2), m north and east per newton
    of a line's change. ``parted``: N left after a break. ``accuracy``: share of a tension to which statics
    and gauge are believed.
    """

    lines: tuple[tuple[str, str], ...]
    origin: Array
    anchors: Array
    fairleads: Array
    start: float
    step: float
    levels: Array
    tables: Array
    sample_time: float
    half: int
    coefficients: Array
    centre: Array
    reference: Array
    response: Array
    parted: float
    accuracy: float = 0.0

    @classmethod
    def fit(cls, training: Sequence[Training], run: RunConfig) -> Tension:
        """Tabulate the lines of the vessel file and learn what `[residuals.tension] calibrate` asks for.

        Raises ConfigError without a vessel file, a position or a line's tension, FitError where the window is short.
        """
        model, lines = _asked(training[0].channels, run)
        system = mooring_of(model)
        rows = [system.names.index(line) for line, _ in lines]
        origin = np.asarray(run.mooring.origin, dtype=np.float64)
        places = pooled(training, AXES) - [*origin, 0.0]
        turn = float(np.angle(np.mean(np.exp(1j * places[:, 2]))))
        centre = np.array([*np.median(places[:, :2], axis=0), turn])
        levels, tables = _levels(model, system)
        new = cls(
            lines=lines,
            origin=locked(origin),
            anchors=locked(system.anchors[rows]),
            fairleads=locked(system.fairleads[rows]),
            start=system.start,
            step=system.step,
            levels=locked(levels),
            tables=locked(tables),
            sample_time=training[0].channels.grid.sample_time,
            half=0,
            coefficients=np.zeros((len(lines), 4)),
            centre=locked(centre),
            reference=locked(system.pulls(centre)[1][rows]),
            response=locked(_response(system, centre)[rows]),
            parted=model.mooring.parted,
            accuracy=run.residuals.tension.accuracy,
        )
        return _calibrated(new, training, run.residuals.tension.calibrate)

    def __call__(self, channels: Channels) -> Residuals:
        """Return measured minus intact tension, N, ``half`` samples late; valid where tension and place are."""
        _need(channels)
        measured, distance, speed = self.states(channels)
        values = measured - self.expected(distance, speed)
        names = tuple(f"{channel} - intact" for _, channel in self.lines)
        units = ("N",) * len(self.lines)
        return Residuals(names, units, channels.grid, values, np.isfinite(values), self.signatures())

    def states(self, channels: Channels) -> tuple[Array, Array, Array]:
        """Return measured tension N, distance m and its rate m/s, (n, lines) each, ``half`` samples late."""
        distance = self.distances(channels)
        measured = np.column_stack([_column(channels, channel) for _, channel in self.lines])
        speed = np.zeros_like(distance)
        if self.half:
            speed = statics.late_slope(distance, self.half) / self.sample_time
            distance, measured = statics.late(distance, self.half), statics.late(measured, self.half)
        return measured, distance, speed

    def distances(self, channels: Channels) -> Array:
        """Return the horizontal distance from each fairlead to its anchor, (n, lines), m; NaN where unknown."""
        eta = np.column_stack([_column(channels, axis) for axis in AXES]) - [*self.origin, 0.0]
        return statics.distances(eta, self.fairleads, self.anchors)

    def expected(self, distance: Array, speed: Array) -> Array:
        """Return the tension of the intact, calibrated line, N, at (n, lines) distances, m, and rates, m/s."""
        offset, gain, linear, square = self.coefficients.T
        static = self.static(distance)
        out = static + offset + gain * (static - self.reference)
        return np.asarray(out + linear * speed + square * speed * np.abs(speed))

    def static(self, distance: Array) -> Array:
        """Return the tension of the intact line by its table, N, at (n, lines) distances, m."""
        return statics.tabled(self.start, self.step, self.tables[0], distance)

    def slopes(self) -> Array:
        """Return dT_j by north, east (N/m) and heading (N/rad) at the middle of the no-fault places, (lines, 3)."""
        out = np.empty((len(self.lines), 3))
        for i, width in enumerate((self.step, self.step, self.step / max(1.0, float(np.abs(self.fairleads).max())))):
            delta = np.zeros(3)
            delta[i] = width
            pair = np.array([self.centre - delta, self.centre + delta])
            distance = statics.distances(pair, self.fairleads, self.anchors)
            low, high = self.expected(distance, np.zeros_like(distance))
            out[:, i] = (high - low) / (2.0 * width)
        return out

    def floor(self) -> Array:
        """Return the sd to which each residual is believed, (lines,), N: ``accuracy`` of its no-fault tension."""
        return np.asarray(self.accuracy * np.abs(self.reference))

    def signatures(self) -> Signatures:
        """Return *line lost*, *buoy lost*, *sensor wrong* for each line, a wrong place, and the environment."""
        n, slopes = len(self.lines), self.slopes()
        carried = SIGNATURE_ERROR * np.abs(slopes[:, :2] @ self.response.T)
        full = self.changes(statics.distances(self.centre[None], self.fairleads, self.anchors))
        found: list[tuple[Fault, Array, Array, str, float, float]] = []
        for j, (line, channel) in enumerate(self.lines):
            row, zero = np.eye(n)[j], np.zeros(n)
            moved = np.where(row > 0, 0.0, carried[:, j])
            level = float(self.reference[j] + self.coefficients[j, 0])
            found.append((Fault("sensor_fault", channel), row, zero, "N", np.nan, 0.0))
            found.append((Fault("line_lost", line), row, moved, "N", -(level - self.parted), -1.0))
            if len(self.levels) > 1:
                total = float(np.interp(1.0, self.levels, full[:, j]))
                found.append((Fault("line_weakened", line, "buoyancy"), row, moved, "N", total, 1.0))
        for i, axis in enumerate(AXES):
            error = SIGNATURE_ERROR * np.abs(slopes[:, i])
            found.append((Fault("sensor_fault", axis), -slopes[:, i], error, ("m", "m", "rad")[i], np.nan, 0.0))
        for angle in COMPASS:
            along = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
            error = SIGNATURE_ERROR * np.abs(slopes[:, :2] @ along)
            fault = Fault("environment", "position", f"offset along {angle:03.0f} deg")
            found.append((fault, np.zeros(n), error, "m", np.nan, 0.0))
        faults, rows, errors, units, totals, signs = zip(*found, strict=True)
        names = tuple(f"{channel} - intact" for _, channel in self.lines)
        return Signatures(faults, names, np.array(rows), units, np.array(totals), np.array(signs), np.array(errors))

    def changes(self, distance: Array) -> Array:
        """Return the mean change of tension at each level of buoyancy lost, (levels, lines), N, over ``distance``."""
        return statics.changes(self.start, self.step, self.tables, self._known(distance))

    def share(self, line: str, change: float, sd: float, distance: Array) -> tuple[float, float, float]:
        """Return the share of buoyancy lost that explains a mean ``change`` of a line's residual, with 95 % limits.

        Parameters
        ----------
        change, sd : N, window mean of the residual less its no-fault mean, and the sd of that.
        distance : (m, lines), m, `distances` over the same window.

        1 is a buoy without lift, more is one that takes water; outside the tables the nearest end is given. Raises
        ConfigError for a vessel without buoys or an unknown line.
        """
        if len(self.levels) < 2:
            raise ConfigError(
                f"'{line}' has no buoy in the vessel file, so no share of one is lost; give sections buoy"
            )
        return statics.share_of_loss(self.levels, self.changes(distance)[:, self._row(line)], change, sd)

    def kind(self, line: str, change: float, sd: float, distance: Array) -> str:
        """Return what a mean ``change`` says of a line, see `statics.kind_of_change`; arguments as for `share`."""
        return statics.kind_of_change(change, sd, self.intact(line, distance), self.parted)

    def intact(self, line: str, distance: Array) -> float:
        """Return the mean tension of a line, N, were it intact, over ``distance`` as for `share`."""
        good = self._known(distance)
        return float(self.expected(good, np.zeros_like(good))[:, self._row(line)].mean())

    def _known(self, distance: Array) -> Array:
        """Return the distances without gaps; where none is known, that at the middle of the no-fault places."""
        good = distance[np.isfinite(distance).all(axis=1)]
        return good if len(good) else statics.distances(self.centre[None], self.fairleads, self.anchors)

    def _row(self, line: str) -> int:
        names = [name for name, _ in self.lines]
        if line not in names:
            raise ConfigError(f"unknown line '{line}'{did_you_mean(line, names)}")
        return names.index(line)

    def to_dict(self) -> dict[str, Any]:
        """Return a JSON-safe mapping."""
        return {k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in self.__dict__.items()}

    @classmethod
    def from_dict(cls, body: Mapping[str, Any]) -> Tension:
        """Rebuild what `to_dict` gave."""
        fields = {k: locked(v) if isinstance(v, list) and k != "lines" else v for k, v in body.items()}
        fields["lines"] = tuple((line, channel) for line, channel in fields["lines"])
        return cls(**fields)


def _asked(channels: Channels, run: RunConfig) -> tuple[VesselModel, tuple[tuple[str, str], ...]]:
    """Return the vessel and its logged lines with their channels."""
    if not run.mooring.model:
        raise ConfigError('[residuals] use "tension" needs the lines\' statics: name a vessel file in [mooring] vessel')
    _need(channels)
    model = vessel(run.mooring.model, Path(run.mooring.vessel or "[mooring] model"))
    lines = tuple(line_tensions(run.mooring, channels).items())
    if not lines:
        raise ConfigError(
            '[residuals] use "tension": the log has no tension channel; map tension_1, ... in [channels], or watch '
            'position alone: [bank] use = ["onset_glr"] in place of [residuals]'
        )
    for line, channel in lines:
        if line not in model.mooring.lines:
            raise ConfigError(
                f"[residuals] use \"tension\": '{channel}' belongs to no line of the vessel file"
                f"{did_you_mean(line, model.mooring.lines)}; or list in [mooring] lines those to be watched"
            )
    return model, lines


def _need(channels: Channels) -> None:
    for axis in AXES:
        if axis not in channels.names:
            raise ConfigError(
                f"[residuals] use \"tension\" needs the vessel's place: the log has no '{axis}'; map north, east and "
                'heading in [channels], or use "learned"'
            )


def _column(channels: Channels, name: str) -> Array:
    column = channels.names.index(name)
    return np.where(channels.valid[:, column], channels.values[:, column], np.nan)


def _levels(model: VesselModel, system: Mooring) -> tuple[Array, Array]:
    """Return the shares of buoyancy lost that are tabulated, (levels,), and the tensions there, (levels, k), N."""
    intact = system.tension[:1]
    most = max((1.0 - s.filled / s.buoy for s in model.mooring.sections if s.buoy > 0.0), default=0.0)
    if most == 0.0:
        return np.zeros(1), np.array(intact)
    levels = sorted({0.5, 1.0, most})
    return np.array([0.0, *levels]), np.vstack([intact, fault_tables(model, "buoyancy", levels)[1]])


def _response(system: Mooring, centre: Array) -> Array:
    """Return how far the vessel goes, (n, 2), m north and east, per newton of each line's tension, its heading held."""
    horizontal, tension, direction = system.pulls(centre)
    stiffness = system.stiffness(centre)[:2, :2]
    pull = direction * (horizontal / tension)[:, None]
    if np.linalg.cond(stiffness) > 1e6:
        return np.zeros_like(pull)
    return np.asarray(np.linalg.solve(stiffness, pull.T).T)


def _calibrated(plain: Tension, training: Sequence[Training], calibrate: str) -> Tension:
    """Return the generator with what the no-fault windows teach, the residual delayed only where drag is worth it."""
    terms = {"none": 0, "offset": 1, "linear": 2, "dynamic": 2}[calibrate]
    if terms == 0:
        return plain
    best, left = _learned(plain, training, terms)
    if calibrate != "dynamic":
        return best
    tried = [_learned(replace(plain, half=h), training, 4) for h in range(1, _WIDEST + 1)]
    with_drag, less = min(tried, key=lambda one: one[1])
    return with_drag if less < left + np.log(_WORTH) else best


def _learned(plain: Tension, training: Sequence[Training], terms: int) -> tuple[Tension, float]:
    """Return the generator with its first ``terms`` coefficients, and the mean logarithm of the residuals' sd."""
    rows = [_rows(plain, one) for one in training]
    measured, distance, speed, around = (np.vstack([r[i] for r in rows]) for i in range(4))
    if len(measured) < _ROWS_PER_COEFFICIENT * terms:
        raise FitError(
            f"tension residual: {len(measured)} no-fault rows with all tensions and the place for {terms} coefficients "
            f"a line; it needs {_ROWS_PER_COEFFICIENT * terms}: lengthen [baseline] window"
        )
    rest = measured - plain.expected(distance, speed)
    static, beside = (plain.static(x) - plain.reference for x in (distance, around))
    coefficients, left = statics.corrections(rest, static, beside, speed, terms)
    return replace(plain, coefficients=locked(coefficients)), left


def _rows(plain: Tension, training: Training) -> tuple[Array, Array, Array, Array]:
    """Return measured tension, distance, speed and the mean of the two distances beside, (m, lines) each, no-fault."""
    measured, distance, speed = plain.states(training.channels)
    around = np.full_like(distance, np.nan)
    around[1:-1] = 0.5 * (distance[2:] + distance[:-2])
    good = np.isfinite(measured + distance + speed + around).all(axis=1)
    inside: Mask = np.zeros_like(good)
    for piece in training.pieces:
        inside[piece.start + 2 * plain.half + 1 : max(piece.stop - 1, 0)] = True
    good &= inside
    return measured[good], distance[good], speed[good], around[good]
