"""The paper's residual, statistic and threshold against formulae and brute force; the page on a hand-made study."""

from __future__ import annotations

import json
from functools import lru_cache
from math import erfc, exp, sqrt
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mooringdx.config import read_toml
from mooringdx.errors import ConfigError, ReportError
from mooringdx.physics.frames import rotation
from mooringdx.physics.rig import fault_tables, mooring_of, neutral
from mooringdx.physics.vessel import vessel
from mooringdx.reproduce import PAPERS, fang2015, run_paper
from mooringdx.reproduce.acceleration import (
    SURGE,
    SWAY,
    accelerations,
    directions,
    filtered,
    inertia,
    pick,
)
from mooringdx.reproduce.claims import claims, text
from mooringdx.reproduce.drawing import SHEETS
from mooringdx.reproduce.effects import (
    FAILS,
    HOLDS,
    PARTLY,
    gaussian_distance,
    grade,
    kurtosis,
    wave_share,
    weibull_distance,
)
from mooringdx.reproduce.page import MISPRINTS, pages
from mooringdx.reproduce.study import Orders, Repeat, Series, Study, judge, statistic
from mooringdx.types import Array, Channels, Event, Fault, Grid, LogSource, Signatures, Whitened
from mooringdx.whiten.compress import fit_compression

ROOT = Path(__file__).parents[1]
GRID = Grid(0.0, 0.1, 8000)
ASKED = 1.0 / 428040.0
LINES = tuple(f"line_{j}" for j in range(1, 7))


def ship() -> Any:
    return vessel(read_toml(ROOT / "configs" / "vessels" / "cybership3.toml"))


def channels(names: list[str], columns: list[Array]) -> Channels:
    values = np.column_stack(columns)
    source = LogSource("log.csv", "csv", 1, "ab" * 32)
    return Channels(tuple(names), ("N",) * len(names), GRID, values, np.isfinite(values), source)


# --- the acceleration residual


def test_filter_answers_a_sinusoid_as_its_transfer_function() -> None:
    """Truth: analytic. Gain and phase of w^2/(s + w)^2, s w^2/(s + w)^2 and so on at s = i omega."""
    cut, omega, dt = 1.0, 0.7, 0.01
    time = dt * np.arange(20_000)
    out = filtered(np.sin(omega * time)[:, None], cut, dt)
    late = time > 100.0
    for order, found in enumerate(out):
        gain = (1j * omega) ** order * cut**2 / (1j * omega + cut) ** 2
        np.testing.assert_allclose(found[late, 0], np.imag(gain * np.exp(1j * omega * time[late])), atol=2e-4)


def motion(extra: Array) -> tuple[Array, Channels]:
    """Return places and a log in which thrust does exactly what the motion needs, less ``extra`` (3,), N, N, N m."""
    model, rig = ship(), mooring_of(ship())
    time = GRID.time
    _, eta0 = neutral(model)
    wave = np.column_stack([0.05 * np.sin(0.3 * time), 0.03 * np.cos(0.2 * time), 0.0 * time])
    speed = np.column_stack([0.015 * np.cos(0.3 * time), -0.006 * np.sin(0.2 * time), 0.0 * time])
    pace = np.column_stack([-0.0045 * np.sin(0.3 * time), -0.0012 * np.cos(0.2 * time), 0.0 * time])
    eta = eta0 + np.array([0.0, 0.0, 0.3]) + wave
    turn = rotation(float(eta[0, 2])).T
    needed = pace @ turn.T @ inertia(model).T + (speed @ turn.T) * np.asarray(model.dynamics.damping)
    lines = np.array([turn @ rig.force(place) for place in eta])
    thrust = needed - lines - extra
    names = ["north", "east", "heading", "thrust_surge", "thrust_sway", "thrust_yaw"]
    return eta, channels(names, [*eta.T, *thrust.T])


