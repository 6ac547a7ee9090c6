"""What every test shares: where the reference data stand, and property tests that draw the same cases every time."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import settings

ROOT = Path(__file__).parents[1]
REFERENCE = ROOT.parent / "shared" / "data"

settings.register_profile("repeatable", derandomize=True, deadline=None, database=None)
settings.load_profile("repeatable")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Skip what needs the reference data where the folder is absent, and say so."""
    if REFERENCE.is_dir():
        return
    absent = pytest.mark.skip(reason="no reference data: the folder shared/data beside the repository is absent")
    for item in items:
        if "reference" in item.keywords:
            item.add_marker(absent)


@pytest.fixture(scope="session")
def root() -> Path:
    """Return the repository's top folder."""
    return ROOT
