"""Hand-made `Detection` nouns for the tests of plots and report.

A moored 3-DOF model ship at model scale on six lines, waves of Tp 1.5 s, Ts 0.1 s, 25 min; line_4 is lost at 1300 s.
Everything is simulated closely enough to look like a real record (colour, drift after the loss, gaps), and nothing
here is a claim about the method: the numbers in the events are chosen, not detected.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from scipy.signal import lfilter

from mooringdx.types import (
    Array,
    Channels,
    Check,
    Defect,
    Detection,
    Event,
    Fault,
    Grid,
    LogSource,
    Posterior,
    Residuals,
    Rival,
    Signatures,
    Statistic,
    Threshold,
    Whitened,
    replace,
)

LINES = tuple(f"line_{j}" for j in range(1, 7))
AZIMUTH = np.radians(np.arange(30.0, 360.0, 60.0))
ONSET, WINDOW, MEMORY = 1300.0, (180.0, 1240.0), 150
DAY = 86400.0
MONTH = 30 * DAY


def _colour(rng: np.random.Generator, n: int) -> Array:
    """Wave-frequency noise of unit sd with a little broad-band noise."""
    angle = 2 * np.pi * 0.1 / 1.5
    wave = lfilter([1.0], [1.0, -2 * 0.975 * np.cos(angle), 0.975**2], rng.standard_normal(n))
    return np.asarray(wave / wave.std() + 0.15 * rng.standard_normal(n))


def _slow(rng: np.random.Generator, n: int) -> Array:
    """Low-frequency motion, period about 40 s."""
    angle = 2 * np.pi * 0.1 / 40.0
    slow = lfilter([1.0], [1.0, -2 * 0.9985 * np.cos(angle), 0.9985**2], rng.standard_normal(n))
    return np.asarray(slow / slow.std())


def _source(path: str, size: int) -> LogSource:
    return LogSource(path=path, format="csv", bytes=size, sha256="9f2c" + "0123456789abcdef" * 3 + "77aa01be55d0")


def _channels(n: int, onset: float | None, gauge: float | None = None, seed: int = 4) -> Channels:
    rng = np.random.default_rng(seed)
    grid = Grid(start=0.0, sample_time=0.1, n=n)
    t = grid.time
    north = 0.05 + 0.012 * _slow(rng, n) + 0.008 * _colour(rng, n)
    east = -0.02 + 0.015 * _slow(rng, n) + 0.006 * _colour(rng, n)
    heading = np.radians(1.5 * _slow(rng, n) + 0.8 * _colour(rng, n))
    after = np.zeros(n)
    if onset is not None:
        late = np.maximum(t - onset, 0.0)
        after = 1.0 - np.exp(-late / 18.0) * np.cos(2 * np.pi * late / 45.0)
        north = north - 0.16 * np.cos(AZIMUTH[3]) * after
        east = east - 0.16 * np.sin(AZIMUTH[3]) * after
    columns = [north, east, heading]
    for j, azimuth in enumerate(AZIMUTH):
        pull = -(np.cos(azimuth) * (north - 0.05) + np.sin(azimuth) * (east + 0.02))
        tension = 6.0 + 9.0 * pull + 0.25 * _colour(rng, n)
        if j == 3 and onset is not None:
            tension = np.where(t < onset, tension, 0.03 + 0.02 * rng.standard_normal(n))
        if j == 2 and gauge is not None:
            tension = tension + np.where(t < gauge, 0.0, 0.6)
        columns.append(tension)
    names = ("north", "east", "heading", *(f"tension_{j}" for j in range(1, 7)))
    units = ("m", "m", "rad", *(["N"] * 6))
    values = np.column_stack(columns)
    return Channels(names, units, grid, values, np.isfinite(values), _source("data/tank_run_07.csv", 2_105_331))


def _signatures(names: tuple[str, ...]) -> Signatures:
    lines = tuple(Fault("line_lost", line) for line in LINES)
    gauges = tuple(Fault("sensor_fault", f"tension_{j}", "bias") for j in range(1, 7))
    gone = np.zeros((6, 8))
    gone[:, 2:] = -np.eye(6)
    gone[:, 0], gone[:, 1] = -0.02 * np.cos(AZIMUTH), -0.02 * np.sin(AZIMUTH)
    wrong = np.zeros((6, 8))
    wrong[:, 2:] = np.eye(6)
    return Signatures(
        faults=lines + gauges,
        residuals=names,
        matrix=np.vstack([gone, wrong]),
        units=("N",) * 12,
        total=np.r_[np.full(6, 6.0), np.full(6, np.nan)],
        sign=np.r_[np.ones(6), np.zeros(6)],
    )


def _residuals(grid: Grid, onset: float | None, gauge: float | None, seed: int = 9) -> tuple[Residuals, Whitened]:
    rng = np.random.default_rng(seed)
    names = ("learned_north", "learned_east", *(f"learned_tension_{j}" for j in range(1, 7)))
    units = ("m", "m", *(["N"] * 6))
    sd = np.r_[0.004, 0.004, np.full(6, 0.12)]
    signatures = _signatures(names)
    step = np.zeros((grid.n, 8))
    if onset is not None:
        step[grid.index(onset) :] += 5.4 * signatures.matrix[3]
    if gauge is not None:
        step[grid.index(gauge) :] += 0.6 * signatures.matrix[8]
    noise = np.column_stack([_colour(rng, grid.n) for _ in range(8)])
    values = sd * noise + step
    angle = 2 * np.pi * 0.1 / 1.5
    ar = [1.0, -2 * 0.975 * np.cos(angle), 0.975**2]
    white = lfilter(ar, [1.0, -0.6], values / sd, axis=0)
    white /= white[2000:8800].std(axis=0)
    white /= 1 + np.abs(white) / 3.0
    valid = np.ones((grid.n, 8), dtype=bool)
    late = valid.copy()
    late[:300] = False
    white = np.where(late, white, np.nan)
    raw = Residuals(names, units, grid, values, valid, signatures)
    return raw, Whitened(names, grid, white, late, signatures, "arma+fang")


def _glrt(residuals: Residuals, memory: int, quiet_window: tuple[float, float]) -> Array:
    """Moving-window energy of each fault's direction, (n, f), near 0.5 when nothing is wrong."""
    quiet = residuals.values[residuals.grid.window(quiet_window)]
    z = (residuals.values - quiet.mean(axis=0)) / quiet.std(axis=0)
    directions = residuals.signatures.matrix / quiet.std(axis=0)
    directions = directions / np.linalg.norm(directions, axis=1)[:, None]
    total = np.cumsum(np.vstack([np.zeros((1, z.shape[1])), np.nan_to_num(z)]), axis=0)
    mean = (total[memory:] - total[:-memory]) / memory
    quiet_sd = mean[residuals.grid.window(quiet_window)].std(axis=0) @ np.abs(directions.T)
    g = 0.5 * (mean @ directions.T / quiet_sd) ** 2
    return np.vstack([np.full((memory - 1, g.shape[1]), np.nan), g])


