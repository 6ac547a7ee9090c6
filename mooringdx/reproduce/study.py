"""One run of the experiment of [Fang2015, sections 2.2-3.2], with every series that its figures show.

    z     = [r_1, r_2, r_5+j]'                           whitened, then compressed            [Fang2015, eqs. 4-10]
    g(k)  = (M/2) (G' Q^-1 (zbar(k) - mu0))^2 / (G' Q^-1 G),  zbar over the last M samples    [Fang2015, eq. 15]
    gamma = scale (-ln P)^(1/shape),   scale, shape of the Weibull law of g without fault     [Fang2015, eqs. 20-22]
    P     = D Ts / (n T)

G is the direction in which the loss of a buoyancy element on line j moves z, Q the lag-0 covariance of z and mu0 its
mean over the no-fault window. Departures from the print: eq. 15 lacks the factor M/2 (without it 2 g is no chi-square),
and the P of eq. 22 is "very low" and per sample: here it follows from one false alarm in T on n lines with clusters of
D samples [Siegmund1985]. The level beside it is that of Gaussian window means of the same variance: P = Q(g), the tail
of half a chi-square.

What it cannot see: the paper's own records, which are not public. Every number is of a simulated twin.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import erfc, log, sqrt

import numpy as np

from mooringdx.baseline import Baseline
from mooringdx.config import RunConfig
from mooringdx.detectors.design import Design
from mooringdx.detectors.glrt import Glrt
from mooringdx.detectors.reference import Reference
from mooringdx.errors import ReportError
from mooringdx.reproduce.acceleration import SURGE, SWAY, pick, vector
from mooringdx.threshold.fit import level_for
from mooringdx.threshold.tails import cluster_law, count_clusters, weibull
from mooringdx.types import Array, Channels, Detection, Grid, Mask, Residuals, Whitened, locked, replace
from mooringdx.whiten.compress import fit_compression
from mooringdx.whiten.whitener import fit_whitener

WINDOWS = (400, 150)
SETTLE = 20.0
"""s after the onset that the distribution "after" leaves out: the vessel swings to its new place."""


@dataclass(frozen=True)
class Series:
    """One residual on its way: ``raw`` in ``unit``, ``white`` and ``packed`` (compressed) unit-free; (n,) each,
    NaN where masked. ``symbol`` is the paper's name; ``trend``: slope (unit/s) and value at the window's middle.
    """

    symbol: str
    name: str
    unit: str
    raw: Array
    white: Array
    packed: Array
    trend: tuple[float, float]

    def __post_init__(self) -> None:
        for key in ("raw", "white", "packed"):
            object.__setattr__(self, key, locked(getattr(self, key)))


@dataclass(frozen=True)
class Course:
    """The statistic g over a window of M samples. ``values``: (n,), NaN before the first full window.

    ``scale``, ``shape`` of the Weibull law of the no-fault values ``quiet``; ``level`` from it at ``probability`` a
    sample; ``ideal_level``: for the same rate by the law of Gaussian window means; ``weibull_rate``: alarms per second
    of the line at ``level`` by that law; ``cluster`` in samples; ``alarm``: s, first passing after the onset (None:
    never); ``before``: samples above the level before it.
    """

    window: int
    values: Array
    quiet: Array
    scale: float
    shape: float
    probability: float
    cluster: float
    level: float
    ideal_level: float
    weibull_rate: float
    alarm: float | None
    before: int

    def __post_init__(self) -> None:
        for key in ("values", "quiet"):
            object.__setattr__(self, key, locked(getattr(self, key)))


@dataclass(frozen=True)
class Orders:
    """Whitening before compressing against after it, on the tension residual: effect sizes and the shift found."""

    kurtosis: tuple[float, float]
    ljung_box: tuple[float, float]
    contrast: tuple[float, float]


@dataclass(frozen=True)
class Study:
    """All that figures and claims are made from. ``onset``: s; ``asked``: false alarms per second of all lines;
    ``quiet``: (n,) no-fault window; ``late``: (n,) after the fault; ``rivals``: each line's statistic one window after.
    """

    detection: Detection
    baseline: Baseline
    onset: float
    line: str
    asked: float
    quiet: Mask
    late: Mask
    force: Series
    tension: Series
    courses: tuple[Course, ...]
    orders: Orders
    rivals: dict[str, float]

    @property
    def window(self) -> tuple[float, float]:
        """The no-fault window, s."""
        return self.detection.no_fault[0]

    @property
    def sample_time(self) -> float:
        """Sample time, s."""
        return self.detection.channels.grid.sample_time


@dataclass(frozen=True)
class Repeat:
    """The outcome on a further record: ``delays`` in s (None: never) and samples above the level ``before`` the fault,
    one for each of WINDOWS; ``named``: the right line has the largest statistic one window after.
    """

    seed: int
    delays: tuple[float | None, ...]
    before: tuple[int, ...]
    named: bool


def analyse(baseline: Baseline, detection: Detection, onset: float, line: str) -> Study:
    """Return the study of one detection. ``onset``: s, of the fault; ``line``: the line that has it, "line_4"."""
    if detection.residuals is None or baseline.fitted is None or not detection.no_fault:
        raise ReportError("the run has no residuals or no no-fault window on this log; fit on the log itself")
    run = baseline.config()
    measured = vector(detection.channels, detection.residuals, run)
    grid = measured.grid
    quiet, late = np.zeros(grid.n, np.bool_), np.zeros(grid.n, np.bool_)
    piece = grid.window(detection.no_fault[0])
    quiet[piece] = True
    late[grid.index(onset + SETTLE) :] = True
    whitener = fit_whitener(
        [(measured, piece)],
        "arma+compression",
        compression=run.whitening.compression,
        peak_period=baseline.fitted.timing.peak_period,
    )
    packed, white = whitener(measured), whitener.uncompressed()(measured)
    own = pick(measured.names, f"tension_{line.removeprefix('line_')}")
    force, tension = (
        _series(symbol, name, measured, white, packed, quiet) for symbol, name in (("r1", SURGE), ("r5", own))
    )
    return Study(
        detection=detection,
        baseline=baseline,
        onset=onset,
        line=line,
        asked=run.alarm.rate,
        quiet=quiet,
        late=late,
        force=force,
        tension=tension,
        courses=_courses(packed, line, quiet, onset, run),
        orders=either_order(measured, own, quiet, onset),
        rivals=_rivals(packed, quiet, onset),
    )


def repeat(channels: Channels, run: RunConfig, study: Study, seed: int) -> Repeat:
    """Return the outcome of the same method, fitted anew on another record of the same experiment."""
    from mooringdx.residuals import fit
    from mooringdx.residuals.training import Training

    assert study.baseline.fitted is not None
    piece = channels.grid.window(study.window)
    quiet = np.zeros(channels.grid.n, np.bool_)
    quiet[piece] = True
    alone = run.model_copy(update={"residuals": run.residuals.model_copy(update={"use": ["tension"]})})
    measured = vector(channels, fit([Training(channels, (piece,))], alone)(channels), run)
    period = study.baseline.fitted.timing.peak_period
    law = run.whitening.compression
    packed = fit_whitener([(measured, piece)], "arma+compression", compression=law, peak_period=period)(measured)
    courses = _courses(packed, study.line, quiet, study.onset, run)
    rivals = _rivals(packed, quiet, study.onset)
    return Repeat(
        seed=seed,
        delays=tuple(None if c.alarm is None else c.alarm - study.onset for c in courses),
        before=tuple(c.before for c in courses),
        named=max(rivals, key=lambda line: rivals[line]) == study.line,
    )


def _courses(packed: Whitened, line: str, quiet: Mask, onset: float, run: RunConfig) -> tuple[Course, ...]:
    share = run.alarm.rate / len(packed.signatures.faults)
    grid = packed.grid
    return tuple(judge(statistic(packed, line, quiet, m), quiet, grid, m, onset, share) for m in WINDOWS)


def _series(symbol: str, name: str, measured: Residuals, white: Whitened, packed: Whitened, quiet: Mask) -> Series:
    i = measured.names.index(name)
    raw = np.where(measured.valid[:, i], measured.values[:, i], np.nan)
    time = measured.grid.time
    ok = quiet & np.isfinite(raw)
    slope, level = np.polyfit(time[ok] - time[ok].mean(), raw[ok], 1)
    return Series(
        symbol, name, measured.units[i], raw, white.values[:, i], packed.values[:, i], (float(slope), float(level))
    )


def statistic(whitened: Whitened, line: str, quiet: Mask, window: int) -> Array:
    """Return g of one line, (n,): the vector detector of eq. 15 on r1, r2 and its tension, lag-0 covariance."""
    names = (SURGE, SWAY, pick(whitened.names, f"tension_{line.removeprefix('line_')}"))
    row = next(i for i, f in enumerate(whitened.signatures.faults) if f.subject == line)
    index = [whitened.names.index(n) for n in names]
    z, valid = whitened.values[:, index], whitened.valid[:, index]
    calm = z[quiet & valid.all(axis=1)]
    reference = Reference(calm.mean(axis=0), calm.std(axis=0))
    direction = np.asarray(whitened.signatures.matrix[row : row + 1, index])
    design = Design((line,), direction, np.zeros(1), np.cov(calm.T), window, reference)
    return np.asarray(Glrt(design)(replace(whitened, names=names, values=z, valid=valid)).values[:, 0])


def judge(g: Array, quiet: Mask, grid: Grid, window: int, onset: float, share: float) -> Course:
    """Fit the Weibull law to the no-fault values of ``g``, set the level. ``share``: alarms per second of one line."""
    dt, inside = grid.sample_time, quiet.copy()
    inside[: int(np.argmax(quiet)) + window] = False  # windows that begin before the no-fault window
    calm = g[inside & np.isfinite(g)]
    if calm.size < 2:
        raise ReportError(f"the no-fault window holds no value of the statistic of {window} samples; make it longer")
    fit = weibull(calm, np.ones((1, calm.size)))
    scale, shape = float(fit.parameters["scale"][0]), float(fit.parameters["shape"][0])
    half, start = 2.0 * float(calm.mean()), float(np.quantile(calm, 0.9))
    above, found = count_clusters(np.ascontiguousarray(calm), start, window // 2)

    def cluster(level: float) -> float:
        law = cluster_law(np.array([start, level]) / half, window)
        return max(1.0, above / max(found, 1) * float(law[1] / law[0]))

    def rate(level: float) -> float:
        return erfc(sqrt(level / half)) / (dt * cluster(level))

    level = 10.0 * half
    for _ in range(60):  # P needs the cluster length at the level, the level needs P
        probability = min(0.5, share * dt * cluster(level))
        level = scale * (-log(probability)) ** (1.0 / shape)
    late = grid.time[g > level]
    after = late[late >= onset]
    return Course(
        window=window,
        values=g,
        quiet=calm,
        scale=scale,
        shape=shape,
        probability=probability,
        cluster=cluster(level),
        level=level,
        ideal_level=half * level_for(lambda at: rate(half * at), share),
        weibull_rate=rate(level),
        alarm=float(after[0]) if after.size else None,
        before=int((late < onset).sum()),
    )


def _rivals(packed: Whitened, quiet: Mask, onset: float) -> dict[str, float]:
    """Return each line's statistic over the first whole window of 150 samples after the onset."""
    at = packed.grid.index(onset) + WINDOWS[-1]
    lines = [fault.subject for fault in packed.signatures.faults]
    return {line: float(statistic(packed, line, quiet, WINDOWS[-1])[at]) for line in lines}


