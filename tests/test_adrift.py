"""Adrift or moved: against enumerated paths, a plain twin, made tracks with known truth, and its own symmetries."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from mooringdx.config import AdriftPart
from mooringdx.hypotheses import HYPOTHESES
from mooringdx.hypotheses.adrift import CALLS, Adrift, Verdict, events, judge
from mooringdx.hypotheses.adrift.kernel import advance, depart, run, spatial_median, watch_circle, weigh
from mooringdx.hypotheses.adrift.nouns import HOLDING, LEARNING, NOT_HOLDING, SERVICE, WARNING, Numbers
from mooringdx.hypotheses.adrift.verdict import numbers
from mooringdx.types import Channels, Event, Grid, LogSource

Floats = NDArray[np.float64]
DAY = 86400.0
SETTINGS = AdriftPart()
NUMBERS = numbers(SETTINGS)


def circle(days: int, seed: int, sd: float = 0.6, phi: float = 0.8) -> Floats:
    """A buoy in its watch circle, (days, 2), km: first-order autoregression, independent per axis."""
    out = np.zeros((days, 2))
    for axis, stream in enumerate(np.random.SeedSequence(seed).spawn(2)):
        shocks = np.random.default_rng(stream).normal(0.0, sd * np.sqrt(1 - phi**2), days)
        for k in range(1, days):
            out[k, axis] = phi * out[k - 1, axis] + shocks[k]
    return out


def shifted(track: Floats, day: int, by: tuple[float, float]) -> Floats:
    out = track.copy()
    out[day:] += by
    return out


def drifting(track: Floats, day: int, stop: int, per_day: tuple[float, float]) -> Floats:
    out = track.copy()
    out[day:] += np.minimum(np.arange(1, track.shape[0] - day + 1), stop - day)[:, None] * np.array(per_day)
    return out


def verdict_of(track: Floats, days: Floats | None = None) -> Verdict:
    time = np.arange(track.shape[0]) * DAY if days is None else days * DAY
    return judge(time, track[:, 0] * 1000.0, track[:, 1] * 1000.0, SETTINGS)


def events_of(track: Floats, days: Floats | None = None) -> tuple[Event, ...]:
    return events(verdict_of(track, days), SETTINGS)


def without(track: Floats, start: int, stop: int) -> Floats:
    out = track.copy()
    out[start:stop] = np.nan
    return out


# ---------------------------------------------------------------- the filter


def lognormal(value: float, median: float, log_sd: float) -> float:
    z = np.log(value / median) / log_sd
    return float(np.exp(-z * z / 2) / (value * log_sd * np.sqrt(2 * np.pi)))


def densities(length: float, days: float, scale: float, n: Numbers) -> tuple[list[float], float]:
    """Density of a step when moving (one a cause) and when held."""
    speed, length = max(length / days, 0.1), max(length, 0.1)
    own = [lognormal(speed, n.speed_median[c], n.speed_log_sd[c]) for c in range(3)]
    common = sum(own) / 3
    moving = [common ** (1 - n.speed_weight) * o**n.speed_weight / days for o in own]
    held = length / scale**2 * (1 + length**2 / (n.held_dof * scale**2)) ** (-(n.held_dof + 2) / 2)
    return moving, held


def test_the_filter_is_the_sum_over_all_paths() -> None:
    """Brute force: enumerate every moving/held path of every cause over six steps."""
    steps, jump, scale = [(9.0, 1.0), (0.4, 1.0), (3.0, 2.0), (6.0, 1.0), (0.0, 1.0), (0.7, 3.0)], 11.0, 0.6
    weights = np.zeros(6)
    depart(weights, jump, NUMBERS)
    for length, days in steps:
        advance(weights, length, days, scale, NUMBERS)
    truth = np.zeros(6)
    for c in range(3):
        start = NUMBERS.prior[c] * lognormal(jump, NUMBERS.jump_median[c], NUMBERS.jump_log_sd[c])
        for path in itertools.product((0, 1), repeat=len(steps)):
            p, before = start, 0
            for now, (length, days) in zip(path, steps, strict=True):
                stop = 1 - (1 - NUMBERS.stop_chance[c]) ** days
                again = 1 - (1 - NUMBERS.departure_chance) ** days
                moving, held = densities(length, days, scale, NUMBERS)
                p *= {(0, 0): 1 - stop, (0, 1): stop, (1, 0): again, (1, 1): 1 - again}[before, now]
                p *= held if now else moving[c]
                before = now
            truth[2 * c + before] += p
    np.testing.assert_allclose(weights, truth / truth.sum(), rtol=1e-10)


def test_a_departure_without_a_jump_is_the_prior() -> None:
    weights = np.zeros(6)
    depart(weights, 0.0, NUMBERS)
    np.testing.assert_allclose(weights[::2], NUMBERS.prior / NUMBERS.prior.sum(), rtol=1e-15)
    assert not weights[1::2].any()


def test_travel_inside_the_warning_distance_is_not_called_lost() -> None:
    """By hand: the same weights and step, at 4 km and at 40 km from a circle whose warning distance is 5 km."""
    for d, call in ((4.0, WARNING), (40.0, NOT_HOLDING)):
        weights = np.array([0.01, 0.0, 0.04, 0.0, 0.95, 0.0])
        assert weigh(weights, WARNING, 0, 8.0, 1.0, d, 5.0, 0.6, NUMBERS)[0] == call


def test_spatial_median_and_radius() -> None:
    """Analytic: the centre of a symmetric cross; numpy's quantile; the shrunken radius by hand."""
    x, y = np.array([1.0, -1.0, 0.0, 0.0, 0.0]), np.array([0.0, 0.0, 2.0, -2.0, 0.0])
    np.testing.assert_allclose(spatial_median(x + 3.0, y - 1.0), (3.0, -1.0), atol=1e-9)
    a, b, radius = watch_circle(x, y, NUMBERS)
    by_hand = (10 * 1.5 + 5 * np.quantile(np.hypot(x - a, y - b), 0.95)) / 15
    assert radius == pytest.approx(by_hand, rel=1e-12)
    assert watch_circle(np.full(45, 7.0), np.full(45, 7.0), numbers(AdriftPart(radius_weight=1.0)))[2] == 0.8


