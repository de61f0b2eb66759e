"""Decisions that are forced on a policy, to see their effect: `--force intention=0`."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence

import numpy as np
from athrl_spaces import Continuous, PolicyDescription
from athrl_spaces.actions import Action
from numpy.typing import NDArray

from athrl_evaluator.errors import EvaluatorError


class CannotForce(EvaluatorError):  # noqa: N818  (the name says what is wrong)
    """A value that is to be forced is not decided by the policy, or beyond its range."""


def read_forced(texts: Sequence[str], description: PolicyDescription) -> dict[str, float]:
    """Return the values to force, by name, from texts NAME=VALUE.

    Raises:
        CannotForce: a text has another form, or the policy does not decide that name or never that value.
    """
    actions = {action.name: action for level in description.levels for action in level.actions}
    forced: dict[str, float] = {}
    for text in texts:
        name, equals, value = (part.strip() for part in text.partition("="))
        if not equals or not name:
            first = next(iter(actions))
            raise CannotForce(f"--force {text}: it should be NAME=VALUE, for instance {first}=0")
        if name not in actions:
            raise CannotForce(f"--force {text}: {_known_names(name, description)}")
        if name in forced:
            raise CannotForce(f"--force {text}: {name} is forced twice: leave one out")
        forced[name] = _value(text, value, actions[name])
    return forced


def forced_actions(
    description: PolicyDescription, forced: Mapping[str, float], batch: int
) -> dict[str, NDArray[np.float32]]:
    """Forced actions of a policy's step: float32 [batch, n] of each level with a forced value, else NaN."""
    arrays = {}
    for level in description.levels:
        values = [forced.get(action.name, np.nan) for action in level.actions]
        if not np.isnan(values).all():
            arrays[level.name] = np.tile(np.array(values, np.float32), (batch, 1))
    return arrays


def _known_names(name: str, description: PolicyDescription) -> str:
    near = difflib.get_close_matches(name, description.entries, n=1, cutoff=0.6)
    hint = f"; did you mean {near[0]}?" if near else ""
    return (
        f"a policy of the planner {description.planner} decides no {name}, "
        f"it decides {', '.join(description.entries)}{hint}"
    )


def _value(text: str, value: str, action: Action) -> float:
    low, high = action.bounds
    if isinstance(action, Continuous):
        unit = f" {action.unit}" if action.unit else ""
        expected = f"a number from {low:g} to {high:g}{unit}"
    else:
        expected = f"a whole number from {low:g} to {high:g}"
    try:
        number = float(value)
    except ValueError:
        number = float("nan")
    whole = isinstance(action, Continuous) or number == round(number, 0)
    if not low <= number <= high or not whole:
        raise CannotForce(f"--force {text}: {action.name} should be {expected}")
    return number