def either_order(measured: Residuals, name: str, quiet: Mask, onset: float) -> Orders:
    """Return effect sizes of one residual whitened then compressed (first of each pair), and the other way round."""
    i = measured.names.index(name)
    x, ok = np.array(measured.values[:, [i]]), np.asarray(measured.valid[:, [i]])
    x -= x[quiet & ok[:, 0]].mean()
    first = int(np.argmax(quiet))
    piece = slice(first, first + int(quiet.sum()))
    signatures = replace(measured.signatures, residuals=(name,), matrix=measured.signatures.matrix[:, [i]],
                         error=measured.signatures.error[:, [i]])  # fmt: skip
    one = replace(measured, names=(name,), units=(measured.units[i],), values=x, valid=ok, signatures=signatures)
    before = fit_compression([x[piece][ok[piece]]], "fang", 3.0)(x)
    white = fit_whitener([(one, piece)], "arma+compression")(one)
    other = replace(one, values=before)
    turned = fit_whitener([(other, piece)], "arma")(other)
    rows = [_effects(w.values[:, 0], piece, measured.grid.index(onset)) for w in (white, turned)]
    a, b = rows
    return Orders((a[0], b[0]), (a[1], b[1]), (a[2], b[2]))


def _effects(z: Array, piece: slice, onset: int) -> tuple[float, float, float]:
    """Return excess kurtosis, LB(20)/N, and the shift of the mean in 15 s after the onset over the sd of such means."""
    from mooringdx.whiten.whiteness import whiteness

    calm = whiteness([z[piece]])
    window = WINDOWS[-1]
    x = z[piece][np.isfinite(z[piece])]
    means = np.convolve(x, np.ones(window) / window, mode="valid")
    shift = float(np.nanmean(z[onset : onset + window])) - float(x.mean())
    return calm.excess_kurtosis, calm.ljung_box, abs(shift) / float(means.std())
