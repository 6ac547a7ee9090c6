"""Look at a ROS message definition before a decoder package gets it: damaged or hostile text must do no harm.

The ROS 1 package writes Python from the text and imports it, so that the text is reduced to fields of plain types
and names. Both packages make as many elements as a (perhaps damaged) length says, and stop only where the
payload ends; a definition whose elements need no bytes of it would never end, and is refused.
"""

from __future__ import annotations

import keyword
import re
from typing import NamedTuple

SEPARATOR = "\n" + "=" * 80 + "\n"

_PLAIN_FIELD = re.compile(r"([A-Za-z][\w/]*)(\[(\d*)\])?\s+([A-Za-z]\w*)", re.ASCII)
_PLAIN_TITLE = re.compile(r"MSG: ([A-Za-z]\w*/[A-Za-z]\w*)\s*", re.ASCII)
_FIELD = re.compile(r"([A-Za-z][\w/]*)(?:<=\d+)?(?:\[(<=)?(\d*)\])?\s+\w+(?!\s*=|\w)")
_TITLE = re.compile(r"MSG:\s*(?:\S*/)?(\w+)\s*")
_SCALARS = {f"{kind}{bits}" for kind in ("int", "uint") for bits in (8, 16, 32, 64)} | {"float32", "float64", "bool"}
_LEAVES = _SCALARS | {"byte", "char", "string", "wstring", "time", "duration", "Time", "Duration"}
_SLICED = {"uint8", "byte"}
_MOST_VALUES = 10**6
_DEEPEST = 32


class UndecodableError(ValueError):
    """A channel's messages cannot be decoded; the text says why."""


class _Field(NamedTuple):
    """``size``: elements of a fixed array, 1 for a scalar, None for an array whose length stands in the payload."""

    kind: str
    size: int | None


def plain_ros1(text: str) -> str:
    """Return a ROS 1 message definition reduced to its fields: no comment, no constant, no other text.

    Raises
    ------
    UndecodableError : a line is no field.
    """
    parts: list[str] = []
    for number, part in enumerate(text.replace("\r", "").split(SEPARATOR)):
        lines = part.split("\n")
        kept: list[str] = []
        if number > 0:
            title = _PLAIN_TITLE.fullmatch(lines.pop(0))
            if title is None:
                raise UndecodableError("a ROS 1 definition does not begin with 'MSG: package/Type'")
            kept.append(f"MSG: {title[1]}")
        kept.extend(field for line in lines if (field := _plain_field(line)))
        parts.append("\n".join(kept))
    return SEPARATOR.join(parts)


def _plain_field(line: str) -> str:
    code = line.split("#")[0].strip()
    if not code or "=" in code:
        return ""
    match = _PLAIN_FIELD.fullmatch(code)
    if match is None or keyword.iskeyword(match[4]):
        raise UndecodableError(f"'{code[:60]}' is not a field of a ROS 1 definition")
    return f"{match[1]}{match[2] or ''} {match[4]}"


def check_definition(text: str) -> None:
    """Refuse a ROS 1 or ROS 2 definition that no payload can bound.

    Raises
    ------
    UndecodableError : an array of elements that need no bytes, fixed arrays of over a million values in all, a type
        inside itself, or the calls of a service.
    """
    kinds: dict[str, list[list[_Field]]] = {}
    main: list[_Field] = []
    for number, part in enumerate(re.split(r"^={3,}\s*$", text, flags=re.MULTILINE)):
        lines = part.strip().split("\n")
        if any(line.strip() == "---" for line in lines):
            raise UndecodableError("the definition holds the calls of a service, which are not read")
        title = _TITLE.match(lines[0])
        fields = [found for line in lines if (found := _field(line)) is not None]
        if number == 0:
            main = fields
        elif title is not None:
            kinds.setdefault(title[1], []).append(fields)
    _weigh(main, kinds, {}, 0)


def _field(line: str) -> _Field | None:
    code = line.split("#")[0].strip()
    match = _FIELD.match(code)
    if match is None:
        return None
    sized = "[" in match[0]
    size = (int(match[3]) if match[3] and not match[2] else None) if sized else 1
    return _Field(match[1].split("/")[-1], size)


def _weigh(
    fields: list[_Field], kinds: dict[str, list[list[_Field]]], known: dict[str, tuple[int, bool]], depth: int
) -> tuple[int, bool]:
    """Return how many values a message has before any payload is read, and whether reading one needs bytes."""
    if depth > _DEEPEST:
        raise UndecodableError("a type of the definition lies inside itself")
    values, needs = 0, False
    for kind, size in fields:
        inner, hungry = 1, kind not in _SLICED or size == 1
        if kind in kinds and kind not in _LEAVES:
            if kind not in known:
                weighed = [_weigh(own, kinds, known, depth + 1) for own in kinds[kind]]
                known[kind] = max(n for n, _ in weighed), all(bytes_needed for _, bytes_needed in weighed)
            inner, hungry = known[kind]
            if size is None and not hungry:
                raise UndecodableError(f"an array of '{kind}' has elements that need no bytes of the message")
        values += inner * (size or 0)
        needs = needs or size is None or hungry
        if values > _MOST_VALUES:
            raise UndecodableError(f"fixed arrays of over {_MOST_VALUES} values in all")
    return values, needs
