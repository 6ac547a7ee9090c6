"""Truth: analytic (derivatives and responses known by hand), and brute force (a faulty log less the healthy one)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mooringdx import residuals
from mooringdx.config import RunConfig, validate
from mooringdx.errors import ConfigError, FitError
from mooringdx.residuals.training import Training
from mooringdx.types import Array, Channels, Grid, LogSource, replace

ANCHORS = np.radians([45.0, 135.0, 225.0, 315.0])
STIFFNESS = np.array([5.0, 7.0, 5.0, 7.0])
PRETENSION = 20.0


def channels(values: Array, names: tuple[str, ...], units: tuple[str, ...]) -> Channels:
    grid = Grid(0.0, 0.1, len(values))
    return Channels(names, units, grid, values, np.isfinite(values), LogSource("made.csv", "csv", 0, ""))


def run(use: list[str], names: tuple[str, ...], **more: Any) -> RunConfig:
    body: dict[str, Any] = {
        "channels": {n: {"column": n} for n in names},
        "clock": {"sample_time": 0.1},
        "residuals": {"use": use, **more.pop("residuals", {})},
        **more,
    }
    return validate(RunConfig, body, Path("t.toml"))


def moored(n: int = 6000, seed: int = 3) -> Channels:
    """Return a vessel on four springs that pull with T_j = 20 - s_j a_j'x, and noise of its own on every channel."""
    rng = np.random.default_rng(seed)
    position = np.cumsum(rng.standard_normal((n, 2)), axis=0)
    position = 0.02 * (position - np.linspace(0, 1, n)[:, None] * position[-1])
    toward = np.column_stack([np.cos(ANCHORS), np.sin(ANCHORS)])
    tension = PRETENSION - STIFFNESS * (position @ toward.T)
    values = np.column_stack([position, tension]) + 0.01 * rng.standard_normal((n, 6))
    names = ("north", "east", "tension_1", "tension_2", "tension_3", "tension_4")
    return channels(values, names, ("m", "m", "N", "N", "N", "N"))


LINES = {"mooring": {"lines": ["line_1", "line_2", "line_3", "line_4"]}}


def test_parity_relation_its_unit_and_its_derivatives() -> None:
    rng = np.random.default_rng(0)
    x = rng.standard_normal((100, 3))
    log = channels(x, ("tension_SB", "tension_PS", "sway"), ("N", "N", "m"))
    config = run(
        ["parity"],
        log.names,
        residuals={"parity": {"r1": "tension_SB + tension_PS", "r2": "(tension_SB - tension_PS)/2 - 30 [N/m] * sway"}},
    )
    stack = residuals.fit([Training(log, (slice(0, 100),))], config)
    out = stack(log)
    np.testing.assert_allclose(out.values[:, 0], x[:, 0] + x[:, 1], atol=1e-12)
    np.testing.assert_allclose(out.values[:, 1], (x[:, 0] - x[:, 1]) / 2 - 30 * x[:, 2], atol=1e-12)
    assert set(out.units) == {"N"}
    by_name = {f.subject: row for f, row in zip(out.signatures.faults, out.signatures.matrix, strict=True)}
    np.testing.assert_allclose(by_name["tension_SB"], [1, 0.5])
    np.testing.assert_allclose(by_name["tension_PS"], [1, -0.5])
    np.testing.assert_allclose(by_name["sway"], [0, -30])


def test_parity_constant_in_another_unit_is_converted_once() -> None:
    log = channels(np.ones((50, 2)), ("tension_1", "sway"), ("N", "m"))
    config = run(["parity"], log.names, residuals={"parity": {"r": "tension_1 - 2 [kN/m] * sway"}})
    out = residuals.fit([Training(log, (slice(0, 50),))], config)(log)
    np.testing.assert_allclose(out.values[:, 0], 1.0 - 2000.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("tension_1 + sway", "give constants a unit"),
        ("tension_1 + tension_9", "unknown channel 'tension_9'; did you mean 'tension_1'"),
        ("tension_1 +", "cannot be read"),
        ("tension_1 + 'x' [N]", "is not allowed in a parity relation"),
        ("max(tension_1, sway)", "is not allowed in a parity relation"),
    ],
)
def test_wrong_parity_relations_are_one_sentence(text: str, message: str) -> None:
    log = channels(np.ones((50, 2)), ("tension_1", "sway"), ("N", "m"))
    with pytest.raises(ConfigError, match=message):
        residuals.fit([Training(log, (slice(0, 50),))], run(["parity"], log.names, residuals={"parity": {"r": text}}))


