"""Score the detection against labelled logs: ``PLANS`` names every kind of plan."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from mooringdx.assess.adrift import assess_adrift
from mooringdx.assess.labelled import assess_labelled
from mooringdx.config import read_toml
from mooringdx.errors import ConfigError
from mooringdx.registry import resolve

PLANS = {
    "adrift": assess_adrift,
    "labelled": assess_labelled,
}


def run_plan(path: Path, out: Path, data: Path | None = None) -> tuple[str, dict[str, Any]]:
    """Carry out the plan at ``path`` on the logs in ``data``, write its tables and figures to ``out``.

    Returns the text for the terminal and the same numbers as JSON-safe values. ``data`` defaults to the plan's folder.
    Raises ConfigError for a wrong plan, LogError for a log or truth that cannot be read.
    """
    body = read_toml(path)
    if "kind" not in body:
        raise ConfigError(f"{path}: key 'kind' is missing; allowed: {', '.join(PLANS)}")
    return resolve(str(body["kind"]), PLANS, "kind of plan")(path, out, data or path.parent)
