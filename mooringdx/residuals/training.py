"""The no-fault data that a generator learns from: aligned channels and the windows in them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from mooringdx.config import MooringPart
from mooringdx.errors import ConfigError, FitError
from mooringdx.registry import did_you_mean
from mooringdx.types import Array, Channels

SIGNATURE_ERROR = 0.1
"""Share to which the effect of a lost line is known: stiffness learned in small motions, lines as springs. A choice."""


COMPASS = (0.0, 45.0, 90.0, 135.0)
"""Directions, deg, that stand for an offset by the environment, which may have any."""


@dataclass(frozen=True)
class Training:
    """One log's channels and its no-fault pieces, half-open sample slices."""

    channels: Channels
    pieces: tuple[slice, ...]

    def rows(self, names: Sequence[str]) -> Array:
        """Return the no-fault rows of ``names`` where all of them are valid, (m, len(names))."""
        columns = [self.channels.names.index(name) for name in names]
        blocks = []
        for piece in self.pieces:
            values = self.channels.values[piece][:, columns]
            blocks.append(values[self.channels.valid[piece][:, columns].all(axis=1)])
        return np.vstack(blocks) if blocks else np.zeros((0, len(columns)))


def pooled(training: Sequence[Training], names: Sequence[str]) -> Array:
    """Return the no-fault rows of all logs, (m, len(names)); FitError when there is none."""
    rows = np.vstack([t.rows(names) for t in training])
    if not len(rows):
        raise FitError(
            f"no sample of the no-fault window has all of {', '.join(names)}; leave out the one that is missing there"
        )
    return rows


def known(names: Iterable[str], channels: Channels, where: str) -> None:
    """Raise a ConfigError for the first name that is no channel of the log."""
    for name in names:
        if name not in channels.names:
            raise ConfigError(f"{where}: unknown channel '{name}'{did_you_mean(name, channels.names)}")


def line_tensions(mooring: MooringPart, channels: Channels) -> dict[str, str]:
    """Return {line: its tension channel}: line_4 and tension_4; every tension when no lines are declared."""
    found = {}
    every = ["line_" + c.removeprefix("tension_") for c in channels.names if c.startswith("tension_")]
    for line in (*mooring.lines, *mooring.azimuth):
        if line not in every:
            missing = "tension_" + line.removeprefix("line_")
            raise ConfigError(f"[mooring]: '{line}' has no channel '{missing}'{did_you_mean(line, every)}")
    for line in mooring.lines or every:
        name = "tension_" + line.removeprefix("line_")
        if name in channels.names:
            found[line] = name
    return found
