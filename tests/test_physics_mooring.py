"""The mooring system against plain numpy, its own energy, the symmetries of a plane, and figures of both vessels."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.optimize import minimize

from mooringdx.errors import ConfigError, FitError
from mooringdx.physics.frames import rotation
from mooringdx.physics.line import deprived, solve
from mooringdx.physics.mooring import Mooring, equilibrium, line_force, lookup, lookups, reaches
from mooringdx.physics.rig import fault_tables, mooring_of, neutral, period, sliding
from mooringdx.physics.vessel import VesselModel, load_vessel, vessel
from mooringdx.types import replace

VESSELS = Path(__file__).parents[1] / "configs" / "vessels"
NAMES = ("cybership3", "fpso200")
SHIPS = {name: load_vessel(VESSELS / f"{name}.toml") for name in NAMES}


def grid(mooring: Mooring) -> np.ndarray:
    return mooring.start + mooring.step * np.arange(mooring.horizontal.shape[1])


def lopsided() -> Mooring:
    """Four lines of different tables and fairleads, because symmetry hides mistakes."""
    x = 10.0 + 0.05 * np.arange(101)
    tables = np.array([a * np.exp(b * (x - 10.0)) for a, b in ((1.0, 0.7), (2.0, 0.4), (0.5, 1.0), (1.5, 0.6))])
    return Mooring(
        names=("line_1", "line_2", "line_3", "line_4"),
        anchors=np.array([[12.0, 3.0], [-2.0, 13.0], [-13.0, -1.0], [4.0, -12.0]]),
        fairleads=np.array([[0.9, 0.2], [-0.3, 0.4], [-0.8, -0.1], [0.2, -0.5]]),
        start=10.0,
        step=0.05,
        horizontal=tables,
        tension=1.3 * tables + 1.0,
    )


PLACES = [np.array(p) for p in ([0.0, 0.0, 0.0], [0.31, -0.22, 0.4], [-0.57, 0.83, -2.3])]


def plain_table(mooring: Mooring, j: int, x: float) -> float:
    points, values = grid(mooring), mooring.horizontal[j]
    if x > points[-1]:
        return float(values[-1] + (values[-1] - values[-2]) / mooring.step * (x - points[-1]))
    return float(np.interp(x, points, values))


def plain_force(mooring: Mooring, eta: np.ndarray) -> np.ndarray:
    """The equations at the head of the module, one line after another, with numpy's own cross product."""
    total = np.zeros(3)
    for j in range(len(mooring.names)):
        arm = rotation(eta[2])[:2, :2] @ mooring.fairleads[j]
        way = mooring.anchors[j] - eta[:2] - arm
        pull = plain_table(mooring, j, float(np.linalg.norm(way))) * way / np.linalg.norm(way)
        total += [pull[0], pull[1], arm[0] * pull[1] - arm[1] * pull[0]]
    return total


@pytest.mark.parametrize("eta", PLACES)
def test_plain_numpy_the_kernels(eta: np.ndarray) -> None:
    m = lopsided()
    assert m.force(eta) == pytest.approx(plain_force(m, eta), rel=1e-12)
    assert line_force(eta, m.fairleads, m.anchors, m.start, m.step, m.horizontal) == pytest.approx(m.force(eta))
    distance, direction = reaches(eta, m.fairleads, m.anchors)
    way = m.anchors - eta[:2] - m.fairleads @ rotation(eta[2])[:2, :2].T
    assert distance == pytest.approx(np.linalg.norm(way, axis=1), rel=1e-14)
    assert direction * distance[:, None] == pytest.approx(way, rel=1e-13)
    horizontal, tension, _ = m.pulls(eta)
    assert horizontal == pytest.approx([plain_table(m, j, distance[j]) for j in range(4)], rel=1e-12)
    assert tension == pytest.approx(1.3 * horizontal + 1.0, rel=1e-12)


@pytest.mark.parametrize("x", [9.0, 10.0, 10.02, 12.345, 14.99, 15.0, 17.0])
def test_plain_numpy_a_table_is_level_before_and_straight_beyond(x: float) -> None:
    m = lopsided()
    assert lookup(m.start, m.step, m.horizontal[1], x) == pytest.approx(plain_table(m, 1, x), rel=1e-12)
    assert lookups(m.start, m.step, m.horizontal, np.full(4, x))[1] == pytest.approx(plain_table(m, 1, x), rel=1e-12)


