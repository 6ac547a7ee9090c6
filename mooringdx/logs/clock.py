"""Stamps of text logs and tables: seconds, epochs, ISO-8601, dates and times of day. Dates never pass through a float.

A relative clock gives float64 s as logged; an absolute one gives int64 ns since 1970-01-01T00:00:00Z.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date, datetime
from decimal import Decimal, InvalidOperation
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mooringdx.errors import ConfigError
from mooringdx.registry import resolve
from mooringdx.types import Array, Mask

RELATIVE = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "day": 86400.0}
# Decimals of the unit that make 1 ns.
EPOCH = {"epoch_s": 9, "epoch_ms": 6, "epoch_us": 3, "epoch_ns": 0}
UNITS = {**dict.fromkeys(RELATIVE, "relative"), **dict.fromkeys(EPOCH, "epoch"), "iso8601": "date", "clock": "clock"}
_DAY_NS = 86400 * 10**9
_EPOCH_DAY = date(1970, 1, 1).toordinal()
_MONTHS = ["jan", "feb", "mar", "apr", "may", "jun", "jul", "aug", "sep", "oct", "nov", "dec"]
_DATE = r"\d{4}[-/.]\d{1,2}[-/.]\d{1,2}|\d{1,2}[-/.]\d{1,2}[-/.]\d{4}|\d{8}|\d{1,2}[- ][A-Za-z]{3}[- ]\d{4}"
_CLOCK = r"(\d{1,2}):(\d\d)(?::(\d\d)(?:[.,](\d+))?)?(?:\s*([AaPp])[Mm])?"
_MOMENT = re.compile(rf"\s*({_DATE})(?:[T\s]+{_CLOCK}\s*(Z|UTC|GMT|[+-]\d\d(?::?\d\d)?)?)?\s*")
_TIME_OF_DAY = re.compile(rf"\s*{_CLOCK}\s*")


@dataclass(frozen=True)
class Stamper:
    """How the stamps of one log are read. ``kind`` is relative, epoch, date or clock."""

    kind: str
    unit: str
    zone: str | None = None
    zoned: bool = False
    day_first: bool = True

    @property
    def absolute(self) -> bool:
        """Whether the stamps are instants."""
        return self.kind in ("epoch", "date")

    def arrow_type(self) -> Any:
        """Return the type in which the stamps are parsed fastest."""
        import pyarrow as pa

        if self.kind == "relative":
            return pa.float64()
        if self.kind == "epoch":
            return pa.decimal128(28, EPOCH[self.unit])
        if self.kind == "date":
            return pa.timestamp("ns", "UTC") if self.zoned else pa.timestamp("ns")
        return pa.binary()

    def of_arrow(self, column: Any) -> tuple[NDArray[Any], Mask]:
        """Return (stamps, readable) of a column in ``arrow_type``: float64 s or int64 ns, (n,) each."""
        ok = valid(column)
        if self.kind == "relative":
            values = floats(column) * RELATIVE[self.unit]
            return values, np.isfinite(values)
        if self.kind == "epoch":
            return _of_decimal(column, ok)
        if self.kind == "date":
            ns = np.where(ok, np.frombuffer(column.buffers()[1], np.int64)[column.offset :][: len(column)], 0)
            return (ns if self.zoned else self._to_utc(ns)), ok
        return self.of_text([None if x is None else x.decode("ascii", "replace") for x in column.to_pylist()])

    def of_text(self, cells: Sequence[str | None]) -> tuple[NDArray[Any], Mask]:
        """Return (stamps, readable) of cells one by one: slower, and of every spelling that is known."""
        parse = {"relative": self._number, "epoch": self._epoch, "date": self._moment, "clock": _time_of_day}[self.kind]
        found = [None if cell is None else parse(cell) for cell in cells]
        ok = np.array([x is not None for x in found], dtype=np.bool_)
        kind = np.int64 if self.absolute else np.float64
        values = np.array([0 if x is None else x for x in found], dtype=kind)
        if self.kind == "date" and self.zone not in (None, "UTC"):
            naive = np.array(
                [x is not None and _zone_of(c) is None for x, c in zip(found, cells, strict=True)], dtype=bool
            )
            values[naive] = self._to_utc(values[naive])
        return values, ok

    def _number(self, cell: str) -> float | None:
        value = number(cell)
        return None if value is None or not np.isfinite(value) else value * RELATIVE[self.unit]

    def _epoch(self, cell: str) -> int | None:
        try:
            ns = int(Decimal(cell.strip().replace(",", ".")).scaleb(EPOCH[self.unit]).to_integral_value())
        except (InvalidOperation, ValueError, OverflowError):
            return None
        return ns if abs(ns) < 2**63 else None

    def _moment(self, cell: str) -> int | None:
        match = _MOMENT.fullmatch(cell)
        day = _day(match[1], self.day_first) if match else None
        if match is None or day is None:
            return None
        ns = day * _DAY_NS
        if match[2]:
            clock = _clock_ns(match[2], match[3], match[4], match[5], match[6])
            if clock is None:
                return None
            ns += clock - _offset_ns(match[7])
        return ns if abs(ns) < 2**63 else None

    def _to_utc(self, ns: NDArray[Any]) -> NDArray[Any]:
        """Return naive local times as UTC; an hour that comes twice is taken as its first."""
        if self.zone in (None, "UTC", "Z") or ns.size == 0:
            return ns
        if re.fullmatch(r"[+-]\d\d(:?\d\d)?", str(self.zone)):
            return np.asarray(ns - _offset_ns(self.zone))
        import pyarrow as pa
        import pyarrow.compute as pc

        naive = pa.array(ns, pa.timestamp("ns"))
        try:
            aware = pc.assume_timezone(naive, self.zone, ambiguous="earliest", nonexistent="latest")
        except pa.ArrowInvalid:
            raise ConfigError(
                f"[log] time.zone: '{self.zone}' is no zone; write one such as UTC, +02:00 or Europe/Oslo"
            ) from None
        return np.asarray(aware.view("int64").to_numpy(zero_copy_only=False))


def stamper(unit: str, zone: str | None, samples: Sequence[str]) -> Stamper:
    """Return the reader of stamps of a unit; ``samples`` show whether they state a zone and how dates are ordered."""
    kind = resolve(unit, UNITS, "time unit")
    zoned = kind == "date" and any(_zone_of(x) for x in samples)
    return Stamper(kind, unit, zone, zoned, not _month_first(samples))


def ambiguous_order(samples: Sequence[str]) -> bool:
    """Return whether dates such as 03/04/2025 leave open what is day and what is month."""
    pairs = [re.match(r"\s*(\d{1,2})[-/](\d{1,2})[-/]\d{4}", x) for x in samples]
    known = [p for p in pairs if p]
    return bool(known) and not any(int(p[1]) > 12 or int(p[2]) > 12 for p in known)


def guess_unit(samples: Sequence[str], header_unit: str | None) -> str | None:
    """Return the unit of ``UNITS`` that sample stamps are written in, or None when they are no stamps."""
    known = [x for x in samples if x.strip()]
    if not known:
        return None
    if 2 * sum(bool(_MOMENT.fullmatch(x)) for x in known) > len(known) and not known[0].strip().isdigit():
        return "iso8601"
    if 2 * sum(bool(_TIME_OF_DAY.fullmatch(x)) for x in known) > len(known):
        return "clock"
    numbers = [y for y in map(number, known) if y is not None and np.isfinite(y)]
    if 2 * len(numbers) <= len(known):
        return None
    size = float(np.median(np.abs(numbers)))
    for unit, least in (("epoch_ns", 3e17), ("epoch_us", 3e14), ("epoch_ms", 3e11), ("epoch_s", 3e8)):
        if size >= least and (header_unit is None or unit.endswith("_" + header_unit)):
            return unit
    spelled = {"sec": "s", "secs": "s", "hr": "h", "hours": "h", "days": "day", "d": "day"}.get(
        header_unit or "s", header_unit or "s"
    )
    return spelled if spelled in RELATIVE else "s"


def is_stamp(cell: str) -> bool:
    """Return whether a cell is a date, an instant or a time of day."""
    return bool(_MOMENT.fullmatch(cell) or _TIME_OF_DAY.fullmatch(cell))


def number(cell: str) -> float | None:
    """Return a cell as a number, also with a Fortran exponent or a plus sign; None when it is none."""
    try:
        return float(cell) if "_" not in cell else None
    except ValueError:
        pass
    if "d" not in cell.lower() or "_" in cell:
        return None
    try:
        return float(re.sub(r"(?<=\d|\.)[dD](?=[+-]?\d)", "e", cell))
    except ValueError:
        return None


def valid(column: Any) -> Mask:
    """Return which cells of an Arrow array are not null, (n,); pyarrow's own way would import pandas, for a second."""
    if not column.null_count:
        return np.ones(len(column), dtype=np.bool_)
    bits = np.frombuffer(column.buffers()[0], dtype=np.uint8)
    return np.unpackbits(bits, bitorder="little")[column.offset :][: len(column)].astype(np.bool_)


