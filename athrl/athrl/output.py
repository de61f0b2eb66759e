"""What the command writes: any text in every encoding, values as JSON, and the log of a service.

A terminal or a file may take ASCII only (`PYTHONIOENCODING=ascii`, some containers). What the encoding lacks
is written in other characters there, so that no command fails because of a sign in its output.
"""

from __future__ import annotations

import codecs
import io
import logging
import math
import os
import sys
from collections.abc import Mapping
from typing import Any

from rich.console import Console

from athrl.errors import CommandError

LEVEL = "ATHRL_LOG"
"""Environment variable with the level of the log."""

_LEVELS = ("debug", "info", "warning", "error")
_PACKAGES = ("athrl", "athrl_protocol", "athrl_driving", "athrl_actor", "athrl_learner", "athrl_evaluator")
_SUBSTITUTES = {"±": "+-", "·": "-"}
_HANDLER = "athrl-substitutes"


def accept_any_text() -> None:
    """Make standard output and standard error of this process accept any text."""
    codecs.register_error(_HANDLER, _substitute)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # none of a process without output, or another one of a test
            stream.reconfigure(errors=_HANDLER)


def flush_output() -> None:
    """Write what standard output has kept back, so that an error of it is not told by Python at its exit."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except BrokenPipeError:  # its reader has seen enough
        discard_output()


def discard_output() -> None:
    """Let standard output lead nowhere after it has failed: Python would try again at its exit."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, sys.stdout.fileno())
        os.close(nowhere)


def of_json(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values with None for infinite numbers and NaN, which JSON does not have."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return of_json(value)
        return None if isinstance(value, float) and not math.isfinite(value) else value

    return {name: plain(value) for name, value in values.items()}


def console(*, soft_wrap: bool = False) -> Console:
    """Return standard output for tables: names of files have no markup, [bold] or :car: is part of one."""
    return Console(markup=False, emoji=False, highlight=False, soft_wrap=soft_wrap)


def start_log() -> None:
    """Log to standard error, athrl's own packages at the level of `ATHRL_LOG`.

    Raises:
        CommandError: there is no such level.
    """
    logging.basicConfig(level=logging.INFO, format="%(asctime)s %(name)s %(message)s", stream=sys.stderr)
    level = os.environ.get(LEVEL) or "info"
    if level.lower() not in _LEVELS:
        raise CommandError(f"{LEVEL}={level}: should be {', '.join(_LEVELS[:-1])} or {_LEVELS[-1]}")
    for package in _PACKAGES:
        logging.getLogger(package).setLevel(level.upper())


def _substitute(error: UnicodeError) -> tuple[str, int]:
    """Return a substitute for the characters that cannot be encoded, and where encoding continues."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    wrong = error.object[error.start : error.end]
    return "".join(_SUBSTITUTES.get(character) or _escaped(character) for character in wrong), error.end


def _escaped(character: str) -> str:
    return character.encode("ascii", "backslashreplace").decode("ascii")
