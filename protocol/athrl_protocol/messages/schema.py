"""Version and hash of the message schema, and the encoding and decoding of all messages.

The hash covers a canonical description of every message, so it is the same for every protobuf runtime, and
two programs with different schemas refuse each other's messages with a clear error.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import TypeVar

from google.protobuf.descriptor import Descriptor, EnumDescriptor, FieldDescriptor
from google.protobuf.message import DecodeError, Message

from athrl_protocol.errors import InvalidMessage
from athrl_protocol.messages import athrl_pb2

_Message = TypeVar("_Message", bound=Message)

LONGEST_NAME = 256
MOST_NUMBERS = 2_000
LARGEST_COUNT = 2**63 - 1
"""Messages have unsigned integers; columns, files and event files have signed ones of 64 bits."""


def _describe_field(field: FieldDescriptor) -> str:
    kind = field.message_type or field.enum_type
    type_name = kind.full_name if kind is not None else str(field.type)
    return f"{field.number} {field.name} {type_name} {'repeated' if field.is_repeated else 'single'}"


def _describe_enum(enum: EnumDescriptor) -> list[str]:
    return [f"enum {enum.full_name}", *(f"{value.number} {value.name}" for value in enum.values)]


def _describe_message(message: Descriptor) -> list[str]:
    lines = [f"message {message.full_name}"]
    lines += [_describe_field(field) for field in sorted(message.fields, key=lambda field: field.number)]
    for enum in sorted(message.enum_types, key=lambda enum: enum.full_name):
        lines += _describe_enum(enum)
    for nested in sorted(message.nested_types, key=lambda nested: nested.full_name):
        lines += _describe_message(nested)
    return lines


def _schema_hash() -> int:
    lines: list[str] = []
    messages = athrl_pb2.DESCRIPTOR.message_types_by_name
    for name in sorted(messages):
        lines += _describe_message(messages[name])
    return int.from_bytes(hashlib.sha256("\n".join(lines).encode()).digest()[:8], "big")


SCHEMA_VERSION: int = int(athrl_pb2.DESCRIPTOR.package.removeprefix("athrl.v"))
SCHEMA_HASH: int = _schema_hash()


def encode_message(message: Message) -> bytes:
    """Set the schema's version and hash in `message` and return its bytes."""
    message.schema_version = SCHEMA_VERSION  # type: ignore[attr-defined]
    message.schema_hash = SCHEMA_HASH  # type: ignore[attr-defined]
    return message.SerializeToString()


def decode_message(kind: type[_Message], payload: bytes, largest: int | None = None) -> _Message:
    """Parse `payload`, of at most `largest` bytes, as a message of `kind`.

    Raises:
        InvalidMessage: it is too large, cannot be parsed, or was written with another schema.
    """
    message = kind()
    if largest is not None and len(payload) > largest:
        raise InvalidMessage("size", f"{_name(kind)}: {len(payload)} bytes, at most {largest}")
    try:
        message.ParseFromString(payload)
    except DecodeError:
        text = f"{_name(kind)}: {len(payload)} bytes that are no such message"
        raise InvalidMessage("malformed", text) from None
    version: int = message.schema_version  # type: ignore[attr-defined]
    schema_hash: int = message.schema_hash  # type: ignore[attr-defined]
    if (version, schema_hash) != (SCHEMA_VERSION, SCHEMA_HASH):
        raise InvalidMessage(
            "schema",
            f"{_name(kind)}: schema {version} ({schema_hash:016x}), this program has schema {SCHEMA_VERSION} "
            f"({SCHEMA_HASH:016x}); all services of a run must be of one release",
        )
    return message


def _name(kind: type[Message]) -> str:
    return str(kind.DESCRIPTOR.name)


def check_text(kind: str, field: str, text: str, longest: int = LONGEST_NAME) -> None:
    """Raise InvalidMessage unless `text` is printable and not too long."""
    if len(text) > longest or not text.isprintable():
        raise InvalidMessage("value", f"{kind}: {field} is no text of at most {longest} characters")


def check_numbers(kind: str, values: Mapping[str, float], most: int = MOST_NUMBERS) -> None:
    """Raise InvalidMessage if there are too many values or a name is not printable."""
    if len(values) > most:
        raise InvalidMessage("size", f"{kind}: {len(values)} values, at most {most}")
    for name in values:
        check_text(kind, "a name", name)


def check_counts(kind: str, **counts: int) -> None:
    """Raise InvalidMessage, which names the count, if one is above `LARGEST_COUNT`."""
    for name, count in counts.items():
        if count > LARGEST_COUNT:
            raise InvalidMessage("value", f"{kind}: {name} is {count}, should be at most 2^63 - 1")
