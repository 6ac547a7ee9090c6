"""Line statics against published figures, MoorPy's own systems, an independent shooting solution, and analysis."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import REFERENCE
from scipy.optimize import fsolve

from mooringdx.errors import ConfigError, FitError
from mooringdx.physics.catenary import catenary
from mooringdx.physics.line import deprived, solve, tabulate
from mooringdx.physics.vessel import Section, VesselModel, load_vessel

VESSELS = Path(__file__).parents[1] / "configs" / "vessels"
STATICS = REFERENCE / "mooring_statics_reference"


@pytest.fixture(scope="module")
def model_ship() -> VesselModel:
    return load_vessel(VESSELS / "cybership3.toml")


def hanging(sections, horizontal, vertical):
    """Walk down a line from its fairlead: (x, z) that it spans, and the vertical tension at the anchor.

    The textbook's elastic catenary from the top, section by section. The uppermost may sag; of those below, what would
    sink below zero vertical tension lies on a seabed without friction.
    """
    x = z = 0.0
    v = vertical
    for s in reversed(sections):
        if s is not sections[-1]:
            v += s.buoy
        lifted = s.length if s is sections[-1] else min(s.length, max(v, 0.0) / s.weight)
        low = v - s.weight * lifted
        h_w = horizontal / s.weight
        x += h_w * (np.arcsinh(v / horizontal) - np.arcsinh(low / horizontal)) + horizontal * s.length / s.stiffness
        z += h_w * (np.hypot(1.0, v / horizontal) - np.hypot(1.0, low / horizontal))
        z += (v**2 - low**2) / (2.0 * s.weight * s.stiffness)
        x += s.length - lifted
        v = 0.0 if lifted < s.length else low
    return x, z, v


def shot(sections, depth, distance, guess):
    """Find the tensions at the fairlead whose walk down ends at the anchor."""
    scale = np.array(guess)

    def miss(y):
        x, z, _ = hanging(sections, *(np.exp(y) * scale))
        return [(x - distance) / depth, (z - depth) / depth]

    y = fsolve(miss, np.zeros(2), xtol=1e-10)
    assert np.max(np.abs(miss(y))) < 1e-9
    return np.exp(y) * scale


@pytest.mark.reference
@pytest.mark.parametrize(
    ("name", "anchor", "fairlead"),
    [("WD0050", 826.2e3, 991.6e3), ("WD0200", 1402.2e3, 2065.4e3), ("WD0600", 3244.2e3, 5232.6e3)],
)
def test_published_a_chain_pulls_as_in_orcaflex(name: str, anchor: float, fairlead: float) -> None:
    rows = [r.split() for r in (STATICS / f"{name}_Chain.txt").read_text(encoding="utf-8").splitlines()]
    kind = next(r for r in rows if r[:1] == ["chain"])
    fixed = next(r for r in rows if r[1:2] == ["Fixed"])
    length = float(next(r for r in rows if r[1:2] == ["chain"])[4])
    weight = (float(kind[2]) - 1025.0 * np.pi / 4.0 * float(kind[1]) ** 2) * 9.80665
    chain = Section(length=length, weight=weight, stiffness=float(kind[3]))
    shape = solve([chain], -float(fixed[4]), float(fixed[2]))
    assert shape.anchor_tension == pytest.approx(anchor, rel=0.015)
    assert shape.tension == pytest.approx(fairlead, rel=0.012)


def cases() -> list[dict[str, float]]:
    path = STATICS / "catenary_cases_moorpy.csv"
    if not path.is_file():
        return []
    with path.open(encoding="utf-8") as file:
        return [{k: float(v) for k, v in row.items()} for row in csv.DictReader(file)]


@pytest.mark.reference
def test_published_ten_catenaries() -> None:
    assert len(cases()) == 10
    for case in cases():
        ends = catenary(
            (case["x_m"], case["z_m"]),
            case["L_m"],
            case["w_Npm"],
            case["EA_N"],
            case["CB"],
            (case["HF0"], case["VF0"]),
        )
        at_anchor, at_fairlead = [case["fAH_N"], case["fAV_N"]], [case["fBH_N"], case["fBV_N"]]
        assert ends.lower == pytest.approx(at_anchor, rel=1e-4, abs=1e-4 * np.hypot(*at_anchor))
        assert ends.upper == pytest.approx(at_fairlead, rel=1e-4, abs=1e-4 * np.hypot(*at_fairlead))


def test_another_program_the_buoyed_line_as_a_system_of_moorpy(model_ship: VesselModel) -> None:
    import moorpy

    m = model_ship.mooring
    chain, wire = m.sections
    for distance in np.linspace(11.0, 13.3, 12):
        shape = solve(m.sections, m.depth, float(distance), m.friction)
        system = moorpy.System(depth=m.depth)
        for name, s in (("chain", chain), ("wire", wire)):
            system.lineTypes[name] = {
                "name": name,
                "w": s.weight,
                "EA": s.stiffness,
                "d_vol": 0.0,
                "m": s.weight / system.g,
            }
        system.addPoint(1, [0.0, 0.0, -m.depth])
        system.addPoint(0, [shape.joints[0, 0] + 0.05, 0.0, shape.joints[0, 1] - m.depth + 0.05], m=0.0, v=0.0)
        system.addPoint(1, [float(distance), 0.0, 0.0])
        system.pointList[1].fExt = np.array([0.0, 0.0, chain.buoy])
        system.addLine(chain.length, "chain", pointA=1, pointB=2)
        system.addLine(wire.length, "wire", pointA=2, pointB=3)
        system.initialize()
        system.solveEquilibrium(tol=1e-9)
        top, low = system.pointList[2].getForces(), system.pointList[0].getForces()
        assert shape.horizontal == pytest.approx(-top[0], abs=1e-4)
        assert shape.vertical == pytest.approx(-top[2], abs=1e-4)
        assert shape.anchor_horizontal == pytest.approx(low[0], abs=1e-4)


@pytest.mark.parametrize("buoy", [0.8, 0.3, 0.0, -0.16])
@pytest.mark.parametrize("distance", [11.2, 12.0, 12.48, 13.0, 13.35, 13.5])
def test_brute_force_two_sections_by_shooting(model_ship: VesselModel, buoy: float, distance: float) -> None:
    m = model_ship.mooring
    sections = [m.sections[0].model_copy(update={"buoy": buoy}), m.sections[1]]
    shape = solve(sections, m.depth, distance)
    truth = shot(sections, m.depth, distance, (shape.horizontal * 1.2, shape.vertical * 0.9))
    assert [shape.horizontal, shape.vertical] == pytest.approx(truth, rel=2e-6)


GROUND = [
    Section(length=300.0, weight=1800.0, stiffness=9e8),
    Section(length=500.0, weight=1500.0, stiffness=8e8, buoy=2e5),
    Section(length=250.0, weight=400.0, stiffness=3e8),
]


@pytest.mark.parametrize("distance", [900.0, 960.0, 1000.0, 1020.0, 1035.0])
def test_brute_force_three_sections_with_a_joint_on_the_seabed(distance: float) -> None:
    shape = solve(GROUND, 200.0, distance)
    truth = shot(GROUND, 200.0, distance, (shape.horizontal * 0.9, shape.vertical * 1.1))
    assert [shape.horizontal, shape.vertical] == pytest.approx(truth, rel=1e-5)
    assert (shape.joints[0, 1] == 0.0) == (shape.bottom > 300.0)


def test_brute_force_the_joint_does_lie_on_the_seabed_somewhere() -> None:
    assert [solve(GROUND, 200.0, x).joints[0, 1] > 0.0 for x in (900.0, 1035.0)] == [False, True]


def test_analytic_a_weight_at_a_joint_on_the_seabed_changes_nothing() -> None:
    weighted = [GROUND[0].model_copy(update={"buoy": -5e4}), *GROUND[1:]]
    bare, more = (solve(sections, 200.0, 960.0) for sections in (GROUND, weighted))
    assert more.joints[0, 1] == 0.0
    assert [more.horizontal, more.vertical] == pytest.approx([bare.horizontal, bare.vertical], rel=1e-6)


@pytest.mark.parametrize(("span", "seabed"), [((460.0, 130.0), 0.0), ((400.0, 250.0), -60.0)])
def test_numerical_a_catenary_knows_its_stiffness(span: tuple[float, float], seabed: float) -> None:
    here = catenary(span, 500.0, 1500.0, 8e8, seabed)
    ways = np.array([1e-3, 0.0]), np.array([0.0, 1e-3])
    ends = [[catenary(span + sign * w, 500.0, 1500.0, 8e8, seabed).upper for sign in (1, -1)] for w in ways]
    slopes = np.column_stack([(far - near) / 2e-3 for far, near in ends])
    assert here.stiff_upper == pytest.approx(-slopes, rel=1e-3)
    moved = 1 if seabed == 0.0 else 2  # a lower end on the seabed moves along it only
    assert here.stiff_cross[:, :moved] == pytest.approx(slopes[:, :moved], rel=1e-3)


def test_analytic_friction_lowers_the_anchor_by_the_weight_on_the_seabed(model_ship: VesselModel) -> None:
    m = model_ship.mooring
    weight = m.sections[0].weight
    smooth, rough = (solve(m.sections, m.depth, 12.9, friction) for friction in (0.0, 0.3))
    assert smooth.anchor_horizontal == pytest.approx(smooth.horizontal, rel=1e-6)
    assert rough.anchor_horizontal == pytest.approx(rough.horizontal - 0.3 * weight * rough.bottom, rel=1e-6)
    assert rough.horizontal == pytest.approx(smooth.horizontal, rel=1e-3)


def test_analytic_what_hangs_is_lifted(model_ship: VesselModel) -> None:
    m = model_ship.mooring
    for distance in (11.0, 12.48, 13.45):
        shape = solve(m.sections, m.depth, distance)
        lifted = sum(s.weight * s.length - s.buoy for s in m.sections) - m.sections[0].weight * shape.bottom
        assert shape.vertical + shape.anchor_vertical * -1.0 == pytest.approx(lifted, rel=1e-6)
        assert shape.tension == pytest.approx(np.hypot(shape.horizontal, shape.vertical), rel=1e-12)


def test_the_way_there_does_not_matter(model_ship: VesselModel) -> None:
    m = model_ship.mooring
    distances = np.linspace(10.5, 13.5, 31)
    horizontal, tension = tabulate(m.sections, m.depth, distances, 0.0)
    fresh = [solve(m.sections, m.depth, float(x)) for x in distances]
    assert horizontal == pytest.approx([s.horizontal for s in fresh], rel=1e-6, abs=1e-7)
    assert tension == pytest.approx([s.tension for s in fresh], rel=1e-6)
    assert np.all(np.diff(horizontal) > 0.0)
    assert np.all(np.diff(tension) > 0.0)


def test_analytic_a_slack_line_hangs_straight_down(model_ship: VesselModel) -> None:
    chain = Section(length=2250.0, weight=221.0, stiffness=2.25e8)
    horizontal, tension = tabulate([chain], 1000.0, np.linspace(300.0, 1990.0, 40), 0.0)
    assert horizontal[:5] == pytest.approx(np.zeros(5), abs=1.0)
    assert tension[:5] == pytest.approx(221.0 * 1000.0, rel=2e-3)


def test_a_line_that_cannot_reach_is_refused_in_a_sentence(model_ship: VesselModel) -> None:
    m = model_ship.mooring
    with pytest.raises(FitError, match="too short to reach"):
        solve(m.sections, m.depth, 20.0)
    with pytest.raises(FitError, match="too short to reach"):
        tabulate(m.sections, m.depth, np.linspace(11.0, 20.0, 10), 0.0)
    with pytest.raises(FitError, match="above 0 m"):
        solve(m.sections, m.depth, -1.0)


def test_nothing_stops_a_batch_or_writes_to_its_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(FitError, match="under ground"):
        catenary((100.0, -5.0), 120.0, 800.0, 1e9, -1.0)
    with pytest.raises(FitError):
        catenary((100.0, 50.0), 0.0, 800.0, 1e9)
    ends = catenary((200.0, 150.0), 249.99, 800.0, 7e13)
    assert np.all(np.isfinite(ends.upper))
    assert capsys.readouterr().out == ""


def test_the_first_import_of_moorpy_on_a_machine_warns_nobody(tmp_path: Path) -> None:
    task = "from mooringdx.physics.catenary import catenary; catenary((400.0, 100.0), 450.0, 1000.0, 5e8)"
    fresh = [sys.executable, "-W", "error", "-X", f"pycache_prefix={tmp_path}", "-c", task]
    done = subprocess.run(fresh, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_buoyancy_is_lost_down_to_a_full_element(model_ship: VesselModel) -> None:
    sections = model_ship.mooring.sections
    full = 1.0 - sections[0].filled / sections[0].buoy
    assert full == pytest.approx(1.2)
    for share, force in ((0.0, 0.8), (0.5, 0.4), (1.0, 0.0), (1.1, -0.08), (full, -0.16), (3.0, -0.16)):
        assert deprived(sections, share)[0].buoy == pytest.approx(force, abs=1e-12)
    assert deprived(sections) == tuple(sections)
    assert [s.stiffness for s in deprived(sections, stiffness=0.25)] == [6750.0, 6750.0]
    assert deprived(sections, 1.0, 0.25)[1] == sections[1].model_copy(update={"stiffness": 6750.0})
    for wrong in ({"buoyancy": -0.1}, {"stiffness": 1.0}, {"stiffness": -0.1}):
        with pytest.raises(ConfigError, match="cannot lose the shares"):
            deprived(sections, **wrong)


@pytest.mark.parametrize(("stiffness"), [0.05, 0.3])
def test_analytic_softer_wire_stretches_by_its_tension(stiffness: float) -> None:
    wire = Section(length=100.0, weight=1e-3, stiffness=1e5)
    soft = deprived([wire], stiffness=stiffness)
    for line in ([wire], soft):
        shape = solve(line, 60.0, 81.0)
        stretch = np.hypot(81.0, 60.0) / 100.0 - 1.0
        assert shape.tension == pytest.approx(line[0].stiffness * stretch, rel=1e-3)
