"""Score the detection against labelled logs: ``PLANS`` names every kind of plan."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from mooringdx.assess.adrift import assess_adrift
from mooringdx.assess.labelled import assess_labelled
from mooringdx.assess.simulated import assess_simulated
from mooringdx.config import read_toml
from mooringdx.errors import ConfigError
from mooringdx.registry import resolve

PLANS = {
    "adrift": assess_adrift,
    "labelled": assess_labelled,
    "simulated": assess_simulated,
}
LONG = ("simulated",)
"""The kinds that take minutes or hours, and say how far they are."""


def run_plan(
    path: Path, out: Path, data: Path | None = None, progress: Callable[[int, int], None] | None = None
) -> tuple[str, dict[str, Any]]:
    """Carry out the plan at ``path`` on the logs in ``data``, write its tables and figures to ``out``.

    Returns the text for the terminal and the same numbers as JSON-safe values. ``data`` defaults to the plan's folder.
    ``progress`` is called with what is done and what is to do by the kinds that take long.
    Raises ConfigError for a wrong plan, LogError for a log or truth that cannot be read.
    """
    body = read_toml(path)
    if "kind" not in body:
        raise ConfigError(f"{path}: key 'kind' is missing; allowed: {', '.join(PLANS)}")
    kind = str(body["kind"])
    extra = {"progress": progress} if kind in LONG else {}
    return resolve(kind, PLANS, "kind of plan")(path, out, data or path.parent, **extra)
