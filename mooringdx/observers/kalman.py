"""The slow motion of a moored vessel, and the force that nothing else explains: a Kalman filter of 15 states.

    eta' = R(psi) nu,   M nu' = -D nu + R'(psi) (b + tau_m) + tau + w3,   b' = w_b          (eta, b: earth axes)
    xi' = xi_w,   xi_w' = -w0^2 xi - 2 lambda w0 xi_w + w_w,   y = eta + xi_w + v

eta is north, east, heading of the slow motion, nu surge, sway and yaw rate, b the bias force (N, N, N m), xi_w the
wave-frequency motion, tau known forces in body axes, tau_m that of the lines: given, earth axes (then it is an
input), or a model of the mooring at the filter's own place (then its stiffness stands in F). w3 has the two-sided
intensities S_F, w_b q_b, w_w sigma_w^2. F, G and Q are exact for forces held over a step [VanLoan1978]; heading is
frozen at multiples of 3 deg and what remains of it turns all earth-axes states, which is exact but for what is not
the same in all directions. The steady gain is that of the Riccati equation, solved by doubling [Fossen2011, ch. 11].

What it cannot see: whether a force that it finds is the environment's or a lost line's (both are b); a force quicker
than about sqrt(q_b / S_F); a wrong position that stands still, which a mooring model turns into a force.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from mooringdx.observers.matrices import Model, Noise, Plant, model
from mooringdx.physics.frames import rotation
from mooringdx.physics.mooring import Mooring, line_force
from mooringdx.types import Array

HEADING_STEP = float(np.radians(3.0))
"""Headings at which the matrices are made anew, rad."""


@dataclass(frozen=True)
class Estimate:
    """What the filter says, after the update at each sample; NaN before the first whole measurement.

    ``position``, ``velocity``, ``bias``: (n, 3), of the slow motion: m, m, rad; body m/s, m/s, rad/s; earth N, N, N m.
    ``innovation``: (n, 3), NaN where no measurement was. ``nis``: (n,), innovation' S^-1 innovation, mean 3 when the
    noise is as assumed. ``covariance``: (3, 3), second moment of the innovations about zero. ``final``: (15,), the
    state predicted for the sample after the last, and ``final_covariance`` (15, 15) of it, where the gain varied.
    """

    position: Array
    velocity: Array
    bias: Array
    innovation: Array
    nis: Array
    covariance: Array
    final: Array
    final_covariance: Array

    @property
    def nis_mean(self) -> float:
        """Mean of ``nis`` over all measurements."""
        return float(np.nanmean(self.nis))


@dataclass(frozen=True)
class Filter:
    """A Kalman filter on samples ``step`` s apart.

    ``mooring``: the lines' model, or None where their force is given. ``place``: (3,), m, m, rad, where its stiffness
    is taken; at other headings the vessel is turned about the middle of the fairleads.
    """

    plant: Plant
    noise: Noise
    step: float
    mooring: Mooring | None = None
    place: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def model(self, heading: float) -> Model:
        """Return the matrices at ``heading``, rad."""
        if self.mooring is None:
            return model(self.plant, self.noise, self.step, heading)
        middle = self.mooring.fairleads.mean(axis=0)
        there = np.array([self.place[0], self.place[1], heading])
        there[:2] += (rotation(self.place[2]) - rotation(heading))[:2, :2] @ middle
        return model(self.plant, self.noise, self.step, heading, self.mooring.stiffness(there))

    def models(self, headings: Array) -> tuple[Model, ...]:
        """Return the models at multiples of 3 deg that cover all finite ``headings``, (n,), rad, unwrapped."""
        good = headings[np.isfinite(headings)]
        if not good.size:
            return (self.model(HEADING_STEP * round(self.place[2] / HEADING_STEP)),)
        first, last = round(float(good.min()) / HEADING_STEP) - 1, round(float(good.max()) / HEADING_STEP) + 1
        return tuple(self.model(HEADING_STEP * i) for i in range(first, last + 1))

    def __call__(
        self,
        measured: Array,
        force: Array | None = None,
        lines: Array | None = None,
        bias: Array | None = None,
        models: Sequence[Model] | None = None,
        turning: bool = True,
        start_covariance: Array | None = None,
    ) -> Estimate:
        """Filter a record in one pass.

        Parameters
        ----------
        measured : (n, 3), north, east, heading (m, m, rad, unwrapped); a row with a NaN is only predicted.
        force : (n, 3), known force in body axes held from each sample to the next, N, N, N m; NaN holds the last.
        lines : (n, 3), the lines' force in earth axes, where there is no ``mooring``.
        bias : (3,), N, N, N m, to start with.
        models : the matrices, lowest heading first, 3 deg apart; made for the record's headings when None.
        turning : False keeps the first model's heading throughout: a linear filter.
        start_covariance : (15, 15), then the covariance is carried and the gain varies; None: the steady gain.
        """
        used = tuple(models) if models is not None else self.models(measured[:, 2])
        zero = np.zeros(np.shape(measured))
        rig, start = self.mooring or _NO_LINES, np.zeros((0, 0)) if start_covariance is None else start_covariance
        state, innovation, nis, final, covariance = _filtered(
            np.require(measured, np.float64, ["C", "W"]),
            zero if force is None else held(force),
            zero if lines is None else held(lines),
            np.zeros(3) if bias is None else np.array(bias, dtype=np.float64),
            np.array([m.heading for m in used]), turning,
            np.stack([m.F for m in used]), np.stack([m.G for m in used]), np.stack([m.K for m in used]),
            np.stack([m.S for m in used]), np.stack([m.Q for m in used]), np.stack([m.stiffness for m in used]),
            used[0].R, np.array(start, dtype=np.float64, order="C"),
            rig.fairleads, rig.anchors, rig.start, rig.step, rig.horizontal,
        )  # fmt: skip
        seen = innovation[np.isfinite(nis)]
        moment = seen.T @ seen / max(len(seen), 1)
        slow = state[:, 0:3], state[:, 3:6], state[:, 6:9]
        return Estimate(*slow, innovation, nis, moment, final, covariance)


_NO_LINES = Mooring((), np.zeros((0, 2)), np.zeros((0, 2)), 0.0, 1.0, np.zeros((0, 2)), np.zeros((0, 2)))


def correlation(innovation: Array, lags: int) -> float:
    """Return the largest autocorrelation, absolute, of any column of (n, 3) over lags of 1 to ``lags`` samples.

    Rows with a NaN are left out: 0 when white, where n samples scatter by n^-1/2.
    """
    worst = 0.0
    for column in innovation[np.isfinite(innovation).all(axis=1)].T:
        x = column - column.mean()
        power = max(float(x @ x), 1e-300)
        worst = max(worst, *(abs(float(x[lag:] @ x[:-lag])) / power for lag in range(1, min(lags, len(x) - 1) + 1)))
    return worst


def held(values: Array) -> Array:
    """Return (n, c) with every NaN replaced by the last finite value of its column, zero before the first."""
    out = np.array(values, dtype=np.float64)
    for column in out.T:
        good = np.isfinite(column)
        if good.all():
            continue
        last = np.maximum.accumulate(np.where(good, np.arange(len(column)), -1))
        column[:] = np.where(last >= 0, column[np.maximum(last, 0)], 0.0)
    return out


@njit(cache=True)
def turn_states(x: Array, c: float, s: float) -> None:
    """Turn the north and east parts of all earth-axes states by the angle of cosine ``c`` and sine ``s``, in place."""
    for i in (0, 6, 9, 12):
        north, east = x[i], x[i + 1]
        x[i], x[i + 1] = c * north - s * east, s * north + c * east


@njit(cache=True)
def _updated(x: Array, error: Array, gain: Array, c: float, s: float, step: Array) -> None:
    """Add gain times innovation to the state, in place; the gain is that of the model's heading."""
    north, east = c * error[0] + s * error[1], c * error[1] - s * error[0]
    for i in range(x.size):
        step[i] = gain[i, 0] * north + gain[i, 1] * east + gain[i, 2] * error[2]
    turn_states(step, c, s)
    for i in range(x.size):
        x[i] += step[i]


