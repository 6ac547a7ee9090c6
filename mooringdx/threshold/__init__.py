"""No-fault statistic -> level for a wanted false-alarm rate, with its uncertainty."""

from __future__ import annotations

from mooringdx.threshold.fit import fit_threshold
from mooringdx.threshold.folds import DRIFT_LIMIT, crossfit, drift_ratio, fold_slices
from mooringdx.threshold.predicted import predicted_threshold
from mooringdx.threshold.smallest import SmallestFault, smallest_fault
from mooringdx.threshold.tails import count_alarms

__all__ = [
    "DRIFT_LIMIT",
    "SmallestFault",
    "count_alarms",
    "crossfit",
    "drift_ratio",
    "fit_threshold",
    "fold_slices",
    "predicted_threshold",
    "smallest_fault",
]
