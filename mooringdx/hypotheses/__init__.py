"""Weigh rival scenarios: ``HYPOTHESES`` names every bank of hypotheses that a run file may use."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mooringdx.hypotheses.adrift import Adrift
from mooringdx.hypotheses.onset_glr import OnsetGlr
from mooringdx.hypotheses.peers import Family, ThesisFamily

HYPOTHESES: Mapping[str, Any] = {
    "adrift": Adrift,
    "imm": Family("imm"),
    "live_bias": Family("live_bias"),
    "no_bias": Family("no_bias"),
    "onset_glr": OnsetGlr,
    "shared_bias": Family("shared_bias"),
    "thesis_dht": ThesisFamily("thesis_dht"),
    "thesis_mle": ThesisFamily("thesis_mle"),
}