def test_quadrature_the_energy() -> None:
    m = lopsided()
    for eta in (*PLACES, np.array([5.0, -3.0, 0.1])):
        distance, _ = reaches(eta, m.fairleads, m.anchors)
        knots = [grid(m)[(grid(m) > min(10.0, x)) & (grid(m) < x)] for x in distance]
        truth = sum(
            quad(lambda x, j=j: plain_table(m, j, x), 10.0, distance[j], points=knots[j], limit=400)[0]
            for j in range(4)
        )
        assert m.energy(eta) == pytest.approx(truth, rel=1e-9)


@pytest.mark.parametrize("name", [*NAMES, "lopsided"])
def test_analytic_restoring_is_the_fall_of_energy(name: str) -> None:
    m = lopsided() if name == "lopsided" else mooring_of(SHIPS[name])
    size = 1.0 if name == "lopsided" else 0.02 * float(np.max(np.abs(m.anchors)))
    for place in PLACES:
        eta = place * np.array([size, size, 1.0])
        force = m.force(eta)
        for i, width in enumerate(np.array([1e-4, 1e-4, 1e-6]) * [size, size, 1.0]):
            delta = np.eye(3)[i] * width
            fall = (m.energy(eta - delta) - m.energy(eta + delta)) / (2.0 * width)
            assert fall == pytest.approx(force[i], rel=2e-5, abs=2e-5 * np.max(np.abs(force)))


@pytest.mark.parametrize("name", NAMES)
def test_analytic_a_lost_line_is_the_system_less_that_line(name: str) -> None:
    m = mooring_of(SHIPS[name])
    scale = 0.01 * float(np.max(np.abs(m.anchors)))
    for lost in m.names:
        others = [line for line in m.names if line != lost]
        for place in PLACES:
            eta = place * np.array([scale, scale, 1.0])
            alone, rest = m.without(others).force(eta), m.without([lost]).force(eta)
            assert rest == pytest.approx(m.force(eta) - alone, rel=1e-9, abs=1e-9 * np.abs(alone).max())
    assert np.all(m.without(m.names).force(np.zeros(3)) == 0.0)


def test_analytic_a_turned_and_shifted_sea_turns_the_force() -> None:
    m, turn, shift = lopsided(), 0.7, np.array([120.0, -35.0])
    r = rotation(turn)
    other = replace(m, anchors=m.anchors @ r[:2, :2].T + shift)
    for eta in PLACES:
        there = r @ eta + np.array([*shift, turn])
        assert other.force(there) == pytest.approx(r @ m.force(eta), rel=1e-10)
        assert other.energy(there) == pytest.approx(m.energy(eta), rel=1e-10)


@pytest.mark.parametrize("name", NAMES)
def test_brute_force_the_tables_are_the_statics(name: str) -> None:
    ship = SHIPS[name]
    m, section = mooring_of(ship), ship.mooring
    distances, _ = neutral(ship)
    for x in np.linspace(0.5 * (m.start + distances[0]), grid(m)[-1], 23)[:-1]:
        shape = solve(section.sections, section.depth, float(x), section.friction)
        assert np.interp(x, grid(m), m.horizontal[0]) == pytest.approx(shape.horizontal, rel=2e-4)
        assert np.interp(x, grid(m), m.tension[0]) == pytest.approx(shape.tension, rel=2e-4)
    near = solve(section.sections, section.depth, float(distances[0]), section.friction)
    assert np.interp(distances[0], grid(m), m.horizontal[0]) == pytest.approx(near.horizontal, rel=2e-5)
    assert np.all(np.diff(m.horizontal[0]) > 0.0)
    assert np.all(np.diff(m.tension[0]) > 0.0)
    assert m.tension[0, -1] > 20.0 * near.tension > m.tension[0, -100]
    assert mooring_of(ship) is m


