"""One instance of every registered detector, for the tests that hold for all of them."""

from __future__ import annotations

import numpy as np

from mooringdx.detectors import DETECTORS
from mooringdx.detectors.design import Design
from mooringdx.detectors.reference import Reference
from mooringdx.types import Fault, Grid, Signatures, Whitened

LINES = 3
WINDOW = 40
MIX = np.array([[1.0, 0.3, -0.2], [0.1, 1.2, 0.4], [-0.3, 0.2, 0.9]])
DIRECTIONS = np.array([[1.0, 0.5, 0.0], [0.0, 1.0, -0.6], [0.2, -0.4, 1.0], [0.0, 0.0, 1.0]])
SIGN = np.array([0.0, 0.0, 1.0, -1.0])
NAMES = tuple(f"residual_{i}" for i in range(LINES))
SIGNATURES = Signatures(
    faults=tuple(Fault("sensor_fault", f"channel_{j}", "bias") for j in range(len(DIRECTIONS))),
    residuals=NAMES,
    matrix=DIRECTIONS,
    units=("N",) * len(DIRECTIONS),
    total=np.full(len(DIRECTIONS), np.nan),
    sign=SIGN,
)


def design(memory=None, level=None, covariance=MIX @ MIX.T, directions=DIRECTIONS, mean=None, sd=None, **more):
    """Return a design for z = MIX e with white e; a following reference when ``memory`` is given."""
    mean = np.zeros(LINES) if mean is None else mean
    sd = np.sqrt(np.diagonal(covariance)) if sd is None else sd
    reference = Reference(mean, sd, memory, 2 * WINDOW if memory else 0)
    labels = tuple(f.label for f in SIGNATURES.faults)
    return Design(labels, directions, SIGN, covariance, WINDOW, reference, level, **more)


CASES = {name: kind(design()) for name, kind in DETECTORS.items()}
FOLLOWING = {name: kind(design(memory=2000.0, level=np.array(13.0))) for name, kind in DETECTORS.items()}


def whitened(values, valid=None):
    """Return values (n, r) on a clock of 0.1 s."""
    valid = np.ones(values.shape, bool) if valid is None else valid
    return Whitened(NAMES, Grid(0.0, 0.1, len(values)), values, valid, SIGNATURES)


def noise(n, seed=0):
    """Return healthy z = MIX e, (n, LINES)."""
    return np.random.default_rng(seed).standard_normal((n, LINES)) @ MIX.T
