"""Truth: brute force (explicit responses, quadrature), analytic (what two answers must give), the simulator."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal, cast

import numpy as np
import pytest
from test_onset import NOISE, QUICK, evidence, odds, over_shares, responses, ship

from mooringdx.config import load_run
from mooringdx.fusion import Gauges, fuse, gauges
from mooringdx.hypotheses.onset.witness import Heard, Sight, Witness, ratio
from mooringdx.observers.kalman import Estimate, Filter
from mooringdx.observers.matrices import plant_of
from mooringdx.physics.mooring import Mooring
from mooringdx.physics.rig import mooring_of
from mooringdx.pipeline import detect, fit, prepare
from mooringdx.report.wording import witnesses
from mooringdx.simulate import Scenario, load_scenario, simulate
from mooringdx.simulate.record import stream
from mooringdx.types import Array, Channels, Check, Defect, Event, Grid, LogSource, Rival, replace

CONFIGS = Path(__file__).parents[1] / "configs"
WHOLE = 680e3
ONSET = 1200.0


# The witness


@cache
def mooring_once() -> Mooring:
    return mooring_of(ship())


Verdict = Literal["confirmed", "refuted", "untold"]


def sight(n: int, lost: int | None = None, onset: int = 0, seed: int = 3) -> Sight:
    """Return a filter's walk with white innovations; from ``onset`` on with what the loss of a line adds to them."""
    mooring = mooring_once()
    rng = stream(seed, "witness")
    place = np.column_stack([rng.normal(0.0, 2.0, (n, 2)), 3.9 + 0.05 * np.sin(0.05 * np.arange(n))])
    models = Filter(plant_of(ship().dynamics), NOISE, 1.0, mooring, (0.0, 0.0, 3.9)).models(place[:, 2])
    errors = rng.normal(0.0, 1.0, (n, 3)) @ np.linalg.cholesky(models[0].S).T
    if lost is not None:
        rho = responses(models, place[:, 2], np.ones(n), (onset, n), mooring.fairleads.mean(axis=0))
        errors -= rho @ pull(mooring, place[onset], lost)
    nothing = np.full((n, 3), np.nan)
    slow = place, nothing, nothing, errors, nothing[:, 0]
    return Sight(
        0, 0, Estimate(*slow, np.eye(3), np.zeros(15), np.zeros((0, 0))), models, mooring, QUICK.warm, np.ones(n)
    )


def pull(mooring: Mooring, place: Array, line: int) -> Array:
    """Return what a line pulls, north, east and moment: all fairleads are at one turret, so the last is nothing."""
    horizontal, _, direction = mooring.pulls(place)
    return np.array([*(horizontal[line] * direction[line]), 0.0])


def test_the_ratio_is_the_quadrature_over_shares_of_explicit_responses() -> None:
    one, settled = sight(60), odds(QUICK, 2.0)
    one.estimate.innovation[30:33] = np.nan
    nats = ratio(one, "line_3", np.array([12]), 50, settled)
    place, errors = one.estimate.position, one.estimate.innovation
    seen = np.isfinite(errors).all(axis=1)
    rho = responses(one.models, place[:, 2], seen, (12, 60), one.mooring.fairleads.mean(axis=0))
    for k in (20, 31, 49):
        z, lam = evidence(one.models, place[: k + 1, 2], errors[: k + 1], rho[: k + 1])
        brute = over_shares(z / 2.0, lam / 2.0, pull(one.mooring, place[12], 2))
        assert nats[k - 12] == pytest.approx(brute, rel=1e-3, abs=2e-3)