def test_acceleration_is_zero_where_every_force_is_known() -> None:
    """Truth: analytic. Thrust is made from Newton's law and the statics of the lines, so that nothing is left over."""
    eta, log = motion(np.zeros(3))
    out = accelerations(log, eta, ship(), mooring_of(ship()))
    late = GRID.time > 60.0
    assert np.isnan(out[0]).all()
    assert np.isfinite(out[late]).all()
    assert np.abs(out[late]).max() < 2e-5  # of 4.5e-3 m/s2 in the motion; the filter bends the lines' force a little


def test_an_unknown_force_moves_the_acceleration_by_its_negative_over_the_mass() -> None:
    """Truth: analytic. What pushes unseen makes the vessel accelerate more than the known forces explain."""
    push = np.array([0.4, -0.2, 0.1])
    eta, log = motion(push)
    out = accelerations(log, eta, ship(), mooring_of(ship()))[GRID.time > 60.0]
    expected = -(np.linalg.inv(inertia(ship())) @ push)[:2]
    np.testing.assert_allclose(out.mean(axis=0), expected, atol=5e-6)


def test_directions_are_what_a_lost_buoy_does() -> None:
    """Truth: brute force. The damaged line's own table in the system, at a place off the neutral one."""
    model = ship()
    rig = mooring_of(model)
    _, place = neutral(model)
    place = place + np.array([0.1, -0.05, 0.2])
    horizontal, tension = fault_tables(model, "buoyancy", [0.0, 1.0])
    names = (SURGE, SWAY, *(f"tension_{j}" for j in range(1, 7)))
    found = directions(model, rig, place, names)
    for j, line in enumerate(rig.names):
        broken = rig.with_line(line, horizontal[1], tension[1])
        intact = rig.with_line(line, horizontal[0], tension[0])
        change = float((broken.pulls(place)[1] - intact.pulls(place)[1])[j])
        force = rotation(place[2]).T @ (broken.force(place) - intact.force(place))
        expected = np.zeros(8)
        expected[:2] = -(np.linalg.inv(inertia(model)) @ force)[:2] / change
        expected[2 + j] = 1.0
        np.testing.assert_allclose(found.matrix[j], expected, rtol=2e-3, atol=1e-7)
        assert found.total[j] == pytest.approx(change, rel=2e-3)
        assert found.faults[j] == Fault("line_weakened", line, "buoyancy")


def test_pick_names_what_is_missing() -> None:
    assert pick(("north", "tension_4 - intact"), "tension_4") == "tension_4 - intact"
    with pytest.raises(ReportError, match="no residual of tension_4; it has north"):
        pick(("north",), "tension_4")


# --- effect sizes


def test_distances_and_kurtosis_of_known_laws() -> None:
    """Truth: analytic. Exact quantiles lie on their law; the uniform one has kurtosis -1.2, D 0.0572."""
    from scipy.special import ndtri

    p = (np.arange(20_000) + 0.5) / 20_000
    assert gaussian_distance(3.0 + 2.0 * ndtri(p)) < 1e-3
    assert kurtosis(ndtri(p)) == pytest.approx(0.0, abs=0.01)
    assert kurtosis(p) == pytest.approx(-1.2, abs=1e-3)
    assert gaussian_distance(p) == pytest.approx(0.0572, abs=5e-4)
    assert gaussian_distance(np.r_[p, np.nan]) == gaussian_distance(p)
    law = SimpleNamespace(quiet=0.4 * (-np.log1p(-p)) ** (1 / 0.7), scale=0.4, shape=0.7)
    assert weibull_distance(law) < 1e-3
    assert weibull_distance(SimpleNamespace(quiet=law.quiet, scale=0.8, shape=0.7)) > 0.1


def test_wave_share_of_two_sinusoids() -> None:
    """Truth: analytic. Power 9 at the wave frequency, 1 at a twentieth of it."""
    time = 0.1 * np.arange(6000)
    x = 3.0 * np.sin(2 * np.pi * time / 1.5) + np.sin(2 * np.pi * time / 30.0)
    assert wave_share(x, 0.1, 1.5) == pytest.approx(0.9, abs=0.005)


