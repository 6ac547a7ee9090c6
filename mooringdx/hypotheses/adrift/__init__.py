"""Adrift or moved: what one position a day says of a single-point mooring, in two levels.

A warning says that the buoy left its watch circle; the verdict that follows weighs a service visit, a drag and a
break-away, each moving or held. ``judge`` is the pure method, ``Adrift`` the same on aligned channels.
"""

from __future__ import annotations

from mooringdx.hypotheses.adrift.events import Adrift, checks, events
from mooringdx.hypotheses.adrift.nouns import CALLS, HYPOTHESES, Verdict
from mooringdx.hypotheses.adrift.verdict import judge

__all__ = ["CALLS", "HYPOTHESES", "Adrift", "Verdict", "checks", "events", "judge"]
