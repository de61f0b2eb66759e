"""Errors of an evaluation that are not bugs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from athrl_spaces.wording import system_reason


class EvaluatorError(RuntimeError):
    """An error that the user can fix, such as a full disk; its message is one line."""


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Convert an OSError inside the block to an EvaluatorError that names the file."""
    try:
        yield
    except OSError as error:
        raise EvaluatorError(f"cannot write {path}: {system_reason(error)}") from error
