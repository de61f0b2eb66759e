"""Files from elsewhere: read within a bound of size, and every error of a parser becomes one of ours.

content = read_untrusted(path, MOST_BYTES)                     # UntrustedFile: "is a folder, ..."
with parser_errors(lambda reason: RunFileError(f"{path}: {reason}")):
    values = json.loads(content)                               # RunFileError: "...: is nested too deeply"
"""

from __future__ import annotations

import json
import os
import stat
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path
from typing import Any

from athrl_spaces.wording import system_reason

PARSER_ERRORS: tuple[type[Exception], ...] = (
    ArithmeticError,  # a number too large, or a division by zero
    AttributeError,  # an array where an object should be
    EOFError,
    LookupError,  # something is missing
    MemoryError,  # an announced size
    RecursionError,  # nested too deeply
    TypeError,
    ValueError,  # also text that is not UTF-8, JSON that is none, an integer of thousands of digits
    struct.error,
)
"""What a parser may raise for a broken input. Libraries have further errors of their own."""

MOST_JSON_BYTES = 2**20
"""Of a JSON file with facts about something, such as the policy beside it."""
LONGEST_REASON = 200
"""Characters of a reason, which may quote the file."""


class UntrustedFile(ValueError):  # noqa: N818  (the name says what it is about)
    """A file cannot be read or is too large; the text follows the file's name in a message of one line."""


def read_untrusted(path: str | Path, most_bytes: int) -> bytes:
    """Return the content of a regular file of at most `most_bytes` bytes.

    Raises:
        UntrustedFile: it is missing, no regular file, or too large.
    """
    with open_untrusted(path, most_bytes) as file:
        try:
            size = min(os.fstat(file.fileno()).st_size, most_bytes)
            content = file.read(size + 1)  # reading allocates as much as is asked for
            if len(content) > size:  # it has grown, or is of the system, whose files have no size
                content += file.read(most_bytes + 1 - len(content))
        except OSError as error:
            raise UntrustedFile(_cannot_be_read(error)) from None
    if len(content) > most_bytes:
        raise UntrustedFile(_too_large(most_bytes))
    return content


def read_json(path: str | Path) -> Any:
    """Return the document in a small JSON file, of at most `MOST_JSON_BYTES` bytes.

    Raises:
        UntrustedFile: it cannot be read, is too large, or is no JSON.
    """
    with parser_errors(UntrustedFile):
        return json.loads(read_untrusted(path, MOST_JSON_BYTES))


def open_untrusted(path: str | Path, most_bytes: int) -> BufferedReader:
    """Open a regular file of at most `most_bytes` bytes; never waits for a pipe or a device.

    Raises:
        UntrustedFile: it is missing, no regular file, or too large.
    """
    try:
        # Without O_NONBLOCK the opening of a pipe would wait for somebody who writes into it.
        file = open(path, "rb", opener=_open_without_waiting)  # noqa: SIM115  (the caller closes it)
    except IsADirectoryError:
        raise UntrustedFile("is a folder, should be a file") from None
    except OSError as error:
        raise UntrustedFile(_cannot_be_read(error)) from None
    except ValueError:
        raise UntrustedFile("cannot be read: its name has a NUL character or is no valid text") from None
    facts = os.fstat(file.fileno())
    if stat.S_ISREG(facts.st_mode) and facts.st_size <= most_bytes:
        return file
    file.close()
    if stat.S_ISREG(facts.st_mode):
        raise UntrustedFile(_too_large(most_bytes))
    raise UntrustedFile("is a pipe, socket or device, should be a file")


def _cannot_be_read(error: OSError) -> str:
    return f"cannot be read: {system_reason(error)}"


def _too_large(most_bytes: int) -> str:
    return f"is too large: should have at most {most_bytes:,} bytes"


def _open_without_waiting(path: str, flags: int) -> int:
    return os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC)


@contextmanager
def parser_errors(ours: Callable[[str], Exception], *libraries: type[Exception]) -> Iterator[None]:
    """Turn every error of a parser inside the block into `ours(reason)`.

    An error that already is of the class of `ours` stays as it is.

    Args:
        ours: makes the error from the reason, which is one line of at most `LONGEST_REASON` characters and
            follows the name of the file: "is nested too deeply".
        libraries: errors of libraries that are used inside, beside `PARSER_ERRORS`: `zstandard.ZstdError`.
    """
    try:
        yield
    except (*PARSER_ERRORS, *libraries) as error:
        converted = ours(reason_of(error))
        if isinstance(error, type(converted)):
            raise
        raise converted from None


def reason_of(error: Exception) -> str:
    """Return what is wrong with an input according to the error of its parser, in one line."""
    match error:
        case RecursionError():
            return "is nested too deeply"
        case MemoryError():
            return "announces more data than fits into memory"
        case UnicodeError():
            return "is not UTF-8 text"
        case OSError():
            return one_short_line(system_reason(error))
        case ArithmeticError():
            return "has a number that is out of range"
        case KeyError():
            return f"lacks {one_short_line(str(error))}"
        case _ if "integer string conversion" in str(error):  # of Python's own limit
            return "has a number of thousands of digits"
        case _:
            return one_short_line(str(error)) or type(error).__name__


def one_short_line(text: str) -> str:
    """Return the beginning of a text, at most `LONGEST_REASON` characters, as `one_line` does."""
    text = one_line(text[: 2 * LONGEST_REASON])
    return text if len(text) <= LONGEST_REASON else f"{text[: LONGEST_REASON - 3]}..."


def one_line(text: str) -> str:
    """Return a text with single blanks, and with unprintable characters as their numbers."""
    shown = (sign if sign.isprintable() or sign.isspace() else f"\\u{ord(sign):04x}" for sign in text)
    return " ".join("".join(shown).split())