def test_grade() -> None:
    assert grade(True, True) == HOLDS
    assert grade(True, False) == PARTLY
    assert grade(False, False) == FAILS


# --- the statistic and its threshold


def made(z: Array) -> Whitened:
    """Return three whitened residuals as r1, r2 and the tension of line 4."""
    names = (SURGE, SWAY, "tension_4 - intact")
    rows = np.array([[-0.1, 0.05, 1.0]])
    signatures = Signatures(
        (Fault("line_weakened", "line_4", "buoyancy"),), names, rows, ("N",), np.array([1.3]), np.array([1.0])
    )
    return Whitened(names, Grid(0.0, 0.1, len(z)), z, np.isfinite(z), signatures, "arma+compression")


def noise(n: int, seed: int = 5) -> Array:
    return np.random.default_rng(seed).standard_normal((n, 3))


def test_statistic_is_the_mended_equation_15() -> None:
    """Truth: brute force, written out as printed but for the factor M/2."""
    z = noise(1500) + np.array([0.3, 0.0, -0.2])
    quiet = np.arange(1500) < 1000
    found = statistic(made(z), "line_4", quiet, 150)
    gamma = np.array([-0.1, 0.05, 1.0])
    inverse, mean = np.linalg.inv(np.cov(z[quiet].T)), z[quiet].mean(axis=0)
    for k in (149, 700, 1499):
        bar = (z[k - 149 : k + 1] - mean).mean(axis=0)
        expected = 75.0 * (gamma @ inverse @ bar) ** 2 / (gamma @ inverse @ gamma)
        assert found[k] == pytest.approx(expected, rel=1e-9)
    assert np.isnan(found[:149]).all()


def test_white_noise_gives_half_a_chi_square() -> None:
    """Truth: theory. Twice the statistic of white Gaussian z has mean 1; a Weibull fit of half a chi-square has .63."""
    z = noise(150_000)
    quiet = np.ones(len(z), dtype=np.bool_)
    course = judge(statistic(made(z), "line_4", quiet, 50), quiet, Grid(0.0, 0.1, len(z)), 50, 1e9, ASKED / 6)
    assert 2 * course.quiet.mean() == pytest.approx(1.0, abs=0.06)
    assert course.shape == pytest.approx(0.63, abs=0.04)
    assert course.alarm is None


def test_level_is_equation_22_at_the_probability_of_the_asked_rate() -> None:
    """Truth: the formulae, put back: 1 - P by eq. 21, and the two rates that the two levels stand for."""
    z = noise(8000)
    z[6000:, 2] += 1.0
    quiet = (np.arange(8000) >= 1000) & (np.arange(8000) < 5500)
    course = judge(statistic(made(z), "line_4", quiet, 150), quiet, GRID, 150, 600.0, ASKED / 6)
    assert exp(-((course.level / course.scale) ** course.shape)) == pytest.approx(course.probability, rel=1e-6)
    assert course.probability == pytest.approx(ASKED / 6 * 0.1 * course.cluster, rel=1e-6)
    half = 2.0 * course.quiet.mean()
    assert course.weibull_rate == pytest.approx(erfc(sqrt(course.level / half)) / (0.1 * course.cluster), rel=1e-9)
    assert course.ideal_level < course.level
    assert course.alarm is not None
    assert 600.0 < course.alarm < 615.0
    assert course.before == 0
    assert course.quiet.size == 5500 - 1150


# --- the page


def coloured(n: int, seed: int) -> Array:
    from scipy.signal import lfilter

    angle = 2 * np.pi * 0.1 / 1.5
    x = lfilter([1.0], [1.0, -2 * 0.975 * np.cos(angle), 0.975**2], np.random.default_rng(seed).standard_normal(n))
    return np.asarray(x / x.std())


