"""Expected errors: each is one line that says what to do, never a traceback."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager

from athrl_spaces.untrusted import one_line

# Expected errors of the packages. Only packages that are already imported are considered: an image only has
# its own service.
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
"""Exit code after an expected error."""


class CommandError(Exception):
    """An error that the user can correct; its text is one line that says what to do."""


def expected_errors() -> tuple[type[Exception], ...]:
    """Return the error classes that are shown as one line, of every imported package."""
    classes: list[type[Exception]] = [CommandError]
    for module_name, class_name in _EXPECTED:
        module = sys.modules.get(module_name)
        if module is not None:
            classes.append(getattr(module, class_name))
    return tuple(classes)


def say(message: object) -> None:
    """Print one line of the command on standard error, without characters that steer a terminal."""
    print(f"athrl: {one_line(str(message))}", file=sys.stderr, flush=True)


@contextmanager
def needs(service: str) -> Iterator[None]:
    """Turn a failing import inside the block into a `CommandError` that names the missing extra."""
    try:
        yield
    except ModuleNotFoundError as error:
        raise CommandError(
            f"this needs athrl[{service}], {error.name} is not installed: pip install 'athrl[{service}]'"
        ) from error
