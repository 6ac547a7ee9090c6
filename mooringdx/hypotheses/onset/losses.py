"""Which losses a bank weighs: every line whole, on request every pair at once and every line in part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from mooringdx.physics.mooring import Mooring
from mooringdx.types import Array, replace


@dataclass(frozen=True)
class Loss:
    """What may be gone: ``lines``, one or two, of whose pull the ``share`` is lost."""

    lines: tuple[str, ...]
    share: float = 1.0

    @property
    def kind(self) -> str:
        """The event's word."""
        return "line_lost" if self.share == 1.0 else "line_weakened"

    @property
    def name(self) -> str:
        """What a posterior calls it: "line_lost line_1 + line_2", "line_weakened line_1 by 50 %"."""
        part = "" if self.share == 1.0 else f" by {100.0 * self.share:.0f} %"
        return f"{self.kind} {' + '.join(self.lines)}{part}"

    def after(self, mooring: Mooring) -> Mooring:
        """Return the mooring that is left."""
        row = np.array([1.0 - self.share * (name in self.lines) for name in mooring.names])[:, None]
        return replace(mooring, horizontal=mooring.horizontal * row, tension=mooring.tension * row)


def losses(lines: Sequence[str], pairs: float = 0.0, partial: Sequence[float] = ()) -> tuple[Loss, ...]:
    """Return every loss to weigh, whole lines first; ``pairs``: share of breaks that take two lines, 0 for none."""
    out = [Loss((name,)) for name in lines]
    out += [Loss((name,), share) for share in partial for name in lines]
    return tuple(out + [Loss(two) for two in combinations(lines, 2)] if pairs > 0.0 else out)


def shares(weighed: Sequence[Loss], lines: Sequence[str]) -> Array:
    """Return the share of every line's pull, (losses, lines), that each takes."""
    return np.array([[loss.share if name in loss.lines else 0.0 for name in lines] for loss in weighed])


def weights(weighed: Sequence[Loss], pairs: float) -> Array:
    """Return each one's part, (losses,), of the rate of breaks; a line loses a part as often as all of its pull."""
    kinds = [(len(loss.lines), loss.share) for loss in weighed]
    rate = {kind: pairs if kind[0] == 2 else 1.0 - pairs for kind in kinds}
    return np.array([rate[kind] / kinds.count(kind) for kind in kinds])
