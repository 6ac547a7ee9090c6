"""Source papers carried out anew: their figures and claims beside what is measured here, one paper a file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from mooringdx.registry import resolve
from mooringdx.reproduce import fang2015, position_thesis

__all__ = ["PAPERS", "run_paper"]

PAPERS: Mapping[str, Callable[[Path, int], str]] = {
    "fang2015": fang2015.reproduce,
    "position-thesis": position_thesis.reproduce,
}


def run_paper(name: str, out: Path, seed: int) -> str:
    """Carry out a paper's experiment, write its page, figures and claims into ``out``, return the outcome in words.

    Raises ConfigError for an unknown paper, ReportError for a folder that holds strangers' files.
    """
    return resolve(name, PAPERS, "paper")(out, seed)