def _statistic(residuals: Residuals, branch: str, memory: int, quiet: tuple[float, float]) -> Statistic:
    labels = tuple(f.label for f in residuals.signatures.faults)
    return Statistic(branch, labels, residuals.grid, _glrt(residuals, memory, quiet))


def _threshold(statistic: Statistic, verdict: str, share: float, window: tuple[float, float]) -> Threshold:
    quiet = statistic.values[statistic.grid.window(window)]
    quiet = quiet[np.isfinite(quiet).all(axis=1)]
    scale = 2.0 * quiet.mean(axis=0)
    pooled = np.sort((quiet / scale).ravel())
    pick = np.unique(np.r_[np.geomspace(1, pooled.size - 1, 160).astype(int)])
    curve = np.column_stack([pooled[::-1][pick], (pick + 0.5) / pooled.size])[::-1]
    reasons = {
        "supported": "the no-fault record covers a tenth of the asked interval between alarms",
        "extrapolated": "the asked interval between alarms is 2,440 times the no-fault record of 18 min",
        "invalid": "the no-fault record holds 37 independent windows; at least 40 are needed",
    }
    asked = share / MONTH
    return Threshold(
        branch=statistic.branch,
        level=30.0 * scale,
        scale=scale,
        asked_rate=asked,
        central_rate=asked * 0.4,
        rate_interval=(share / (10 * 365.25 * DAY), share / (3 * DAY)),
        scaled_level=30.0,
        scaled_interval=(22.0, 48.0),
        probability=1.2e-7,
        cluster_length=7.0,
        independent_windows=70.7,
        drift_ratio=0.88,
        verdict=verdict,
        reason=reasons[verdict],
        tail={"degrees": 1.0, "median": 0.2275, "shape": 0.85, "central_level": 28.0},
        curve=curve,
    )


