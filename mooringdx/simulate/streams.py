"""Random numbers: one stream a process, keyed by its name, and the slow wandering made of them.

Every random process draws from a stream of its own: two axes fed by one stream once made a published study's results
unusable, and a stream that depends on its place in a list changes when the list grows.

Wandering is the Ornstein-Uhlenbeck process, x(k+1) = a x(k) + sd sqrt(1 - a^2) w(k), a = exp(-dt/memory), started in
its stationary law.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable

import numpy as np

from mooringdx.types import Array

Draw = Callable[[str], np.random.Generator]


def stream(seed: int | tuple[int, ...], name: str) -> np.random.Generator:
    """Return the random stream of ``name``: independent of every other name, the same for the same seed."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(zlib.crc32(name.encode()),)))


def streams(seed: int | tuple[int, ...]) -> Draw:
    """Return the function from a name to its stream under ``seed``."""
    return lambda name: stream(seed, name)


def wander(rng: np.random.Generator, n: int, dt: float, sd: float, memory: float) -> Array:
    """Return a stationary Ornstein-Uhlenbeck process, (n,), of deviation ``sd``, time constant ``memory`` s."""
    from scipy.signal import lfilter

    if sd == 0.0:
        return np.zeros(n)
    keep = np.exp(-dt / memory)
    shocks = rng.standard_normal(n) * np.sqrt(1.0 - keep**2)
    shocks[0] = rng.standard_normal()
    return np.asarray(sd * lfilter([1.0], [1.0, -keep], shocks), dtype=np.float64)
