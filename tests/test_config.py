"""Truth: analytic (what the words mean) and the house's rule that every wrong key is one sentence with a remedy."""

from __future__ import annotations

from pathlib import Path

import pytest

from mooringdx.config import RunConfig, load_run, parse_rate, parse_window, rate_text, validate, window_seconds
from mooringdx.errors import ConfigError

MINIMAL = {
    "channels": {"north": {"column": "x", "unit": "m"}},
    "clock": {"sample_time": 0.1},
    "residuals": {"use": ["position"]},
}


@pytest.mark.parametrize(
    ("text", "per_second"),
    [("1/month", 1 / 2592000), ("2/day", 2 / 86400), ("0.5/hour", 0.5 / 3600), ("1/30 days", 1 / 2592000)],
)
def test_rates_are_per_second(text: str, per_second: float) -> None:
    assert parse_rate(text) == pytest.approx(per_second)


def test_rate_survives_the_round_trip_through_the_stored_configuration() -> None:
    run = validate(RunConfig, {**MINIMAL, "alarm": {"rate": "1/week"}}, Path("a.toml"))
    again = RunConfig.model_validate(run.model_dump(mode="json"))
    assert again.alarm.rate == pytest.approx(run.alarm.rate, rel=1e-12)
    assert again.digest() == run.digest()


def test_rates_read_as_people_say_them() -> None:
    assert rate_text(1 / 2592000) == "1 per 30 days"
    assert rate_text(2.5 / 3600) == "2.5 per hour"
    assert rate_text(0.0) == "none"


def test_windows_in_seconds_and_as_instants() -> None:
    assert parse_window([180, 550]) == (180.0, 550.0)
    epoch = 1_741_932_000 * 10**9  # 2025-03-14T06:00:00Z
    window = parse_window("2025-03-14T06:10:00Z/PT1H")
    assert window_seconds(window, epoch) == (600.0, 4200.0)
    assert window_seconds(parse_window("2025-03-14T07:00:00+01:00/2025-03-14T06:00:30Z"), epoch) == (0.0, 30.0)


def test_a_reversed_window_is_refused() -> None:
    with pytest.raises(ConfigError, match="reversed"):
        validate(RunConfig, {**MINIMAL, "baseline": {"window": [550, 180]}}, Path("a.toml"))
    with pytest.raises(ConfigError, match="reversed"):
        window_seconds(("2025-03-14T07:00:00Z", "2025-03-14T06:00:00Z"), 0)


def test_instants_need_a_dated_log() -> None:
    with pytest.raises(ConfigError, match="no date"):
        window_seconds(("2025-03-14T07:00:00Z", "PT1H"), None)


def test_an_unknown_key_names_the_nearest_right_one() -> None:
    wrong = {**MINIMAL, "clock": {"smaple_time": 0.1}}
    with pytest.raises(
        ConfigError, match=r"runs/a\.toml: unknown key 'smaple_time' in \[clock\]; did you mean 'sample_time'"
    ):
        validate(RunConfig, wrong, Path("runs/a.toml"))


def test_a_channel_needs_one_place() -> None:
    wrong = {**MINIMAL, "channels": {"north": {"column": "x", "topic": "/p", "field": "x"}}}
    with pytest.raises(ConfigError, match="either a column, or a topic"):
        validate(RunConfig, wrong, Path("a.toml"))


def test_a_missing_file_says_how_to_make_one(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="mooringdx init"):
        load_run(tmp_path / "none.toml")


def test_broken_toml_says_where(tmp_path: Path) -> None:
    path = tmp_path / "b.toml"
    path.write_text("[clock\nsample_time = 1")
    with pytest.raises(ConfigError, match=r"b\.toml: not TOML.*line 1"):
        load_run(path)


def test_the_digest_follows_what_changes_a_result_and_nothing_else() -> None:
    base = validate(RunConfig, MINIMAL, Path("a.toml"))
    moved = validate(RunConfig, {**MINIMAL, "log": {"path": "elsewhere.csv"}}, Path("a.toml"))
    other = validate(RunConfig, {**MINIMAL, "clock": {"sample_time": 0.2}}, Path("a.toml"))
    assert base.digest() == moved.digest() != other.digest()
