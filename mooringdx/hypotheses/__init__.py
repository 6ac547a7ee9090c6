"""Weigh rival scenarios: ``HYPOTHESES`` names every bank of hypotheses that a run file may use."""

from __future__ import annotations

from mooringdx.hypotheses.adrift import Adrift

HYPOTHESES = {
    "adrift": Adrift,
}
