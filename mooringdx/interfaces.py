"""The verbs, as protocols. A family's members stand in one folder, one a file, listed in its literal dict."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

from mooringdx.types import Channels, RawLog, Residuals, Statistic, Whitened


class Reader(Protocol):
    """One log format."""

    def __call__(self, path: Path, **options: Any) -> RawLog: ...


class Writer(Protocol):
    """Write a log in one format."""

    def __call__(self, log: RawLog, path: Path) -> None: ...


class ResidualGenerator(Protocol):
    """A fitted generator: channels in, residuals with their signatures out. Causal: a prefix gives the prefix."""

    def __call__(self, channels: Channels) -> Residuals: ...


class Detector(Protocol):
    """A fitted detector: whitened residuals in, a statistic out. Causal."""

    def __call__(self, whitened: Whitened) -> Statistic: ...