def _provenance(source: LogSource) -> dict[str, Any]:
    return {
        "mooringdx": "0.1.0",
        "configuration_digest": "c0ffee" + "12" * 29,
        "command": "mooringdx run configs/runs/tank.toml -o reports/tank",
        "log": {"path": source.path, "sha256": source.sha256},
        "versions": {"python": "3.11.9", "numpy": "2.4.1", "scipy": "1.17.0"},
    }


RUN: dict[str, Any] = {
    "clock": {"sample_time": 0.1, "max_gap": 1.0},
    "residuals": {"use": ["learned"], "learned": {"lags": 5, "ridge": 1e-6}},
    "detector": {"kind": "glrt", "window": 15.0},
    "alarm": {"rate": "0.03333333333333333/day", "assurance": 0.9},
}
CHOICE = (
    {"whitening": "none", "smallest line_lost line_4": 0.31, "rate": 1.0, "taken": False},
    {"whitening": "arma", "smallest line_lost line_4": 0.12, "rate": 1.0, "taken": False},
    {"whitening": "arma + fang", "smallest line_lost line_4": 0.1, "rate": 1.0, "taken": True},
)
CHECKS = (
    Check("whiteness", "learned_tension_4", True, "Ljung-Box over N at wave-period lags", 0.05, 0.2, "1"),
    Check("drift", "system", True, "slow drift ratio R of the whitened residuals", 0.88, 1.2, "1"),
    Check("range", "heading", True, "inside the plausible range", 0.09, 3.15, "rad"),
)


def rate(verdict: str) -> dict[str, Any]:
    """Alarm rates of the system, per second, as `decide` gives them."""
    return {
        "asked": 1 / MONTH,
        "central": 0.4 / MONTH,
        "interval": (1 / (10 * 365.25 * DAY), 1 / (3 * DAY)),
        "verdict": verdict,
    }


def _build(onset: float | None, gauge: float | None, verdict: str, n: int = 15000, **changes: Any) -> Detection:
    channels = _channels(n, onset, gauge)
    residuals, whitened = _residuals(channels.grid, onset, gauge)
    quiet = changes.get("no_fault", (WINDOW,))[0]
    statistics = (_statistic(residuals, "main", MEMORY, quiet), _statistic(residuals, "short", 20, quiet))
    fields: dict[str, Any] = {
        "name": "tank_run_07",
        "verdict": "fault_found",
        "channels": channels,
        "residuals": residuals,
        "whitened": whitened,
        "statistics": statistics,
        "thresholds": tuple(
            _threshold(s, verdict, share, quiet) for s, share in zip(statistics, (0.8, 0.1), strict=True)
        ),
        "posteriors": (),
        "events": (),
        "checks": CHECKS,
        "no_fault": (WINDOW,),
        "alarm_rate": rate(verdict),
        "choice": CHOICE,
        "run": RUN,
        "provenance": _provenance(channels.source),
    }
    return Detection(**(fields | changes))


@lru_cache
def line_lost(n: int = 15000) -> Detection:
    """line_4 lost at 1300 s; its gauge is the stated rival."""
    event = Event(
        kind="line_lost",
        subject="line_4",
        onset=1300.1,
        onset_interval=(1299.2, 1300.8),
        detected=1301.6,
        named=1316.6,
        size=5.4,
        size_unit="N",
        size_interval=(5.1, 5.7),
        probability=0.97,
        rivals=(Rival("sensor_fault", "tension_4", 0.03, "the vessel moved away from anchor 4 as a loss predicts"),),
        evidence={"detector": "glrt", "branch": "main", "peak": 812.4, "threshold": 10.3, "channels": ["tension_4"]},
    )
    return _build(ONSET, None, "supported", n, events=(event,))


def _forces(grid: Grid, change: float, seed: int = 5) -> Residuals:
    """The balance of forces: a slow common force, and a difference that steps with line_4 (or with its gauge)."""
    rng = np.random.default_rng(seed)
    names = tuple(f"{word} {axis}" for word in ("common", "difference") for axis in ("force north", "force east"))
    towards = np.r_[np.cos(AZIMUTH[3]), np.sin(AZIMUTH[3])]
    late = (grid.time >= ONSET)[:, None]
    common = 0.08 * np.column_stack([_slow(rng, grid.n) for _ in range(2)])
    across = 0.5 * late * np.r_[-towards[1], towards[0]]
    difference = 0.02 * np.column_stack([_colour(rng, grid.n) for _ in range(2)]) + change * late * towards
    values = np.hstack([common + 0.5 * change * late * towards + across, difference])
    faults = (Fault("line_lost", "line_4"), Fault("sensor_fault", "tension_4"), Fault("environment", "force"))
    matrix = np.vstack([np.r_[towards / 2, towards], np.r_[-towards / 2, towards], np.r_[towards, 0.0, 0.0]])
    signatures = Signatures(faults, names, matrix, ("N",) * 3, np.full(3, np.nan), np.r_[-1.0, 0.0, 0.0])
    return Residuals(names, ("N",) * 4, grid, values, np.isfinite(values), signatures)