@njit(cache=True)
def _predicted(
    x: Array, earth: Array, body: Array, F: Array, G: Array, K: Array, reference: float, c: float, s: float,
    out: Array,
) -> None:  # fmt: skip
    """Carry the state one step on, in place.

    ``earth``: the lines' force; ``K``: their stiffness, in F, given back here; ``out``: (15,), scratch.
    """
    turn_states(x, c, s * -1.0)
    north, east, moment = c * earth[0] + s * earth[1], c * earth[1] - s * earth[0], earth[2]
    north += K[0, 0] * x[0] + K[0, 1] * x[1] + K[0, 2] * x[2]
    east += K[1, 0] * x[0] + K[1, 1] * x[1] + K[1, 2] * x[2]
    moment += K[2, 0] * x[0] + K[2, 1] * x[1] + K[2, 2] * x[2]
    cr, sr = np.cos(reference), np.sin(reference)
    surge, sway, yaw = body[0] + cr * north + sr * east, body[1] + cr * east - sr * north, body[2] + moment
    for i in range(6):
        out[i] = G[i, 0] * surge + G[i, 1] * sway + G[i, 2] * yaw
        for j in range(9):
            out[i] += F[i, j] * x[j]
    for i in range(6):
        x[i] = out[i]
    for i in range(9, 12):
        low, high = x[i], x[i + 3]
        x[i], x[i + 3] = F[i, i] * low + F[i, i + 3] * high, F[i + 3, i] * low + F[i + 3, i + 3] * high
    turn_states(x, c, s)


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _rows_on(F: Array, p: Array, out: Array) -> None:
    """Fill ``out`` with F p, flat (225,) both: bias forces stay, wave states move in pairs, the rest is 6 x 9."""
    n = 15
    for r in range(6):
        a, b, c, d, e = F[r, 0], F[r, 1], F[r, 2], F[r, 3], F[r, 4]
        f, g, h, k = F[r, 5], F[r, 6], F[r, 7], F[r, 8]
        for j in range(n):
            total = a * p[j] + b * p[n + j] + c * p[2 * n + j] + d * p[3 * n + j] + e * p[4 * n + j]
            out[r * n + j] = total + f * p[5 * n + j] + g * p[6 * n + j] + h * p[7 * n + j] + k * p[8 * n + j]
    for j in range(3 * n):
        out[6 * n + j] = p[6 * n + j]
    for m in range(9, 12):
        a, b, c, d = F[m, m], F[m, m + 3], F[m + 3, m], F[m + 3, m + 3]
        for j in range(n):
            low, high = p[m * n + j], p[(m + 3) * n + j]
            out[m * n + j] = a * low + b * high
            out[(m + 3) * n + j] = c * low + d * high


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _carried(p: Array, F: Array, Q: Array, gain: Array, seen: bool, pc: Array, work: Array) -> None:
    """Carry the covariance, flat (225,), to before the next update, in place; ``seen``: there was one with ``gain``.

    ``pc``: C P, of `_gain`; ``work``: (225,), scratch.
    """
    n = 15
    if seen:
        for i in range(n):
            x, y, z = gain[i, 0], gain[i, 1], gain[i, 2]
            for j in range(n):
                p[i * n + j] -= x * pc[j] + y * pc[n + j] + z * pc[2 * n + j]
    _rows_on(F, p, work)
    for i in range(n):
        for j in range(n):
            p[i * n + j] = work[j * n + i]
    _rows_on(F, p, work)
    for i in range(n):
        for j in range(n):
            p[i * n + j] = 0.5 * (work[i * n + j] + work[j * n + i]) + Q[i, j]