def test_several_onsets_are_the_mean_of_their_likelihoods() -> None:
    one, settled = sight(60), odds(QUICK)
    first, second = (ratio(one, "line_2", np.array([k]), 40, settled) for k in (10, 14))
    both = ratio(one, "line_2", np.array([10, 14]), 40, settled)
    late = np.concatenate([np.zeros(4), second])
    np.testing.assert_allclose(both, np.log(0.5 * (np.exp(first) + np.exp(late))), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize(("lost", "verdict"), [(4, "confirmed"), (None, "refuted"), (2, "refuted")])
def test_a_loss_is_confirmed_and_nothing_or_another_line_refuted(lost: int | None, verdict: str) -> None:
    for seed in range(1, 6):
        heard = Witness((sight(300, lost, 100, seed),), odds(QUICK), replace(QUICK, end=200), (50.0, 1.0))(
            "line_5", (150.0, 150.0)
        )
        assert heard.verdict == verdict
        assert heard.score >= 7.0 or heard.score <= -5.0
        assert all(-5.0 < nats < 7.0 for _, nats in heard.trace[:-1])
        assert heard.trace[-1] == pytest.approx((heard.time - 150.0, heard.score), abs=1e-3)


def test_what_cannot_be_asked_is_untold_and_says_why() -> None:
    witness = Witness((sight(300),), odds(QUICK), QUICK, (0.0, 1.0))
    assert witness("line_5", (3.0, 3.0)).why.startswith("its filter had not settled")
    assert witness("line_5", (100.0, 100.0), 103.0).verdict == "untold"
    short = witness("line_5", (100.0, 100.0), 103.0)
    assert short.time <= 103.0
    assert "short of +7 and of -5" in short.why
    gone = replace(witness.sights[0], mooring=witness.sights[0].mooring.without(["line_5"]))
    after = replace(
        witness,
        times=replace(QUICK, end=200),
        sights=(replace(witness.sights[0], first=0), replace(gone, first=20, skip=10)),
    )
    assert after("line_5", (100.0, 100.0)).verdict == "refuted"  # asked of the walk that still had the line


# The gauges


def known(values: Array | None = None, raw: Array | None = None, defects: tuple[Defect, ...] = ()) -> Gauges:
    """Return the gauges of lines 1 and 2, with a residual of line 1 of 2 kN noise, and the channel itself."""
    n = 2000
    noise = stream(1, "gauge").normal(0.0, 2000.0, (n, 2))
    residual = noise.copy() if values is None else noise + np.column_stack([values, np.zeros(n)])
    channel = WHOLE + residual if raw is None else np.column_stack([raw, WHOLE + noise[:, 1]])
    grid = Grid(0.0, 1.0, n)
    names = ("tension_1", "tension_2")
    channels = Channels(
        names, ("N", "N"), grid, channel, np.ones((n, 2), np.bool_), LogSource("x", "csv", 0, ""), (), defects
    )
    residuals = SimpleNamespace(
        names=tuple(f"{c} - intact" for c in names), values=residual, valid=np.ones((n, 2), np.bool_)
    )
    fitted = SimpleNamespace(
        timing=SimpleNamespace(window=10), agitation=np.full(2, 2828.0),
        raw=SimpleNamespace(mean=np.zeros(2), covariance=4e6 * np.eye(2)),
    )  # fmt: skip
    part = SimpleNamespace(
        lines=(("line_1", "tension_1"), ("line_2", "tension_2")), parted=0.0,
        intact=lambda line, at: WHOLE,
        kind=lambda line, change, sd, at: "line_lost" if change < -6e5 else "line_parted_low",
    )  # fmt: skip
    return Gauges(channels, cast(Any, residuals), cast(Any, fitted), cast(Any, part))


def test_a_gauge_that_reads_its_line_refutes_and_one_that_fell_confirms() -> None:
    fell = np.where(np.arange(2000) >= ONSET, -WHOLE, 0.0)
    expected = 0.5 / 0.1**2  # half the loss squared over its own error, a tenth of it
    still, gone = known().spoken("line_1", 1200.0, 1260.0), known(fell).spoken("line_1", 1200.0, 1260.0)
    assert still.score == pytest.approx(-expected, rel=0.05)
    assert gone.score == pytest.approx(expected, rel=0.05)
    assert still.alive
    assert known().spoken("line_9", 1200.0, 1260.0).score is None


def test_a_held_gauge_has_no_say() -> None:
    held = known(raw=np.full(2000, WHOLE)).spoken("line_1", 1200.0, 1260.0)
    assert not held.alive
    defect = Defect("stuck", ("tension_1",), 1100.0, 1500.0, 400.0, "s", "", True)
    assert not known(defects=(defect,)).spoken("line_1", 1200.0, 1260.0).alive
    assert known(defects=(replace(defect, subjects=("tension_2",)),)).spoken("line_1", 1200.0, 1260.0).alive


# One verdict


def tension(kind: str, nats: float | None, share: float = 1.0, **change: Any) -> Event:
    """Return what tensions say of line 1: detected at once, named 10 s later or when the forces told at 30 s."""
    subject = "tension_1" if kind == "sensor_fault" else "line_1"
    lost = kind in ("line_lost", "line_parted_low")
    figures = {
        "tension_change": -share * WHOLE,
        "tension_change_interval": [-share * WHOLE - 900.0, -share * WHOLE + 900.0],
    }
    told = {} if nats is None else {"log_likelihood_ratio": nats, "discrimination": 5.0, "cause_told": ONSET + 30.0}
    fields: dict[str, Any] = {
        "kind": kind, "subject": subject, "onset": ONSET, "onset_interval": (ONSET, ONSET), "detected": ONSET + 1.0,
        "named": ONSET + (11.0 if nats is None else 30.0), "probability": None if kind == "unknown" else 0.99,
        "size_interval": None if lost else figures["tension_change_interval"],
        "size": share if lost else -share * WHOLE, "size_unit": "share of tension" if lost else "N",
        "evidence": {**(figures if lost else {}), **told}, "cannot_tell": "pair" if kind == "unknown" else None,
    }  # fmt: skip
    return Event(**fields | change)


def alarm(line: str = "line_1", **change: Any) -> Event:
    fields: dict[str, Any] = {
        "kind": "line_lost", "subject": line, "onset": ONSET, "onset_interval": (ONSET - 5.0, ONSET + 5.0),
        "detected": ONSET + 50.0, "named": ONSET + 110.0, "probability": 0.9,
        "rivals": (Rival("environment", "force", 0.1, "rarer"),), "cannot_tell": "a squall",
        "evidence": {"detector": "onset_glr", "peak": 3.0, "threshold": 0.0},
    }  # fmt: skip
    return Event(**fields | change)


def fused(
    events: list[Event], own: list[Event], verdict: Verdict = "untold", with_gauges: Gauges | None = None
) -> tuple[tuple[Event, ...], tuple[Check, ...]]:
    score = {"confirmed": 7.5, "refuted": -5.2, "untold": 1.0}[verdict]

    def ask(line: str, interval: tuple[float, float], stop: float) -> Heard:
        return Heard(line, verdict, score, interval[0], interval[0] + 18.0, ((0.0, 0.0), (18.0, score)))

    return fuse(events, own, ask, with_gauges or known())


CASES = [  # what tensions say, nats of their forces, what position says: kind, subject, when the cause was told
    ("line_lost", 20.0, "confirmed", "line_lost", "line_1", 18.0),
    ("line_lost", 4.0, "confirmed", "line_lost", "line_1", 18.0),
    ("unknown", None, "confirmed", "line_lost", "line_1", 18.0),
    ("sensor_fault", -4.0, "confirmed", "line_lost", "line_1", 18.0),
    ("sensor_fault", -20.0, "confirmed", "unknown", "line_1", 30.0),
    ("sensor_fault", -20.0, "refuted", "sensor_fault", "tension_1", 18.0),
    ("unknown", None, "refuted", "sensor_fault", "tension_1", 18.0),
    ("line_lost", 4.0, "refuted", "sensor_fault", "tension_1", 18.0),
    ("line_lost", None, "refuted", "sensor_fault", "tension_1", 18.0),
    ("line_lost", 20.0, "refuted", "unknown", "line_1", 30.0),
    ("line_lost", 20.0, "untold", "line_lost", "line_1", 30.0),
    ("unknown", None, "untold", "unknown", "line_1", 11.0),
]


@pytest.mark.parametrize(("says", "nats", "position", "kind", "subject", "told"), CASES)
def test_a_cause_is_named_where_neither_branch_contradicts(
    says: str, nats: float | None, position: str, kind: str, subject: str, told: float
) -> None:
    (event,), rows = fused([tension(says, nats)], [], position)
    assert (event.kind, event.subject, event.named) == (kind, subject, ONSET + told)
    apart = abs(nats or 0.0) > 7.0 and kind == "unknown"
    assert [row.passed for row in rows] == [not apart]
    assert event.evidence["position"]["verdict"] == position
    assert event.detected == ONSET + 1.0
    if apart:
        assert {(r.kind, r.subject) for r in event.rivals} == {("line_lost", "line_1"), ("sensor_fault", "tension_1")}
        assert f"{nats:+.1f}" in str(event.cannot_tell)
        assert ("+7.5" if position == "confirmed" else "-5.2") in str(event.cannot_tell)
    elif position != "untold":
        assert event.cannot_tell is None
        nats_of_position = 7.5 if position == "confirmed" else 5.2
        assert event.probability == pytest.approx(max(1.0 / (1.0 + math.exp(-nats_of_position)), 0.99), rel=1e-6)
        weak = abs(nats or 0.0) < 7.0
        assert bool(event.rivals) == weak


def test_sizes_follow_the_name() -> None:
    (event,), _ = fused([tension("unknown", None)], [], "confirmed")
    assert event.size == pytest.approx(1.0)
    assert event.size_unit == "share of tension"
    assert event.size_interval == pytest.approx((1.0 - 900.0 / WHOLE, 1.0 + 900.0 / WHOLE))
    (event,), _ = fused([tension("line_lost", 2.0)], [], "refuted")
    assert (event.size, event.size_unit, event.mode) == (-WHOLE, "N", "dead")
    (event,), _ = fused([tension("unknown", None, share=0.8)], [], "confirmed")
    assert event.kind == "line_parted_low"


@pytest.mark.parametrize("share", [0.3, 0.6, -0.5])
def test_position_is_not_asked_of_a_part_of_a_pull(share: float) -> None:
    before = tension("unknown", None, share=share)
    (event,), rows = fused([before], [], "refuted")
    assert event == before
    assert rows == ()


def test_an_alarm_of_position_is_folded_into_the_tensions_event() -> None:
    for own in (alarm(), alarm("line_2"), alarm(onset=ONSET + 40.0, onset_interval=(ONSET + 30.0, ONSET + 50.0))):
        (event,), _ = fused([tension("line_lost", 20.0)], [own], "confirmed")
        assert (event.kind, event.subject, event.detected) == ("line_lost", "line_1", ONSET + 1.0)
        assert event.evidence["position"]["alarms"][0]["subject"] == own.subject
    (event,), _ = fused([tension("unknown", None)], [alarm()], "untold")
    assert (event.kind, event.named) == ("line_lost", ONSET + 110.0)  # its own alarm confirms as well
    (event,), _ = fused([tension("line_lost", 20.0, detected=ONSET + 70.0)], [alarm()], "confirmed")
    assert event.detected == ONSET + 50.0
    (early, late), _ = fused([tension("line_lost", 20.0)], [alarm(onset=500.0, onset_interval=(490.0, 510.0))])
    assert (early.kind, late.kind) == ("environment", "line_lost")


def test_another_cause_of_the_tensions_is_weighed_by_both() -> None:
    rival = Rival("environment", "position", 0.2, "moved")
    (alone,), _ = fused([tension("line_lost", 20.0, rivals=(rival,))], [], "confirmed")
    (both,), _ = fused([tension("line_lost", 20.0, rivals=(rival,))], [alarm()], "confirmed")
    assert alone.rivals[0].probability == pytest.approx(0.2)
    assert both.rivals[0].probability == pytest.approx(0.2 / 9.0)
    assert (both.probability or 0.0) > (alone.probability or 1.0)


def test_a_living_gauge_makes_positions_alarm_the_environments() -> None:
    (event,), rows = fused([], [alarm()])
    assert (event.kind, event.subject) == ("environment", "force")
    assert event.rivals[0].subject == "line_1"
    assert event.rivals[0].probability < 1e-9
    assert event.evidence["position"]["probability"] == 0.9
    assert rows == ()


def test_a_stuck_gauge_cannot_refute_and_a_missing_one_changes_nothing() -> None:
    masked = known(defects=(Defect("stuck", ("tension_1",), 1100.0, 1500.0, 400.0, "s", "", True),))
    masked.residuals.valid[1100:1500, 0] = False
    for held in (known(raw=np.full(2000, WHOLE)), masked):
        (event,), rows = fused([], [alarm()], with_gauges=held)
        assert (event.kind, event.subject) == ("line_lost", "line_1")
        assert "does not move" in str(event.cannot_tell)
        assert [(row.name, row.passed) for row in rows] == [("branches disagree", False)]
    (event,), rows = fused([], [alarm("line_9")])
    assert replace(event, evidence={}) == replace(alarm("line_9"), evidence={})
    assert rows == ()


def test_events_without_a_line_pass_through() -> None:
    other = [
        tension("environment", None, subject="position", size=None, size_unit=""),
        tension("sensor_fault", None, subject="north", onset=100.0, size=3.0, size_unit="m"),
        tension("sensor_fault", None, mode="stuck", size=30.0, size_unit="s"),
    ]  # fmt: skip
    events, rows = fused(other, [], "refuted")
    assert sorted(events, key=id) == sorted(other, key=id)
    assert rows == ()


def test_the_look_ends_where_the_next_fault_begins() -> None:
    until = []

    def ask(line: str, interval: tuple[float, float], stop: float) -> Heard:
        until.append(stop)
        return Heard(line, "untold", 0.0, interval[0], interval[0])

    later = ONSET + 300.0
    second = tension("line_lost", 20.0, subject="line_2", onset=later, onset_interval=(later, later))
    fuse([tension("line_lost", 20.0), second], [], ask, known())
    assert until == [later, np.inf]


def test_both_witnesses_are_said_in_words() -> None:
    (event,), _ = fused([tension("line_lost", 4.0)], [], "refuted")
    said = witnesses(event)
    assert "cannot tell which, +4 nats" in said
    assert "position: break refuted after 18 s, -5.2 nats" in said
    (event,), _ = fused([], [alarm()])
    assert "gauge lives" in witnesses(event)
    assert "alarm for line_1 by itself 50 s after" in witnesses(event)
    assert witnesses(alarm()) == ""


# The whole, on simulated logs


def scenario(faults: list[dict[str, Any]], duration: float) -> Scenario:
    body = load_scenario(CONFIGS / "scenarios" / "fpso_line_lost.toml").model_dump(mode="json")
    body["record"] |= {"duration": duration, "sample_time": 0.5}
    return Scenario.model_validate(body | {"faults": faults})


@pytest.mark.slow
def test_a_parted_line_and_a_dead_gauge_on_simulated_logs() -> None:
    run = load_run(CONFIGS / "runs" / "fpso_both.toml")
    baseline = fit([prepare(simulate(scenario([], 4200.0), 1, 100)[0], run)], run, extrapolate=True)
    lost = {"kind": "line_lost", "subject": "line_2", "onset": ONSET}
    dead = {"kind": "sensor_fault", "subject": "tension_2", "mode": "dead", "onset": ONSET}
    for fault, within in ((lost, 40.0), (dead, 60.0)):
        log = prepare(simulate(scenario([fault], 2000.0), 1, 101)[0], run)
        found = detect(log, baseline, name="fusion")
        (event,) = found.events
        assert (event.kind, event.subject) == (fault["kind"], fault["subject"])
        assert event.detected - ONSET <= 10.0
        assert event.evidence["position"]["told"] - ONSET <= within
        assert event.mode in (None, "dead")
    alone = run.model_copy(update={"residuals": run.residuals.model_copy(update={"use": []})})
    bank = fit([prepare(simulate(scenario([], 4200.0), 1, 100)[0], alone)], alone)
    assert bank.fitted is None  # then there are no gauges, and nothing is fused
    fitted = cast(Any, baseline.fitted)
    assert gauges(log, cast(Any, found.residuals), replace(fitted, stack=replace(fitted.stack, parts=()))) is None
