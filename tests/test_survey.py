"""What is in a log: counts against hand-made damage, names against what logs are known to write, the page as drawn."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from mooringdx.logs.naming import guess_name, guess_names
from mooringdx.logs.survey import as_dict, survey
from mooringdx.plots.survey import HEIGHT, WIDTH, inspect_html, sparkline
from mooringdx.types import Check, LogSource, RawLog, Signal


def made(fmt: str = "csv", **signals: Signal) -> RawLog:
    return RawLog({s.name: s for s in signals.values()}, LogSource("logs/<made>.csv", fmt, 12, "ab"))


def damaged() -> RawLog:
    t = 0.1 * np.arange(1000)
    x = np.sin(t) + 0.01 * np.random.default_rng(0).standard_normal(1000)
    x[400:450] = x[400]
    x[7] = np.nan
    keep = np.ones(1000, dtype=bool)
    keep[600:650] = False
    stamps, values = t[keep], x[keep]
    stamps = np.concatenate([stamps[:100], stamps[99:]])  # one stamp twice
    values = np.concatenate([values[:100], values[99:]])
    stamps[[200, 201]], values[[200, 201]] = stamps[[201, 200]], values[[201, 200]]
    return made(a=Signal("T1 [kN]", stamps, values, "kN"), b=Signal("flag", t, np.ones(1000), ""))


def test_every_kind_of_damage_is_counted() -> None:
    tension, flag = survey(damaged())
    assert (tension.samples, tension.nonfinite, tension.duplicates, tension.out_of_order) == (951, 1, 1, 1)
    assert tension.rate == pytest.approx(10.0)
    assert tension.gaps == 1
    assert tension.longest_gap == pytest.approx(5.1)
    assert tension.stuck == 1
    assert tension.longest_stuck == pytest.approx(4.9)
    assert tension.span == pytest.approx(99.9)
    assert (tension.guess, tension.unit, tension.known) == ("tension_1", "kN", True)
    assert (flag.guess, flag.known) == ("x_flag", False)
    assert flag.min == flag.median == flag.max == 1.0


def test_rows_are_plain_json_and_an_empty_signal_has_none() -> None:
    rows = survey(made(a=Signal("void", np.arange(3.0), np.full(3, np.nan), "")))
    body = json.loads(json.dumps(as_dict(rows[0]), allow_nan=False))
    assert body["median"] is None
    assert body["nonfinite"] == 3


def test_a_message_log_keeps_topic_and_field() -> None:
    t = np.arange(5.0)
    row = survey(made("mcap", a=Signal("/vessel/pose pose.position.x", t, t, "", "/vessel/pose pose.position.x")))[0]
    assert (row.topic, row.field, row.guess) == ("/vessel/pose", "pose.position.x", "north")


@pytest.mark.parametrize(
    ("text", "unit", "name"),
    [
        ("x", "m", "north"),
        ("y", None, "east"),
        ("psi", "deg", "heading"),
        ("HDG", "deg", "heading"),
        ("yaw", "rad", "yaw"),
        ("T1", "kN", "tension_1"),
        ("tension_12", "N", "tension_12"),
        ("FAIRTEN1", "N", "tension_1"),
        ("Line1", None, "tension_1"),
        ("Line 3 tension [kN]", "kN", "tension_3"),
        ("line_length_2", "m", "line_length_2"),
        ("Tension_SB [N]", "N", "tension_SB"),
        ("lat_deg", "deg", "latitude"),
        ("lon_east_deg", "deg", "longitude"),
        ("WindSpeed", "knots", "wind_speed"),
        ("wind_dir", "deg", "wind_direction"),
        ("eta", "m", "wave_elevation_1"),
        ("WP_3 [m]", "m", "wave_elevation_3"),
        ("Hs", "m", "wave_height"),
        ("Tp", "s", "wave_period"),
        ("Roll [rad]", "rad", "roll"),
        ("pitch", None, "pitch"),
        ("Heave [m]", "m", "heave"),
        ("ACC_SWAY [m/s2]", "m/s2", "accel_y"),
        ("thruster_2", "N", "thruster_2"),
        ("Force_Sway [N]", "N", "x_force_sway"),
        ("WM_Position", None, "x_wm_position"),
        ("T1", "degC", "x_t1"),
        ("roll", "N", "x_roll"),
        ("%", None, "x_channel"),
    ],
)
def test_names_that_logs_write(text: str, unit: str | None, name: str) -> None:
    assert guess_name(text, unit).name == name


@pytest.mark.parametrize(
    ("topic", "field", "name"),
    [
        ("/mooring/tensions", "data[3]", "tension_4"),
        ("/mooring/tension_2", "data", "tension_2"),
        ("/imu", "linear_acceleration.x", "accel_x"),
        ("/wind", "speed", "wind_speed"),
        ("/vessel/status", "brake_active", "x_vessel_status_brake_active"),
    ],
)
def test_fields_of_messages(topic: str, field: str, name: str) -> None:
    assert guess_name(field, None, topic).name == name


def test_two_columns_never_get_one_name() -> None:
    guesses = guess_names([("heading", "deg", ""), ("psi", "deg", ""), ("odd", None, ""), ("odd", None, "")])
    assert [g.name for g in guesses] == ["heading", "x_psi", "x_odd", "x_odd_2"]
    assert guesses[1].reason == "heading is already taken"


def test_the_plot_holds_every_extreme_and_breaks_at_gaps() -> None:
    t = 0.1 * np.arange(100_000)
    x = np.zeros(t.size)
    x[55_555], x[77_777] = 10.0, -10.0
    keep = (t < 3000.0) | (t > 4000.0)
    parts = sparkline(Signal("x", t[keep], x[keep], ""), (0.0, 10_000.0))
    assert len(parts) == 2
    points = [tuple(map(float, p.split(","))) for part in parts for p in part.split()]
    heights = [y for _, y in points]
    assert min(heights) == pytest.approx(1.5, abs=0.1)
    assert max(heights) == pytest.approx(HEIGHT - 1.5, abs=0.1)
    assert 0 <= min(p[0] for p in points) <= max(p[0] for p in points) <= WIDTH


def test_the_page_is_complete_escaped_and_the_same_every_time() -> None:
    log = damaged()
    log = RawLog(log.signals, log.source, None, (Check("cells empty", "flag", False, "3 <b>cells</b>", remedy="look"),))
    rows = survey(log)
    page = inspect_html(rows, log)
    assert page == inspect_html(rows, log)
    assert page.count("<svg") == 2
    assert "logs/&lt;made&gt;.csv" in page
    assert "3 &lt;b&gt;cells" in page
    assert "tension_1" in page
    assert not re.search(r"https?://(?!www\.w3\.org)", page)  # self-contained
    assert "nan" not in page.lower().replace("non-finite", "")
