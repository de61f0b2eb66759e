"""Which classes of highway-env the kernels know, and what a subclass may change without becoming unknown.

A subclass may have its own constructor, parameters and helpers. It is unknown if it overrides a method that
the kernels replace: this is determined from what its methods resolve to, not from its name.
"""

from __future__ import annotations

from functools import cache
from inspect import getattr_static

from highway_env.road.lane import AbstractLane, CircularLane, SineLane, StraightLane
from highway_env.road.regulation import RegulatedRoad
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import AggressiveVehicle, DefensiveVehicle, IDMVehicle, LinearVehicle
from highway_env.vehicle.controller import ControlledVehicle, MDPVehicle
from highway_env.vehicle.dynamics import BicycleVehicle
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import Landmark, Obstacle, RoadObject

from athrl_accelerate.columns import (
    BICYCLE,
    CONTROLLED,
    IDM,
    LANDMARK,
    LINEAR,
    OBSTACLE,
    SCALAR_PARAMETERS,
    VECTOR_PARAMETERS,
    VEHICLE,
)


class UnknownClassError(ValueError):
    """An environment has a vehicle, an object, a lane or a road of a class that the kernels do not know."""


KINDS: dict[type, int] = {
    Obstacle: OBSTACLE,
    Landmark: LANDMARK,
    Vehicle: VEHICLE,
    BicycleVehicle: BICYCLE,
    ControlledVehicle: CONTROLLED,
    MDPVehicle: CONTROLLED,
    IDMVehicle: IDM,
    LinearVehicle: LINEAR,
    AggressiveVehicle: LINEAR,
    DefensiveVehicle: LINEAR,
}

OBJECT_BEHAVIOUR = frozenset(
    (
        "__bool__",
        "__delattr__",
        "__eq__",
        "__getattr__",
        "__getattribute__",
        "__len__",
        "__setattr__",
        "_is_colliding",
        "acceleration",
        "acceleration_features",
        "act",
        "change_lane_policy",
        "clip_actions",
        "derivative_func",
        "desired_gap",
        "direction",
        "follow_road",
        "front_distance_to",
        "handle_collisions",
        "lane_distance_to",
        "mobil",
        "on_state_update",
        "polygon",
        "predict_trajectory_constant_speed",
        "speed_control",
        "state",
        "steering_control",
        "steering_features",
        "step",
        "velocity",
        "position",
        "heading",
        "speed",
        "target_speed",
        "action",
        "timer",
        "impact",
        "lane",
        "lane_index",
        "target_lane_index",
        "route",
        "crashed",
        "hit",
        "solid",
        "collidable",
        "check_collisions",
        "enable_lane_change",
        "is_yielding",
        "yield_timer",
        "diagonal",
        "lateral_speed",
        "yaw_rate",
    )
)
"""Methods of vehicles and objects that run in a frame, and the attributes that become columns."""

LANE_BEHAVIOUR = frozenset(
    (
        "__getattr__",
        "__getattribute__",
        "after_end",
        "distance",
        "distance_with_heading",
        "heading_at",
        "is_reachable_from",
        "local_angle",
        "local_coordinates",
        "on_lane",
        "position",
        "width_at",
    )
)

ROAD_BEHAVIOUR = frozenset(
    (
        "__getattr__",
        "__getattribute__",
        "__setattr__",
        "act",
        "close_objects_to",
        "close_vehicles_to",
        "enforce_road_rules",
        "is_conflict_possible",
        "neighbour_vehicles",
        "network",
        "objects",
        "respect_priorities",
        "step",
        "vehicles",
    )
)

NETWORK_BEHAVIOUR = frozenset(
    (
        "__getattr__",
        "__getattribute__",
        "get_closest_lane_index",
        "get_lane",
        "next_lane",
        "next_lane_given_next_road",
        "position_heading_along_route",
        "side_lanes",
    )
)


def object_kind(thing: RoadObject) -> int:
    """Return the kind of a vehicle or an object. Raises `UnknownClassError`, which names its class."""
    known = _known_base(type(thing), tuple(KINDS), OBJECT_BEHAVIOUR, "vehicle or object")
    own = OBJECT_BEHAVIOUR.intersection(vars(thing)).intersection(vars_of_methods(known))
    if own:
        name = _name(type(thing))
        raise UnknownClassError(f"cannot accelerate {name}: this one has its own {min(own)}")
    return KINDS[known]


def lane_class(lane: AbstractLane) -> type:
    """Return the known class that a lane behaves as. Raises `UnknownClassError`, which names its class."""
    return _known_base(type(lane), (StraightLane, SineLane, CircularLane), LANE_BEHAVIOUR, "lane")


def road_class(road: Road) -> type:
    """Return Road or RegulatedRoad. Raises `UnknownClassError`, which names the class of another road."""
    return _known_base(type(road), (Road, RegulatedRoad), ROAD_BEHAVIOUR, "road")


def network_class(network: RoadNetwork) -> type:
    """Return RoadNetwork. Raises `UnknownClassError`, which names the class of another network."""
    return _known_base(type(network), (RoadNetwork,), NETWORK_BEHAVIOUR, "road network")


@cache
def vars_of_methods(known: type) -> frozenset[str]:
    """Return the names of a class's methods, including inherited ones."""
    return frozenset(name for name in dir(known) if callable(getattr_static(known, name)))


def _known_base(cls: type, known: tuple[type, ...], behaviour: frozenset[str], what: str) -> type:
    """Return the known class that a class behaves as; determined once for each class."""
    if (cls, what) not in _bases:
        _bases[cls, what] = _find_known_base(cls, known, behaviour, what)
    return _bases[cls, what]


_bases: dict[tuple[type, str], type] = {}


def _find_known_base(cls: type, known: tuple[type, ...], behaviour: frozenset[str], what: str) -> type:
    base = next((ancestor for ancestor in cls.__mro__ if ancestor in known), None)
    if base is None:
        names = ", ".join(other.__name__ for other in known)
        raise UnknownClassError(f"cannot accelerate the {what} class {_name(cls)}: known are {names}")
    missing = object()
    for name in sorted(behaviour):
        if getattr_static(cls, name, missing) is not getattr_static(base, name, missing):
            raise UnknownClassError(
                f"cannot accelerate the {what} class {_name(cls)}: it overrides {base.__name__}.{name}"
            )
    for name in (*SCALAR_PARAMETERS, *VECTOR_PARAMETERS):
        if hasattr(getattr_static(cls, name, None), "__get__"):
            raise UnknownClassError(
                f"cannot accelerate the {what} class {_name(cls)}: its {name} is no number, but computed"
            )
    return base


def _name(cls: type) -> str:
    return f"{cls.__module__}.{cls.__qualname__}"
