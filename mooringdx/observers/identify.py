"""What drives a moored vessel, learned from a record without faults: six numbers by maximum likelihood.

    theta = ln [S_F surge, S_F sway, S_F yaw, q_b, sigma_w, lambda],
    minimise  1/2 mean_k (ln det S + e(k)' S^-1 e(k)),      e(k) = y(k) - C x(k|k-1), the steady filter's innovations

q_b is one number: intensity of the bias in north and east, N^2/s; the moment's is that times the square of the
radius of gyration. sigma_w is one number times the measured share of each axis in the wave band. w0, the peak
frequency of the waves, is read from the positions' spectrum, the measurement variances from sixth differences, which
leave of anything slower than the sampling next to nothing. Source: innovations form of the likelihood
[Fossen2011, ch. 11; Hastie2009]. What it cannot see: a bias slower than the record, whose memory is held under the
record's length, and steady errors of the model, which become bias.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mooringdx.errors import FitError
from mooringdx.observers.kalman import Filter
from mooringdx.observers.matrices import Noise, Plant
from mooringdx.physics.mooring import Mooring
from mooringdx.types import Array

_SIXTH = 924.0
"""Sum of the squared coefficients of a sixth difference."""
_PER_PERIOD = 10
_MOST = 8000


@dataclass(frozen=True)
class Record:
    """A no-fault piece: ``measured``, ``force`` (body axes), ``lines`` (earth axes): (n, 3), ``step`` s apart."""

    measured: Array
    force: Array
    lines: Array
    step: float


@dataclass(frozen=True)
class Identified:
    """The noise found, the steady bias force (3,), N, N, N m, at the record's start, and how well it fits.

    ``nis``: mean normalised innovation squared, 3 when matched. ``likelihood``: mean a sample; ``count``: evaluations;
    ``step``: s, of the thinned record.
    """

    noise: Noise
    bias: Array
    nis: float
    likelihood: float
    count: int
    step: float


def measurement_variance(measured: Array) -> Array:
    """Return the variance of each column's white noise, (3,), from sixth differences of a record, (n, 3)."""
    from scipy.special import binom

    weights = binom(6, np.arange(7)) * (-1.0) ** np.arange(7)
    out = np.empty(measured.shape[1])
    for i, column in enumerate(measured.T):
        rough = np.convolve(column, weights, "valid")
        rough = rough[np.isfinite(rough)]
        if rough.size < 100:
            raise FitError("the no-fault window has under 100 samples of position and heading in a row without a gap")
        moved = column[np.isfinite(column)]
        out[i] = max(float(np.mean(rough**2)) / _SIXTH, 1e-6 * float(np.var(moved)), 1e-24)
    return out


