"""Shares, quantiles and rates with their intervals, and how they are printed.

    quantile q of delays: the smallest x with at least a share q of the cases <= x; a miss is infinite
    its interval: order statistics of ranks B^-1(a/2; n, q) and B^-1(1-a/2; n, q) + 1, B binomial (no law assumed)

[a, b] is an exact 95 % interval throughout: binomial for shares, Poisson for rates, order statistics for quantiles.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from mooringdx.assess.intervals import binomial, poisson

HOUR = 3600.0
MONTH = 720.0
"""Hours in 30 days."""


def share(flags: Iterable[bool | None]) -> dict[str, Any]:
    """Return count, n, share and interval of what is true; None is left out."""
    known = [bool(f) for f in flags if f is not None]
    low, high = binomial(sum(known), len(known))
    value = sum(known) / len(known) if known else None
    return {"count": sum(known), "n": len(known), "share": value, "low": low, "high": high}


def quantile(values: Sequence[float], q: float, level: float = 0.95) -> dict[str, Any]:
    """Return a quantile and its interval by order statistics, None where the cases are too few to bound it.

    Infinite values are cases never reached.
    """
    from scipy.stats import binom

    known = np.sort(np.asarray(values, dtype=np.float64))
    n, tail = known.size, (1.0 - level) / 2.0
    if n == 0:
        return {"value": None, "low": None, "high": None, "n": 0}
    low, high = int(binom.ppf(tail, n, q)), int(binom.ppf(1.0 - tail, n, q)) + 1
    return {
        "value": float(known[max(math.ceil(q * n - 1e-9) - 1, 0)]),
        "low": float(known[low - 1]) if low >= 1 else None,
        "high": float(known[high - 1]) if high <= n else None,
        "n": n,
    }


def rate(count: int, hours: float, asked: float | None = None) -> dict[str, Any]:
    """Return a rate per hour with its interval, and its ratio to the ``asked`` one, 1/s, where there is one."""
    if hours <= 0.0:
        return {"count": count, "per_hour": None, "low": None, "high": None, "ratio": [None, None, None]}
    low, high = poisson(count, hours)
    ratio = [None if asked is None else x / (asked * HOUR) for x in (count / hours, low, high)]
    return {"count": count, "per_hour": count / hours, "low": low, "high": high, "ratio": ratio}


def share_text(s: Mapping[str, Any]) -> str:
    """Return "3/4 [0.19, 0.99]"."""
    return f"{s['count']}/{s['n']} [{s['low']:.2f}, {s['high']:.2f}]" if s["n"] else "-"


def rate_in(r: Mapping[str, Any], hours: float = 1.0) -> str:
    """Return a rate in so many hours with its interval."""
    if r["per_hour"] is None:
        return "-"
    return "{:.3g} [{:.3g}, {:.3g}]".format(*(hours * r[key] for key in ("per_hour", "low", "high")))


def number_text(value: float | None) -> str:
    """Return a number in three digits, "missed" for a delay without end."""
    return "-" if value is None else "missed" if value == math.inf else f"{value:.3g}"


def quantile_text(q: Mapping[str, Any]) -> str:
    """Return a quantile with its interval, "?" where the cases are too few to bound it."""
    if q["value"] is None:
        return "-"
    low, high = ("?" if q[end] is None else number_text(q[end]) for end in ("low", "high"))
    return f"{number_text(q['value'])} [{low}, {high}]"


def columns(table: Sequence[Sequence[str]]) -> list[str]:
    """Return rows of text with the columns under each other."""
    widths = [max(len(row[i]) for row in table) for i in range(len(table[0]))]
    return ["  " + "  ".join(x.ljust(w) for x, w in zip(row, widths, strict=True)).rstrip() for row in table]