@lru_cache(maxsize=1)
def study() -> Study:
    """Return a study made by hand: 800 s, fitted on [180, 550] s, fault at 580 s; nothing in it is a claim."""
    n, time = GRID.n, GRID.time
    quiet, after = (time >= 180) & (time < 550), time >= 580
    z = noise(n, 11)
    z[:100] = np.nan
    packed = fit_compression([z[quiet, i] for i in range(3)], "fang", 3.0)(z)
    series = []
    for i, (symbol, name, unit, size) in enumerate(
        [("r1", SURGE, "m/s2", 0.01), ("r5", "tension_4 - intact", "N", 0.13)]
    ):
        raw = size * coloured(n, 20 + i) + (10 * size if i else size) * after + (1 - i) * 1e-5 * time
        white = z[:, 2 * i] + 3.0 * after
        series.append(Series(symbol, name, unit, raw, white, packed[:, 2 * i] + 0.8 * after, ((1 - i) * 1e-5, 0.0)))
    walk = made(np.where(after[:, None], packed + np.array([0.0, 0.0, 0.8]), packed))
    courses = tuple(judge(statistic(walk, "line_4", quiet, m), quiet, GRID, m, 580.0, ASKED / 6) for m in (400, 150))
    run = SimpleNamespace(digest=lambda: "cd" * 32)
    baseline: Any = SimpleNamespace(
        verdict="invalid", config=lambda: run, fitted=SimpleNamespace(timing=SimpleNamespace(peak_period=1.5))
    )
    detection: Any = SimpleNamespace(
        channels=channels(["north"], [0.0 * time]),
        no_fault=((180.0, 550.0),),
        events=(Event("line_weakened", "line_4", 580.0, (579.0, 581.0), 582.0),),
    )
    return Study(
        detection=detection, baseline=baseline, onset=580.0, line="line_4", asked=ASKED, quiet=quiet,
        late=time >= 600, force=series[0], tension=series[1], courses=courses,
        orders=Orders((-1.2, 0.5), (0.01, 0.01), (40.0, 50.0)),
        rivals={line: 500.0 if line == "line_4" else 4.0 + j for j, line in enumerate(LINES)},
    )  # fmt: skip


REPEATS = (Repeat(2, (4.0, 3.0), (0, 0), True), Repeat(3, (9.0, 12.0), (0, 0), True))


def test_every_claim_has_a_rule_a_verdict_and_numbers() -> None:
    found = claims(study(), REPEATS)
    assert len(found) == 16
    for claim in found:
        assert claim.verdict in (HOLDS, PARTLY, FAILS)
        assert claim.rule
        assert claim.numbers
        assert claim.measured.endswith(".")
    assert text(found).splitlines()[0].startswith("Fang2015, 16 claims: ")
    assert len(text(found).splitlines()) == 17


def test_verdicts_follow_the_numbers() -> None:
    """Truth: construction. Each of these follows from how the hand-made study was made."""
    by_word = {c.paper.split()[0] + " " + c.where: c for c in claims(study(), REPEATS)}
    verdict = {key: c.verdict for key, c in by_word.items()}
    assert verdict["It 2.3, Fig. 6"] == FAILS  # Gaussian noise is compressed into something nearly uniform
    assert verdict["Parallel 3.1, eq. 19"] == HOLDS
    assert verdict["The 2.3, Fig. 5"] == HOLDS
    assert verdict["(One 3.1, 3.2"] == HOLDS
    assert by_word["(One 3.1, 3.2"].numbers["delay_last_m150"] == 12.0
    worse = claims(study(), (*REPEATS, Repeat(4, (None, 3.0), (5, 0), False)))[-1]
    assert worse.verdict == PARTLY
    assert worse.numbers["found_m400"] == 2.0
    assert worse.numbers["false_m400"] == 1.0


def test_exactly_gaussian_values_become_nearly_uniform() -> None:
    """Truth: theory of eqs. 9 and 10 on N(0, 1), k = 3: s 0.536, excess kurtosis -1.23."""
    claim = next(c for c in claims(study()) if "better fit" in c.paper)
    assert claim.numbers["ideal_scale"] == pytest.approx(0.536, abs=0.001)
    assert claim.numbers["ideal_kurtosis"] == pytest.approx(-1.23, abs=0.01)