@njit(cache=True, error_model="numpy", fastmath={"contract"})
def _gain(p: Array, R: Array, pc: Array, gain: Array, weight: Array) -> None:
    """Fill C P, flat (45,), the gain, (15, 3), and the inverse of the innovations' covariance, (3, 3).

    ``p``: the covariance before the update, flat (225,).
    """
    n = 15
    for m in range(3):
        for j in range(n):
            pc[m * n + j] = p[m * n + j] + p[(12 + m) * n + j]
    a, b, c = pc[0] + pc[12] + R[0, 0], pc[1] + pc[13] + R[0, 1], pc[2] + pc[14] + R[0, 2]
    d, e, f = pc[16] + pc[28] + R[1, 1], pc[17] + pc[29] + R[1, 2], pc[32] + pc[44] + R[2, 2]
    u, v, w = d * f - e * e, c * e - b * f, b * e - c * d
    scale = 1.0 / (a * u + b * v + c * w)
    weight[0, 0], weight[0, 1], weight[0, 2] = scale * u, scale * v, scale * w
    weight[1, 1], weight[1, 2] = scale * (a * f - c * c), scale * (b * c - a * e)
    weight[2, 2] = scale * (a * d - b * b)
    weight[1, 0], weight[2, 0], weight[2, 1] = weight[0, 1], weight[0, 2], weight[1, 2]
    for i in range(n):
        x, y, z = pc[i], pc[n + i], pc[2 * n + i]
        for m in range(3):
            gain[i, m] = x * weight[0, m] + y * weight[1, m] + z * weight[2, m]