# ---------------------------------------------------------------- the numba walk against a plain twin


class Twin:
    """The walk of kernel.run in plain numpy, written from the equations and rules of its docstring."""

    def __init__(self, n: Numbers) -> None:
        self.n, self.held, self.state, self.opened = n, np.zeros((0, 3)), LEARNING, -1

    def centre(self, xy: Floats) -> Floats:
        at = xy.mean(axis=0)
        for _ in range(60):
            w = 1 / np.sqrt(((xy - at) ** 2).sum(axis=1) + 0.01)
            at = (w[:, None] * xy).sum(axis=0) / w.sum()
        return at

    def learn(self) -> None:
        recent = self.held[-self.n.history :]
        self.at = self.centre(recent[:, :2])
        q95 = np.quantile(np.hypot(*(recent[:, :2] - self.at).T), 0.95)
        m, m0 = len(recent), self.n.radius_weight
        self.r = max(self.n.radius_floor, (m0 * self.n.radius_prior + m * q95) / (m0 + m))
        self.scale = max(self.n.held_scale, np.median(recent[:, 2]) / 1.1774100225154747)

    def step(self, weights: Floats, length: float, days: float) -> Floats:
        moving, held = densities(length, days, self.scale, self.n)
        out = np.zeros(6)
        again = 1 - (1 - self.n.departure_chance) ** days
        for c in range(3):
            stop = 1 - (1 - self.n.stop_chance[c]) ** days
            move = np.array([[1 - stop, stop], [again, 1 - again]])
            out[2 * c : 2 * c + 2] = (weights[2 * c : 2 * c + 2] @ move) * [moving[c], held]
        return out / out.sum()

    def leave(self, jump: float) -> Floats:
        w = np.zeros(6)
        w[::2] = self.n.prior
        if jump > 0:
            w[::2] *= [lognormal(jump, self.n.jump_median[c], self.n.jump_log_sd[c]) for c in range(3)]
        return w / w.sum()

    def walk(self, day: Floats, xy: Floats) -> tuple[Floats, Floats]:
        n, rows, level, w = self.n, [], 0.0, np.zeros(6)
        probability = np.zeros((len(day), 8))
        for k in range(len(day)):
            gap, move = (day[k] - day[k - 1], np.hypot(*(xy[k] - xy[k - 1]))) if k else (1.0, 0.0)
            if gap > (n.lost_gap if self.state >= WARNING else n.expired_gap):
                self.state, self.held = LEARNING, np.zeros((0, 3))
            if not len(self.held):
                self.at, self.r, level, self.scale = xy[k], max(n.radius_prior, n.radius_floor), 0.0, n.held_scale
            elif self.state < WARNING:
                self.learn()
            d, far = float(np.hypot(*(xy[k] - self.at))), max(n.warn_distance, n.warn_factor * self.r)
            if self.state == SERVICE:
                excess = d / (self.r / 2.4477468306808166) - n.cusum_allowance
                level = level + excess if excess > 0 else 0.0
                if d > far or level > n.cusum_level:
                    self.state, self.opened, still, jumped = WARNING, self.opened + 1, [], d > far
                    w = self.leave(d if jumped else 0.0)
            elif self.state == LEARNING and d > far:
                self.held, self.at, d = np.zeros((0, 3)), xy[k], 0.0
            elif self.state >= WARNING:
                if gap > n.departure_gap and (self.state != HOLDING or move > far):
                    w, still = self.leave(move if move > far else 0.0), []
                    self.state = NOT_HOLDING if self.state == NOT_HOLDING else WARNING
                else:
                    w = self.step(w, move, gap)
                    still = [*still, k] if w[1::2].sum() >= n.held else []
                    if w[2] + w[4] >= n.alarm and d > far:
                        self.state = NOT_HOLDING
                    elif w[1::2].sum() >= n.held:
                        self.state = HOLDING
            rows.append([*self.at, self.r, far, d, level, self.state, self.opened if self.state >= WARNING else -1])
            if self.state >= WARNING:
                probability[k, 2:] = w
                if len(still) >= n.learn_fixes:
                    self.held = self.held if jumped and d <= far else np.zeros((0, 3))
                    for i in still[-n.learn_fixes :]:
                        self.remember(xy, i)
                    self.state, level = SERVICE, 0.0
            else:
                probability[k, self.state] = 1.0
                self.remember(xy, k)
                if len(self.held) >= n.learn_fixes:
                    self.state = SERVICE
        return np.array(rows), probability

    def remember(self, xy: Floats, k: int) -> None:
        move = np.hypot(*(xy[k] - xy[k - 1])) if k and len(self.held) else 0.0
        self.held = np.vstack([self.held, [*xy[k], move]])


