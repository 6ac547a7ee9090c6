"""Our default beside the thesis, and half a day: counts by hand, exact intervals, a page of made-up numbers."""

from __future__ import annotations

import json
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from mooringdx.hypotheses.thesis_bank import NONE
from mooringdx.reproduce import position_drawing, position_thesis
from mooringdx.reproduce.effects import FAILS, HOLDS, PARTLY
from mooringdx.reproduce.position_cases import BENCHES, CASES, Case, Score, fit_bank, trial, twins
from mooringdx.reproduce.position_claims import Beyond, beyond_claims, delay_cells
from mooringdx.reproduce.position_days import RELEARNED, WATERS, Night, alarms, in_water, night_cells, pooled, told
from mooringdx.reproduce.position_ours import (
    EARLIER,
    NAMES,
    Heard,
    Ours,
    channels_of,
    earlier,
    heard,
    line_score,
    longer,
    median_interval,
    ours_cell,
    ours_record,
    seconds,
    taught,
)
from mooringdx.reproduce.position_ours_drawing import OUR_SHEETS, Seen, looked, our_captions
from mooringdx.reproduce.position_table import METHODS, Row, claims
from mooringdx.simulate.scenario import Scenario, load_scenario
from mooringdx.types import Event, Posterior, replace

SCENARIO = Path(__file__).parents[1] / "configs" / "scenarios" / "thesis_none.toml"


def base() -> Scenario:
    return load_scenario(SCENARIO)


def test_an_alarm_is_held_and_ends_when_none_is_held() -> None:
    """Truth: by hand. 20 s at 1 s: a flicker is no alarm, a gap of under 20 s is the same alarm."""
    lost = np.zeros(200, dtype=bool)
    lost[10:29] = True  # 19 s
    assert alarms(lost, 1.0) == 0
    lost[10:30] = True  # 20 s
    assert alarms(lost, 1.0) == 1
    lost[45:70] = True  # 15 s after it
    assert alarms(lost, 1.0) == 1
    lost[100:200] = True  # 30 s after it
    assert alarms(lost, 1.0) == 2
    assert alarms(np.ones(50, dtype=bool), 1.0) == 1
    assert alarms(np.ones(19, dtype=bool), 1.0) == 0
    assert alarms(lost, 0.1) == 0, "seconds, not samples"


@pytest.mark.parametrize(("n", "low"), [(10, 1), (20, 5), (5, 0), (1, 0)])
def test_interval_of_a_median_is_the_tightest_of_at_least_its_level(n: int, low: int) -> None:
    """Truth: brute force. The median lies under the k-th of n with the share of coin throws with fewer than k heads."""
    values = np.arange(float(n))[::-1]
    assert median_interval(values.tolist()) == (low, n - 1 - low)
    if n == 10:
        under = [sum(throw) for throw in product((0, 1), repeat=n)]
        assert 2.0 * np.mean(np.array(under) < low + 1) <= 0.05 < 2.0 * np.mean(np.array(under) < low + 2)


def test_a_loss_never_found_is_infinite_and_said_so() -> None:
    assert seconds([30.0] * 9 + [np.inf]) == "30 s [30, 30]"
    assert seconds([30.0] * 4 + [np.inf] * 6) == "never [30, never]"


def test_rate_a_day_has_the_poisson_interval() -> None:
    """Truth: published (Garwood): 0 events give 0 to 3.689, 5 give 1.623 to 11.668."""
    night = Night(WATERS[0], "any", "dht", 5, 12.0, 0.25)
    np.testing.assert_allclose(night.rate, (10.0, 2.0 * 1.6235, 2.0 * 11.6683), rtol=1e-4)
    np.testing.assert_allclose(replace(night, alarms=0).rate, (0.0, 0.0, 2.0 * 3.6889), rtol=1e-4)
    assert told(night) == "10 a day [3.2, 23.3] (5 in 12.0 h); wrong 25 %"
    both = pooled([night, Night(WATERS[0], "any", "dht", 1, 36.0, 0.05), replace(night, method="mle")])
    assert [(n.alarms, n.hours) for n in both] == [(6, 48.0), (5, 12.0)]
    assert both[0].wrong == pytest.approx(0.1)


def test_one_motion_read_twice() -> None:
    """Truth: by subtraction, and another path: the twins are the two trials."""
    plan = longer(base(), CASES[4]).model_copy(update={"faults": []})
    plan = plan.model_copy(update={"record": plan.record.model_copy(update={"duration": 60.0})})
    own, shared = twins(plan, 3)
    np.testing.assert_array_equal(own.measured, trial(plan, 3, shared=False).measured)
    np.testing.assert_array_equal(shared.measured, trial(plan, 3, shared=True).measured)
    np.testing.assert_array_equal(own.thrust, shared.thrust)
    apart = own.measured - shared.measured
    assert apart[:, 1].std() > 0.05


