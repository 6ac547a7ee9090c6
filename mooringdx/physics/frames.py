"""Frames: north-east-down, body x forward and y to starboard, heading clockwise from north, rad."""

from __future__ import annotations

import numpy as np

from mooringdx.types import Array


def rotation(heading: float) -> Array:
    """Return R, (3, 3): body surge, sway, yaw to earth north, east, yaw at ``heading``, rad."""
    c, s = np.cos(heading), np.sin(heading)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def wrapped(angle: Array) -> Array:
    """Return angles, rad, in [-pi, pi)."""
    return np.asarray((np.asarray(angle) + np.pi) % (2.0 * np.pi) - np.pi)


def unwrapped(angle: Array) -> Array:
    """Return an angle's history, (n,), rad, without jumps of 2 pi; NaN stays NaN."""
    out: Array = np.array(angle, dtype=np.float64)
    good = np.isfinite(out)
    out[good] = np.unwrap(out[good])
    return out