def test_published_the_model_ship() -> None:
    """Figures of the rig that stands in for that of [Fang2015]: 2.5 N, 4.0 N, 5.4 N/m, 17 N/m, 13 s, +1.2655 N."""
    ship = SHIPS["cybership3"]
    m = mooring_of(ship)
    distances, eta = neutral(ship)
    horizontal, tension, direction = m.pulls(eta)
    assert distances == pytest.approx(np.full(6, 12.48))
    assert eta == pytest.approx([-0.85, 0.0, 0.0])
    assert np.degrees(np.arctan2(direction[:, 1], direction[:, 0])) % 360 == pytest.approx([30, 90, 150, 210, 270, 330])
    assert horizontal == pytest.approx(2.5, rel=0.01)
    assert tension == pytest.approx(4.0, rel=0.01)
    slope = np.gradient(m.horizontal[0], m.step)
    assert np.interp(12.48, grid(m), slope) == pytest.approx(5.4, rel=0.01)
    assert m.stiffness(eta)[0, 0] == pytest.approx(17.0, rel=0.02)
    assert period(ship, m)[0] == pytest.approx(13.0, rel=0.06)


def test_published_a_lost_buoy_pulls_its_line() -> None:
    ship = SHIPS["cybership3"]
    m = mooring_of(ship)
    h, t = fault_tables(ship, "buoyancy", [0.0, 1.0, 1.2])
    more_h = np.array([np.interp(12.48, grid(m), row) for row in h - m.horizontal[0]])
    more_t = np.array([np.interp(12.48, grid(m), row) for row in t - m.tension[0]])
    assert more_t[0] == pytest.approx(0.0, abs=1e-9)
    assert more_t[1] == pytest.approx(1.2655, rel=2e-3)
    assert more_h[1] / more_t[1] == pytest.approx(0.60, abs=0.005)
    assert more_t[2] / more_t[1] == pytest.approx(1.2, abs=0.01)
    direct = solve(deprived(ship.mooring.sections, 1.0), ship.mooring.depth, 12.48)
    assert more_t[1] == pytest.approx(direct.tension - np.interp(12.48, grid(m), m.tension[0]), abs=1e-4)


def test_published_the_platform() -> None:
    """Figures of [PositionThesis]'s platform with the stated line: 460 kN, 680 kN, 14.5 kN/m, 540 s, 40 m."""
    ship = SHIPS["fpso200"]
    m = mooring_of(ship)
    distances, eta = neutral(ship)
    horizontal, tension, _ = m.pulls(eta)
    assert distances == pytest.approx(1950.0, rel=1e-4)
    assert horizontal == pytest.approx(460e3, rel=0.005)
    assert tension == pytest.approx(680e3, rel=0.005)
    k = m.stiffness(eta)
    assert k[0, 0] == pytest.approx(14.5e3, rel=0.02)
    assert k[1, 1] == pytest.approx(k[0, 0], rel=1e-3)
    periods = period(ship, m)
    assert periods[0] == pytest.approx(540.0, rel=0.05)
    assert periods[2] == np.inf
    for lost in ("line_6", "line_7", "line_8"):
        place = equilibrium(m.without([lost]), np.zeros(3), eta)
        assert np.hypot(place[0], place[1]) == pytest.approx(40.0, rel=0.1)
    away = equilibrium(m.without(["line_7"]), np.zeros(3), eta)
    assert away[:2] @ ship.mooring.anchors["line_7"] < 0.0
    held = equilibrium(m.without(["line_7"]), np.array([-0.25e6, -0.25e6, 0.0]) / np.sqrt(2.0), eta)
    assert np.hypot(held[0], held[1]) == pytest.approx(19.1, abs=0.5)


def test_brute_force_equilibrium_is_the_least_energy() -> None:
    m = lopsided()
    for load in (np.zeros(3), np.array([1.5, -0.8, 0.6]), np.array([-3.0, 2.0, -1.0])):
        eta = equilibrium(m, load, np.zeros(3))
        truth = minimize(lambda y, f=load: m.energy(y) - f @ y, np.zeros(3), method="Nelder-Mead", tol=1e-12)
        assert eta == pytest.approx(truth.x, abs=1e-5)
        assert m.force(eta) == pytest.approx(-load, abs=1e-6)
        fixed = equilibrium(m, load, np.array([0.1, 0.0, 0.2]), hold_heading=True)
        assert fixed[2] == 0.2
        assert m.force(fixed)[:2] == pytest.approx(-load[:2], abs=1e-6)