@lru_cache
def untold() -> Detection:
    """line_4 or its gauge, with the force across the line grown in the same minute: the forces refuse to tell."""
    why = "the environment changed at the same time (force across the line 2.6 times its limit)"
    event = Event(
        kind="unknown",
        subject="line_4",
        onset=1300.1,
        onset_interval=(1299.2, 1300.8),
        detected=1301.6,
        named=1316.6,
        size=-3.9,
        size_unit="N",
        size_interval=(-4.1, -3.7),
        rivals=(
            Rival("line_lost", "line_4", 0.62, why),
            Rival("sensor_fault", "tension_4", 0.38, why),
            Rival("environment", "force", 0.5, "the force changed across the line as well"),
        ),
        cannot_tell=f"line_4 lost or sensor tension_4 wrong: {why}",
        evidence={
            "detector": "glrt (main branch)",
            "peak": 812.4,
            "threshold": 10.3,
            "channels": ["tension_4"],
            "discrimination": 6.1,
            "log_likelihood_ratio": 0.5,
            "environment_gate": 2.6,
            "cause_told": 1343.0,
        },
    )
    base = _build(ONSET, None, "supported", events=(event,))
    return replace(base, name="tank_run_11", forces=_forces(base.channels.grid, -3.9))


@lru_cache
def sensor_fault() -> Detection:
    """Gauge 3 reads 0.6 N too much from 900 s; extrapolated threshold; two faults cannot be told apart."""
    event = Event(
        kind="sensor_fault",
        subject="tension_3",
        mode="bias",
        onset=899.8,
        onset_interval=(898.0, 901.5),
        detected=902.4,
        named=917.4,
        cleared=1402.0,
        size=0.61,
        size_unit="N",
        size_interval=(0.55, 0.66),
        probability=0.72,
        rivals=(Rival("line_weakened", "line_3", 0.28, "the vessel did not move, which a small loss also allows"),),
        cannot_tell="A bias of tension_3 and a small loss of buoyancy on line_3 give the same residuals here.",
        evidence={"detector": "glrt", "branch": "main", "peak": 58.1, "threshold": 10.3, "channels": ["tension_3"]},
        marks=("extrapolated_threshold",),
    )
    second = Event("environment", "sea", 1210.0, (1190.0, 1230.0), 1236.0, cleared=1260.0, probability=0.6)
    failed = Check(
        "independent windows", "baseline", False, "too few for the asked rate", 70.7, 4800.0, "1", "Record 20 h more."
    )
    return _build(
        None, 900.0, "extrapolated", events=(event, second), checks=(*CHECKS, failed), no_fault=((180.0, 880.0),)
    )


@lru_cache
def nothing_found() -> Detection:
    """A healthy record."""
    return replace(_build(None, None, "supported"), verdict="nothing_found", name="tank_run_02")


@lru_cache
def cannot_be_judged() -> Detection:
    """A record whose baseline supports no rate; no statistic was allowed."""
    base = _build(None, None, "invalid")
    failed = Check("valid share", "log", False, "valid samples in all channels", 0.31, 0.5, "1", "Log the tensions.")
    return replace(
        base,
        verdict="cannot_be_judged",
        statistics=(),
        thresholds=(),
        whitened=None,
        residuals=None,
        checks=(failed, *CHECKS),
        no_fault=(),
        choice=(),
    )


