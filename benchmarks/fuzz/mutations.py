"""Ways to break a file: bytes, numbers in a text, values of a JSON document."""

from __future__ import annotations

import copy
import json
import random
import re
from typing import Any

DEPTH = 20_000
"""Beyond the depth that a recursive parser survives."""

_NUMBER = re.compile(rb"-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
_ODD_NUMBERS = [
    b"0", b"-1", b"-0.0", b"nan", b"inf", b"-inf", b"NaN", b"Infinity", b"1e30", b"-1e300", b"1e400",
    b"1e-320", b"2147483648", b"4294967296", b"9223372036854775807", b"9223372036854775808",
    b"18446744073709551616", b"9" * 400, b"9" * 5_001, b"1.5", b"0x7fffffffffffffff", b"1_000", b"true",
    b'""', b"[]", b"",
]  # fmt: skip
_ODD_BYTES = [
    b"\0",
    b"\xff\xfe",
    b"\xc3",
    b"\x1b[2J",
    b"\r",
    b"\n\n",
    b'"',
    b"'",
    b"\\",
    b"<",
    b"&",
    b"]",
    b"}",
]
_ODD_VALUES: list[Any] = [
    None, True, False, 0, -1, 1, 2**31, 2**53 + 1, 2**63, 2**64, 10**400, -(10**400), 0.5, -1e300,
    float("nan"), float("inf"), "", "x", "\0", "\x1b[2J", "x" * 10_000, "../..", "/etc/passwd", [], {}, [[]],
    [None], {"": None}, {"sha256": 1},
]  # fmt: skip


def random_bytes(chance: random.Random, content: bytes) -> bytes:
    """Return bytes that never were such a file."""
    return chance.randbytes(chance.choice([0, 1, 2, 16, 300, 5_000]))


def changed_bytes(chance: random.Random, content: bytes) -> bytes:
    """Return the content with a few bits or bytes changed."""
    changed = bytearray(content)
    for _ in range(chance.choice([1, 1, 2, 5, 30]) if changed else 0):
        place = chance.randrange(len(changed))
        changed[place] = chance.choice(
            [changed[place] ^ (1 << chance.randrange(8)), chance.randrange(256), 0, 255]
        )
    return bytes(changed)


def cut_or_stretched(chance: random.Random, content: bytes) -> bytes:
    """Return the content without a piece, or with one of its own twice."""
    start, end = sorted(chance.choices(range(len(content) + 1), k=2))
    return chance.choice(
        [content[:start], content[start:], content[:start] + content[end:], content + content[start:end]]
    )


def changed_numbers(chance: random.Random, content: bytes) -> bytes:
    """Return a text with a few of its numbers replaced by odd ones."""
    for _ in range(chance.choice([1, 1, 1, 3])):
        numbers = list(_NUMBER.finditer(content))
        if not numbers:
            break
        number = chance.choice(numbers)
        content = content[: number.start()] + chance.choice(_ODD_NUMBERS) + content[number.end() :]
    return content


def odd_characters(chance: random.Random, content: bytes) -> bytes:
    """Return a text with characters inside that are rare, or none at all."""
    for _ in range(chance.choice([1, 1, 3])):
        place = chance.randrange(len(content) + 1)
        content = content[:place] + chance.choice(_ODD_BYTES) + content[place:]
    return content


def nested(chance: random.Random, content: bytes) -> bytes:
    """Return a text with brackets inside, one in the other, closed or not."""
    place = chance.randrange(len(content) + 1)
    depth = chance.choice([10, 500, DEPTH])
    opened, closed = chance.choice(
        [(b"[", b"]"), (b'{"a":', b"}"), (b"{a=", b"}"), (b"<a>", b"</a>"), (b"(", b")")]
    )
    inside = opened * depth + chance.choice([b"", b"1" + closed * depth])
    return chance.choice([inside, content[:place] + inside + content[place:]])


BYTES = [random_bytes, changed_bytes, changed_bytes, cut_or_stretched]
"""For any file."""
TEXT = [*BYTES, changed_numbers, changed_numbers, odd_characters, nested]
"""For TOML, JSON and XML."""


def changed_document(chance: random.Random, document: Any) -> Any:
    """Return a JSON document with a few values that are odd, missing, repeated, or one in another's place."""
    changed = copy.deepcopy(document)
    for _ in range(chance.choice([1, 1, 1, 2, 4])):
        places = list(_places(changed))
        if not places:
            break
        holder, key = chance.choice(places)
        match chance.randrange(6):
            case 0:
                del holder[key]
            case 1 if isinstance(holder, list):
                holder.extend(copy.deepcopy(holder[key]) for _ in range(chance.choice([1, 50])))
            case 1:
                holder[chance.choice(["", "x", "\0", "unknown"])] = copy.deepcopy(holder[key])
            case 2:
                other, name = chance.choice(places)
                if name in other if isinstance(other, dict) else name < len(other):
                    holder[key] = copy.deepcopy(other[name])
            case _:
                holder[key] = copy.deepcopy(chance.choice(_ODD_VALUES))
    return changed


def changed_json(chance: random.Random, content: bytes) -> bytes:
    """Return a JSON file with a changed document."""
    return json.dumps(changed_document(chance, json.loads(content))).encode()


def _places(document: Any) -> Any:
    """Yield every holder of a value with its key or index."""
    if not isinstance(document, dict | list):
        return
    for key, value in list(document.items() if isinstance(document, dict) else enumerate(document)):
        yield document, key
        yield from _places(value)
