"""Banks to compare the onset bank with: the thesis's own, and four on Kalman filters."""

from __future__ import annotations

from mooringdx.hypotheses.peers.family import Family, Peer
from mooringdx.hypotheses.peers.thesis import Thesis, ThesisFamily

__all__ = ["Family", "Peer", "Thesis", "ThesisFamily"]