def test_the_longer_record_breaks_later_by_as_much_as_it_begins_earlier() -> None:
    for case in CASES:
        plan = longer(base(), case)
        assert plan.record.duration == 1000.0 + EARLIER
        assert [f.onset for f in plan.faults] == ([case.onset + EARLIER] if case.line != NONE else [])
        assert earlier(case).pull == case.pull


def test_seas_of_half_a_day() -> None:
    """Truth: the vessel's bow points to 225 deg; the notch of a bank learned anew is at the sea's own peak."""
    plan = in_water(base(), WATERS[2])
    assert (plan.sea.height, plan.sea.peak_period, plan.sea.direction) == (4.0, 9.0, 225.0)
    assert in_water(base(), WATERS[0]) == base()
    bank = fit_bank(plan, BENCHES[2], 1, duration=60.0)
    np.testing.assert_allclose(bank.observer.wave[0], (2.0 * np.pi / 9.0) ** 2)


def event(subject: str, detected: float, warning: float) -> Event:
    return Event(
        "line_lost", subject, warning, (warning, detected), detected, probability=0.9, evidence={"warning": warning}
    )


def test_what_was_heard_by_hand() -> None:
    early, late = event("line_2", 700.0, 690.0), event("line_6", 1330.0, 1324.0)
    got = heard([late, early], 1300.0)
    assert got == Heard(24.0, 30.0, "line_6", 0.9, 1, 700.0 / 3600.0)
    assert heard([event("line_6", 1330.0, 1290.0)], 1300.0).warned == 0.0, "a warning before the loss is none of it"
    nothing = heard([early], 1300.0)
    assert (nothing.alarm, nothing.named, nothing.false) == (None, None, 1)
    row = Ours(CASES[2], NAMES[0], (got, nothing))
    assert (row.right, row.false, row.probability) == (1, 2, 0.9)
    assert ours_cell(row) == "never [30, never] (1 of 2); named right 1, p 0.90; 2 false alarms in 0.4 h"
    assert ours_record(row)["alarm"] == {"median": None, "low": 30.0, "high": None}
    wrong = Ours(CASES[2], NAMES[0], (replace(got, named="line_7"),))
    assert wrong.right == 0


def test_score_is_the_log_odds_of_a_line_against_all_else() -> None:
    rows = np.array([[0.5, 0.2, 0.2, 0.06, 0.04], [1.0, 0.0, 0.0, 0.0, 0.0], [0.0, 0.6, 0.3, 0.1, 0.0]])
    score = line_score(Posterior("any", ("no fault", "a", "b", "environment", "wave group"), np.arange(3.0), rows), 2)
    np.testing.assert_allclose(score, [np.log(0.4 / 0.6), np.nan, np.log(9.0)])


@pytest.fixture(scope="module")
def seen() -> Seen:
    bank = taught(base(), CASES[2], (1, 200, 0), duration=1800.0)
    return looked(base(), CASES[2], bank, 1)


def test_our_default_names_line_6_and_says_nothing_before(seen: Seen) -> None:
    got = heard(seen.events, CASES[2].onset + EARLIER)
    assert got.false == 0
    assert got.named == "line_6"
    assert got.alarm is not None
    assert 5.0 < got.alarm < 120.0
    assert seen.alarm == pytest.approx(CASES[2].onset + got.alarm)
    score = line_score(seen.posterior, 8)
    first = int(np.argmax(score >= seen.bank.alarm))
    assert seen.posterior.time[first] == pytest.approx(CASES[2].onset + EARLIER + got.alarm, abs=seen.bank.step)


def test_the_log_is_what_was_measured_and_the_filter_follows_it(seen: Seen) -> None:
    log = channels_of(seen.record)
    np.testing.assert_array_equal(log.column("heading"), seen.record.measured[:, 2])
    np.testing.assert_array_equal(log.column("thrust_yaw"), seen.record.thrust[:, 2])
    quiet = slice(700, 1290)
    apart = seen.estimate.position[quiet, :2] - seen.record.true[:: seen.bank.thin][quiet, :2]
    assert np.abs(apart).max() < 0.5


def test_every_figure_of_ours_is_drawn(seen: Seen) -> None:
    cases = [replace(seen, case=case) for case in CASES]
    for name, sheet in OUR_SHEETS.items():
        figure = position_drawing.painted(partial(sheet.draw, cases), sheet.seen)
        assert figure.get_axes()[0].lines, name
        assert figure.get_suptitle() == sheet.seen
        assert "mooringdx reproduce" in our_captions("mooringdx reproduce X")[name]