def test_page_is_whole_and_the_same_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    """Truth: read back. Every figure inside the page, nothing from outside, the same bytes twice."""
    few = {name: SHEETS[name] for name in ("fig5_acf_whitened", "fig8_statistic_m150")}
    monkeypatch.setattr("mooringdx.reproduce.page.SHEETS", few)
    found = claims(study(), REPEATS)
    files = pages(study(), found, fang2015.command(1))
    assert files == pages(study(), found, fang2015.command(1))
    page = files["index.html"].decode()
    assert page.count("data:image/png;base64,") == 2
    assert 'src="http' not in page
    assert "mooringdx reproduce fang2015 -o DIR --seed 1" in page
    for name in few:
        assert files[f"figures/{name}.png"][:4] == b"\x89PNG"
        assert files[f"figures/{name}.svg"].startswith(b"<?xml")
    body = json.loads(files["claims.json"])
    assert [c["verdict"] for c in body["claims"]] == [c.verdict for c in found]
    assert len(body["misprints"]) == len(MISPRINTS)


def test_the_misprinted_wave_would_break() -> None:
    """Truth: deep water, length g T^2 / 2 pi: at 0.15 s shorter than the waves are high, at 1.5 s not."""
    length = [9.81 * period**2 / (2 * np.pi) for period in (0.15, 1.5)]
    assert length[0] == pytest.approx(0.035, abs=5e-4)
    assert length[0] < 0.06 < 0.14 * length[1]


def test_strangers_and_unknown_papers_are_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.pdf").write_bytes(b"x")
    with pytest.raises(ReportError, match=r"thesis\.pdf"):
        run_paper("fang2015", tmp_path, 1)
    with pytest.raises(ConfigError, match="fang2015"):
        run_paper("fang2014", tmp_path / "new", 1)
    assert tuple(PAPERS) == ("fang2015", "position-thesis")


@pytest.mark.parametrize(("kind", "name"), [("runs", "fang2015"), ("scenarios", "fang_paper")])
def test_the_experiment_is_the_papers(kind: str, name: str) -> None:
    """Truth: published, section 2.2 and 5.1: window, fault, schedule."""
    body = read_toml(fang2015.setting(kind, name))
    if kind == "runs":
        assert body["baseline"]["window"] == [180.0, 550.0]
        assert body["detector"]["window"] == 15.0
    else:
        assert (body["sea"]["start"], body["faults"][0]["subject"]) == (150.0, "line_4")
        assert body["faults"][0]["onset"] == 580.0
        assert body["traps"][0]["onset"] == 370.0
        assert body["traps"][0]["ramp"] == 150.0
    with pytest.raises(ConfigError, match="no run file"):
        fang2015.setting("runs", "nobody2015")


@pytest.mark.slow
def test_the_whole_reproduction(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Truth: another program for the size (MoorPy: a lost buoy adds 1.27 N), the paper for the rest."""
    monkeypatch.setattr(fang2015, "FURTHER", 1)
    said = run_paper("fang2015", tmp_path, 1)
    body = json.loads((tmp_path / "claims.json").read_text())
    numbers = [c["numbers"] for c in body["claims"]]
    shift = next(n["r5_shift"] for n in numbers if "r5_shift" in n)
    assert shift == pytest.approx(1.27, abs=0.1)
    delays = next(n for n in numbers if "delay_m150" in n)
    assert 0.0 < delays["delay_m150"] < 15.0
    assert 0.0 < delays["delay_m400"] < 40.0
    assert delays["false_m150"] == delays["false_m400"] == 0.0
    rivals = next(n for n in numbers if "line_4" in n)
    assert max(rivals, key=lambda line: rivals[line]) == "line_4"
    assert {p.name for p in tmp_path.iterdir()} == set(fang2015.OWN)
    assert len(list((tmp_path / "figures").iterdir())) == 2 * len(SHEETS)
    assert said.startswith("Fang2015, 16 claims")