def spectrum(measured: Array, step: float, longest: float) -> tuple[Array, Array]:
    """Return frequencies, (m,), rad/s, and the one-sided spectra of the columns, (m, 3), unit^2/Hz.

    ``longest``: s, the period that a segment holds ten times, where the record has room for eight segments: from fewer,
    single values of the noise stand out as if they were waves.
    """
    from scipy.signal import welch

    filled = measured.copy()
    for column in filled.T:
        good = np.isfinite(column)
        column[~good] = np.interp(np.flatnonzero(~good), np.flatnonzero(good), column[good])
    size = int(max(min(256, len(filled)), min(len(filled) // 8, round(10.0 * longest / step))))
    frequency, density = welch(filled, 1.0 / step, nperseg=size, axis=0, detrend="linear")
    return np.asarray(2.0 * np.pi * frequency), np.asarray(density)


def wave_peak(omega: Array, density: Array, variance: Array, step: float, lowest: float) -> float:
    """Return the waves' peak frequency, rad/s: where the horizontal motion above ``lowest`` rad/s is largest.

    The search starts where the squared speed per log-frequency is largest, which slow motion cannot hide, among
    frequencies where the motion stands out of the noise ``variance``, (3,).
    """
    motion = density[:, :2].sum(axis=1)
    floor = 2.0 * step * float(variance[:2].sum())
    band = (omega > lowest) & (motion > 3.0 * floor) & (omega < 0.9 * np.pi / step)
    if not band.any():
        return float(min(max(4.0 * lowest, omega[1]), 0.5 * np.pi / step))
    quick = float(omega[band][np.argmax((omega**3 * (motion - floor))[band])])
    near = band & (omega > max(lowest, 0.6 * quick)) & (omega < 1.4 * quick)
    return float(omega[near][np.argmax((omega**2 * (motion - floor))[near])])


def thinned(record: Record, frequency: float) -> Record:
    """Return every m-th sample: at least ten a wave period, and not over 8000 where that allows it.

    Forces are averaged over what is left out, because the filter holds them from sample to sample.
    """
    m = max(1, int(2.0 * np.pi / frequency / record.step / _PER_PERIOD))
    n = min(len(record.measured) // m, _MOST)
    force, lines = (x[: n * m].reshape(n, m, 3).mean(axis=1) for x in (record.force, record.lines))
    return Record(record.measured[: n * m : m], force, lines, record.step * m)


def identify(
    record: Record,
    plant: Plant,
    mooring: Mooring | None,
    stiffness: Array,
    place: Array,
    variance: Array | None = None,
) -> Identified:
    """Return the noise that makes a no-fault record most likely.

    Parameters
    ----------
    record : measured positions and known forces, NaN-free in the forces, at least two slow periods long.
    mooring : the lines' model, or None where ``record.lines`` holds their force.
    stiffness : (3, 3), of the mooring at ``place`` (3,): it sets where slow motion ends and the search starts.
    variance : (3,), m2, m2, rad2, of the measurements; read from the record when None.
    """
    from scipy.optimize import minimize

    natural = np.sqrt(np.maximum(np.diag(stiffness), 1e-12) / np.diag(plant.inertia))
    slow = 2.0 * np.pi / float(natural[:2].min())
    if len(record.measured) * record.step < 2.0 * slow:
        raise FitError(
            f"the no-fault window of {len(record.measured) * record.step:.0f} s holds under two slow periods of "
            f"{slow:.0f} s, too few to learn the slow forces; give a longer [baseline] window"
        )
    variance = measurement_variance(record.measured) if variance is None else variance
    omega, density = spectrum(record.measured, record.step, slow)
    lowest = 3.0 * float(natural[:2].max())
    peak = wave_peak(omega, density, variance, record.step, lowest)
    start = _first_guess(omega, density, variance, record.step, natural, plant, peak)
    thin = thinned(record, peak)
    span = len(thin.measured) * thin.step
    bias = steady_bias(thin, mooring)
    skip = int(min(2.0 * slow / thin.step, 0.25 * len(thin.measured)))
    axes = np.array([1.0, 1.0, plant.inertia[2, 2] / plant.inertia[0, 0]])

    def noise_of(theta: Array) -> Noise:
        found = np.exp(theta) * scale
        wave = found[4] * np.asarray(start.wave) / start.wave[0]
        quick = found[3] * axes
        return Noise(_triple(found[:3]), _triple(quick), _triple(wave), _triple(variance), peak, float(found[5]))

    scale = np.array([*start.force, start.bias[0], start.wave[0], start.share])
    state = {"count": 0, "nis": np.nan}

    def cost(theta: Array) -> float:
        filtering = Filter(plant, noise_of(theta), thin.step, mooring, _triple(place))
        models = filtering.models(thin.measured[:, 2])
        out = filtering(thin.measured, thin.force, thin.lines, bias, models)
        state["count"] += 1
        state["nis"] = float(np.nanmean(out.nis[skip:]))
        value = 0.5 * (float(np.linalg.slogdet(models[len(models) // 2].S)[1]) + state["nis"])
        return value if np.isfinite(value) else 1e6

    # A bias memory sqrt(S_F / q_b) under a slow period would leave nothing to the white force; over the record, none.
    wide = float(np.log(300.0))
    least = float(np.log((2.0 / span) ** 2 * start.force[0] / start.bias[0]))
    bounds = [(-wide, wide)] * 3 + [
        (least, wide),
        (-wide, wide),
        (np.log(0.02 / start.share), np.log(1.0 / start.share)),
    ]
    best = minimize(
        cost, np.zeros(6), method="L-BFGS-B", bounds=bounds, options={"eps": 1e-3, "maxiter": 40, "ftol": 1e-6}
    )
    value = cost(best.x)
    return Identified(noise_of(best.x), bias, state["nis"], value, int(state["count"]), thin.step)


def _first_guess(
    omega: Array, density: Array, variance: Array, step: float, natural: Array, plant: Plant, peak: float
) -> Noise:
    """Return a start for the search from the spectra: slow motion as a resonance, waves as a band."""
    width = omega[1] - omega[0]
    floor = 2.0 * step * variance
    waves = (omega > 0.6 * peak) & (omega < 2.0 * peak)
    slow = omega <= 0.6 * peak
    sd = np.sqrt(np.maximum((density[waves] - floor).sum(axis=0) * width / (2.0 * np.pi), 1e-3 * variance))
    drift = np.maximum(density[slow].sum(axis=0) * width / (2.0 * np.pi), 1e-2 * variance)
    # A resonance of frequency w_n and damping ratio z under white force S: variance S / (4 z w_n^3 m^2); z about 0.2.
    inertia = np.diag(plant.inertia)
    force = 0.8 * np.maximum(natural, 0.2 * natural.max()) ** 3 * inertia**2 * drift
    share = 0.1
    wave = sd * np.sqrt(4.0 * share * peak)
    bias = force[0] * (0.2 * float(natural[0])) ** 2
    return Noise(_triple(force), (bias, bias, bias), _triple(wave), _triple(variance), peak, share)


def steady_bias(record: Record, mooring: Mooring | None, count: int = 0) -> Array:
    """Return minus the mean known force, (3,), earth axes, over the first ``count`` samples, or the first fifth."""
    first = slice(0, count or max(1, len(record.measured) // 5))
    eta, body = record.measured[first], record.force[first]
    good = np.isfinite(eta).all(axis=1)
    eta, body = eta[good], body[good]
    c, s = np.cos(eta[:, 2]), np.sin(eta[:, 2])
    known = np.column_stack([c * body[:, 0] - s * body[:, 1], s * body[:, 0] + c * body[:, 1], body[:, 2]])
    lines = record.lines[first][good]
    if mooring is not None:
        lines = lines + np.array([mooring.force(x) for x in eta])
    return np.asarray(-(known + lines).mean(axis=0))


def _triple(values: Array) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
