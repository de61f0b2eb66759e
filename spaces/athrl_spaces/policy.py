"""What a policy says of itself: the JSON that an artefact carries, and the checks when it is read."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from athrl_spaces.action_kinds import ActionKind, Limits, action_kind
from athrl_spaces.actions import Action, Continuous, Discrete, Epsilon, Noise, Sampled
from athrl_spaces.observation import Observation
from athrl_spaces.reward_terms import refuse_wrong_terms

SCHEMA_VERSION = 2

MOST_LEVELS, MOST_CHOICES, LARGEST_STATE = 16, 4096, 65_536
"""Bounds on what a file from elsewhere may ask for."""


class InvalidDescription(ValueError):  # noqa: N818  (the name says what the text is)
    """A text is not the description of a policy; the message is one line for the user."""


@dataclass(frozen=True)
class LevelDescription:
    """One level of a planner.

    Attributes:
        name: of the level.
        actions: what it decides.
        state_size: numbers in its recurrent state; 0 where it has no memory.
        rewarded: names of the terms of the reward that it is paid (`REWARD_TERMS`); empty: all of them, the
            task's reward.
    """

    name: str
    actions: tuple[Action, ...]
    state_size: int = 0
    rewarded: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        refuse_wrong_terms(self.name, self.rewarded)

    @property
    def action_size(self) -> int:
        """How many entries it decides."""
        return len(self.actions)

    @cached_property
    def low(self) -> NDArray[np.float32]:
        """Lowest value of each entry, float32 [n]."""
        return np.array([action.bounds[0] for action in self.actions], np.float32)

    @cached_property
    def high(self) -> NDArray[np.float32]:
        """Highest value of each entry, float32 [n]."""
        return np.array([action.bounds[1] for action in self.actions], np.float32)


@dataclass(frozen=True)
class PolicyDescription:
    """What a policy is.

    Attributes:
        planner: kind of the planner.
        action_kind: name of the kind of action that an environment takes of it.
        limits: what that environment makes of a decision.
        observation: what it sees.
        levels: highest first; each sees what those above it decided.
    """

    planner: str
    action_kind: str
    limits: Limits
    observation: Observation
    levels: tuple[LevelDescription, ...]

    def __post_init__(self) -> None:
        if not 1 <= len(self.levels) <= MOST_LEVELS:
            raise ValueError(f"a policy has {len(self.levels)} levels; it should have 1 to {MOST_LEVELS}")
        _refuse_repeats("level", [level.name for level in self.levels])
        _refuse_repeats("action", self.entries)
        missing = [entry for entry in self.kind.entries if entry not in self.entries]
        if missing:
            raise ValueError(f"no level decides {missing[0]}, which actions of kind {self.action_kind} need")
        for (_, _, action), wanted in zip(self._places, self._taken, strict=True):
            if _form(action) != _form(wanted):
                raise ValueError(
                    f"{action.name} is {_form(action)}; actions of kind {self.action_kind} need "
                    f"{_form(wanted)}"
                )

    @property
    def kind(self) -> ActionKind:
        """The kind of action that an environment takes."""
        return action_kind(self.action_kind)

    @property
    def entries(self) -> list[str]:
        """Names of everything that is decided, from the highest level down."""
        return [action.name for level in self.levels for action in level.actions]

    @cached_property
    def _places(self) -> list[tuple[str, int, Action]]:
        """Level, column and action of each entry that the environment takes."""
        found = {
            action.name: (level.name, column, action)
            for level in self.levels
            for column, action in enumerate(level.actions)
        }
        return [found[entry] for entry in self.kind.entries]

    @cached_property
    def _taken(self) -> tuple[Action, Action]:
        """What the environment has for those entries."""
        return self.kind.describe(self.limits)

    def environment_action(self, actions: Mapping[str, NDArray[np.floating]]) -> NDArray[np.float32]:
        """What the environment takes of a decision, float32 [batch, 2].

        A continuous entry is normalised to [-1, 1] by the range that the environment has for it, a choice is
        its index.

        Args:
            actions: of each level float32 [batch, n], physical units.
        """
        columns = []
        for (level, column, _), taken in zip(self._places, self._taken, strict=True):
            value = actions[level][:, column]
            if isinstance(taken, Continuous):
                value = np.clip((value - taken.centre) / taken.half_range, -1.0, 1.0)
            columns.append(value)
        return np.stack(columns, axis=1).astype(np.float32)

    def named_values(self, actions: Mapping[str, NDArray[np.floating]], row: int) -> dict[str, float]:
        """Everything that was decided in one row of a batch, by name, physical units or index."""
        return {
            action.name: float(actions[level.name][row, column])
            for level in self.levels
            for column, action in enumerate(level.actions)
        }

    def to_json(self) -> str:
        """The description as JSON."""
        return json.dumps({"schema_version": SCHEMA_VERSION, **_plain(asdict(self), self)})

    @classmethod
    def from_json(cls, text: str) -> PolicyDescription:
        """Read and check what `to_json` wrote.

        Raises:
            InvalidDescription: it is something else; names what is wrong.
        """
        try:
            document = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise InvalidDescription(f"its metadata is not JSON: {error}") from None
        if not isinstance(document, dict):
            raise InvalidDescription("its metadata is not a JSON object")
        version = document.get("schema_version")
        if version != SCHEMA_VERSION:
            raise InvalidDescription(
                f"it has schema version {version!r}; this program reads {SCHEMA_VERSION}"
            )
        try:
            return cls(
                planner=_take(document, "planner", str),
                action_kind=_take(document, "action_kind", str),
                limits=_limits(_take(document, "limits", dict)),
                observation=_observation(_take(document, "observation", dict)),
                levels=tuple(_level(entry) for entry in _take(document, "levels", list)),
            )
        except InvalidDescription:
            raise
        except (ValueError, TypeError) as error:
            raise InvalidDescription(f"its metadata: {error}") from None


def _form(action: Action) -> str:
    """What an action is, for messages."""
    return "a number" if isinstance(action, Continuous) else f"a choice of {len(action.choices)}"


def _refuse_repeats(what: str, names: list[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"the {what} {name!r} comes twice")


def _plain(document: dict[str, Any], description: PolicyDescription) -> dict[str, Any]:
    """Add to each action what it is, which its attributes do not say."""
    for entry, level in zip(document["levels"], description.levels, strict=True):
        for written, action in zip(entry["actions"], level.actions, strict=True):
            written["type"] = "continuous" if isinstance(action, Continuous) else "discrete"
            if isinstance(action.exploration, Sampled):
                written["exploration"] = "sampled"
    return document


def _limits(document: Mapping[str, Any]) -> Limits:
    names = ("maximum_speed", "waypoint_radius", "waypoint_half_angle")
    values = {name: _number(document, name) for name in names}
    for name, value in values.items():
        if not value > 0:
            raise InvalidDescription(f"its metadata: limits.{name} is {value:g}; it should be above 0")
    return Limits(**values)


def _observation(document: Mapping[str, Any]) -> Observation:
    return Observation(
        image_size=_take(document, "image_size", int),
        channels=_texts(document, "channels"),
        motion=_texts(document, "motion"),
    )


def _level(entry: Any) -> LevelDescription:
    if not isinstance(entry, dict):
        raise InvalidDescription(f"its metadata: a level is {entry!r:.60}; it should be an object")
    name = _take(entry, "name", str)
    size = _take(entry, "state_size", int)
    if not 0 <= size <= LARGEST_STATE:
        raise InvalidDescription(
            f"its metadata: {name}.state_size is {size}; it should be 0 to {LARGEST_STATE}"
        )
    actions = tuple(_action(name, action) for action in _take(entry, "actions", list))
    if not actions:
        raise InvalidDescription(f"its metadata: level {name!r} decides nothing")
    # A file without it is of a planner whose levels are all paid the task's reward.
    rewarded = _texts(entry, "rewarded") if "rewarded" in entry else ()
    return LevelDescription(name, actions, size, rewarded)


def _action(level: str, entry: Any) -> Action:
    if not isinstance(entry, dict):
        raise InvalidDescription(
            f"its metadata: an action of {level!r} is {entry!r:.60}; should be an object"
        )
    kind = _take(entry, "type", str)
    if kind == "continuous":
        return Continuous(
            name=_take(entry, "name", str),
            unit=_take(entry, "unit", str),
            low=_number(entry, "low"),
            high=_number(entry, "high"),
            exploration=_noise(entry),
            sideways=entry.get("sideways") is True,
        )
    if kind != "discrete":
        raise InvalidDescription(
            f"its metadata: an action of {level!r} is {kind!r}; should be continuous or discrete"
        )
    choices = _texts(entry, "choices")
    if len(choices) > MOST_CHOICES:
        raise InvalidDescription(
            f"its metadata: {level!r} has {len(choices)} choices, at most {MOST_CHOICES} may be"
        )
    exploration = _take(entry, "exploration", dict)
    return Discrete(
        name=_take(entry, "name", str),
        choices=choices,
        exploration=Epsilon(_number(exploration, "low"), _number(exploration, "high")),
        mirrored=tuple(_whole(value) for value in _take(entry, "mirrored", list)),
    )


def _noise(entry: Mapping[str, Any]) -> Noise | Sampled:
    if entry.get("exploration") == "sampled":
        return Sampled()
    noise = _take(entry, "exploration", dict)
    return Noise(_number(noise, "low"), _number(noise, "high"), _number(noise, "damping"))


def _texts(document: Mapping[str, Any], key: str) -> tuple[str, ...]:
    values = _take(document, key, list)
    if not all(isinstance(value, str) for value in values):
        raise InvalidDescription(f"its metadata: {key!r} is {values!r:.60}; it should be a list of texts")
    return tuple(values)


def _whole(value: Any) -> int:
    if not isinstance(value, int) or isinstance(value, bool):
        raise InvalidDescription(
            f"its metadata: a mirrored choice is {value!r:.60}; it should be a whole number"
        )
    return value


def _take(document: Mapping[str, Any], key: str, kind: type) -> Any:
    value = document.get(key)
    if not isinstance(value, kind) or isinstance(value, bool):
        raise InvalidDescription(f"its metadata: {key!r} is {value!r:.60}, not of type {kind.__name__}")
    return value


def _number(document: Mapping[str, Any], key: str) -> float:
    value = document.get(key)
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        raise InvalidDescription(f"its metadata: {key!r} is {value!r:.60}; it should be a number")
    try:
        number = float(value)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise InvalidDescription(f"its metadata: {key!r} is {value!r:.60}; it should be a finite number")
    return number
