"""Compute a hull's response table with the panel method of capytaine, and write it as CSV.

The hull is no real ship's: symmetric fore and aft, of the length, breadth, draught and block of a vessel file,

    y = B/2 (1 - |xi|^p) (1 - |ze|^q (0.3 + 0.7 xi^2)),   xi = 2x/L, ze = z/T, p such that the block coefficient is met,

free, in deep water, at zero speed. Mass is the displaced mass; the centre of gravity lies amidships, ``--centre`` above
the keel (the vessel file has none: a choice); radii of gyration are shares of breadth and length; roll has a linear
viscous damping, a share of the critical. A lid on the inner free surface keeps irregular frequencies out.

    pip install capytaine
    python scripts/make_response.py configs/vessels/fpso200.toml -o configs/vessels/fpso200_response.csv
"""

from __future__ import annotations

import argparse
import csv
import itertools
import logging
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from mooringdx.physics.response import DOF
from mooringdx.physics.vessel import Hull, load_vessel
from mooringdx.physics.waves import GRAVITY

Floats = NDArray[np.float64]
DENSITY = 1025.0
OMEGA = ("0.1:0.3:0.05", "0.3:0.8:0.02", "0.8:1.5:0.05")  # close together where roll resonates
TURN = np.array([1.0, -1.0, -1.0, 1.0, -1.0, -1.0])  # capytaine has y to port and z up: half a turn about x


def breadth_share(xi: Floats, ze: Floats, ends: float, bilge: float) -> Floats:
    """Return 2y/B at xi, ze in [-1, 1] and [-1, 0]."""
    return (1.0 - np.abs(xi) ** ends) * (1.0 - np.abs(ze) ** bilge * (0.3 + 0.7 * xi**2))


def ends_of(block: float, bilge: float) -> float:
    """Return the exponent p of the ends for a block coefficient; the integrals are elementary."""

    def surplus(p: float) -> float:
        flat, round_ = p / (p + 1.0), 0.3 * p / (p + 1.0) + 0.7 * (1.0 / 3.0 - 1.0 / (p + 3.0))
        return flat - round_ / (bilge + 1.0) - block

    return float(brentq(surplus, 0.5, 500.0))


def starboard_panels(hull: Hull, bilge: float, size: float) -> Floats:
    """Return the panels of the half hull at y > 0, (n, 4, 3), m, about ``size`` long, origin at the waterline."""
    ends = ends_of(hull.block, bilge)
    fine = np.sin(np.linspace(-np.pi / 2.0, np.pi / 2.0, 4001))
    x, y = 0.5 * hull.length * fine, 0.5 * hull.breadth * (1.0 - np.abs(fine) ** ends)
    run = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    stations = np.interp(np.linspace(0.0, run[-1], 2 * int(np.ceil(run[-1] / size / 2.0)) + 1), run, fine)
    stations[0], stations[-1] = -1.0, 1.0
    levels = -np.sin(np.linspace(0.0, np.pi / 2.0, max(4, int(np.ceil(1.3 * hull.draught / size))) + 1))
    strips = np.linspace(1.0, 0.0, max(2, int(np.ceil(0.5 * hull.breadth / size))) + 1)

    def point(xi: float, ze: float, strip: float) -> list[float]:
        half = 0.5 * hull.breadth * float(breadth_share(np.array(xi), np.array(ze), ends, bilge))
        return [0.5 * hull.length * xi, strip * half, ze * hull.draught]

    outline = [(ze, 1.0) for ze in levels] + [(-1.0, strip) for strip in strips[1:]]
    panels = [
        [point(a, *one), point(b, *one), point(b, *two), point(a, *two)]
        for a, b in itertools.pairwise(stations)
        for one, two in itertools.pairwise(outline)
    ]
    kept = [p for p in panels if np.linalg.norm(np.cross(np.subtract(p[2], p[0]), np.subtract(p[3], p[1]))) > 1e-6]
    return np.array(kept)


def floating(panels: Floats, centre: float, draught: float, size: float) -> Any:
    """Return the whole body for capytaine, its motions about the centre of gravity ``centre`` above the keel."""
    import capytaine as cpt

    half = cpt.Mesh(vertices=panels.reshape(-1, 3), faces=np.arange(4 * len(panels)).reshape(-1, 4))
    mesh = cpt.ReflectionSymmetricMesh(half, plane="xOz")
    gravity = (0.0, 0.0, centre - draught)
    return cpt.FloatingBody(
        mesh,
        dofs=cpt.rigid_body_dofs(rotation_center=gravity),
        lid_mesh=mesh.generate_lid(faces_max_radius=size),
        center_of_mass=gravity,
    )


def inertia(hull: Hull, volume: float, radii: tuple[float, float, float]) -> Floats:
    """Return mass and moments of inertia, (6, 6); ``radii``: of roll over breadth, of pitch and yaw over length."""
    mass = DENSITY * volume
    gyration = np.array([radii[0] * hull.breadth, radii[1] * hull.length, radii[2] * hull.length])
    return np.diag(np.concatenate([np.full(3, mass), mass * gyration**2]))


