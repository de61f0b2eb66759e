"""What may go wrong and is no bug: such an error is one line that says what to do, never a traceback."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

# Errors of the rooms that are expected. A room is only looked at when it has been imported already: an
# image has only its own service.
_EXPECTED = (
    ("athrl_protocol", "ProtocolError"),
    ("athrl_driving.errors", "DrivingError"),
    ("athrl_driving.policy", "InvalidPolicy"),
    ("athrl_driving.policy", "EnvironmentFailure"),
    ("athrl_planners.registry", "UnknownPlanner"),
    ("athrl_learner", "LearnerError"),
    ("athrl_actor", "ActorError"),
    ("athrl_evaluator.errors", "EvaluatorError"),
)

EXPECTED_ERROR = 2
"""Exit code of a command that could not do its work because of what it was given or met."""


class CommandError(Exception):
    """Something the user can mend; `str()` of it is one line that says what to do."""


def expected_errors() -> tuple[type[Exception], ...]:
    """Return the error classes that are shown as one line, of every room that is loaded."""
    classes: list[type[Exception]] = [CommandError]
    for module_name, class_name in _EXPECTED:
        module = sys.modules.get(module_name)
        if module is not None:
            classes.append(getattr(module, class_name))
    return tuple(classes)


def say(message: object) -> None:
    """Print one line of the command on standard error."""
    line = " ".join(str(message).split())
    print(f"athrl: {line}", file=sys.stderr, flush=True)


@contextmanager
def needs(service: str) -> Iterator[None]:
    """Turn a failing import inside the block into a `CommandError` that names the missing extra."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise CommandError(
            f"this needs athrl[{service}], {error.name} is not installed: pip install 'athrl[{service}]'"
        ) from error
