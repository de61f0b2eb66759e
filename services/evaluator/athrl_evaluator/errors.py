"""What may go wrong in an evaluation and is no bug."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


class EvaluatorError(RuntimeError):
    """Something that the user can mend, such as a disk that is full; `str()` of it is one line."""


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn what the disk says inside the block into an EvaluatorError that names the file."""
    try:
        yield
    except OSError as error:
        raise EvaluatorError(f"cannot write {path}: {error.strerror}") from error