def eventful(seed: int) -> tuple[Floats, Floats]:
    """Days and track with a redeployment, a drag, a break-away, an excursion, a slow displacement and gaps."""
    track = circle(420, seed)
    track = shifted(track, 60, (9.0, -6.0))
    track = drifting(track, 110, 114, (5.0, 4.0))
    track[160] += (12.0, 0.0)
    track = shifted(track, 200, (0.0, 3.6))
    track = shifted(track, 203, (0.0, 1.0))
    track = drifting(track, 260, 290, (-14.0, 3.0))
    drop = np.random.default_rng(seed).random(420) < 0.06
    drop[[0, *range(270, 276), *range(330, 350), *range(360, 395)]] = [False] + 6 * [True] + 20 * [True] + 35 * [True]
    return np.flatnonzero(~drop).astype(np.float64), track[~drop]


@pytest.mark.parametrize("seed", range(6))
def test_numba_walk_equals_its_plain_twin(seed: int) -> None:
    day, xy = eventful(seed)
    trace = run(day, xy[:, 0].copy(), xy[:, 1].copy(), NUMBERS)
    rows, probability = Twin(NUMBERS).walk(day, xy)
    assert {WARNING, NOT_HOLDING, HOLDING} <= set(rows[:, 6])
    got = np.column_stack(
        [trace.centre, trace.radius, trace.limit, trace.offset, trace.cusum, trace.call, trace.episode]
    )
    np.testing.assert_allclose(got, rows, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(trace.probability, probability, rtol=1e-9, atol=1e-9)


# ---------------------------------------------------------------- symmetries


def test_causal_the_verdict_of_a_prefix_is_the_prefix() -> None:
    day, xy = eventful(1)
    whole = verdict_of(xy, day)
    for n in (1, 5, 62, 66, 115, 250, 262, day.size - 3):
        part = verdict_of(xy[:n], day[:n])
        for name in ("neutral", "radius", "offset", "call", "episode", "probability", "near", "rise"):
            np.testing.assert_array_equal(getattr(part, name), getattr(whole, name)[:n], err_msg=name)


def test_causal_on_a_grid_with_missing_days() -> None:
    day, xy = eventful(2)
    grid = np.full((420, 2), np.nan)
    grid[day.astype(int)] = xy
    whole = verdict_of(grid)
    for n in (100, 272, 336, 347, 380):
        np.testing.assert_array_equal(verdict_of(grid[:n]).probability, whole.probability[:n])
        np.testing.assert_array_equal(verdict_of(grid[:n]).call, whole.call[:n])
    np.testing.assert_array_equal(whole.call[whole.seen], verdict_of(xy, day).call)


def test_turning_and_shifting_the_track_changes_nothing_but_the_neutral_point() -> None:
    day, xy = eventful(3)
    angle = 1.234
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    here, there = verdict_of(xy, day), verdict_of(xy @ turn.T + (300.0, -5000.0), day)
    np.testing.assert_array_equal(here.call, there.call)
    np.testing.assert_allclose(here.probability, there.probability, atol=1e-7)
    np.testing.assert_allclose(here.radius, there.radius, rtol=1e-7)
    np.testing.assert_allclose(here.neutral @ turn.T + (3e5, -5e6), there.neutral, atol=1e-3)


def test_input_is_left_alone_and_rows_sum_to_one() -> None:
    day, xy = eventful(4)
    time, north, east = day * DAY, xy[:, 0] * 1e3, xy[:, 1] * 1e3
    before = time.copy(), north.copy(), east.copy()
    verdict = judge(time, north, east, SETTINGS)
    for a, b in zip((time, north, east), before, strict=True):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_allclose(verdict.probability.sum(axis=1), 1.0, atol=1e-12)
    with pytest.raises(ValueError, match="read-only"):
        verdict.probability[0, 0] = 1.0


# ---------------------------------------------------------------- made tracks with known truth


def test_a_held_buoy_is_left_in_peace() -> None:
    """Monte Carlo, seeded: ten buoys of 800 days in their circle give no warning."""
    assert sum(len(events_of(circle(800, seed))) for seed in range(10)) == 0


@pytest.mark.parametrize("seed", range(8))
def test_a_redeployment_is_called_moved_not_lost(seed: int) -> None:
    track = shifted(circle(120, seed), 70, (8.0, 8.0))
    (event,) = events_of(track)
    assert (event.kind, event.subject) == ("moved", "mooring")
    assert event.detected == 70 * DAY
    assert event.named is not None
    assert event.named <= 72 * DAY
    assert event.onset_interval == (69 * DAY, 70 * DAY)
    assert event.size == pytest.approx(1000 * np.hypot(8, 8), abs=2500)
    assert event.cleared is not None
    assert event.cleared <= 80 * DAY
    assert event.cannot_tell is not None
    assert "service visit" in event.cannot_tell
    assert event.rivals[0].kind == "mooring_lost"
    assert event.probability is not None
    assert event.probability >= 0.9
    assert verdict_of(track).call[-1] == SERVICE


@pytest.mark.parametrize("seed", range(8))
def test_a_break_away_is_called_lost_within_three_days(seed: int) -> None:
    track = drifting(circle(100, seed), 70, 100, (12.0, 9.0))
    (event,) = events_of(track)
    assert event.kind == "mooring_lost"
    assert event.detected == 70 * DAY
    assert event.named is not None
    assert 71 * DAY <= event.named <= 73 * DAY
    assert event.cleared is None
    assert event.evidence["cause"] == "adrift"
    assert event.rivals[0].kind == "moved"
    assert event.probability == pytest.approx(verdict_of(track).not_holding[int(event.named / DAY)])


@pytest.mark.parametrize("seed", range(8))
def test_a_drag_is_called_lost_and_cleared_when_it_holds(seed: int) -> None:
    (event,) = events_of(drifting(circle(130, seed), 70, 75, (5.5, 4.5)))
    assert event.kind == "mooring_lost"
    assert event.cleared is not None
    assert 74 * DAY <= event.cleared <= 78 * DAY
    assert verdict_of(drifting(circle(130, seed), 70, 75, (5.5, 4.5))).call[-1] == SERVICE


def test_one_stray_fix_is_a_warning_and_no_more() -> None:
    track = circle(120, 5)
    track[70] += (9.0, 0.0)
    (event,) = events_of(track)
    assert event.kind == "unknown"
    assert event.named is None
    assert event.probability is None
    assert event.cannot_tell is not None
    assert len(event.rivals) == 2
    assert event.cleared is not None


def test_a_lasting_displacement_inside_the_warning_distance_is_found_by_the_cusum() -> None:
    (event,) = events_of(shifted(circle(140, 6, sd=0.2), 80, (4.2, 0.0)))
    assert event.evidence["warned_by"] == "cusum"
    assert event.kind == "unknown"
    assert event.onset_interval[0] == 80 * DAY
    assert 80 * DAY < event.detected <= 85 * DAY


def test_nothing_is_said_of_what_cannot_be_seen() -> None:
    """A move inside the watch circle leaves no event, and the checks say that it would not."""
    track = shifted(circle(160, 7), 80, (0.6, 0.0))
    assert events_of(track) == ()
    rows = {c.name: c for c in Adrift()(channels_of(track))[2]}
    assert "inside its watch circle" in rows["not observable"].detail


# ---------------------------------------------------------------- gaps


def test_a_silence_while_held_that_outlasts_the_circle_starts_again() -> None:
    short = without(shifted(circle(150, 8), 90, (10.0, 0.0)), 70, 90)
    assert [e.kind for e in events_of(short)] == ["moved"]
    long = without(shifted(circle(150, 8), 110, (10.0, 0.0)), 70, 110)
    assert events_of(long) == ()
    call = verdict_of(long).call
    assert call[90] == SERVICE
    assert set(call[101:110]) == {LEARNING}
    assert call[-1] == SERVICE


def test_a_silence_under_warning_loses_the_buoy() -> None:
    lost = without(drifting(circle(150, 9), 70, 150, (12.0, 9.0)), 76, 100)
    (event,) = events_of(lost)
    assert event.kind == "mooring_lost"
    assert event.marks == ("contact_lost",)
    call = verdict_of(lost).call
    assert call[85] == NOT_HOLDING
    assert call[95] == LEARNING


def test_after_a_gap_of_days_the_next_fix_is_a_new_departure() -> None:
    """Four days of silence under warning: no verdict on the unseen step; the weights are those of a departure."""
    track = shifted(shifted(circle(120, 10), 70, (8.0, 8.0)), 71, (30.0, 0.0))
    verdict = verdict_of(without(track, 71, 75))
    after = verdict.probability[75, 2:]
    assert not after[1::2].any()
    assert verdict.call[75] == WARNING


def test_a_held_buoy_stays_held_over_a_gap() -> None:
    verdict = verdict_of(without(shifted(circle(120, 11), 70, (8.0, 8.0)), 73, 78))
    assert verdict.call[72] == HOLDING
    assert verdict.call[78] == HOLDING


# ---------------------------------------------------------------- edges and the bank on channels


def channels_of(track: Floats) -> Channels:
    values = track * 1000.0
    valid = np.isfinite(values)
    grid = Grid(0.0, DAY, track.shape[0])
    return Channels(("north", "east"), ("m", "m"), grid, values, valid, LogSource("made", "csv", 0, "0" * 64))


def test_the_bank_on_channels() -> None:
    track = without(drifting(circle(100, 12), 70, 100, (12.0, 9.0)), 40, 45)
    posterior, found, rows = HYPOTHESES["adrift"](SETTINGS)(channels_of(track))
    assert posterior.probability.shape == (100, 8)
    np.testing.assert_array_equal(posterior.probability, verdict_of(track).probability)
    assert [e.kind for e in found] == ["mooring_lost"]
    assert all(c.passed for c in rows)
    assert rows[1].value == pytest.approx(0.95)


def test_samples_that_are_not_valid_are_no_fixes() -> None:
    track = circle(100, 13)
    whole = channels_of(track)
    valid = np.array(whole.valid)
    valid[50, 0] = False
    values = np.array(whole.values)
    values[50] = 9e9
    masked = Channels(whole.names, whole.units, whole.grid, values, valid, whole.source)
    assert Adrift()(masked)[1] == ()


def test_repeated_nominal_positions_are_judged_and_remarked() -> None:
    track = np.zeros((100, 2))
    track[60:] = (0.0, 12.0)
    posterior, found, rows = Adrift()(channels_of(track))
    assert [e.kind for e in found] == ["moved"]
    assert np.isfinite(posterior.probability).all()
    failed = [c for c in rows if not c.passed]
    assert [c.name for c in failed] == ["repeated positions"]
    assert failed[0].remedy


def test_a_record_without_fixes_says_that_nothing_is_known() -> None:
    posterior, found, rows = Adrift()(channels_of(np.full((10, 2), np.nan)))
    assert found == ()
    assert set(posterior.probability[:, 0]) == {1.0}
    assert not rows[0].passed


def test_wrong_input_is_refused() -> None:
    ones = np.ones(3)
    with pytest.raises(ValueError, match="does not rise"):
        judge(ones, ones, ones, SETTINGS)
    with pytest.raises(ValueError, match="differ"):
        judge(np.arange(3.0), ones[:2], ones, SETTINGS)
    with pytest.raises(ValidationError):
        AdriftPart(stop_chance=(0.9, 1.2, 0.03))
    assert len(CALLS) == 5
