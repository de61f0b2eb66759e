"""What a check found: one line with what was seen, and one with what to do about it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum

from athrl.errors import expected_errors


class Level(StrEnum):
    """How bad it is."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "failed"


@dataclass(frozen=True)
class Finding:
    """One line of the report.

    Attributes:
        check: what was looked at.
        level: how bad it is.
        seen: what was found.
        remedy: what to do; empty where nothing has to be done.
    """

    check: str
    level: Level
    seen: str
    remedy: str = ""


Check = Callable[[], Iterator[Finding]]


def ok(check: str, seen: str) -> Finding:
    """Return a finding that needs nothing."""
    return Finding(check, Level.OK, seen)


def warning(check: str, seen: str, remedy: str) -> Finding:
    """Return a finding with which a run works, but not as it should."""
    return Finding(check, Level.WARNING, seen, remedy)


def failed(check: str, seen: str, remedy: str) -> Finding:
    """Return a finding with which no run works."""
    return Finding(check, Level.FAILED, seen, remedy)


def findings_of(name: str, check: Check) -> Iterator[Finding]:
    """Yield what a check finds; an expected error in the middle of it is a finding, too."""
    try:
        yield from check()
    except Exception as error:
        # Which errors are expected depends on the rooms that the check has imported.
        if not isinstance(error, (OSError, *expected_errors())):
            raise
        yield failed(name, " ".join(str(error).split()), "mend what it names and look again")
