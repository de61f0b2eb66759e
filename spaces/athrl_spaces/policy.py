"""The description of a policy: the JSON in an artefact, and its checks when it is read."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from athrl_spaces.action_kinds import ActionKind, Limits, action_kind
from athrl_spaces.actions import Action, Continuous, Discrete, Epsilon, Noise, Sampled
from athrl_spaces.environment import BOUNDS
from athrl_spaces.observation import Observation
from athrl_spaces.reward_terms import refuse_wrong_terms
from athrl_spaces.untrusted import parser_errors

SCHEMA_VERSION = 2

MOST_LEVELS, MOST_ENTRIES, MOST_CHOICES, LARGEST_STATE = 16, 256, 4096, 65_536
MOST_SEEN, LONGEST_NAME, LONGEST_TEXT, LARGEST_NUMBER = 64, 256, 2**20, 1e9
"""Bounds for files from other sources; `MOST_SEEN` is of channels, and of entries of the motion vector."""

GAIN_OF_OLDER_FILES = 0.7
"""1/s, of the speed loop; files that do not say it were made for the gain of the authors' release."""

METADATA_KEY = "athrl"
"""Under which a policy's file has its description."""

LARGEST_ARTEFACT = 320 * 2**20
"""Bytes of a policy's file. The paper's planner has 12 MB; opening takes three times as much memory."""


class InvalidDescription(ValueError):  # noqa: N818  (the name says what is wrong)
    """A text is not a valid description of a policy; the message is one line for the user."""


@dataclass(frozen=True)
class LevelDescription:
    """One level of a planner.

    Attributes:
        name: of the level.
        actions: what it decides.
        state_size: numbers in its recurrent state; 0 if it has no memory.
        rewarded: names of its reward terms (`REWARD_TERMS`); empty: all of them, the task's reward.
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
    """Describes a policy.

    Attributes:
        planner: kind of the planner.
        action_kind: name of the kind of action that it gives to an environment.
        limits: limits of decisions in that environment.
        observation: its observation.
        levels: highest first; each sees the decisions of the levels above.
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
        """Names of all decided entries, from the highest level down."""
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
        """The environment's own spaces of those entries."""
        return self.kind.describe(self.limits)

    def environment_action(self, actions: Mapping[str, NDArray[np.floating]]) -> NDArray[np.float32]:
        """The environment's action for a decision, float32 [batch, 2].

        A continuous entry is normalised to [-1, 1] by the environment's range of it, a choice is its index.

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
        """All decided entries of one row of a batch by name, physical units or index."""
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
            InvalidDescription: the text is not valid; names the error.
        """
        if len(text) > LONGEST_TEXT:
            raise InvalidDescription(
                f"its metadata has {len(text):,} characters; at most {LONGEST_TEXT:,} may be"
            )
        with parser_errors(lambda reason: InvalidDescription(f"its metadata is not JSON: {reason}")):
            document = json.loads(text)
        if not isinstance(document, dict):
            raise InvalidDescription("its metadata is not a JSON object")
        version = document.get("schema_version")
        if version != SCHEMA_VERSION:
            raise InvalidDescription(
                f"it has schema version {version!r:.60}; this program reads {SCHEMA_VERSION}"
            )
        with parser_errors(lambda reason: InvalidDescription(f"its metadata: {reason}")):
            return cls(
                planner=_name(document, "planner"),
                action_kind=_name(document, "action_kind"),
                limits=_limits(_take(document, "limits", dict)),
                observation=_observation(_take(document, "observation", dict)),
                levels=tuple(_level(entry) for entry in _few(document, "levels", MOST_LEVELS)),
            )


def _form(action: Action) -> str:
    """The form of an action, for messages."""
    return "a number" if isinstance(action, Continuous) else f"a choice of {len(action.choices)}"


