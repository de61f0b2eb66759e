"""What a policy artefact says about itself: its observation, its levels, their actions and their noise."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

SCHEMA_VERSION = 1
NOISES = ("ornstein-uhlenbeck", "gaussian")


class InvalidPolicy(ValueError):  # noqa: N818  (the name says what the file is)
    """A file or message is not a policy artefact that can be run; the text is one line for the user."""


@dataclass(frozen=True)
class ActionMetadata:
    """One number that a level decides, in physical units, and how actors explore it."""

    name: str
    unit: str
    low: float
    high: float
    noise: str  # one of NOISES
    noise_scale: float  # half-ranges
    damping: float  # Ornstein-Uhlenbeck only


@dataclass(frozen=True)
class LevelMetadata:
    """One level of the planner, with its actions' bounds as float32 [n]."""

    name: str
    state_size: int
    actions: tuple[ActionMetadata, ...]
    low: np.ndarray = field(init=False, compare=False, repr=False)
    high: np.ndarray = field(init=False, compare=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "low", np.array([action.low for action in self.actions], np.float32))
        object.__setattr__(self, "high", np.array([action.high for action in self.actions], np.float32))

    @property
    def action_size(self) -> int:
        """How many numbers the level decides."""
        return len(self.actions)

    @property
    def half_range(self) -> np.ndarray:
        """Half of each action's range, float32 [n], physical units."""
        return (self.high - self.low) / 2

    def normalised(self, actions: np.ndarray) -> np.ndarray:
        """Physical actions float32 [..., n] as the environment takes them: float32 in [-1, 1]."""
        unit = (actions - self.low) / self.half_range - 1
        return np.clip(unit, -1, 1).astype(np.float32)


@dataclass(frozen=True)
class PolicyMetadata:
    """The metadata of an artefact."""

    planner: str
    image_shape: tuple[int, int, int]  # height, width, channels
    motion: tuple[str, ...]  # what each entry of `motion` is
    levels: tuple[LevelMetadata, ...]  # highest first; the last one acts on the environment

    @property
    def acting_level(self) -> LevelMetadata:
        """The level whose actions the environment takes."""
        return self.levels[-1]


def parse_metadata(text: str) -> PolicyMetadata:
    """Read and check the JSON that an artefact carries; raises InvalidPolicy, naming what is wrong."""
    try:
        document = json.loads(text)
    except ValueError as error:
        raise InvalidPolicy(f"its metadata is not JSON: {error}") from None
    if not isinstance(document, dict):
        raise InvalidPolicy("its metadata is not a JSON object")
    version = document.get("schema_version")
    if version != SCHEMA_VERSION:
        raise InvalidPolicy(f"it has schema version {version!r}; this program reads {SCHEMA_VERSION}")
    observation = _take(document, "observation", dict)
    levels = tuple(_parse_level(entry) for entry in _take(document, "levels", list))
    if not levels:
        raise InvalidPolicy("its metadata lists no level")
    if len({level.name for level in levels}) != len(levels):
        raise InvalidPolicy("its metadata names a level twice")
    return PolicyMetadata(
        planner=_take(document, "planner", str),
        image_shape=_parse_image_shape(_take(observation, "image", list)),
        motion=_parse_names(_take(observation, "motion", list)),
        levels=levels,
    )


def _parse_level(entry: Any) -> LevelMetadata:
    if not isinstance(entry, dict):
        raise InvalidPolicy(f"its metadata: a level is {entry!r}; it should be an object")
    name = _take(entry, "name", str)
    state_size = _take(entry, "state_size", int)
    if state_size < 0:
        raise InvalidPolicy(f"its metadata: {name}.state_size is {state_size}; it should be 0 or more")
    actions = tuple(_parse_action(name, action) for action in _take(entry, "actions", list))
    if not actions:
        raise InvalidPolicy(f"its metadata: level {name!r} has no action")
    return LevelMetadata(name=name, state_size=state_size, actions=actions)


def _parse_action(level: str, entry: Any) -> ActionMetadata:
    if not isinstance(entry, dict):
        raise InvalidPolicy(f"its metadata: an action of {level!r} is {entry!r}; it should be an object")
    action = ActionMetadata(
        name=_take(entry, "name", str),
        unit=_take(entry, "unit", str),
        low=_take_number(entry, "low"),
        high=_take_number(entry, "high"),
        noise=_take(entry, "noise", str),
        noise_scale=_take_number(entry, "noise_scale"),
        damping=_take_number(entry, "damping"),
    )
    where = f"its metadata: {level}.{action.name}"
    if not action.low < action.high:
        raise InvalidPolicy(f"its metadata: {level}.{action.name} has no range: {action.low}..{action.high}")
    if action.noise not in NOISES:
        raise InvalidPolicy(f"its metadata: {level}.{action.name}.noise is {action.noise!r}, not of {NOISES}")
    if action.noise_scale < 0 or not 0 <= action.damping <= 1:
        raise InvalidPolicy(
            f"{where} has noise_scale {action.noise_scale} (at least 0) and damping {action.damping} (0 to 1)"
        )
    return action


def _parse_image_shape(values: list[Any]) -> tuple[int, int, int]:
    if len(values) != 3 or not all(isinstance(value, int) and value > 0 for value in values):
        raise InvalidPolicy(f"its metadata: observation.image is {values}; it should be three sizes")
    return values[0], values[1], values[2]


def _parse_names(values: list[Any]) -> tuple[str, ...]:
    if not all(isinstance(value, str) for value in values):
        raise InvalidPolicy(f"its metadata: observation.motion is {values}; it should be names")
    return tuple(values)


def _take(document: Mapping[str, Any], key: str, kind: type) -> Any:
    value = document.get(key)
    if not isinstance(value, kind) or isinstance(value, bool):
        raise InvalidPolicy(f"its metadata: {key!r} is {value!r}, not of type {kind.__name__}")
    return value


def _take_number(document: Mapping[str, Any], key: str) -> float:
    value = document.get(key)
    if not isinstance(value, (int, float)) or isinstance(value, bool) or not math.isfinite(value):
        raise InvalidPolicy(f"its metadata: {key!r} is {value!r}; it should be a number")
    return float(value)
