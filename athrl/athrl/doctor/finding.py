"""The result of a check: what was found, and what to do about it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import StrEnum

from athrl.errors import expected_errors


class Level(StrEnum):
    """Severity of a finding."""

    OK = "ok"
    WARNING = "warning"
    FAILED = "failed"


@dataclass(frozen=True)
class Finding:
    """One line of the report.

    Attributes:
        check: name of the check.
        level: severity.
        seen: what was found.
        remedy: what to do; empty if nothing has to be done.
    """

    check: str
    level: Level
    seen: str
    remedy: str = ""


Check = Callable[[], Iterator[Finding]]


def ok(check: str, seen: str) -> Finding:
    """Return a finding without a problem."""
    return Finding(check, Level.OK, seen)


def warning(check: str, seen: str, remedy: str) -> Finding:
    """Return a finding with which a run works, but not well."""
    return Finding(check, Level.WARNING, seen, remedy)


def failed(check: str, seen: str, remedy: str) -> Finding:
    """Return a finding with which no run works."""
    return Finding(check, Level.FAILED, seen, remedy)


def findings_of(name: str, check: Check) -> Iterator[Finding]:
    """Yield the findings of a check; an expected error in it is a finding, too."""
    try:
        yield from check()
    except Exception as error:
        # Which errors are expected depends on the packages that the check has imported.
        if not isinstance(error, (OSError, *expected_errors())):
            raise
        yield failed(name, " ".join(str(error).split()), "correct what it names and check again")
