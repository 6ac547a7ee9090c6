"""A hull's answer to waves: limits, brute force, published figures, and two panel programs that are not ours."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from conftest import REFERENCE
from scipy.integrate import dblquad
from scipy.io import loadmat

from mooringdx.errors import ConfigError
from mooringdx.physics.response import DOF, MIRROR, Complex, ResponseTable, closed_form, read_response
from mooringdx.physics.vessel import Hull, load_vessel
from mooringdx.physics.waves import GRAVITY, density

SHIP = Hull(length=275.0, breadth=40.0, draught=12.0, mass=8.9e7, block=0.66)
HEAD, BEAM = np.pi, np.pi / 2.0
PANELS = "fpso200_response.csv"


def column(answer: Complex, dof: str) -> Complex:
    return np.asarray(answer[DOF.index(dof)])


def test_head_sea_has_the_published_size() -> None:
    answer = closed_form(SHIP, np.array([0.4]), HEAD)
    assert abs(column(answer, "heave")[0]) == pytest.approx(0.365, abs=0.001)
    assert np.degrees(abs(column(answer, "pitch")[0])) == pytest.approx(0.566, abs=0.001)


def test_heave_and_pitch_are_the_published_formulae() -> None:
    omega, heading = np.linspace(0.2, 1.3, 23), np.radians(130.0)
    k = omega**2 / GRAVITY
    ke, box = np.abs(k * np.cos(heading)), k * SHIP.breadth * SHIP.block
    spread = 2.0 * np.sin(0.5 * box) * np.exp(-k * SHIP.draught)
    f = np.sqrt((1.0 - k * SHIP.draught) ** 2 + (spread**2 / box) ** 2)
    h = 1.0 / np.sqrt((1.0 - 2.0 * k * SHIP.draught) ** 2 + (spread**2 / box) ** 2)
    half = 0.5 * ke * SHIP.length
    heave = np.exp(-ke * SHIP.draught) * f * np.sin(half) / half
    pitch = np.exp(-ke * SHIP.draught) * f * 6.0 / (half**2 * SHIP.length) * (np.sin(half) - half * np.cos(half))
    answer = closed_form(SHIP, omega, heading)
    np.testing.assert_allclose(abs(column(answer, "heave")), h * abs(heave), rtol=1e-9)
    np.testing.assert_allclose(abs(column(answer, "pitch")), h * abs(pitch), rtol=1e-9)


@pytest.mark.parametrize("degrees", [0.0, 40.0, 90.0, 135.0, 180.0, 250.0])
def test_in_very_long_waves_the_hull_rides_the_water(degrees: float) -> None:
    heading, omega = np.radians(degrees), np.array([0.01])
    k = omega[0] ** 2 / GRAVITY
    along, across = np.cos(heading), np.sin(heading)
    want = [-1j * along, -1j * across, -1.0, 0.0, -1j * k * along, -k * along * across]
    answer = closed_form(SHIP, omega, heading)[:, 0]
    np.testing.assert_allclose(answer[:3], want[:3], atol=2e-3)
    np.testing.assert_allclose(answer[3:] / k, np.array(want[3:]) / k, atol=2e-3)


def test_surge_sway_and_yaw_are_the_water_averaged_over_the_box() -> None:
    omega, heading = 0.55, np.radians(120.0)
    k = omega**2 / GRAVITY
    along, across = np.cos(heading), np.sin(heading)
    half = (0.5 * SHIP.length, 0.5 * SHIP.breadth)
    deep = (1.0 - np.exp(-k * SHIP.draught)) / (k * SHIP.draught)

    def average(weight: str, part: str) -> float:
        def water(y: float, x: float) -> float:
            orbit = -1j * np.exp(-1j * k * (x * along + y * across)) * (x if weight == "x" else 1.0)
            return float(getattr(orbit, part))

        return float(dblquad(water, -half[0], half[0], -half[1], half[1])[0]) / (4.0 * half[0] * half[1])

    mean, lever = average("1", "imag") * 1j, average("x", "real") * 12.0 / SHIP.length**2
    answer = closed_form(SHIP, np.array([omega]), heading)
    assert column(answer, "surge")[0] == pytest.approx(along * mean * deep, abs=1e-9)
    assert column(answer, "sway")[0] == pytest.approx(across * mean * deep, abs=1e-9)
    assert column(answer, "yaw")[0] == pytest.approx(across * lever * deep, abs=1e-9)


def test_waves_from_the_other_side_are_mirrored_and_rest_is_finite() -> None:
    omega = np.linspace(0.0, 3.0, 61)
    port, starboard = (closed_form(SHIP, omega, side * 1.1) for side in (1.0, -1.0))
    np.testing.assert_allclose(starboard, port * MIRROR[:, None], atol=1e-12)
    assert np.isfinite(port).all()
    assert not column(port, "roll").any()


def table() -> ResponseTable:
    rng = np.random.default_rng(1)
    amplitude = rng.standard_normal((6, 3, 4)) + 1j * rng.standard_normal((6, 3, 4))
    return ResponseTable(np.array([0.2, 0.4, 0.7, 1.0]), np.array([0.0, 1.0, np.pi]), amplitude)


def test_a_table_gives_back_its_cells_and_is_linear_between_them() -> None:
    whole = table()
    np.testing.assert_allclose(whole(whole.omega, 1.0), whole.amplitude[:, 1], atol=1e-12)
    np.testing.assert_allclose(whole(whole.omega, np.pi), whole.amplitude[:, 2], atol=1e-12)
    want = 0.25 * whole.amplitude[:, :2, 1:3].sum(axis=(1, 2))
    np.testing.assert_allclose(whole(np.array([0.55]), 0.5)[:, 0], want, atol=1e-12)


def test_a_table_is_mirrored_wrapped_held_below_and_silent_above() -> None:
    whole = table()
    np.testing.assert_allclose(whole(whole.omega, -1.0), whole.amplitude[:, 1] * MIRROR[:, None], atol=1e-12)
    np.testing.assert_allclose(whole(whole.omega, 1.0 + 2.0 * np.pi), whole.amplitude[:, 1], atol=1e-12)
    np.testing.assert_allclose(whole(np.array([0.0, 0.1]), 1.0), whole.amplitude[:, 1, [0, 0]], atol=1e-12)
    assert not whole(np.array([1.0001, 5.0]), 1.0).any()


HEADER = "omega,heading,dof,amplitude,phase\n"
GOOD = "# a comment\n" + HEADER + "".join(
    f"{w},{h},{dof},{w + h / 100.0},{10 * w}\n" for w in (1, 0.5) for h in (0, 90, 180) for dof in ("heave", "pitch")
)  # fmt: skip


def written(folder: Path, text: str) -> Path:
    path = folder / "ship.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_written_table_is_read_in_any_order_of_rows(tmp_path: Path) -> None:
    read = read_response(written(tmp_path, GOOD))
    assert read.omega.tolist() == [0.5, 1.0]
    np.testing.assert_allclose(read.heading, [0.0, np.pi / 2.0, np.pi])
    assert read(np.array([0.5]), BEAM)[2, 0] == pytest.approx(1.4 * np.exp(1j * np.radians(5.0)))
    assert not read.amplitude[[0, 1, 3, 5]].any()


def test_periods_and_degrees_a_metre_are_the_same_table(tmp_path: Path) -> None:
    plain = read_response(written(tmp_path, GOOD))
    rows = ["period,heading,dof,amplitude,phase,unit"]
    for row in GOOD.splitlines()[2:]:
        omega, heading, dof, amplitude, phase = row.split(",")
        unit, scale = ("m/m", 1.0) if dof == "heave" else ("deg/m", 180.0 / np.pi)
        period = 2.0 * np.pi / float(omega)
        rows.append(f"{period!r},{heading},{dof},{float(amplitude) * scale!r},{phase},{unit}")
    other = read_response(written(tmp_path, "\n".join(rows)))
    np.testing.assert_allclose(other.omega, plain.omega)
    np.testing.assert_allclose(other.amplitude, plain.amplitude)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "columns '' are not those"),
        ("omega,heading,dof,amplitude\n", "are not those of a response table; allowed: omega"),
        ("omega,period,heading,dof,amplitude,phase\n", "are not those"),
        (GOOD.replace("phase\n", "phase,colour\n"), "are not those"),
        (HEADER, "0 frequencies and headings none"),
        (GOOD.replace("pitch", "pich"), r"line 4: 'pich'; did you mean 'pitch'"),
        (GOOD.replace(",180,", ",170,"), "headings from 0 to 180"),
        (GOOD.replace(",180,", ",190,"), "line 7: .*within 0 to 180"),
        (GOOD.replace("1,90,heave,1.9,", "1,90,heave,none,"), "line 5: could not convert"),
        (GOOD.replace("1,90,heave,1.9,", "1,90,heave,nan,"), "line 5: .*all finite"),
        (GOOD.replace("1,90,heave,1.9,10", "1,90,heave,1.9"), "line 5: 4 cells under 5 columns"),
        (GOOD.replace("1,90,heave,1.9,10\n", ""), "no heave at heading 90 deg and 1 rad/s"),
        (GOOD + "1,90,heave,1.9,10\n", "line 15: .*stand twice"),
        (
            "omega,heading,dof,amplitude,phase,unit\n1,0,heave,1,0,rad/m\n",
            "unit 'rad/m' does not suit heave; allowed: m/m",
        ),
        ("omega,heading,dof,amplitude,phase,unit\n1,0,roll,1,0,m/m\n", "does not suit roll; allowed: rad/m, deg/m"),
        ("omega,heading,dof,amplitude,phase,unit\n1,0,roll,1,0,turns\n", "unknown unit"),
    ],
)
def test_a_wrong_table_is_one_sentence(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says) as caught:
        read_response(written(tmp_path, text))
    assert "ship.csv" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_an_absent_table_is_one_sentence(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.csv: the response table cannot be read"):
        read_response(tmp_path / "none.csv")


def test_the_shipped_table_rides_long_waves_and_knows_its_symmetry(root: Path) -> None:
    shipped = read_response(root / "configs" / "vessels" / PANELS)
    for degrees in (0.0, 45.0, 90.0, 180.0):
        answer = shipped(np.array([0.1]), np.radians(degrees))[:3, 0]
        want = [-1j * np.cos(np.radians(degrees)), -1j * np.sin(np.radians(degrees)), -1.0]
        np.testing.assert_allclose(answer, want, atol=0.02)
    for heading in (0.0, np.pi):
        assert not shipped(shipped.omega, heading)[[1, 3, 5]].any()


def test_the_closed_form_keeps_the_signs_and_phases_of_the_shipped_table(root: Path) -> None:
    shipped = read_response(root / "configs" / "vessels" / PANELS)
    hull = load_vessel(root / "configs" / "vessels" / "fpso200.toml").hull
    omega = np.linspace(0.15, 0.4, 11)
    for degrees in (0.0, 30.0, 60.0, 90.0, 120.0, 150.0, 180.0):
        close, panels = (f(omega, np.radians(degrees)) for f in (lambda w, b: closed_form(hull, w, b), shipped))
        np.testing.assert_allclose(close[:3], panels[:3], atol=0.22)
        np.testing.assert_allclose(close[4:], panels[4:], atol=0.0025)


def potential(name: str) -> tuple[Hull, np.ndarray, np.ndarray, Complex]:
    """Return hull, omega, heading and the amplitudes at no speed, (6, h, w), of a hull file of another program."""
    ship = loadmat(REFERENCE / "hydro" / name, squeeze_me=True, struct_as_record=False)["vessel"]
    main, motion = ship.main, ship.motionRAO
    block = main.m / (main.rho * main.Lpp * main.B * main.T)
    hull = Hull(length=main.Lpp, breadth=main.B, draught=main.T, mass=main.m, block=block)
    pairs = zip(motion.amp, motion.phase, strict=True)
    answer = np.stack([(a[:, :, 0] * np.exp(1j * p[:, :, 0])).T for a, p in pairs])
    return hull, np.asarray(motion.w), np.asarray(ship.headings), answer


@pytest.mark.reference
def test_the_shipped_table_is_near_another_panel_program(root: Path) -> None:
    shipped = read_response(root / "configs" / "vessels" / PANELS)
    _, omega, heading, other = potential("fpso.mat")
    kept = (omega > 0.15) & (omega < 0.42)  # above, roll is near resonance and its damping a choice of each
    limits = (0.04, 0.08, 0.05, 0.02, 0.0015, 0.0005)  # m/m and rad/m
    for h, angle in enumerate(heading):  # all round: the other side too, by its own sign of each motion
        apart = abs(shipped(omega[kept], angle) - other[:, h, kept]).max(axis=1)
        assert (apart < limits).all(), (np.degrees(angle), apart)


@pytest.mark.reference
def test_in_a_sea_the_shipped_table_moves_like_another_panel_program(root: Path) -> None:
    shipped = read_response(root / "configs" / "vessels" / PANELS)
    _, omega, heading, other = potential("fpso.mat")
    sea = density("jonswap", omega, 4.0, 12.0)
    for degrees, dofs in ((180, (0, 2, 4)), (140, (0, 1, 2, 4, 5)), (90, (1, 2))):
        h = degrees // 10
        size = [abs(answer) ** 2 for answer in (shipped(omega, heading[h]), other[:, h])]
        own, theirs = (np.sqrt(np.trapezoid(sea * part, omega, axis=1)) for part in size)
        np.testing.assert_allclose(own[list(dofs)], theirs[list(dofs)], rtol=0.13)


@pytest.mark.reference
@pytest.mark.parametrize("name", ["fpso.mat", "s175.mat"])
def test_the_closed_form_has_the_signs_and_the_size_of_another_panel_program(name: str) -> None:
    hull, omega, heading, other = potential(name)
    long = omega * np.sqrt(hull.length / GRAVITY) < 1.6  # waves longer than about two and a half ships
    long &= omega > 0.05
    for h, angle in enumerate(heading):
        close = closed_form(hull, omega[long], angle)
        apart = abs(close - other[:, h, long])
        assert apart[[0, 2]].max() < 0.18
        assert apart[1].max() < 0.06
        assert (apart[4:] * hull.length).max() < 0.3


def script(root: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location("make_response", root / "scripts" / "make_response.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_panels_of_the_script_close_and_hold_the_block(root: Path) -> None:
    panels = script(root).starboard_panels(SHIP, 6.0, 4.0)
    cross = 0.5 * np.cross(panels[:, 2] - panels[:, 0], panels[:, 3] - panels[:, 1])
    volume = 2.0 * float((cross * panels.mean(axis=1))[:, 2].sum())
    block = volume / (SHIP.length * SHIP.breadth * SHIP.draught)
    assert block == pytest.approx(SHIP.block, rel=0.02)  # positive: the normals point out of the hull
    assert abs(cross[:, 0].sum()) < 1e-6  # closed fore and aft


def test_the_script_writes_what_the_package_reads(root: Path, tmp_path: Path) -> None:
    whole = table()
    path = tmp_path / "round.csv"
    script(root).write(path, ["a line"], whole.omega, np.array([0.0, 1.5, np.pi]), whole.amplitude)
    np.testing.assert_allclose(read_response(path).amplitude, whole.amplitude, rtol=3e-3)