@pytest.mark.parametrize("lags", [0, 3])
def test_learned_signatures_are_what_a_wrong_channel_really_does(lags: int) -> None:
    log = moored()
    config = run(["learned"], log.names, residuals={"learned": {"lags": lags}}, **LINES)
    stack = residuals.fit([Training(log, (slice(0, 4000),))], config)
    healthy = stack(log)
    for fault, row in zip(healthy.signatures.faults, healthy.signatures.matrix, strict=True):
        if fault.kind != "sensor_fault":
            continue
        values = np.array(log.values)
        values[4500:, log.names.index(fault.subject)] += 0.5
        moved = stack(replace(log, values=values)).values - healthy.values
        np.testing.assert_allclose(moved[5000:].mean(axis=0), 0.5 * row, atol=1e-9)
        np.testing.assert_array_equal(np.nan_to_num(moved[:4500]), 0.0)


def test_learned_residual_is_white_small_and_causal() -> None:
    log = moored()
    stack = residuals.fit([Training(log, (slice(0, 4000),))], run(["learned"], log.names, **LINES))
    out = stack(log)
    assert out.names == tuple(f"tension_{i} - predicted" for i in (1, 2, 3, 4))
    assert np.std(out.values[4000:], axis=0).max() < 0.08 < np.std(log.column("tension_1"))
    half = channels(np.array(log.values[:3000]), log.names, log.units)
    np.testing.assert_array_equal(stack(half).values, out.values[:3000])


def test_learned_refuses_a_record_too_short_for_its_coefficients() -> None:
    log = moored()
    with pytest.raises(FitError, match=r"lower \[residuals\.learned\] lags"):
        residuals.fit(
            [Training(log, (slice(0, 200),))], run(["learned"], log.names, residuals={"learned": {"lags": 8}})
        )


def test_learned_masks_what_a_gap_touches() -> None:
    log = moored()
    values = np.array(log.values)
    values[5000:5010, 0] = np.nan
    gappy = channels(values, log.names, log.units)
    out = residuals.fit(
        [Training(log, (slice(0, 4000),))], run(["learned"], log.names, residuals={"learned": {"lags": 2}})
    )(gappy)
    column = out.names.index("tension_1 - predicted")
    assert not out.valid[5000:5012, column].any()
    assert out.valid[5012:, column].all()
    assert out.valid[3:5000, column].all()


def test_position_signature_is_the_offset_of_the_mooring_without_the_line() -> None:
    log = moored()
    stack = residuals.fit([Training(log, (slice(0, 6000),))], run(["position"], log.names, **LINES))
    signatures = stack(log).signatures
    toward = np.column_stack([np.cos(ANCHORS), np.sin(ANCHORS)])
    whole = sum(STIFFNESS[k] * np.outer(toward[k], toward[k]) for k in range(4))
    for j in range(4):
        rest = whole - STIFFNESS[j] * np.outer(toward[j], toward[j])
        tension = log.column(f"tension_{j + 1}").mean()
        offset = -np.linalg.solve(rest, toward[j]) * tension  # where the mooring without line j comes to rest
        missing = -(tension - STIFFNESS[j] * toward[j] @ offset)  # against the intact line at that place
        row = next(i for i, f in enumerate(signatures.faults) if f.subject == f"line_{j + 1}")
        np.testing.assert_allclose(signatures.matrix[row] * missing, offset, rtol=0.1, atol=0.05)
        assert signatures.total[row] == pytest.approx(missing, rel=0.05)
        assert signatures.sign[row] == -1


def test_stacked_generators_share_their_faults_and_survive_the_round_trip() -> None:
    log = moored()
    stack = residuals.fit([Training(log, (slice(0, 6000),))], run(["learned", "position"], log.names, **LINES))
    out = stack(log)
    labels = [f.label for f in out.signatures.faults]
    assert len(labels) == len(set(labels))
    assert out.signatures.matrix.shape == (len(labels), 6)
    row = out.signatures.matrix[labels.index("line_lost line_2")]
    assert np.abs(row[:4]).max() > 0.5
    assert np.abs(row[4:]).max() > 0.05
    again = residuals.Stack.from_dict(stack.to_dict())(log)
    np.testing.assert_array_equal(again.values, out.values)
    np.testing.assert_array_equal(again.signatures.matrix, out.signatures.matrix)


def test_faults_can_be_narrowed_and_a_wrong_one_is_named() -> None:
    log = moored()
    config = run(["learned"], log.names, residuals={"faults": ["line_lost"]}, **LINES)
    out = residuals.fit([Training(log, (slice(0, 6000),))], config)(log)
    assert {f.kind for f in out.signatures.faults} == {"line_lost"}
    config = run(["learned"], log.names, residuals={"faults": ["line_5"]}, **LINES)
    with pytest.raises(ConfigError, match="did you mean 'line_"):
        residuals.fit([Training(log, (slice(0, 6000),))], config)(log)
