"""TOML from elsewhere: parsed within bounds of size, depth and numbers, before its settings are looked at."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from athrl_spaces.untrusted import one_line, parser_errors, read_untrusted

from athrl_protocol.errors import RunFileError
from athrl_protocol.run_file.toml_values import cut, show

MOST_BYTES = 2**20
"""Of a run file; one with every setting and comment has some 12 KB."""
MOST_DEPTH = 8
"""Tables and lists one in the other; a run file has three: a section, its setting, and its entries."""
MOST_PARTS = 32
"""Of a dotted key; more are refused before they are parsed."""
LARGEST_INTEGER = 2**63 - 1
"""TOML's integers have 64 bits, and so do those of messages."""
MOST_DIGITS = 1_000
"""Of a number; Python refuses to read thousands, and does not say where they are."""
LONGEST_TEXT = 4_096
"""Characters; the longest are paths, which Linux bounds likewise."""
LONGEST_FILE_NAME = 255
"""Bytes between two slashes of a path, as file systems bound them."""

_PART = r"""(?:[A-Za-z0-9_-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')"""
_LONG_KEY = re.compile(
    rf"(?:^|[{{,])[ \t]*+\[?+\[?+[ \t]*+(?:{_PART}[ \t]*+\.[ \t]*+){{{MOST_PARTS}}}", re.MULTILINE
)
"""A dotted key with many parts, with whose square the time and memory of the TOML parser grow."""
_LONG_NUMBER = re.compile(rf"(?<![0-9_])[0-9][0-9_]{{{MOST_DIGITS}}}")
_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f]")


class NoToml(RunFileError):  # noqa: N818
    """A text does not follow TOML's grammar."""


def read_document(path: Path) -> dict[str, Any]:
    """Return the tables of a run file.

    Raises:
        RunFileError: it cannot be read, is no TOML, or exceeds a bound; one line that names file and key.
    """
    with parser_errors(lambda reason: RunFileError(f"{path}: {reason}")):
        content = read_untrusted(path, MOST_BYTES)
    try:
        text = content.decode("utf-8-sig")  # some editors begin a file with a mark of its encoding
    except UnicodeDecodeError:
        raise RunFileError(f"{path}: is not a TOML file, which is UTF-8 text") from None
    values = parse_document(text, str(path))
    check_document(values, f"{path}: ")
    return values


def parse_document(text: str, source: str) -> dict[str, Any]:
    """Return the tables of a TOML text.

    Raises:
        NoToml: it is none.
        RunFileError: it is nested too deeply, or has a key of too many parts or a number of too many digits.
    """
    if _LONG_KEY.search(text):
        raise RunFileError(f"{source}: has a dotted key of more than {MOST_PARTS} parts")
    if digits := _LONG_NUMBER.search(text):
        line = text.count("\n", 0, digits.start()) + 1
        raise RunFileError(f"{source}: line {line} has a number of more than {MOST_DIGITS:,} digits")
    with parser_errors(lambda reason: RunFileError(f"{source}: {reason}")):
        try:
            return tomllib.loads(text)
        except tomllib.TOMLDecodeError as error:
            raise NoToml(f"{source}: is not TOML: {one_line(str(error))}") from None


def check_document(values: Mapping[str, Any], place: str) -> None:
    """Refuse tables that are nested too deeply, integers beyond 64 bits and texts that no setting may have.

    Raises:
        RunFileError: begins with `place`, then names the key.
    """
    for path, value in _entries(values):
        wrong = _wrong(value, len(path))
        if wrong:
            raise RunFileError(f"{place}{cut('.'.join(map(str, path)))} = {_shown(value)}: {wrong}")


def check_value(value: Any, place: str) -> None:
    """Refuse the same in the value of a setting; `place` names both."""
    for path, inner in _entries(value):
        wrong = _wrong(inner, 2 + len(path))
        if wrong:
            raise RunFileError(f"{place}: {wrong}")


def _wrong(value: Any, depth: int) -> str:
    """What a value within so many tables and lists should be; empty if nothing is wrong."""
    if depth > MOST_DEPTH:
        return f"is nested too deeply, should have at most {MOST_DEPTH} levels"
    if isinstance(value, int) and not -LARGEST_INTEGER <= value <= LARGEST_INTEGER:
        return "should be an integer from -(2^63 - 1) to 2^63 - 1"
    if not isinstance(value, str):
        return ""
    if len(value) > LONGEST_TEXT:
        return f"has {len(value):,} characters, should have at most {LONGEST_TEXT:,}"
    if _CONTROL.search(value):
        return "has a control character, should be printable text in one line"
    try:
        parts = value.encode().split(b"/")
    except UnicodeEncodeError:  # bytes of the command line that are none cannot be written into a file
        return "is not UTF-8 text"
    longest = max(map(len, parts))
    if longest > LONGEST_FILE_NAME:  # every text is a name or a path
        return f"has a part of {longest:,} bytes, a file's name has at most {LONGEST_FILE_NAME}"
    return ""


def _shown(value: Any) -> str:
    """The value for a message; Python does not write integers of thousands of digits in decimal."""
    if isinstance(value, int) and value.bit_length() > 256:
        return f"an integer of {value.bit_length():,} bits"
    return "a table" if isinstance(value, Mapping) else "a list" if isinstance(value, list) else show(value)


def _entries(values: Any) -> Iterator[tuple[tuple[str | int, ...], Any]]:
    """Yield every value in the order of the file with its keys and indices, without recursion."""
    waiting: list[tuple[tuple[str | int, ...], Any]] = [((), values)]
    while waiting:
        path, value = waiting.pop()
        yield path, value
        if isinstance(value, Mapping):
            waiting += reversed([((*path, key), inner) for key, inner in value.items()])
        elif isinstance(value, list):
            waiting += reversed([((*path, index), inner) for index, inner in enumerate(value)])
