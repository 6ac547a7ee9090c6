"""One elastic catenary, with or without seabed contact, by MoorPy [Hall2021].

For weight w per metre, length L, stiffness EA, horizontal tension H and vertical tension V at the upper end, hanging
free (V_l = V - w L at the lower end):

    x = H/w [asinh(V/H) - asinh(V_l/H)] + H L/EA
    z = H/w [sqrt(1 + (V/H)^2) - sqrt(1 + (V_l/H)^2)] + (V^2 - V_l^2)/(2 w EA)

and with a part on the seabed V_l = 0 where it lifts off; friction there lowers H towards the anchor. Where MoorPy finds
no H and V it takes a weightless straight line instead; such ends are marked ``rough``.

Not seen: bending, current on the line, a sloping seabed.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from typing import Any
from warnings import catch_warnings, simplefilter

import numpy as np

from mooringdx.errors import FitError
from mooringdx.types import Array

SHARP = 1e-9  # to what share of its length a catenary closes


@dataclass(frozen=True)
class Ends:
    """One section's ends: (2,) forces of the section on its lower and upper end, N; (2, 2) stiffness matrices, N/m.

    ``bottom``: length on the seabed, m. ``rough``: the section is a weightless straight line, for want of a catenary.
    """

    lower: Array
    upper: Array
    stiff_lower: Array
    stiff_upper: Array
    stiff_cross: Array
    bottom: float
    rough: bool


def catenary(
    span: tuple[float, float], length: float, weight: float, stiffness: float, seabed: float = 0.0, guess: Any = (0, 0)
) -> Ends:
    """Return the elastic catenary over ``span`` (x, z from lower to upper end, m) by MoorPy.

    ``seabed``: friction coefficient with the lower end on the seabed, or, negative, minus its height above it, m.
    ``guess``: horizontal and vertical tension to start from, N. Raise FitError where MoorPy finds no shape.
    """
    with _unattended():  # its files hold escapes that Python warns of when it first compiles them
        from moorpy.Catenary import catenary as moorpy_catenary
        from moorpy.helpers import CatenaryError

    x, z = float(span[0]), float(span[1])
    if x < 0.0 or z + max(0.0, -seabed) < -1e-9 * length or min(length, stiffness) <= 0.0:
        raise FitError(
            f"no catenary of {length:g} m, EA {stiffness:g} N, over {x:g} by {z:g} m; it would be under ground"
        )
    try:
        with _unattended():
            ax, az, bx, bz, info = moorpy_catenary(
                x, z, length, stiffness, weight, CB=seabed, HF0=guess[0], VF0=guess[1], Tol=SHARP * length, MaxIter=100
            )
    except (CatenaryError, ArithmeticError, ValueError) as error:
        raise FitError(f"no catenary of {length:g} m over {x:g} by {z:g} m: {error}") from None
    lower, upper, cross = (np.array(info[key]) for key in ("stiffnessA", "stiffnessB", "stiffnessBA"))
    if info["ProfileType"] in (2, 3):  # lower end on the seabed: only its x matters, and it matters as the upper end's
        cross = np.column_stack([-upper[:, 0], np.zeros(2)])  # MoorPy leaves the second entry out
    rough = info["ProfileType"] in (-1, -2)
    return Ends(np.array([ax, az]), np.array([bx, bz]), lower, upper, cross, float(info["LBot"]), rough)


@contextmanager
def _unattended() -> Iterator[None]:
    """Let nothing that MoorPy does stop a batch: no debugger, no text on the terminal, no warnings."""

    def refuse(*_: object, **__: object) -> None:
        raise ArithmeticError("MoorPy would stop in a debugger")

    before = sys.breakpointhook
    sys.breakpointhook = refuse
    try:
        with redirect_stdout(StringIO()), np.errstate(all="ignore"), catch_warnings():
            simplefilter("ignore")
            yield
    finally:
        sys.breakpointhook = before
