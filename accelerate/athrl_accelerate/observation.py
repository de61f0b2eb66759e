"""highway-env's kinematic observation without pandas, which costs more than many compiled frames."""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env import utils
from highway_env.envs.common.observation import (
    KinematicObservation,
    MultiAgentObservation,
    ObservationType,
    TupleObservation,
)
from highway_env.road.lane import AbstractLane
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import RoadObject
from numpy.typing import NDArray

from athrl_accelerate.columns import HEADING, SPEED
from athrl_accelerate.mixins import class_with_mixin
from athrl_accelerate.table import Table

_OWN_METHODS = ("observe", "normalize_obs", "space")
_DICTIONARIES = (Vehicle.to_dict, RoadObject.to_dict)
_OFFSETS = ("long_off", "lat_off", "ang_off")
_DIRECTIONS = ("cos_d", "sin_d")


def accelerate_observation(observation: ObservationType) -> None:
    """Make the kinematic observations in an observation fast, in place; all others stay as they are."""
    if isinstance(observation, MultiAgentObservation):
        for agent in observation.agents_observation_types:
            accelerate_observation(agent)
    elif isinstance(observation, TupleObservation):
        for member in observation.observation_types:
            accelerate_observation(member)
    elif isinstance(observation, KinematicObservation) and all(
        getattr(type(observation), name) is getattr(KinematicObservation, name) for name in _OWN_METHODS
    ):
        observation.__class__ = class_with_mixin(type(observation), QuickKinematics)


class QuickKinematics:
    """Mixin of a KinematicObservation that reads the arrays of a road instead of the vehicles."""

    __slots__ = ()

    def observe(self: Any) -> NDArray[np.float32]:
        """Return float32 [vehicles_count, features]: the observer, then the vehicles and objects near it."""
        road, observer = self.env.road, self.observer_vehicle
        table: Table | None = getattr(road, "table", None)
        if table is None or not table.has(observer) or not _has_known_dictionaries(table):
            return type(self).plain.observe(self)
        close = road.close_objects_to(
            observer,
            self.env.PERCEPTION_DISTANCE,
            count=self.vehicles_count - 1,
            see_behind=self.see_behind,
            sort=self.order == "sorted",
            vehicles_only=not self.include_obstacles,
        )
        seen = [observer, *close[-self.vehicles_count + 1 :]]
        values = _values(table, seen, self.features, not self.absolute, self.observe_intentions)
        if self.normalize:
            self._normalize(values)
        numbers = np.zeros((max(len(seen), self.vehicles_count), len(self.features)))
        for column, feature in enumerate(self.features):
            numbers[: len(seen), column] = values[feature]
        if self.order == "shuffled":
            self.env.np_random.shuffle(numbers[1:])
        return numbers.astype(np.float32)

    def _normalize(self: Any, values: dict[str, NDArray[np.float64]]) -> None:
        if not self.features_range:
            lanes = len(self.env.road.network.all_side_lanes(self.observer_vehicle.lane_index))
            across = AbstractLane.DEFAULT_WIDTH * lanes
            fast = 2 * Vehicle.MAX_SPEED
            self.features_range = {
                "x": [-5.0 * Vehicle.MAX_SPEED, 5.0 * Vehicle.MAX_SPEED],
                "y": [-across, across],
                "vx": [-fast, fast],
                "vy": [-fast, fast],
            }
        for feature, (low, high) in self.features_range.items():
            if feature in values:
                mapped = utils.lmap(values[feature], [low, high], [-1, 1])
                values[feature] = np.clip(mapped, -1, 1) if self.clip else mapped


def _has_known_dictionaries(table: Table) -> bool:
    classes: set[Any] = table.classes
    return all(cls.to_dict in _DICTIONARIES for cls in classes)


def _values(
    table: Table, seen: list[Any], features: list[str], relative: bool, intentions: bool
) -> dict[str, NDArray[np.float64]]:
    """Return the features' values for the observer and for what it sees, equal to their `to_dict`."""
    rows = np.array([thing._row for thing in seen])
    moves = rows < table.vehicle_count
    heading, speed = table.rows.state[HEADING, rows], table.rows.state[SPEED, rows]
    cosine, sine = np.cos(heading), np.sin(heading)
    position = table.rows.position[rows]
    values = {
        "x": position[:, 0],
        "y": position[:, 1],
        "vx": np.where(moves, speed * cosine, 0.0),
        "vy": np.where(moves, speed * sine, 0.0),
    }
    if relative:
        for value in values.values():
            value[1:] -= value[0]
    values["presence"] = np.ones(len(seen))
    values["cos_h"], values["sin_h"] = cosine, sine
    if "heading" in features:
        values["heading"] = np.where(moves, heading, np.nan)
    if any(name in features for name in _OFFSETS):
        unknown = np.full(3, np.nan)
        offsets = [
            thing.lane_offset if moving else unknown for thing, moving in zip(seen, moves, strict=True)
        ]
        values.update(zip(_OFFSETS, np.array(offsets).T, strict=True))
    if any(name in features for name in _DIRECTIONS):
        directions = np.zeros((len(seen), 2))
        for index in range(len(seen) if intentions else 1):
            if moves[index]:
                directions[index] = seen[index].destination_direction
        values.update(zip(_DIRECTIONS, directions.T, strict=True))
    missing = [name for name in features if name not in values]
    if missing:
        raise KeyError(f"{missing} not in index")
    return {name: values[name] for name in features}