def floats(column: Any) -> Array:
    """Return an Arrow array of float64, (n,), NaN where null, a view where there is none."""
    if not len(column):
        return np.zeros(0)
    values = np.frombuffer(column.buffers()[1], dtype=np.float64)[column.offset :][: len(column)]
    return values if not column.null_count else np.where(valid(column), values, np.nan)


def unroll(seconds: Array, last: float | None) -> Array:
    """Return times of day, s, as one running clock: a fall of half a day is midnight. ``last``: the stamp before."""
    if seconds.size == 0:
        return seconds
    joined = np.concatenate([[seconds[0] if last is None else last], seconds])
    days = np.round(np.diff(joined) / 86400.0)
    return np.asarray(seconds - 86400.0 * np.cumsum(days))


def _of_decimal(column: Any, ok: Mask) -> tuple[NDArray[Any], Mask]:
    words = np.frombuffer(column.buffers()[1], dtype=np.int64)[2 * column.offset :][: 2 * len(column)]
    low, high = words[::2], words[1::2]
    return np.where(ok, low, 0), ok & (high == (low >> 63))


def _time_of_day(cell: str) -> float | None:
    match = _TIME_OF_DAY.fullmatch(cell)
    ns = _clock_ns(*match.groups()) if match else None
    return None if ns is None else ns / 1e9


