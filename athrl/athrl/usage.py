"""What is wrong with a command line: the option, what it was, and what it should be."""

from __future__ import annotations

from typing import Any

import typer
from pydantic import ValidationError
from pydantic_core import ErrorDetails

UsageError: Any = typer.BadParameter.__base__
"""Errors of a command line; typer has no public name for this class."""

_BOUNDS = {"greater_than_equal": ("ge", ">="), "less_than_equal": ("le", "<=")}


def explain(error: Any) -> str:
    """Return one line about a `UsageError`; empty if the help has been shown instead."""
    if getattr(error, "possibilities", None):
        return f"there is no option {error.option_name}; did you mean {' or '.join(error.possibilities)}?"
    if isinstance(error.__cause__, ValidationError):
        wrong = error.__cause__.errors(include_url=False)[0]
        expected = _expected(wrong, "a number" if "float" in error.__cause__.title else "an integer")
        if expected:
            option, meaning = error.param.opts[0], (error.param.help or "").rstrip(".")
            return f"{option} {' '.join(str(wrong['input']).split())}: should be {expected} ({meaning})"
    return str(error.format_message()).replace("Value error, ", "").rstrip(".")


def _expected(wrong: ErrorDetails, kind: str) -> str:
    """Return which numbers of this kind are allowed; empty if no number is wanted."""
    if wrong["type"] in _BOUNDS:
        name, sign = _BOUNDS[wrong["type"]]
        return f"{kind}, {sign} {wrong['ctx'][name]:g}"
    return kind if wrong["type"].startswith(("int_", "float_")) else ""
