"""Turn the payload of an MCAP message into numbers: JSON, ROS 1, ROS 2 (CDR) and protobuf.

The official decoder packages do the decoding; ROS definitions are looked at first (``mcap_ros``).
"""

from __future__ import annotations

import contextlib
import io
import json
import logging
import re
import struct
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from datetime import datetime
from typing import TYPE_CHECKING, Any

from mooringdx.logs.mcap_ros import UndecodableError, check_definition, plain_ros1

if TYPE_CHECKING:
    from mcap.records import Channel, Schema

LONGEST_ARRAY = 16
DEEPEST = 32

Token = str | int
Decoder = Callable[[bytes], Any]

_PATH = re.compile(r"\.?([^.\[\]]+)|\[(\d+)\]")
_QUIET = logging.NullHandler()
_NS = {"s": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
_PARTS = (("sec", "nanosec"), ("secs", "nsecs"), ("sec", "nsec"), ("seconds", "nanos"))


def decoder(channel: Channel, schema: Schema | None) -> tuple[Decoder, tuple[type[BaseException], ...]]:
    """Return a function from payload to message, and the errors that it raises on a damaged payload.

    Raises
    ------
    UndecodableError : the encoding is not known here, or the schema cannot be read.
    """
    encoding = channel.message_encoding
    kind = schema.encoding if schema is not None else "none"
    makers = {
        ("json", kind): _json,
        ("ros1", "ros1msg"): _ros1,
        ("cdr", "ros2msg"): _ros2,
        ("protobuf", "protobuf"): _protobuf,
    }
    maker = makers.get((encoding, kind))
    if maker is None:
        raise UndecodableError(
            f"messages encoded as '{encoding}' with a schema of kind '{kind}' cannot be read; "
            "allowed: json, ros1 with ros1msg, cdr with ros2msg, protobuf with protobuf"
        )
    damage = (*_DAMAGE, *_package_errors(encoding))
    unreadable: tuple[type[BaseException], ...] = (*damage, OSError)
    try:
        with contextlib.redirect_stderr(io.StringIO()):  # the ROS 2 parser prints what it raises
            return maker(channel, schema), damage
    except UndecodableError:
        raise
    except unreadable as error:
        name = schema.name if schema is not None else ""
        raise UndecodableError(f"the schema '{name}' cannot be read ({type(error).__name__}: {error})") from None


_DAMAGE: tuple[type[BaseException], ...] = (
    struct.error,
    ValueError,
    TypeError,
    LookupError,
    AttributeError,
    ArithmeticError,
    AssertionError,
    RuntimeError,
    NameError,
    MemoryError,
    EOFError,
    SyntaxError,
)


def _package_errors(encoding: str) -> tuple[type[BaseException], ...]:
    """Return the errors of a decoder package that derive from Exception alone."""
    from mcap.exceptions import McapError

    if encoding == "ros1":
        from mcap_ros1._vendor.genmsg.base import InvalidMsgSpec, MsgGenerationException
        from mcap_ros1._vendor.genmsg.msg_loader import MsgNotFound
        from mcap_ros1._vendor.genpy.message import MessageException

        return McapError, InvalidMsgSpec, MsgGenerationException, MsgNotFound, MessageException
    if encoding == "cdr":
        from mcap_ros2._vendor.rosidl_adapter.parser import InvalidSpecification, InvalidValue

        return McapError, InvalidSpecification, InvalidValue
    if encoding == "protobuf":
        from google.protobuf.message import Error

        return McapError, Error
    return (McapError,)


def _json(_channel: Channel, _schema: Schema | None) -> Decoder:
    return json.loads


def _ros1(channel: Channel, schema: Schema | None) -> Decoder:
    from mcap.records import Schema
    from mcap_ros1.decoder import DecoderFactory

    assert schema is not None
    if not re.fullmatch(r"[A-Za-z]\w*/[A-Za-z]\w*", schema.name, re.ASCII):
        raise UndecodableError(f"'{schema.name}' is not the name of a ROS 1 message")
    plain = plain_ros1(schema.data.decode("utf-8", errors="replace"))
    check_definition(plain)
    clean = Schema(id=schema.id, name=schema.name, encoding=schema.encoding, data=plain.encode())
    logging.getLogger("rosout").addHandler(_QUIET)  # a damaged text is counted, not printed
    places = list(sys.path)
    try:
        return _made(DecoderFactory().decoder_for(channel.message_encoding, clean))
    finally:
        sys.path[:] = places  # the package leaves a temporary folder there


def _ros2(channel: Channel, schema: Schema | None) -> Decoder:
    from mcap_ros2.decoder import DecoderFactory

    assert schema is not None
    check_definition(schema.data.decode())
    return _made(DecoderFactory().decoder_for(channel.message_encoding, schema))


def _protobuf(channel: Channel, schema: Schema | None) -> Decoder:
    from mcap_protobuf.decoder import DecoderFactory

    return _made(DecoderFactory().decoder_for(channel.message_encoding, schema))


def _made(found: Decoder | None) -> Decoder:
    if found is None:
        raise UndecodableError("the decoder package does not take this schema")
    return found


def path(text: str) -> tuple[Token, ...]:
    """Return a field path such as ``tensions.data[3]`` as names and indices.

    Raises
    ------
    ValueError : the text is not a path.
    """
    tokens: list[Token] = []
    at = 0
    while at < len(text):
        match = _PATH.match(text, at)
        if match is None:
            raise ValueError(f"'{text}' is not a field path such as 'pose.position.x' or 'data[3]'")
        tokens.append(match[1] if match[1] is not None else int(match[2]))
        at = match.end()
    return tuple(tokens)


def follow(message: Any, tokens: Sequence[Token]) -> Any:
    """Return what stands at a path.

    Raises
    ------
    LookupError : a name or an index is not there.
    """
    here = message
    for token in tokens:
        if isinstance(token, int):
            if not _is_array(here):
                raise LookupError(f"[{token}] of something that is no array")
            here = here[token]
        elif isinstance(here, Mapping):
            here = here[token]
        elif token in field_names(here):
            here = _member(here, token)
        else:
            raise LookupError(token)
    return here


def field_names(message: Any) -> tuple[str, ...]:
    """Return the names of a decoded message's fields; none for a number, a text or an array."""
    if isinstance(message, Mapping):
        return tuple(str(name) for name in message)
    described = getattr(message, "DESCRIPTOR", None)
    if described is not None:
        return tuple(field.name for field in described.fields)
    if _is_array(message) or isinstance(message, (str, int, float)):
        return ()
    slots = getattr(type(message), "__slots__", None)
    return tuple(getattr(message, "__dict__", ()) if slots is None else slots)


def _member(message: Any, name: str) -> Any:
    """Return one field; an optional protobuf number that was not set is None, never an invented zero."""
    described = getattr(message, "DESCRIPTOR", None)
    if described is not None:
        field = described.fields_by_name[name]
        if field.has_presence and field.message_type is None and not message.HasField(name):
            return None
    return getattr(message, name)


def _is_array(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)


def number(value: Any) -> float | None:
    """Return a leaf as a float: a bool is 0 or 1, a missing value NaN; None for what is no number."""
    if value is None:
        return float("nan")
    if isinstance(value, (int, float)):
        try:
            return float(value)
        except OverflowError:
            return float("inf") if value > 0 else float("-inf")
    return None


def leaves(message: Any, at: str = "", depth: int = 0) -> Iterator[tuple[str, float | int]]:
    """Yield every numeric leaf as (path, float), and an array that is too long to spell out as (path, its int length).

    Texts are left out; so is what lies deeper than 32 levels.
    """
    if depth > DEEPEST or isinstance(message, str):
        return
    value = number(message)
    if value is not None:
        yield at, value
    elif _is_array(message):
        if len(message) > LONGEST_ARRAY:
            yield at, len(message)
            return
        for index, item in enumerate(message):
            yield from leaves(item, f"{at}[{index}]", depth + 1)
    else:
        for name in field_names(message):
            inner = message[name] if isinstance(message, Mapping) else _member(message, name)
            yield from leaves(inner, f"{at}.{name}" if at else name, depth + 1)


def stamp_ns(value: Any, unit: str) -> int:
    """Return a stamp in ns: seconds with nanoseconds as ROS and protobuf keep them, a number in ``unit``, or ISO-8601.

    Raises
    ------
    ValueError, TypeError, OverflowError : the value is no stamp.
    """
    names = set(field_names(value))
    for whole, part in _PARTS:
        if {whole, part} <= names:
            return int(follow(value, (whole,))) * 10**9 + int(follow(value, (part,)))
    if isinstance(value, str):
        return round(datetime.fromisoformat(value).timestamp() * 10**6) * 10**3
    scale = _NS.get(unit.removeprefix("epoch_"), 10**9)
    return value * scale if isinstance(value, int) else round(float(value) * scale)