@njit(cache=True)
def _square(weight: Array, x: float, y: float, z: float) -> float:
    """Return (x, y, z) weight (x, y, z)' of a symmetric weight, (3, 3)."""
    out: float = weight[0, 0] * x * x + weight[1, 1] * y * y + weight[2, 2] * z * z
    out += 2.0 * (weight[0, 1] * x * y + weight[0, 2] * x * z + weight[1, 2] * y * z)
    return out


@njit(cache=True)
def _filtered(
    measured: Array, force: Array, lines: Array, bias: Array, headings: Array, turning: bool,
    F: Array, G: Array, gains: Array, spreads: Array, Q: Array, stiffness: Array, R: Array, P: Array,
    fairleads: Array, anchors: Array, start: float, step: float, horizontal: Array,
) -> tuple[Array, Array, Array, Array, Array]:  # fmt: skip
    """Return states after the updates (n, 9), innovations (n, 3), their squares (n,), last state and covariance."""
    n, bins = len(measured), len(F)
    states, innovations, squares = np.full((n, 9), np.nan), np.full((n, 3), np.nan), np.full(n, np.nan)
    inverse = np.empty_like(spreads)
    for i in range(bins):
        inverse[i] = np.linalg.inv(spreads[i])
    carried, p, pc, work = P.size > 0, P.ravel(), np.empty(45), np.empty(225)
    varied, square = np.empty((15, 3)), np.empty((3, 3))
    x, new, started, error, earth = np.zeros(15), np.empty(15), False, np.zeros(3), np.zeros(3)
    for k in range(n):
        seen = np.isfinite(measured[k, 0]) and np.isfinite(measured[k, 1]) and np.isfinite(measured[k, 2])
        if not started:
            if not seen:
                continue
            started = True
            x[:3], x[6:9] = measured[k], bias
        at = min(max(int(np.round((x[2] - headings[0]) / HEADING_STEP)), 0), bins - 1) if turning else 0
        reference = headings[at]
        rest = x[2] - reference if turning else 0.0
        c, s = np.cos(rest), np.sin(rest)
        gain, weight = gains[at], inverse[at]
        if carried and seen:
            _gain(p, R, pc, varied, square)
            gain, weight = varied, square
        if seen:
            for i in range(3):
                error[i] = measured[k, i] - x[i] - x[12 + i]
            north, east = c * error[0] + s * error[1], c * error[1] - s * error[0]
            squares[k] = _square(weight, north, east, error[2])
            innovations[k] = error
            _updated(x, error, gain, c, s, new)
        states[k] = x[:9]
        if carried:
            _carried(p, F[at], Q[at], gain, seen, pc, work)
        earth[:] = lines[k]
        if len(anchors):
            earth += line_force(x[:3], fairleads, anchors, start, step, horizontal)
        _predicted(x, earth, force[k], F[at], G[at], stiffness[at], reference, c, s, new)
    return states, innovations, squares, x, P
