"""Whitened residuals -> statistic, one detector a file. The table is literal: name in a run file -> class."""

from __future__ import annotations

from mooringdx.detectors.cusum import Cusum
from mooringdx.detectors.glrt import Glrt
from mooringdx.detectors.glrt_unknown import GlrtUnknown

DETECTORS: dict[str, type[Glrt] | type[GlrtUnknown] | type[Cusum]] = {
    "glrt": Glrt,
    "glrt_unknown": GlrtUnknown,
    "cusum": Cusum,
}
