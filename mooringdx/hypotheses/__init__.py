"""Weigh rival scenarios: ``HYPOTHESES`` names every bank of hypotheses that a run file may use."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mooringdx.hypotheses.adrift import Adrift
from mooringdx.hypotheses.onset_glr import OnsetGlr

HYPOTHESES: Mapping[str, Any] = {
    "adrift": Adrift,
    "onset_glr": OnsetGlr,
}