def _clock_ns(hour: str, minute: str, second: str | None, fraction: str | None, half: str | None) -> int | None:
    h, m, s = int(hour), int(minute), int(second or 0)
    if half:
        h = h % 12 + (12 if half in "pP" else 0)
    if h > 24 or m > 59 or s > 60:
        return None
    return (h * 3600 + m * 60 + s) * 10**9 + int((fraction or "0").ljust(9, "0")[:9])


def _zone_of(cell: str | None) -> str | None:
    match = _MOMENT.fullmatch(cell or "")
    return match[7] if match else None


def _offset_ns(zone: str | None) -> int:
    if not zone or zone[0] not in "+-":
        return 0
    digits = zone[1:].replace(":", "").ljust(4, "0")
    return (1 if zone[0] == "+" else -1) * (int(digits[:2]) * 60 + int(digits[2:])) * 60 * 10**9


@functools.lru_cache(maxsize=4096)
def _day(text: str, day_first: bool) -> int | None:
    parts = re.split(r"[-/. ]", text) if len(text) != 8 or not text.isdigit() else [text[:4], text[4:6], text[6:]]
    if parts[1].isalpha():
        if parts[1].lower() not in _MONTHS:
            return None
        parts[1] = str(_MONTHS.index(parts[1].lower()) + 1)
    a, b, c = (int(x) for x in parts)
    year, month, day = (a, b, c) if len(parts[0]) == 4 else (c, b, a) if day_first or "." in text else (c, a, b)
    try:
        return date(year, month, day).toordinal() - _EPOCH_DAY
    except ValueError:
        return None


def _month_first(samples: Sequence[str]) -> bool:
    pairs = [re.match(r"\s*(\d{1,2})[-/](\d{1,2})[-/]\d{4}", x) for x in samples]
    return any(p and int(p[2]) > 12 for p in pairs) and not any(p and int(p[1]) > 12 for p in pairs)


def iso(epoch_ns: int) -> str:
    """Return an instant as ISO-8601 with nanoseconds, exactly."""
    seconds, rest = divmod(epoch_ns, 10**9)
    return f"{datetime.fromordinal(_EPOCH_DAY + seconds // 86400):%Y-%m-%d}T{_hms(seconds % 86400)}.{rest:09d}Z"


def _hms(seconds: int) -> str:
    return f"{seconds // 3600:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}"
