"""Look a name from a configuration up in the literal dict that a folder keeps."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from typing import TypeVar

from mooringdx.errors import ConfigError

T = TypeVar("T")


def resolve(name: str, table: Mapping[str, T], what: str) -> T:
    """Return ``table[name]``, or raise a ConfigError that names the nearest entries.

    Parameters
    ----------
    name : the word from the configuration.
    table : the literal dict of the folder.
    what : what the table holds, for the message ("detector", "log format").
    """
    try:
        return table[name]
    except KeyError:
        raise ConfigError(f"unknown {what} '{name}'{did_you_mean(name, table)}") from None


def did_you_mean(name: str, allowed: Iterable[str]) -> str:
    """Return "; did you mean 'x'? allowed: ..." for a word that is not among ``allowed``."""
    words = list(allowed)
    near = difflib.get_close_matches(name, words, n=1, cutoff=0.5)
    hint = f"; did you mean '{near[0]}'?" if near else ";"
    return f"{hint} allowed: {', '.join(words)}"