def motions(body: Any, mass: Floats, omega: Floats, heading: Floats, roll_damping: float) -> NDArray[np.complex128]:
    """Return the answer in the package's signs, (6, h, w): m/m and rad/m. ``heading``: (h,), rad."""
    import capytaine as cpt

    names = ("Surge", "Sway", "Heave", "Roll", "Pitch", "Yaw")
    solver, stiffness = cpt.BEMSolver(), np.zeros((6, 6))
    found = body.compute_hydrostatic_stiffness(rho=DENSITY, g=GRAVITY)
    stiffness[:] = found.sel(influenced_dof=list(names), radiating_dof=list(names)).to_numpy()
    out = np.zeros((6, heading.size, omega.size), dtype=np.complex128)
    for w, frequency in enumerate(omega):
        common = {"body": body, "omega": frequency, "rho": DENSITY, "g": GRAVITY, "water_depth": np.inf}
        radiation = [cpt.RadiationProblem(radiating_dof=name, **common) for name in names]
        waves = [cpt.DiffractionProblem(wave_direction=-angle, **common) for angle in heading]
        results = solver.solve_all(radiation + waves, progress_bar=False)
        added = np.array([[r.added_masses[n] for r in results[:6]] for n in names])
        damping = np.array([[r.radiation_dampings[n] for r in results[:6]] for n in names])
        critical = 2.0 * np.sqrt((mass[3, 3] + added[3, 3]) * stiffness[3, 3])
        damping[3, 3] += roll_damping * critical
        force = np.array(
            [[r.forces[n] + cpt.bem.airy_waves.froude_krylov_force(r)[n] for r in results[6:]] for n in names]
        )
        dynamic = stiffness - frequency**2 * (mass + added) - 1j * frequency * damping
        out[:, :, w] = np.conj(np.linalg.solve(dynamic, force)) * TURN[:, None]  # capytaine: exp(-i w t)
    ends = np.abs(np.sin(heading)) < 1e-9
    out[np.ix_([1, 3, 5], np.flatnonzero(ends))] = 0.0  # symmetry forbids it; what is left is rounding
    return out


def write(path: Path, head: list[str], omega: Floats, heading: Floats, answer: NDArray[np.complex128]) -> None:
    """Write the table for `mooringdx.physics.response.read_response`; what is under 1e-6 is written as 0."""
    with path.open("w", encoding="utf-8", newline="") as file:
        file.writelines(f"# {line}\n" for line in head)
        table = csv.writer(file, lineterminator="\n")
        table.writerow(["omega", "heading", "dof", "amplitude", "phase"])
        for w, frequency in enumerate(omega):
            for h, angle in enumerate(heading):
                for d, dof in enumerate(DOF):
                    value = answer[d, h, w] if abs(answer[d, h, w]) > 1e-6 else 0.0
                    size, phase = f"{abs(value):.4g}", f"{np.degrees(np.angle(value)):.1f}"
                    table.writerow([f"{frequency:g}", f"{np.degrees(angle):g}", dof, size, phase])


def frequencies(pieces: Sequence[str]) -> Floats:
    """Return the frequencies of pieces ``first:last:step``, (w,), rad/s, each once."""
    parts = []
    for piece in pieces:
        first, last, step = (float(word) for word in piece.split(":"))
        parts.append(np.arange(first, last + step / 2.0, step))
    return np.unique(np.concatenate(parts).round(4))


def options() -> argparse.Namespace:
    """Return the command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("vessel", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--centre", type=float, default=11.0, help="centre of gravity above the keel, m")
    parser.add_argument("--bilge", type=float, default=12.0, help="exponent q of the bilge")
    parser.add_argument("--radii", type=float, nargs=3, default=(0.37, 0.27, 0.27), help="roll/B, pitch/L, yaw/L")
    parser.add_argument("--roll-damping", type=float, default=0.05, help="share of the critical")
    parser.add_argument("--panel", type=float, default=5.0, help="length of a panel, m")
    parser.add_argument("--omega", nargs="+", default=OMEGA, help="first:last:step, rad/s; several pieces join")
    parser.add_argument("--step", type=float, default=7.5, help="between headings, deg")
    return parser.parse_args()


def main() -> None:
    """Compute and write one table."""
    import capytaine

    logging.getLogger("capytaine").setLevel(logging.ERROR)
    ask = options()
    model = load_vessel(ask.vessel)
    omega = frequencies(ask.omega)
    heading = np.radians(np.arange(0.0, 180.0 + ask.step / 2.0, ask.step))
    panels = starboard_panels(model.hull, ask.bilge, ask.panel)
    body = floating(panels, ask.centre, model.hull.draught, ask.panel)
    volume = float(body.mesh.volume)
    mass = inertia(model.hull, volume, tuple(ask.radii))
    answer = motions(body, mass, omega, heading, ask.roll_damping)
    head = [
        f"Response of a parametric hull with the main dimensions of '{model.name}' to waves of unit amplitude.",
        f"Computed by scripts/make_response.py with capytaine {capytaine.__version__} (panels), deep water, no speed.",
        f"{2 * len(panels)} panels of about {ask.panel:g} m, volume {volume:.0f} m3, bilge exponent {ask.bilge:g}, "
        f"ends {ends_of(model.hull.block, ask.bilge):.2f}.",
        f"Choices: centre of gravity {ask.centre:g} m above the keel, radii of gyration {ask.radii[0]:g} B, "
        f"{ask.radii[1]:g} L, {ask.radii[2]:g} L, roll damping {ask.roll_damping:g} of critical.",
        "omega rad/s; heading deg, where the waves travel to (180 head sea); m/m and rad/m; phase deg ahead of "
        "the crest",
        "at the centre of gravity, exp(i w t), x forward, y starboard, z down, yaw clockwise.",
    ]
    write(ask.output, head, omega, heading, answer)


if __name__ == "__main__":
    main()