@lru_cache
def dirty() -> Detection:
    """The lost line in a record with gaps, a stuck heading, spikes, and hostile names."""
    base = line_lost()
    rng = np.random.default_rng(3)
    valid = base.channels.valid.copy()
    for start in rng.integers(0, 14000, 14):
        valid[start : start + int(rng.integers(10, 600))] = False
    valid[4000:5200, 2] = False
    values = np.where(valid, base.channels.values, np.nan)
    values[7000, 4] = np.nan
    defects = (
        Defect(
            "stuck", ("heading",), 400.0, 520.0, 120.0, "s", "heading held while the others moved", True, (119, 121)
        ),
        Defect("gap", ("north", "east"), 610.0, 655.0, 45.0, "s", "no samples"),
    )
    keep = valid.all(axis=1)[:, None]
    residuals = base.residuals
    whitened = base.whitened
    assert residuals is not None
    assert whitened is not None
    stuck = Event(
        "sensor_fault",
        "heading",
        400.0,
        (399.9, 400.1),
        401.0,
        401.0,
        520.0,
        "stuck",
        120.0,
        "s",
        (119.0, 121.0),
        evidence={"detector": "align", "channels": ["heading"]},
    )
    return replace(
        base,
        name='run <3> & "co"',
        channels=replace(base.channels, values=values, valid=valid, defects=defects),
        residuals=replace(residuals, values=np.where(keep, residuals.values, np.nan), valid=residuals.valid & keep),
        whitened=replace(whitened, values=np.where(keep, whitened.values, np.nan), valid=whitened.valid & keep),
        statistics=tuple(replace(s, values=np.where(keep, s.values, np.nan)) for s in base.statistics),
        events=(stuck, *base.events),
        checks=(
            Check("gaps", "log", False, "24 gaps, longest 58.9 s", 58.9, 1.0, "s", "Masked; mend the logger."),
            *base.checks,
        ),
        no_fault=(),
    )


@lru_cache
def adrift() -> Detection:
    """A buoy with one position a day from 1986-03-07 12:00Z; adrift from day 300."""
    rng = np.random.default_rng(11)
    n, gone = 322, 300
    epoch_ns = 510_580_800 * 10**9
    grid = Grid(start=0.0, sample_time=DAY, n=n, epoch_ns=epoch_ns)
    wander = lfilter([1.0], [1.0, -0.8], rng.normal(0, 700.0, (n, 2)), axis=0)
    late = np.maximum(np.arange(n) - gone + 1, 0)[:, None]
    values = np.array([-1900.0, 60400.0]) + wander + late * np.array([9000.0, -26000.0]) / 2
    valid = np.ones((n, 2), dtype=bool)
    valid[120:131] = False
    values = np.where(valid, values, np.nan)
    channels = Channels(("north", "east"), ("m", "m"), grid, values, valid, _source("data/0n110w.csv", 1_204_551))
    signatures = Signatures((), ("offset_north", "offset_east"), np.zeros((0, 2)), (), np.zeros(0), np.zeros(0))
    neutral = np.nanmedian(values[:gone], axis=0)
    residuals = Residuals(("offset_north", "offset_east"), ("m", "m"), grid, values - neutral, valid, signatures)
    log_odds = np.clip(late[:, 0] * 2.6 - 1.5, -6, 9) * (late[:, 0] > 0) - 6.0 * (late[:, 0] == 0)
    p = 1 / (1 + np.exp(-log_odds))
    probability = np.column_stack([1 - p, 0.15 * p, 0.85 * p])
    posterior = Posterior("adrift", ("held", "drag", "adrift"), grid.time, probability)
    event = Event(
        kind="mooring_lost",
        subject="mooring",
        onset=gone * DAY,
        onset_interval=((gone - 1) * DAY, gone * DAY),
        detected=gone * DAY,
        named=(gone + 2) * DAY,
        size=30.4e3,
        size_unit="m",
        size_interval=(29.0e3, 32.0e3),
        probability=0.94,
        rivals=(Rival("moved", "mooring", 0.06, "it moved on each of the last three days"),),
        cannot_tell="Position alone cannot tell which part of a single-point mooring failed.",
        evidence={"detector": "adrift", "peak": 0.94, "threshold": 0.9, "channels": ["north", "east"]},
    )
    return Detection(
        name="0n110w",
        verdict="fault_found",
        channels=channels,
        residuals=residuals,
        whitened=None,
        statistics=(),
        thresholds=(),
        posteriors=(posterior,),
        events=(event,),
        checks=(Check("gaps", "north", False, "one gap of 11 days", 11.0, 3.0, "d", "The next fix was re-acquired."),),
        no_fault=((0.0, 200 * DAY),),
        alarm_rate={},
        choice=(),
        run={"bank": {"use": ["adrift"]}},
        provenance=_provenance(channels.source),
    )


ALL = {
    "line_lost": line_lost,
    "sensor_fault": sensor_fault,
    "nothing_found": nothing_found,
    "cannot_be_judged": cannot_be_judged,
    "dirty": dirty,
    "adrift": adrift,
    "untold": untold,
}