def _refuse_repeats(what: str, names: list[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise ValueError(f"the {what} {name!r} comes twice")


def _plain(document: dict[str, Any], description: PolicyDescription) -> dict[str, Any]:
    """Add to each action its type, which its attributes do not contain."""
    for entry, level in zip(document["levels"], description.levels, strict=True):
        for written, action in zip(entry["actions"], level.actions, strict=True):
            written["type"] = "continuous" if isinstance(action, Continuous) else "discrete"
            if isinstance(action.exploration, Sampled):
                written["exploration"] = "sampled"
    return document


def _limits(document: Mapping[str, Any]) -> Limits:
    document = {"speed_gain": GAIN_OF_OLDER_FILES, **document}
    values = {field.name: _number(document, field.name) for field in fields(Limits)}
    for name, value in values.items():
        if not value > 0:
            raise InvalidDescription(f"its metadata: limits.{name} is {value:g}; it should be above 0")
    return Limits(**values)


def _observation(document: Mapping[str, Any]) -> Observation:
    largest = BOUNDS["image_size"][2]
    size = _take(document, "image_size", int)
    if size > largest:
        raise InvalidDescription(f"its metadata: image_size is {size!r:.60}; it should be at most {largest}")
    return Observation(
        image_size=size,
        channels=_texts(document, "channels", MOST_SEEN),
        motion=_texts(document, "motion", MOST_SEEN),
    )


def _level(entry: Any) -> LevelDescription:
    if not isinstance(entry, dict):
        raise InvalidDescription(f"its metadata: a level is {entry!r:.60}; it should be an object")
    name = _name(entry, "name")
    size = _take(entry, "state_size", int)
    if not 0 <= size <= LARGEST_STATE:
        raise InvalidDescription(
            f"its metadata: {name}.state_size is {size!r:.60}; it should be 0 to {LARGEST_STATE}"
        )
    actions = tuple(_action(name, action) for action in _few(entry, "actions", MOST_ENTRIES))
    if not actions:
        raise InvalidDescription(f"its metadata: level {name!r} decides nothing")
    # A file without it is of a planner whose levels all get the task's reward.
    rewarded = _texts(entry, "rewarded", MOST_SEEN) if "rewarded" in entry else ()
    return LevelDescription(name, actions, size, rewarded)


def _action(level: str, entry: Any) -> Action:
    if not isinstance(entry, dict):
        raise InvalidDescription(
            f"its metadata: an action of {level!r} is {entry!r:.60}; should be an object"
        )
    kind = _take(entry, "type", str)
    if kind == "continuous":
        return Continuous(
            name=_name(entry, "name"),
            unit=_name(entry, "unit"),
            low=_number(entry, "low"),
            high=_number(entry, "high"),
            exploration=_noise(entry),
            sideways=entry.get("sideways") is True,
        )
    if kind != "discrete":
        raise InvalidDescription(
            f"its metadata: an action of {level!r} is {kind!r:.60}; should be continuous or discrete"
        )
    choices = _texts(entry, "choices", MOST_CHOICES)
    exploration = _take(entry, "exploration", dict)
    return Discrete(
        name=_name(entry, "name"),
        choices=choices,
        exploration=Epsilon(_number(exploration, "low"), _number(exploration, "high")),
        mirrored=tuple(_whole(value) for value in _few(entry, "mirrored", MOST_CHOICES)),
    )


def _noise(entry: Mapping[str, Any]) -> Noise | Sampled:
    if entry.get("exploration") == "sampled":
        return Sampled()
    noise = _take(entry, "exploration", dict)
    return Noise(_number(noise, "low"), _number(noise, "high"), _number(noise, "damping"))


def _texts(document: Mapping[str, Any], key: str, most: int) -> tuple[str, ...]:
    values = _few(document, key, most)
    if not all(isinstance(value, str) for value in values):
        raise InvalidDescription(f"its metadata: {key!r} is {values!r:.60}; it should be a list of texts")
    if not all(map(_is_name, values)):
        raise InvalidDescription(f"its metadata: a text of {key!r} is too long or not printable")
    return tuple(values)


def _few(document: Mapping[str, Any], key: str, most: int) -> list[Any]:
    values: list[Any] = _take(document, key, list)
    if len(values) > most:
        raise InvalidDescription(
            f"its metadata: {key!r} has {len(values):,} entries, at most {most:,} may be"
        )
    return values


def _name(document: Mapping[str, Any], key: str) -> str:
    text: str = _take(document, key, str)
    if not _is_name(text):
        raise InvalidDescription(f"its metadata: {key!r} is {text!r:.60}; it should be short and printable")
    return text


def _is_name(text: str) -> bool:
    return len(text) <= LONGEST_NAME and text.isprintable()


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
    if abs(number) > LARGEST_NUMBER:
        raise InvalidDescription(
            f"its metadata: {key!r} is {number:g}; it should be {-LARGEST_NUMBER:g} to {LARGEST_NUMBER:g}"
        )
    return number
