"""Compare answers of a hull to waves: closed form, response tables, and hull files of the MSS toolbox.

For JONSWAP seas (peakedness 3.3, long-crested) prints the standard deviation of each motion per metre of significant
height by the first answer, and the ratio of every other answer to it. The first is a vessel's table, or with ``--mat``
alone the hull file.

    python benchmarks/responses.py configs/vessels/fpso200.toml configs/vessels/fpso200_response.csv --mat FILE
    python benchmarks/responses.py --mat FILE
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from mooringdx.physics.response import DOF, Complex, ResponseTable, closed_form, read_response
from mooringdx.physics.vessel import Hull, load_vessel
from mooringdx.physics.waves import density
from mooringdx.types import Array

Answer = Callable[[Array, float], Complex]
OMEGA = np.linspace(0.1, 1.5, 561)


def mss(path: Path) -> tuple[Hull, ResponseTable]:
    """Return main dimensions and the answers at no speed, headings 0 to 180 deg."""
    ship = loadmat(path, squeeze_me=True, struct_as_record=False)["vessel"]
    main, motion = ship.main, ship.motionRAO
    block = main.m / (main.rho * main.Lpp * main.B * main.T)
    hull = Hull(length=main.Lpp, breadth=main.B, draught=main.T, mass=main.m, block=block)
    half = np.asarray(ship.headings) < np.pi + 1e-6
    pairs = zip(motion.amp, motion.phase, strict=True)
    answer = np.stack([(a[:, half, 0] * np.exp(1j * p[:, half, 0])).T for a, p in pairs])
    heading = np.append(np.asarray(ship.headings)[half][:-1], np.pi)
    return hull, ResponseTable(np.asarray(motion.w), heading, answer)


def deviation(answer: Answer, period: float, heading: float) -> Array:
    """Return the standard deviation of each motion per metre of height, (6,), m and deg."""
    size = abs(answer(OMEGA, heading)) ** 2
    out = np.sqrt(np.trapezoid(density("jonswap", OMEGA, 1.0, period) * size, OMEGA, axis=1))
    return np.asarray(out * np.repeat([1.0, 180.0 / np.pi], 3))


def show(answers: dict[str, Answer], least: float = 0.004) -> None:
    """Print one row a sea, heading and motion; motions under ``least`` of the first answer are left out."""
    first, *others = answers
    print(f"| Tp, s | heading | motion | {first}, per m Hs | " + " | ".join(f"{o} / {first}" for o in others) + " |")
    print("|---" * (4 + len(others)) + "|")
    for period in (8.0, 12.0, 16.0):
        for degrees in (180, 135, 90):
            sizes = [deviation(answer, period, np.radians(degrees)) for answer in answers.values()]
            for d, dof in enumerate(DOF):
                if sizes[0][d] < least:
                    continue
                ratios = " | ".join(f"{size[d] / sizes[0][d]:.2f}" for size in sizes[1:])
                unit = "m" if d < 3 else "deg"
                print(f"| {period:g} | {degrees} | {dof} | {sizes[0][d]:.3f} {unit} | {ratios} |")


def main() -> None:
    """Read what is given and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("vessel", type=Path, nargs="?")
    parser.add_argument("tables", type=Path, nargs="*")
    parser.add_argument("--mat", type=Path, help="hull file of the MSS toolbox")
    ask = parser.parse_args()
    other = mss(ask.mat) if ask.mat else None
    answers: dict[str, Answer] = {path.stem: read_response(path) for path in ask.tables}
    if other:
        answers[ask.mat.stem + ".mat"] = other[1]
    if not ask.vessel and other is None:
        parser.error("give a vessel with a table, or --mat")
    hull = load_vessel(ask.vessel).hull if ask.vessel or other is None else other[0]
    answers["closed form"] = lambda omega, heading: closed_form(hull, omega, heading)
    show(answers)


if __name__ == "__main__":
    main()