def made_rows(delay: float) -> list[Row]:
    found = {m: tuple(Score(delay + k, 1.0, 1.0, 0.0, 3.0) for k in range(3)) for m in METHODS}
    return [Row(case, bench, found, 30.0, 0.3) for bench in BENCHES for case in CASES]


def made_ours(delay: float, false: int, right: bool = True) -> tuple[Ours, ...]:
    def one(case: Case, count: int) -> Ours:
        named = case.line if right else "line_1"
        return Ours(case, NAMES[min(count, 1)], (Heard(delay - 4.0, delay, named, 0.97, count, 0.2),) * 3)

    return tuple(one(case, count) for case in CASES for count in (0, false))


def made_nights(thesis: int, ours: int, wrong: float) -> tuple[Night, ...]:
    benches = (BENCHES[0].name, BENCHES[2].name, BENCHES[4].name)
    bank = [Night(w, b, m, thesis, 12.0, wrong) for w in WATERS for b in benches for m in METHODS]
    anew = [Night(WATERS[2], RELEARNED, m, thesis, 12.0, wrong) for m in METHODS]
    return (*bank, *anew, *(Night(w, NAMES[0], "onset", ours, 12.0, 0.0) for w in WATERS))


def test_verdicts_follow_the_numbers() -> None:
    """Truth: construction. Every further claim holds on good numbers and fails on bad ones."""
    good = Beyond(made_ours(30.0, 0), made_nights(0, 0, 0.0), ())
    assert [c.verdict for c in beyond_claims(made_rows(78.0), good)] == [HOLDS] * 7
    bad = Beyond(made_ours(200.0, 3, right=False), made_nights(7, 2, 0.4), ())
    got = beyond_claims(made_rows(900.0), bad)
    assert [c.verdict for c in got] == [FAILS, FAILS, FAILS, FAILS, FAILS, PARTLY, PARTLY]
    assert got[5].numbers["not_learned"] == 36.0
    mixed = beyond_claims(made_rows(40.0), good)[0]
    assert mixed.verdict == PARTLY
    assert mixed.numbers["line 8 + current"] == pytest.approx(41.0 / 150.0)
    assert "line 6 + current MLE 41 s [40, 42], DHT 41 s [40, 42]" in mixed.measured
    assert delay_cells(made_rows(40.0))[1][-1] == "no figure"


def test_the_page_shows_ours_and_half_a_day(seen: Seen, monkeypatch: pytest.MonkeyPatch) -> None:
    """Truth: read back. Every made-up number stands in the page and in the JSON, the same bytes twice."""
    few = {"ours_track": OUR_SHEETS["ours_track"]}
    monkeypatch.setattr(position_thesis, "OUR_SHEETS", few)
    monkeypatch.setattr(position_thesis, "SHEETS", {})
    rows, beyond = made_rows(40.0), Beyond(made_ours(33.0, 2), made_nights(7, 0, 0.4), (seen,) * 8)
    beyond = replace(beyond, seen=tuple(replace(seen, case=case) for case in CASES))
    bank = fit_bank(base(), BENCHES[0], 1, duration=60.0)
    found = (*claims(rows), *beyond_claims(rows, beyond))
    made = position_thesis.pages(base(), rows, bank, found, 1, beyond)
    page, body = made["index.html"].decode(), json.loads(made["claims.json"])
    assert set(made) == {"index.html", "claims.json", "figures/ours_track.png", "figures/ours_track.svg"}
    cell = "33 s [33, 33] (3 of 3); named right 3, p 0.97; {} false alarms in 0.6 h"
    assert page.count(cell.format(0)) == 3 * 6, "in the tables of both methods, and in its own"
    assert page.count(cell.format(6)) == 6
    assert page.count("14 a day [5.6, 28.8] (7 in 12.0 h); wrong 40 %") >= 18
    assert "these records begin 900 s earlier" in page
    assert "0.36 of 461 kN = 166 kN" in page
    assert "0.48 of 461 kN = 221 kN" in page
    assert [len(body[key]) for key in ("ours", "half_a_day", "claims")] == [16, 23, 16]
    assert [c["verdict"] for c in body["claims"]] == [c.verdict for c in found]
    told_so = position_thesis.text(rows, found, beyond)
    assert all(cell in told_so for row in night_cells(beyond.nights) for cell in row)
    assert made == position_thesis.pages(base(), rows, bank, found, 1, beyond)
