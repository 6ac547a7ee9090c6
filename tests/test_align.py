"""Alignment: stamps, spikes, resampling, holds, lags. Truth: analytic, plain-numpy twins, the measured flume runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mooringdx.config import ClockPart, Zero
from mooringdx.errors import ConfigError, LogError
from mooringdx.logs import resample as rs
from mooringdx.logs import spikes as sp
from mooringdx.logs import stuck as st
from mooringdx.logs.align import align
from mooringdx.logs.lag import low_pass
from mooringdx.logs.stamps import find_steps, order
from mooringdx.types import Channels, Check, Defect, LogSource, RawLog, Signal

SOURCE = LogSource("made.csv", "csv", 0, "")
FLUME = Path(__file__).parents[2] / "shared" / "data" / "flume"
HEALTHY = ("3101_3", "3101_4", "3102_1", "3111_2", "4101_2", "5101_1", "6111_1")
CAMERA = {"camera": ["sway", "heave", "roll"]}


def log_of(**signals: tuple[np.ndarray, np.ndarray]) -> RawLog:
    return RawLog({n: Signal(n, t, x, "m") for n, (t, x) in signals.items()}, SOURCE)


def wave(t: np.ndarray, period: float = 1.5, slow: float = 25.0) -> np.ndarray:
    return np.sin(2 * np.pi * t / period) + 0.7 * np.sin(2 * np.pi * t / slow + 0.4)


def sea(t: np.ndarray, seed: int, period: float = 1.5, slow: float = 20.0) -> np.ndarray:
    """Return irregular motion: 40 wave components about ``period``, 20 slow ones about ``slow``, unit variance each."""
    rng = np.random.default_rng(seed)
    x = np.zeros_like(t)
    for centre, count in ((period, 40), (slow, 20)):
        f = rng.normal(1.0, 0.15, count).clip(0.6, 1.5) / centre
        phase = rng.uniform(0, 2 * np.pi, count)
        x += np.sqrt(2.0 / count) * np.cos(2 * np.pi * f * t[:, None] + phase).sum(axis=1)
    return x


def check(c: Channels, name: str) -> Check:
    return next(k for k in c.checks if k.name == name)


def of(c: Channels, mode: str) -> list[Defect]:
    return [d for d in c.defects if d.mode == mode]


# --- stamps ---------------------------------------------------------------------------------------------------------


def test_a_clean_log_on_its_own_clock_comes_back_bit_for_bit() -> None:
    t = 0.05 + 0.1 * np.arange(1000)
    c = align(log_of(sway=(t, wave(t)), heave=(t, wave(t, 2.0))), ClockPart(sample_time=0.1))
    assert c.grid.start == pytest.approx(0.05)  # the log's own phase: nothing is interpolated that need not be
    assert c.valid.all()
    np.testing.assert_array_equal(c.column("sway"), wave(t))
    assert all(k.passed for k in c.checks)
    assert c.defects == ()


def test_duplicates_and_late_samples_are_counted_and_mended() -> None:
    t = 0.1 * np.arange(400)
    x = wave(t)
    logged = np.concatenate([np.arange(400), [57, 57, 200]])
    logged[[100, 101]] = logged[[101, 100]]
    tt, xx = t[logged], np.array(x[logged])
    xx[-1] += 9.0  # a second value for a stamp that is taken: the first one counts
    at = np.argsort(np.concatenate([np.arange(400), [57.1, 57.2, 200.1]]), kind="stable")
    c = align(log_of(sway=(tt[at], xx[at])), ClockPart(sample_time=0.1))
    np.testing.assert_allclose(c.column("sway"), x, atol=1e-12)
    assert of(c, "duplicate")[0].value == 3.0
    assert of(c, "out_of_order")[0].value == 1.0
    assert not check(c, "duplicate stamps").passed or check(c, "duplicate stamps").value <= 1.0


def test_a_shuffled_log_is_sorted_and_a_block_written_late_is_no_clock_step() -> None:
    t = 0.1 * np.arange(500)
    mixed = np.random.default_rng(1).permutation(500)
    blocks = np.concatenate([np.arange(250, 500), np.arange(250)])
    for places in (mixed, blocks):
        c = align(log_of(sway=(t[places], wave(t)[places])), ClockPart(sample_time=0.1))
        np.testing.assert_allclose(c.column("sway"), wave(t), atol=1e-12)
        assert of(c, "clock_step") == []
        assert not check(c, "out-of-order stamps").passed


def test_a_clock_set_back_is_found_with_its_size_and_the_log_goes_on() -> None:
    true = 0.1 * np.arange(1000)
    stamps = np.where(true >= 60.0, true - 7.0, true)
    (step,) = find_steps(stamps, 1.0)
    assert step.index == 600
    assert step.size == pytest.approx(7.0)
    c = align(log_of(sway=(stamps, wave(true)), heave=(stamps, wave(true, 2.0))), ClockPart(sample_time=0.1))
    np.testing.assert_allclose(c.column("sway"), wave(true), atol=1e-9)
    (defect,) = of(c, "clock_step")
    assert defect.subjects == ("sway", "heave")
    assert defect.value == pytest.approx(-7.0)
    assert not check(c, "clock steps").passed


def test_a_clock_of_one_signal_set_back_is_believed_and_the_overlap_left_out() -> None:
    true = 0.1 * np.arange(1000)
    stamps = np.where(true >= 60.0, true - 7.0, true)
    c = align(log_of(sway=(true, wave(true)), heave=(stamps, wave(stamps))), ClockPart(sample_time=0.1))
    k = c.names.index("heave")
    np.testing.assert_allclose(c.values[c.valid[:, k], k], wave(c.grid.time[c.valid[:, k]]), atol=1e-9)
    assert of(c, "clock_step")[0].subjects == ("heave",)


def test_impossible_stamps_are_dropped_and_an_endless_grid_is_refused() -> None:
    t = 0.1 * np.arange(300)
    damaged = np.concatenate([[1.7e9], t[:150], [-4e8], t[150:]])
    x = np.concatenate([[0.0], wave(t)[:150], [0.0], wave(t)[150:]])
    c = align(log_of(sway=(damaged, x)), ClockPart(sample_time=0.1))
    assert c.grid.n == 300
    np.testing.assert_allclose(c.column("sway"), wave(t), atol=1e-12)
    half = np.concatenate([t, 1.7e9 + t])
    with pytest.raises(LogError, match="too many samples"):
        align(log_of(sway=(half, np.arange(600.0))), ClockPart(sample_time=0.1))


def test_whole_second_stamps_of_a_ten_hertz_log_are_spread() -> None:
    t = 0.1 * np.arange(600)
    o = order(np.floor(t + 1e-9), wave(t), (), False)
    np.testing.assert_allclose(o.time, t, atol=1e-9)
    assert o.doubled == 0
    assert o.spread == 540


def test_no_usable_sample_is_a_sentence() -> None:
    with pytest.raises(LogError, match="no usable sample in sway"):
        align(log_of(sway=(np.arange(3.0), np.full(3, np.nan))), ClockPart(sample_time=1.0))


def test_a_channel_without_numbers_is_masked_beside_a_good_one() -> None:
    t = 0.1 * np.arange(100)
    c = align(log_of(sway=(t, wave(t)), heave=(t, np.full(100, np.nan))), ClockPart(sample_time=0.1))
    assert not c.valid[:, 1].any()
    assert np.isnan(c.column("heave")).all()
    assert not check(c, "usable samples").passed


# --- gaps -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("native", [0.1, 0.01])
def test_ten_percent_in_gaps_is_masked_there_and_nothing_else_changes(native: float) -> None:
    rng = np.random.default_rng(7)
    n = int(1800.0 / native)
    t = native * np.arange(n)
    keep = np.ones(n, dtype=bool)
    while keep.mean() > 0.9:
        a, length = rng.uniform(0, 1790), rng.uniform(1.0 + 2 * native, 60.0)
        keep &= ~((t > a) & (t < a + length))
    clock = ClockPart(sample_time=0.1)
    whole = align(log_of(sway=(t, wave(t))), clock)
    holed = align(log_of(sway=(t[keep], wave(t[keep]))), clock)
    grid_keep = keep[:: round(0.1 / native)][: holed.grid.n]
    interior = np.convolve(grid_keep, np.ones(3), "same") == 3
    assert holed.grid == whole.grid
    assert not holed.valid[~np.convolve(grid_keep, np.ones(3), "same").astype(bool), 0].any()
    assert holed.valid[interior, 0].all()
    # at the gap's edge within half a sample: real data for at least half of the kernel, else masked
    assert np.mean(holed.valid[:, 0] != grid_keep) < 2e-3
    both = holed.valid[:, 0]
    error = np.abs(holed.column("sway") - whole.column("sway"))[both]
    assert error.max() < (1e-12 if native == 0.1 else 0.08)
    assert np.mean(error > 2e-3) < 0.02
    lost = sum(d.value for d in of(holed, "gap"))
    assert lost == pytest.approx(float((~keep).sum()) * native, rel=0.02)


def test_one_missing_sample_is_bridged_and_five_are_not() -> None:
    t = 0.1 * np.arange(200)
    keep = np.ones(200, dtype=bool)
    keep[50] = keep[100:105] = False
    c = align(log_of(sway=(t[keep], wave(t[keep]))), ClockPart(sample_time=0.1, max_gap=1.0))
    assert c.valid[50, 0]
    assert c.column("sway")[50] == pytest.approx(0.5 * (wave(t)[49] + wave(t)[51]))
    assert not c.valid[100:105, 0].any()
    assert of(c, "gap") == []  # shorter than max_gap: masked, but no gap to report


def test_a_slow_sensor_is_interpolated_and_one_slower_than_the_gap_is_named() -> None:
    t, slow = 0.1 * np.arange(600), np.arange(60.0)
    rough = slow + 0.03 * np.random.default_rng(0).standard_normal(60)  # a jitter about max_gap is no gap
    c = align(log_of(sway=(t, wave(t)), wind_speed=(rough, 5 + 0.1 * rough)), ClockPart(sample_time=0.1))
    k = c.names.index("wind_speed")
    inside = (c.grid.time > rough[0]) & (c.grid.time < rough[-1])
    assert c.valid[inside, k].all()
    np.testing.assert_allclose(c.values[inside, k], 5 + 0.1 * c.grid.time[inside], atol=1e-9)
    late = align(log_of(sway=(t, wave(t)), wind_speed=(slow[::5], slow[::5])), ClockPart(sample_time=0.1))
    assert check(late, "sampling").subject == "wind_speed"
    assert "max_gap" in check(late, "sampling").remedy


def test_daily_fixes_pass_untouched_with_a_jump_for_one_day() -> None:
    t = 86400.0 * np.arange(400)
    x = 1000.0 * np.random.default_rng(3).standard_normal(400)
    x[200] += 60e3
    c = align(log_of(north=(t, x)), ClockPart(sample_time=86400.0, max_gap=129600.0))
    np.testing.assert_array_equal(c.column("north"), x)
    assert of(c, "spike") == []


# --- resampling -----------------------------------------------------------------------------------------------------


def kernel(u: np.ndarray) -> np.ndarray:
    return np.where(np.abs(u) <= rs.HALF, np.sinc(0.8 * u) * np.cos(np.pi * u / (2 * rs.HALF)) ** 2, 0.0)


def plain_convolve(t: np.ndarray, x: np.ndarray, period: float, grid: np.ndarray, ts: float) -> np.ndarray:
    left, right = np.diff(t, prepend=t[0] - period), np.diff(t, append=t[-1] + period)
    w = 0.5 * (np.minimum(left, 1.5 * period) + np.minimum(right, 1.5 * period))
    fine = np.arange(rs.HALF * rs.TABLE) / rs.TABLE
    area = 2 * ts * np.abs(kernel(fine)).sum() / rs.TABLE
    out = np.full(grid.size, np.nan)
    for k, at in enumerate(grid):
        u = (t - at) / ts
        h = w * kernel(u)
        real = np.abs(h).sum()
        if real >= rs.FULL * area:
            out[k] = (h @ x) / h.sum()
        elif real >= 0.5 * area:
            g = w * np.where(np.abs(u) < rs.NEAR, np.cos(0.5 * np.pi * u / rs.NEAR) ** 2, 0.0)
            moments = np.array([[g.sum(), g @ u], [g @ u, g @ u**2]])
            out[k] = np.linalg.solve(moments, [g @ x, g @ (u * x)])[0]
    return out


def test_the_low_pass_equals_its_plain_twin_with_jitter_and_a_gap() -> None:
    rng = np.random.default_rng(5)
    t = np.sort(0.01 * np.arange(1500) + 0.002 * rng.standard_normal(1500))
    keep = (t < 6.0) | (t > 9.0)
    t, x = t[keep], wave(t[keep]) + 0.1 * rng.standard_normal(keep.sum())
    period = float(np.median(np.diff(t)))
    y, valid = rs.resample(t, x, period, 0.0, 0.1, 150, 1.0)
    twin = plain_convolve(t, x, period, 0.1 * np.arange(150), 0.1)
    np.testing.assert_array_equal(valid, np.isfinite(twin))
    np.testing.assert_allclose(y[valid], twin[valid], atol=1e-5)  # the kernel is tabulated at 1024 points a sample


def test_interpolation_equals_its_plain_twin() -> None:
    rng = np.random.default_rng(6)
    t = np.cumsum(rng.uniform(0.05, 0.3, 800))
    x = rng.standard_normal(800)
    period = float(np.median(np.diff(t)))
    y, valid = rs.resample(t, x, period, 0.0, 0.1, 1000, 0.25)
    at = 0.1 * np.arange(1000)
    right = np.clip(np.searchsorted(t, at), 1, t.size - 1)
    span, lower = t[right] - t[right - 1], at - t[right - 1]
    upper = t[right] - at
    close = (span <= 2.5 * period) | (np.minimum(lower, upper) <= 0.5 * period)
    close &= (span <= max(0.25, 1.5 * period)) & (at >= t[0]) & (at <= t[-1])
    on = np.abs(t[np.argmin(np.abs(t[:, None] - at), axis=0)] - at) <= 0.005
    np.testing.assert_array_equal(valid, close | on)
    np.testing.assert_allclose(y[close], np.interp(at, t, x)[close], atol=1e-12)


@pytest.mark.parametrize(
    ("hertz", "low", "high"),
    [(0.5, 0.997, 1.003), (2.0, 0.97, 1.03), (4.0, 0.45, 0.55), (7.0, 0, 0.01), (9.7, 0, 0.01)],
)
def test_decimating_keeps_the_band_and_does_not_alias(hertz: float, low: float, high: float) -> None:
    t = 0.005 * np.arange(20_000)
    y, valid = rs.resample(t, np.sin(2 * np.pi * hertz * t), 0.005, 0.0, 0.1, 1000, 1.0)
    inner = y[20:-20]
    at = 0.1 * np.arange(1000)[20:-20]
    gain = 2 * abs(np.mean(inner * np.exp(-2j * np.pi * hertz * at)))
    assert valid.all()
    assert low <= gain <= high
    if low > 0.9:  # and no delay
        np.testing.assert_allclose(inner, gain * np.sin(2 * np.pi * hertz * at), atol=2e-3)


def test_it_looks_no_further_ahead_than_it_says() -> None:
    t = 0.01 * np.arange(3000)
    x = wave(t)
    whole = rs.resample(t, x, 0.01, 0.0, 0.1, 300, 1.0)[0]
    changed = np.where(t > 20.0, 9.0, x)
    part = rs.resample(t, changed, 0.01, 0.0, 0.1, 300, 1.0)[0]
    same = np.flatnonzero(whole != part)
    assert same[0] * 0.1 >= 20.0 - rs.HALF * 0.1


def test_headings_are_unwrapped() -> None:
    t = 0.1 * np.arange(500)
    true = 6.0 + 0.02 * t
    log = RawLog({"heading": Signal("heading", t, true % (2 * np.pi), "rad")}, SOURCE)
    c = align(log, ClockPart(sample_time=0.2))
    np.testing.assert_allclose(c.column("heading"), 6.0 + 0.02 * c.grid.time, atol=2e-4)


def test_the_zero_is_the_median_over_its_window_of_the_named_channels_only() -> None:
    t = 0.1 * np.arange(1000)
    clock = ClockPart(sample_time=0.1, zero=Zero(channels=["sway"], window=(0.0, 15.0)))
    c = align(log_of(sway=(t, 5.0 + (t > 20) * 1.0), heave=(t, 3.0 + 0 * t + wave(t))), clock)
    assert c.column("sway")[0] == 0.0
    assert c.column("sway")[-1] == pytest.approx(1.0)
    np.testing.assert_array_equal(c.column("heave"), 3.0 + wave(t))
    late = ClockPart(sample_time=0.1, zero=Zero(channels=["sway"], window=(500.0, 515.0)))
    with pytest.raises(ConfigError, match="no usable sample of 'sway'"):
        align(log_of(sway=(t, wave(t))), late)
    with pytest.raises(ConfigError, match="did you mean 'sway'"):
        align(log_of(sway=(t, wave(t))), ClockPart(sample_time=0.1, groups={"camera": ["swaj"]}))


# --- spikes and range -----------------------------------------------------------------------------------------------


def test_isolated_spikes_are_found_exactly() -> None:
    t = 0.1 * np.arange(5000)
    x = sea(t, 2) + 0.01 * np.random.default_rng(0).standard_normal(t.size)
    where = [300, 1200, 1201, 2500, 2501, 2502, 4000]
    dirty = np.array(x)
    dirty[where] += np.where(np.array(where) > 2000, 30.0, -30.0)
    c = align(log_of(sway=(t, dirty)), ClockPart(sample_time=0.1))
    assert of(c, "spike")[0].value == len(where)
    masked = np.flatnonzero(~c.valid[:, 0])
    assert set(masked) <= set(where)
    np.testing.assert_allclose(c.column("sway")[c.valid[:, 0]], x[c.valid[:, 0]], atol=0.4)  # single ones are bridged
    assert check(c, "spikes").passed  # 7 of 5000


def stepping(kind: str) -> np.ndarray:
    rng = np.random.default_rng(9)
    t = 0.1 * np.arange(6000)
    noise = 0.01 * rng.standard_normal(t.size)
    match kind:
        case "step":
            return noise + 40.0 * (t > 300)
        case "staircase":
            return np.floor(t / 37.0)
        case "switch":
            return ((np.arange(t.size) % 97) < 2).astype(float)
        case "calm, then waves":
            return noise * 0.01 + sea(t, 1) * (t > 250)
        case "start of a noise fault":
            return noise + 5.0 * rng.standard_normal(t.size) * (t > 310.3)
        case "break with a snatch":
            return 4.0 + noise + 3.0 * (np.abs(t - 300.0) < 0.05) - 3.9 * (t > 300.05)
        case "quantised":
            return np.round(sea(t, 4), 1)
        case _:
            return np.where(np.arange(t.size) % 40 < 1, rng.standard_normal(t.size) * 30, noise)


@pytest.mark.parametrize(
    "kind",
    [
        "step",
        "staircase",
        "switch",
        "calm, then waves",
        "start of a noise fault",
        "break with a snatch",
        "quantised",
        "noisy",
    ],
)
def test_nothing_real_is_called_a_spike(kind: str) -> None:
    x = stepping(kind)
    mask, crowded = sp.find_spikes(0.1 * np.arange(x.size), x, 12.0, 1.0)
    assert not mask.any()
    assert (crowded > 0) == (kind == "noisy")


def test_the_spike_scan_equals_its_plain_twin() -> None:
    rng = np.random.default_rng(11)
    x = rng.standard_normal(3000)
    x[rng.integers(5, 2990, 40)] += 60.0 * rng.choice([-1, 1], 40)
    t = np.cumsum(rng.uniform(0.05, 0.4, 3000))
    limit = 12.0 * sp.change_scale(x)
    first, width = sp._scan(t, x, limit, 1.0)
    twin, i = [], 1
    while i < x.size - 1:
        up, step = x[i] - x[i - 1], 1
        for w in (1, 2, 3):
            b = i + w
            if abs(up) <= limit[i // sp.BLOCK] or b >= x.size or t[b] - t[i - 1] > 1.0:
                break
            down = x[b] - x[b - 1]
            back = abs(x[b] - x[i - 1]) <= 0.3 * min(abs(up), abs(down))
            if up * down < 0 and abs(down) > limit[i // sp.BLOCK] and back:
                twin.append((i, w))
                step = w
                break
        i += step
    assert list(zip(first.astype(int), width.astype(int), strict=True)) == twin
    assert len(twin) > 10


def test_values_outside_the_catalogue_are_masked() -> None:
    t = 0.1 * np.arange(600)
    x = 10.0 + wave(t)
    x[100:140] = 999.0  # m/s: a missing value that the logger wrote as a number
    log = RawLog({"wind_speed": Signal("wind_speed", t, x, "m/s")}, SOURCE)
    c = align(log, ClockPart(sample_time=0.1))
    assert of(c, "range")[0].value == 40.0
    assert np.nanmax(c.values) < 20.0
    assert not check(c, "plausible range").passed


# --- stuck ----------------------------------------------------------------------------------------------------------


def rig(t: np.ndarray, seed: int = 3) -> dict[str, np.ndarray]:
    """Return a moored section: sway, and the tensions of two opposite springs with gauge noise."""
    rng = np.random.default_rng(seed)
    sway = 0.01 * sea(t, seed)
    return {
        "sway": sway + 1e-5 * rng.standard_normal(t.size),
        "tension_1": 30.0 * sway + 0.005 * rng.standard_normal(t.size),
        "tension_2": -30.0 * sway + 0.005 * rng.standard_normal(t.size),
    }


def test_a_channel_held_while_the_others_move_is_an_event_and_masked() -> None:
    t = 0.1 * np.arange(6000)
    x = rig(t)
    x["tension_1"][4000:4100] = x["tension_1"][4000]
    c = align(log_of(**{k: (t, v) for k, v in x.items()}), ClockPart(sample_time=0.1))
    (stuck,) = [d for d in of(c, "stuck") if d.alarming]
    assert stuck.subjects == ("tension_1",)
    assert stuck.start == pytest.approx(400.0, abs=0.15)
    assert stuck.value == pytest.approx(9.9, abs=0.3)
    assert stuck.detected is not None
    assert 1.0 <= stuck.detected - stuck.start < 3.0
    assert not c.valid[4002:4098, 1].any()
    assert c.valid[:, [0, 2]].all()


@pytest.mark.parametrize("case", ["calm start", "short hold", "set point", "sample and hold", "constant", "clamped"])
def test_a_hold_that_proves_nothing_is_no_event(case: str) -> None:
    t = 0.1 * np.arange(6000)
    x = rig(t)
    match case:
        case "calm start":
            x = {
                k: np.where(t < 60.0, 1e-4 * np.random.default_rng(0).standard_normal(t.size), v) for k, v in x.items()
            }
            x["sway"][:600] = 0.0
        case "short hold":
            x["sway"][3000:3008] = x["sway"][3000]
        case "set point":
            x["x_set_point"] = np.floor(t / 100.0)
        case "sample and hold":
            x["sway"] = np.repeat(x["sway"][::20], 20)
        case "constant":
            x["sway"] = np.full(t.size, 0.3)
        case _:
            x["sway"] = 1e-6 * np.random.default_rng(1).standard_normal(t.size)
            x["sway"][2000:2100] = 0.0
    c = align(log_of(**{k: (t, v) for k, v in x.items()}), ClockPart(sample_time=0.1))
    assert [d for d in c.defects if d.alarming] == []
    assert c.valid.all()


def test_a_group_that_freezes_is_one_event() -> None:
    t = 0.1 * np.arange(6000)
    x = rig(t)
    x["heave"] = 0.01 * sea(t, 21)
    for name in ("sway", "heave"):
        x[name][3500:3600] = x[name][3500]
    c = align(
        log_of(**{k: (t, v) for k, v in x.items()}), ClockPart(sample_time=0.1, groups={"camera": ["sway", "heave"]})
    )
    (stuck,) = [d for d in of(c, "stuck") if d.alarming]
    assert set(stuck.subjects) == {"sway", "heave"}


def test_hold_runs_equal_their_plain_twin() -> None:
    x = np.round(np.random.default_rng(2).standard_normal(2000), 1)
    t = np.cumsum(np.where(np.arange(2000) % 191 == 0, 5.0, 0.1))
    start, stop = st.hold_runs(t, x, 0.0, 1.0)
    breaks = np.flatnonzero((np.diff(x) != 0.0) | (np.diff(t) > 1.0)) + 1
    np.testing.assert_array_equal(start, np.concatenate(([0], breaks)))
    np.testing.assert_array_equal(stop, np.concatenate((breaks - 1, [1999])))


# --- clock lag ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("late", [1.9, -2.4, 0.0])
def test_a_late_clock_is_measured_and_taken_off(late: float) -> None:
    t = 0.1 * np.arange(6000)
    x = rig(t)
    pairs = {k: (t + (late if k == "sway" else 0.0), v) for k, v in x.items()}
    clock = ClockPart(sample_time=0.1, groups={"camera": ["sway"]})
    c = align(log_of(**pairs), clock)
    if late == 0.0:
        assert of(c, "delay") == []
        return
    (lag,) = of(c, "delay")
    assert lag.value == pytest.approx(late, abs=0.1)
    assert lag.interval is not None
    assert lag.interval[0] < late < lag.interval[1]
    both = c.valid[:, 0] & c.valid[:, 1]
    assert np.corrcoef(c.values[both, 0], c.values[both, 1])[0, 1] > 0.98


def test_a_lag_is_not_read_from_the_waves_alone() -> None:
    t = 0.1 * np.arange(6000)
    x = np.sin(2 * np.pi * t / 1.5)  # one wave: 0.5 s late and 1 s early are the same
    c = align(log_of(sway=(t + 0.5, x), tension_1=(t, x)), ClockPart(sample_time=0.1))
    assert of(c, "delay") == []


def test_the_low_pass_for_lags_keeps_slow_and_drops_waves() -> None:
    t = 0.1 * np.arange(4000)
    slow = np.sin(2 * np.pi * t / 20.0)
    out = low_pass(slow + np.sin(2 * np.pi * t / 1.5), 0.33, 0.1)
    np.testing.assert_allclose(out[100:-100], slow[100:-100], atol=0.01)


# --- the measured runs ----------------------------------------------------------------------------------------------


def flume(run: str, sample_time: float) -> Channels:
    path = FLUME / f"{run}.csv.gz"
    if not path.exists():
        pytest.skip(f"needs {path.name} of the reference data folder beside the repository")
    data = np.genfromtxt(path, delimiter=",", names=True, deletechars="")
    columns = {
        "sway": "Sway_[m]",
        "heave": "Heave_[m]",
        "roll": "Roll_[rad]",
        "tension_SB": "Tension_SB_[N]",
        "tension_PS": "Tension_PS_[N]",
    }
    log = RawLog({k: Signal(k, data["Time_[s]"], data[c], "") for k, c in columns.items()}, SOURCE)
    zero = Zero(channels=["sway", "tension_SB", "tension_PS"], window=(0.0, 15.0))
    return align(log, ClockPart(sample_time=sample_time, zero=zero, groups=CAMERA))


@pytest.mark.reference
@pytest.mark.parametrize("sample_time", [0.02, 0.05])
@pytest.mark.parametrize("run", [*HEALTHY, "3012_1"])
def test_no_defect_alarms_on_a_run_without_one(run: str, sample_time: float) -> None:
    c = flume(run, sample_time)
    assert [d for d in c.defects if d.alarming] == []
    assert of(c, "spike") == []
    assert c.valid.mean() > 0.999


@pytest.mark.reference
@pytest.mark.parametrize("sample_time", [0.02, 0.05])
def test_the_frozen_camera_of_3031_2(sample_time: float) -> None:
    c = flume("3031_2", sample_time)
    (stuck,) = [d for d in c.defects if d.alarming]
    assert stuck.mode == "stuck"
    assert set(stuck.subjects) == {"sway", "heave", "roll"}
    assert stuck.start == pytest.approx(55.4, abs=0.2)
    assert stuck.detected is not None
    assert 55.4 < stuck.detected < 57.4
    assert not c.valid[c.grid.window((55.6, 64.0)), 0].any()


@pytest.mark.reference
@pytest.mark.parametrize("sample_time", [0.02, 0.05])
def test_the_late_camera_clock_of_3061_1(sample_time: float) -> None:
    c = flume("3061_1", sample_time)
    (lag,) = [d for d in c.defects if d.alarming]
    assert lag.mode == "delay"
    assert set(lag.subjects) == {"sway", "heave", "roll"}
    assert lag.value == pytest.approx(1.9, abs=0.2)
    assert lag.interval is not None
    assert lag.interval[0] < 1.9 < lag.interval[1]
    assert c.grid.start == 0.0
