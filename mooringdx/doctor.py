"""Versions, and whether the installation is sound: everything imports, and a compiled kernel gives the right sum."""

from __future__ import annotations

import importlib
import platform
from importlib import metadata

from mooringdx import __version__

_PARTS = {
    "numpy": "numpy",
    "scipy": "scipy",
    "numba": "numba",
    "pyarrow": "pyarrow",
    "pint": "pint",
    "pymap3d": "pymap3d",
    "mcap": "mcap",
    "mcap-ros1-support": "mcap_ros1",
    "mcap-ros2-support": "mcap_ros2",
    "mcap-protobuf-support": "mcap_protobuf",
    "zstandard": "zstandard",
    "lz4": "lz4.frame",
    "matplotlib": "matplotlib",
    "jinja2": "jinja2",
    "pydantic": "pydantic",
    "click": "click",
    "rich": "rich",
}


def examine() -> list[tuple[str, str, bool, str]]:
    """Return rows of (part, version, sound, remedy)."""
    rows = [("mooringdx", __version__, True, ""), ("python", platform.python_version(), True, "")]
    for package, module in _PARTS.items():
        try:
            version = metadata.version(package)
            importlib.import_module(module)
            rows.append((package, version, True, ""))
        except (ImportError, OSError) as error:
            rows.append((package, "missing", False, f"{error}; install again from requirements.lock"))
    rows.append(_kernel())
    return rows


def _kernel() -> tuple[str, str, bool, str]:
    import numpy as np

    from mooringdx.detectors.design import Design
    from mooringdx.detectors.glrt import Glrt
    from mooringdx.detectors.reference import Reference
    from mooringdx.types import Fault, Grid, Signatures, Whitened

    one = np.ones((1, 1))
    signatures = Signatures((Fault("sensor_fault", "x_a"),), ("r",), one, ("m",), np.array([np.nan]), np.zeros(1))
    z = Whitened(("r",), Grid(0.0, 1.0, 64), np.ones((64, 1)), np.ones((64, 1), dtype=np.bool_), signatures)
    detector = Glrt(Design.of(signatures, one, 8, Reference(np.zeros(1), np.ones(1))))
    got = float(detector(z).values[-1, 0])
    sound = abs(got - 4.0) < 1e-12
    return ("compiled kernel", "GLRT of ones", sound, "" if sound else f"gave {got}, expected 4; delete __pycache__")