def test_analytic_a_vessel_on_a_turret_swings_downstream() -> None:
    ship = SHIPS["cybership3"]
    m, start = mooring_of(ship), neutral(ship)[1]
    for load in ([-0.7, 0.25, 0.0], [0.3, 0.4, 0.0]):
        eta = equilibrium(m, np.array(load), start)
        assert rotation(eta[2])[:2, 0] == pytest.approx(-np.array(load[:2]) / np.hypot(*load[:2]), abs=1e-5)
    small = np.array([0.01, 0.0, 0.0])
    held = equilibrium(m, small, start, hold_heading=True)
    assert held[0] - start[0] == pytest.approx(0.01 / m.stiffness(start)[0, 0], rel=0.01)


def test_a_load_that_nothing_holds_is_refused_in_a_sentence() -> None:
    m = mooring_of(SHIPS["fpso200"])
    with pytest.raises(FitError, match="cannot hold a load"):
        equilibrium(m.without(m.names), np.array([1e5, 0.0, 0.0]), np.zeros(3))
    with pytest.raises(FitError, match="cannot hold a load"):
        equilibrium(m, np.array([0.0, 0.0, 1e6]), np.zeros(3))


def test_analytic_where_a_parted_line_slides() -> None:
    for ship in SHIPS.values():
        m = mooring_of(ship)
        horizontal, tension, _ = m.pulls(neutral(ship)[1])
        assert sliding(ship, 1.0) == pytest.approx(np.mean(horizontal), rel=1e-3)
        half = sliding(ship, 0.5)
        assert np.interp(half, m.horizontal[0], m.tension[0]) == pytest.approx(0.5 * np.mean(tension), rel=1e-6)
        with pytest.raises(ConfigError, match=r"give a share from 0\.\d+ to 1"):
            sliding(ship, 0.1)
        with pytest.raises(ConfigError, match="to 1"):
            sliding(ship, 1.1)


def test_stiffness_lost_slackens_a_line_a_little() -> None:
    ship = SHIPS["fpso200"]
    m = mooring_of(ship)
    x = neutral(ship)[0][0]
    _, t = fault_tables(ship, "stiffness", [0.0, 0.1, 0.3])
    found = [np.interp(x, grid(m), row) for row in t]
    soft = deprived(ship.mooring.sections, stiffness=0.3)
    assert found[0] == pytest.approx(np.interp(x, grid(m), m.tension[0]), rel=1e-9)
    assert found[2] == pytest.approx(solve(soft, ship.mooring.depth, float(x)).tension, rel=1e-4)
    assert found[0] > found[1] > found[2]
    with pytest.raises(ConfigError, match="give buoyancy or stiffness"):
        fault_tables(ship, "colour", [0.1])


def spread(**changes: object) -> VesselModel:
    """The platform with its lines at four corners, bow east, or with what is given instead."""
    body = SHIPS["fpso200"].model_dump()
    corners = {"line_1": (90.0, 20.0), "line_2": (-90.0, 20.0), "line_3": (-90.0, -20.0), "line_4": (90.0, -20.0)}
    body["mooring"] |= {"turret": None, "anchors": {}, "fairleads": corners, "heading": 90.0, "radius": 1950.0}
    body["mooring"] |= {"azimuth": {"line_1": 135.0, "line_2": 225.0, "line_3": 315.0, "line_4": 45.0}, **changes}
    return vessel(body)


def test_analytic_a_spread_mooring_stands_where_its_file_says() -> None:
    ship = spread()
    m = mooring_of(ship)
    distances, eta = neutral(ship)
    assert distances == pytest.approx(1950.0)
    assert eta == pytest.approx([0.0, 0.0, np.pi / 2])
    assert m.fairleads[0] == pytest.approx([90.0, 20.0])
    assert m.anchors[0] == pytest.approx([-20.0 - 1950.0 * np.sqrt(0.5), 90.0 + 1950.0 * np.sqrt(0.5)])
    assert m.force(eta) == pytest.approx(np.zeros(3), abs=1.0)
    assert np.all(np.isfinite(period(ship, m)))
    k = m.stiffness(eta)
    assert period(ship, m)[2] == pytest.approx(2.0 * np.pi * np.sqrt(4.38e11 / k[2, 2]), rel=1e-2)


def test_a_line_too_short_for_its_anchors_is_refused_in_a_sentence() -> None:
    with pytest.raises(FitError, match="too short to reach"):
        mooring_of(spread(radius=3950.0))
