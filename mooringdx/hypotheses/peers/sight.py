"""What the compared banks see of a log: the same places and known forces as the onset bank."""

from __future__ import annotations

from mooringdx.errors import ConfigError
from mooringdx.hypotheses.onset_glr import OnsetGlr
from mooringdx.observers.forces import PLACE
from mooringdx.types import Array, Channels


def inputs(base: OnsetGlr, channels: Channels, word: str, piece: slice = slice(None)) -> tuple[Array, Array]:
    """Return places and known forces in body axes, (n, 3) each, every ``base.thin`` samples of ``piece``.

    Raise ConfigError where the log has not what the no-fault log had; ``word`` names the bank in it.
    """
    if missing := [name for name in (*PLACE, *base.known) if name not in channels.names]:
        raise ConfigError(
            f"[bank] {word}: the log has no '{missing[0]}', which the no-fault log had; map it, or fit anew"
        )
    return base.inputs(channels, piece)
