"""Slow drift from measured waves or motions: a force fed forward where, and only where, it explains the drift.

    F(t) = c (x(t - lag)^2 - m),     x: elevation, heave or pitch without its slow mean, m: mean of x^2 without faults
    c    = argmin sum_k (e + P c)' S^-1 (e + P c),   P: what a unit of the force adds to the filter's innovations e
    R^2  = 1 - S_F(with F) / S_F(without),  an axis; S_F by maximum likelihood, c of each half of the record used in the
           other half

The drift of a hull is the squared envelope of the waves times a coefficient [Newman1974]. The square of the elevation
is half that envelope plus an oscillation at twice the waves' frequency, which moves no vessel by a millimetre: no
filter stands between the probe and the force and it comes without delay; the 10 s of a low-pass would cost more of
the drift than they clean. A probe ahead sees a group before the vessel feels it; ``lag`` is read from the record. S_F
is what the filter must take for unknown: measurement noise, which hides the drift from any plain regression, is not in
it. F is fed on axes where R^2 is .8 and more: a poor force is one more disturbance.

What it cannot see: drift coefficients that depend on the period (c is that of the no-fault window's sea); waves from
another side than in that window; a probe that has lost its scale. In a gap F is that of the last ten minutes' mean.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit

from mooringdx.observers.kalman import Filter
from mooringdx.observers.matrices import Model
from mooringdx.types import Array, Check, locked, replace

ENOUGH = 0.8
"""R^2 from which on a learned force is fed forward."""
HARM = -0.1
"""R^2 under which a force that a vessel file tells is not."""
LONGEST_LAG = 60.0
"""s at full scale that a probe may be ahead of the vessel."""
SLOW_MEAN, MEMORY = 200.0, 600.0
"""s at full scale: memory of the mean that is taken out of an elevation, and of the square that stands in a gap."""
GAPS, FLAT = 0.05, 0.02
"""Share of a log that fed channels may miss, and their least median square over the no-fault mean."""
NARROW = float(np.radians(30.0))
"""Headings within this are one heading where shares are weighed."""
AXES = ("surge", "sway", "yaw")


@dataclass(frozen=True)
class Feed:
    """A force that is fed forward on the axes where it is ``on``, (3,).

    ``subject``: in words; ``channels``: (c,) names; ``lag``: s; ``mean``: (c,), of the squares without faults;
    ``gain``: (3, c), N and N m per unit squared, body axes; ``explained``: (3,), R^2 an axis.
    """

    subject: str
    channels: tuple[str, ...]
    lag: float
    mean: Array
    gain: Array
    explained: tuple[float, float, float]
    on: tuple[bool, bool, bool]

    def __post_init__(self) -> None:
        object.__setattr__(self, "mean", locked(self.mean))
        object.__setattr__(self, "gain", locked(self.gain))

    @property
    def sentence(self) -> str:
        """What was decided: "wave envelope: R^2 surge 0.97 on, sway 0.02 off, yaw 0.00 off; 18 s ahead"."""
        said = (f"{a} {r:.2f} {'on' if x else 'off'}" for a, r, x in zip(AXES, self.explained, self.on, strict=True))
        late = f"; {self.lag:g} s ahead" if self.lag else ""
        return f"{self.subject}: R^2 {', '.join(said)}{late}"

    def force(self, squares: Array, step: float, memory: float) -> Array:
        """Return the force in body axes, (n, 3), of the squares, (n, c), ``step`` s apart, NaN in gaps.

        ``memory``: s, of the mean that stands in a gap.
        """
        gain = np.where(np.array(self.on)[:, None], self.gain, 0.0)
        shape = bridged(squares, self.mean, memory / step) - self.mean
        return np.asarray(lagged(shape, round(self.lag / step)) @ gain.T)


@dataclass(frozen=True)
class Ground:
    """What a force is weighed on: a no-fault record, and the filter with the noise that was identified on it.

    ``measured``, ``force``: (n, 3); ``bias``: (3,); ``skip``: samples of start-up that are not weighed.
    """

    filtering: Filter
    measured: Array
    force: Array
    bias: Array
    skip: int

    def models(self) -> tuple[Model, ...]:
        """Return the filter's matrices over the record's headings."""
        return self.filtering.models(self.measured[:, 2])


def squared(values: Array, step: float, memory: float, thin: int) -> Array:
    """Return the squares about the slow mean so far, averaged over ``thin`` samples, (n // thin, c).

    ``values``: (n, c), NaN where missing, ``step`` s apart; ``memory``: s, of the mean. NaN where all ``thin`` miss.
    """
    about = values - running_mean(values, memory / step)
    n = len(about) // thin
    part = about[: n * thin].reshape(n, thin, -1) ** 2
    seen = np.isfinite(part)
    count = seen.sum(axis=1)
    total = np.where(seen, part, 0.0).sum(axis=1)
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


@njit(cache=True)
def running_mean(values: Array, memory: float) -> Array:
    """Return the mean so far of each column, (n, c), that forgets over ``memory`` samples; NaN is passed over."""
    out = np.zeros(values.shape)
    for j in range(values.shape[1]):
        mean, count = 0.0, 0.0
        for k in range(len(values)):
            if np.isfinite(values[k, j]):
                count += 1.0
                mean += (values[k, j] - mean) / min(count, memory)
            out[k, j] = mean
    return out


@njit(cache=True)
def bridged(squares: Array, start: Array, memory: float) -> Array:
    """Return the squares, (n, c), with every NaN replaced by their mean so far, which forgets over ``memory`` samples.

    ``start``: (c,), the mean before the first.
    """
    out = squares.copy()
    for j in range(squares.shape[1]):
        mean = start[j]
        for k in range(len(squares)):
            if np.isfinite(squares[k, j]):
                mean += (squares[k, j] - mean) / memory
            else:
                out[k, j] = mean
    return out


def lagged(values: Array, lag: int) -> Array:
    """Return rows ``lag`` samples later, zero before."""
    return np.concatenate([np.zeros((lag, *values.shape[1:])), values])[: len(values)] if lag else values


def candidates(names: Sequence[str]) -> tuple[tuple[str, tuple[str, ...], float], ...]:
    """Return what a log's channels may tell of the drift: in words, channels, and s at full scale they may be ahead."""
    waves = tuple(sorted(n for n in names if n.startswith("wave_elevation_")))
    motion = tuple(n for n in ("heave", "pitch") if n in names)
    found = (("wave envelope", waves, LONGEST_LAG), ("heave and pitch", motion, 0.0))
    return tuple(row for row in found if row[1])


def best_of(feeds: Sequence[Feed], always: bool = False) -> tuple[Feed, ...]:
    """Return the forces with each axis on in one of them at most: in the one that explains it best.

    ``always``: on whether it explains enough or not.
    """
    table = np.array([feed.explained for feed in feeds])
    out = []
    for i, feed in enumerate(feeds):
        surge, sway, yaw = ((always or feed.on[a]) and int(np.argmax(table[:, a])) == i for a in range(3))
        out.append(replace(feed, on=(surge, sway, yaw)))
    return tuple(out)


def learned(
    ground: Ground,
    names: Sequence[str],
    squares_of: Callable[[tuple[str, ...]], Array],
    per_second: float,
    always: bool = False,
) -> tuple[Feed, ...]:
    """Return every force that a log's channels, ``names``, may tell, learned and weighed.

    ``squares_of``: from channels to their squares, (n, c); ``per_second``: samples in a second at full scale;
    ``always``: on whether they explain enough or not.
    """
    feeds = []
    for subject, logged, ahead in candidates(names):
        moving = np.std(np.nan_to_num(squares_of(logged)), axis=0) > 0.0
        channels = tuple(name for name, live in zip(logged, moving, strict=True) if live)
        if channels:
            lags = range(round(ahead * per_second) + 1)
            feeds.append(weigh(ground, subject, channels, squares_of(channels), lags))
    return best_of(feeds, always) if feeds else ()


def weigh(ground: Ground, subject: str, channels: tuple[str, ...], squares: Array, lags: Sequence[int]) -> Feed:
    """Return the force of ``squares``, (n, c), that suits a record best, on where it explains enough.

    ``lags``: samples to try. What it explains is measured where it was not learned.
    """
    step = ground.filtering.step
    mean = np.nanmean(squares, axis=0)
    shape = np.where(np.isfinite(squares), squares, mean) - mean
    models = ground.models()
    quiet, answer = _answers(ground, models, shape)
    half = (ground.skip + len(shape)) // 2
    parts = (slice(ground.skip, half), slice(half, len(shape)))
    crossed = np.zeros(ground.force.shape)
    for learned, used in ((parts[0], slice(half, None)), (parts[1], slice(0, half))):
        lag, gain = _best(quiet, answer, models, learned, lags)
        crossed[used] = (lagged(shape, lag) @ gain.T)[used]
    explained = removed(ground, crossed)
    lag, gain = _best(quiet, answer, models, slice(ground.skip, None), lags)
    on = (explained[0] >= ENOUGH, explained[1] >= ENOUGH, explained[2] >= ENOUGH)
    return Feed(subject, channels, lag * step, mean, gain, explained, on)


def _answers(ground: Ground, models: tuple[Model, ...], shape: Array) -> tuple[Array, Array]:
    """Return the innovations, (n, 3), and what a unit of each force adds to them, (n, 3, 3 c): axis by column."""

    def innovations(force: Array) -> Array:
        return ground.filtering(ground.measured, force, bias=ground.bias, models=models).innovation

    quiet = innovations(ground.force)
    columns = []
    for axis in range(3):
        for column in shape.T:
            size = 0.1 * np.sqrt(ground.filtering.noise.force[axis]) / max(float(np.std(column)), 1e-300)
            pushed = np.array(ground.force)
            pushed[:, axis] += size * column
            columns.append((innovations(pushed) - quiet) / size)
    return quiet, np.stack(columns, axis=-1)


def _best(
    quiet: Array, answer: Array, models: tuple[Model, ...], rows: slice, lags: Sequence[int]
) -> tuple[int, Array]:
    """Return the lag and the gain, (3, c), that leave the least of the innovations in ``rows``."""
    inverse: Array = np.linalg.inv(models[len(models) // 2].S).astype(np.float64)
    tried = [_regressed(quiet[rows], lagged(answer, lag)[rows], inverse) for lag in lags]
    at = int(np.argmax([worth for worth, _ in tried]))
    return int(lags[at]), tried[at][1].reshape(3, -1)


def _regressed(quiet: Array, answer: Array, inverse: Array) -> tuple[float, Array]:
    """Return how many nats a regression of innovations explains, and its coefficients, (3 c,)."""
    good = np.isfinite(quiet).all(axis=1) & np.isfinite(answer).all(axis=(1, 2))
    weighted = np.einsum("nik,ij->njk", answer[good], inverse)
    square = np.einsum("njk,njl->kl", weighted, answer[good])
    cross = np.einsum("njk,nj->k", weighted, quiet[good])
    scale = np.sqrt(np.maximum(np.diag(square), 1e-300))
    found = -np.linalg.lstsq(square / np.outer(scale, scale), cross / scale, rcond=1e-9)[0] / scale
    return float(-0.5 * cross @ found), found


def removed(ground: Ground, force: Array) -> tuple[float, float, float]:
    """Return the share of S_F that a known ``force``, (n, 3), takes away, surge, sway and yaw; under 0 if it adds.

    All other noise stays as it is, so that what the force leaves cannot hide in the bias.
    """
    if float(np.std(force)) == 0.0:
        return 0.0, 0.0, 0.0
    before = _intensity(ground)
    after = _intensity(replace(ground, force=ground.force + force))
    surge, sway, yaw = (float(1.0 - b / a) for a, b in zip(before, after, strict=True))
    return surge, sway, yaw


def _intensity(ground: Ground) -> Array:
    """Return the S_F, (3,), that makes the record most likely, all other noise given.

    A heading that hardly wanders is frozen at its median: one matrix for all, at a fifth of the cost.
    """
    from scipy.optimize import minimize

    noise, headings = ground.filtering.noise, ground.measured[:, 2]
    middle, turning = float(np.nanmedian(headings)), bool(np.nanmax(headings) - np.nanmin(headings) > NARROW)

    def cost(theta: Array) -> float:
        surge, sway, yaw = np.exp(theta) * np.asarray(noise.force)
        filtering = replace(ground.filtering, noise=replace(noise, force=(float(surge), float(sway), float(yaw))))
        models = filtering.models(headings) if turning else (filtering.model(middle),)
        seen = filtering(ground.measured, ground.force, bias=ground.bias, models=models, turning=turning)
        nis = seen.nis[ground.skip :]
        value = 0.5 * (float(np.linalg.slogdet(models[len(models) // 2].S)[1]) + float(np.nanmean(nis)))
        return value if np.isfinite(value) else 1e6

    settings = {"eps": 1e-3, "maxiter": 30, "ftol": 1e-7}
    best = minimize(cost, np.zeros(3), method="L-BFGS-B", bounds=[(-7.0, 4.0)] * 3, options=settings)
    return np.asarray(np.exp(best.x) * np.asarray(noise.force))


def told(feeds: Sequence[Feed], wind: tuple[float, float, float] | None, squares: Sequence[Array]) -> list[Check]:
    """Return what is fed forward and why, and whether its channels still speak, as rows of a log's checks.

    ``wind``: R^2 of the vessel file's wind force, None where it was not weighed; ``squares``: of each force, (n, c).
    """
    out = []
    if wind is not None:
        said = ", ".join(f"{a} {r:.2f}" for a, r in zip(AXES, wind, strict=True))
        on = min(wind[:2]) >= HARM
        out.append(
            Check(
                "feed-forward", "wind", True, f"wind force of the vessel file: R^2 {said}; {'on' if on else 'off'}",
                max(wind), HARM, "1",
            )
        )  # fmt: skip
    for feed, seen in zip(feeds, squares, strict=True):
        out.append(Check("feed-forward", feed.subject, True, feed.sentence, max(feed.explained), ENOUGH, "1"))
        if any(feed.on):
            out.append(_speaks(feed, seen))
    return out


def _speaks(feed: Feed, squares: Array) -> Check:
    """Return whether a force's channels were there, and moved: a dead one takes the mean drift away."""
    gaps = 1.0 - float(np.isfinite(squares).all(axis=1).mean())
    size = np.nanmedian(squares, axis=0) / feed.mean
    good = gaps <= GAPS and bool((size >= FLAT).all())
    return Check(
        "fed channels", feed.subject, good,
        f"{100.0 * gaps:.1f} % missing; median square {float(np.min(size)):.2g} of the mean (no fault: .45)",
        gaps, GAPS, "1",
        "" if good else "the drift is unknown where they are silent: mend them, or fit without them",
    )  # fmt: skip
