"""Vehicles and objects whose state is stored in arrays and which are otherwise highway-env's own.

A vehicle becomes a row when its class is changed to one made from `Row` and its own class: the object stays
the same, `isinstance` stays true, all methods stay highway-env's; only its attributes read and write the
arrays.
"""

from __future__ import annotations

from abc import ABCMeta
from collections.abc import Callable, Iterable
from functools import cache
from typing import Any, Protocol

import numpy as np
from highway_env.road.lane import AbstractLane
from highway_env.road.road import LaneIndex
from highway_env.vehicle.behavior import LinearVehicle
from highway_env.vehicle.objects import RoadObject

from athrl_accelerate import columns as column
from athrl_accelerate.columns import SCALAR_PARAMETERS, VECTOR_PARAMETERS, Rows
from athrl_accelerate.mixins import class_with_mixin
from athrl_accelerate.network import CompiledNetwork
from athrl_accelerate.supported_classes import OBJECT_BEHAVIOUR, UnknownClassError, vars_of_methods

PARAMETERS = frozenset((*SCALAR_PARAMETERS, *VECTOR_PARAMETERS, "prediction_type"))
"""Attributes that may be set on a single vehicle; its parameters are then read again."""

METHODS = OBJECT_BEHAVIOUR & vars_of_methods(LinearVehicle)
"""Methods that the kernels replace; they may not be overridden on a single vehicle."""


class RowTable(Protocol):
    """The part of a table that its rows need."""

    rows: Rows
    network: CompiledNetwork

    def take_out(self, thing: RoadObject) -> None:
        """Make a row a plain object again."""

    def read_again(self, thing: RoadObject) -> None:
        """Copy a vehicle's attributes into the arrays."""

    def write_route(self, thing: RoadObject, route: Iterable[LaneIndex] | None) -> None:
        """Write a vehicle's route into the arrays."""


class RowType(ABCMeta):
    """The metaclass of rows' classes: each is equal to the class it replaces, and constructs that class."""

    plain: type

    def __eq__(cls, other: object) -> bool:
        # highway-env's renderer compares types: it draws the wheels of what is exactly a Vehicle.
        return cls is other or cls.plain is getattr(other, "plain", other)

    def __hash__(cls) -> int:
        return hash(cls.plain)

    def __call__(cls, *arguments: Any, **settings: Any) -> Any:
        """Construct an ordinary vehicle; it becomes a row when the road finds it in its list."""
        return cls.plain(*arguments, **settings)


def _state(index: int) -> property:
    def read(self: Row) -> np.float64:
        return self._table.rows.state[index, self._row]

    def write(self: Row, value: float) -> None:
        self._table.rows.state[index, self._row] = value

    return property(read, write)


def _flag(index: int) -> property:
    def read(self: Row) -> bool:
        return bool(self._table.rows.marks[index, self._row])

    def write(self: Row, value: bool) -> None:
        self._table.rows.marks[index, self._row] = bool(value)

    return property(read, write)


def _lane_index(index: int) -> property:
    def read(self: Row) -> LaneIndex:
        return self._table.network.indices[self._table.rows.marks[index, self._row]]

    def write(self: Row, value: LaneIndex) -> None:
        self._table.rows.marks[index, self._row] = self._table.network.row(value)

    return property(read, write)


class Action(dict):
    """A vehicle's action; entries that are set are written to the arrays."""

    def __init__(self, row: Row) -> None:
        state = row._table.rows.state
        super().__init__(
            steering=float(state[column.STEERING, row._row]),
            acceleration=float(state[column.ACCELERATION, row._row]),
        )
        self._of = row

    def __setitem__(self, name: str, value: float) -> None:
        super().__setitem__(name, value)
        self._of.action = self


class Route(list):
    """A vehicle's route: kernels drop driven roads; other changes are written to the arrays."""

    def __init__(self, row: Row, roads: Iterable[LaneIndex]) -> None:
        super().__init__(roads)
        self._of = row
        self.dropped = 0

    def catch_up(self) -> None:
        """Drop the roads that the kernels have dropped."""
        if getattr(self._of, "_route", None) is self:
            head = int(self._of._table.rows.marks[column.ROUTE_HEAD, self._of._row])
            super().__delitem__(slice(0, head - self.dropped))
            self.dropped = head

    def _changed(self) -> None:
        if getattr(self._of, "_route", None) is self:
            self._of._table.write_route(self._of, self)

    def __reduce__(self) -> tuple:
        return _copied_route, (self._of, list(self), self.dropped)


def _copied_route(row: Row, roads: list[LaneIndex], dropped: int) -> Route:
    route = Route(row, roads)
    route.dropped = dropped
    return route


def _changing(name: str) -> Callable:
    change = getattr(list, name)

    def method(self: Route, *arguments: Any, **settings: Any) -> Any:
        self.catch_up()
        result = change(self, *arguments, **settings)
        self._changed()
        return self if result is not None and name.startswith("__i") else result

    return method


_CHANGES = ("append", "clear", "extend", "insert", "pop", "remove", "reverse", "sort")
for _name in (*_CHANGES, "__delitem__", "__setitem__", "__iadd__", "__imul__"):
    setattr(Route, _name, _changing(_name))


class Row:
    """Mixin that makes a vehicle or an object a row of a `Table`."""

    __slots__ = ()
    plain: type
    _table: RowTable
    _row: int

    heading = _state(column.HEADING)
    speed = _state(column.SPEED)
    diagonal = _state(column.DIAGONAL)
    crashed = _flag(column.CRASHED)
    hit = _flag(column.HIT)
    solid = _flag(column.SOLID)
    collidable = _flag(column.COLLIDABLE)
    check_collisions = _flag(column.CHECK_COLLISIONS)
    lane_index = _lane_index(column.LANE)

    @property
    def position(self) -> np.ndarray:
        """The centre, m; a view, because highway-env changes it in place."""
        return self._table.rows.position[self._row]

    @position.setter
    def position(self, value: np.ndarray) -> None:
        self._table.rows.position[self._row] = value

    @property
    def lane(self) -> AbstractLane:
        """The present lane."""
        return self._table.network.lanes[self._table.rows.marks[column.LANE, self._row]]

    @lane.setter
    def lane(self, value: AbstractLane) -> None:
        self._table.rows.marks[column.LANE, self._row] = self._table.network.row_of(value)

    @property
    def impact(self) -> np.ndarray | None:
        """Displacement by a collision at the next step, m."""
        rows, row = self._table.rows, self._row
        if not rows.marks[column.HAS_IMPACT, row]:
            return None
        return rows.state[column.IMPACT_X : column.IMPACT_Y + 1, row].copy()

    @impact.setter
    def impact(self, value: np.ndarray | None) -> None:
        rows, row = self._table.rows, self._row
        rows.marks[column.HAS_IMPACT, row] = value is not None
        rows.state[column.IMPACT_X : column.IMPACT_Y + 1, row] = 0.0 if value is None else value

    def __setattr__(self, name: str, value: Any) -> None:
        if name in METHODS:
            raise UnknownClassError(
                f"cannot accelerate {type(self).__qualname__}: this one is given its own {name}"
            )
        super().__setattr__(name, value)
        if name in PARAMETERS:
            self._table.read_again(self)

    def __delattr__(self, name: str) -> None:
        super().__delattr__(name)
        if name in PARAMETERS:
            self._table.read_again(self)


class VehicleRow(Row):
    """A row that is a vehicle."""

    __slots__ = ()

    @property
    def action(self) -> Action:
        """The steering angle (rad) and the acceleration (m/s2)."""
        return Action(self)

    @action.setter
    def action(self, value: dict[str, float]) -> None:
        state, row = self._table.rows.state, self._row
        state[column.STEERING, row] = np.asarray(value["steering"]).item()
        state[column.ACCELERATION, row] = np.asarray(value["acceleration"]).item()


class BicycleRow(VehicleRow):
    """A row that is a BicycleVehicle."""

    __slots__ = ()

    lateral_speed = _state(column.LATERAL_SPEED)
    yaw_rate = _state(column.YAW_RATE)


class ControlledRow(VehicleRow):
    """A row that is a ControlledVehicle."""

    __slots__ = ()

    road: Any
    _route: Route | None
    target_speed = _state(column.TARGET_SPEED)
    target_lane_index = _lane_index(column.TARGET_LANE)
    is_yielding = _flag(column.IS_YIELDING)
    yield_timer = _state(column.YIELD_TIMER)

    @property
    def route(self) -> list[LaneIndex] | None:
        """The roads ahead, or None."""
        if self._route is not None:
            self._route.catch_up()
        return self._route

    @route.setter
    def route(self, value: list[LaneIndex] | None) -> None:
        self._table.write_route(self, value)

    @property
    def color(self) -> Any:
        """The color that was set, or the road's color for yielding vehicles, as in highway-env."""
        if self.is_yielding:
            return self.road.YIELDING_COLOR
        if self._table.rows.marks[column.HAS_YIELDED, self._row] or "_color" not in self.__dict__:
            raise AttributeError("color")
        return self.__dict__["_color"]

    @color.setter
    def color(self, value: Any) -> None:
        self._table.rows.marks[column.HAS_YIELDED, self._row] = 0
        self.__dict__["_color"] = value


class IDMRow(ControlledRow):
    """A row that is an IDMVehicle."""

    __slots__ = ()

    timer = _state(column.TIMER)
    enable_lane_change = _flag(column.ENABLE_LANE_CHANGE)


_ROW_OF_KIND: dict[int, type[Row]] = {
    column.OBSTACLE: Row,
    column.LANDMARK: Row,
    column.VEHICLE: VehicleRow,
    column.BICYCLE: BicycleRow,
    column.CONTROLLED: ControlledRow,
    column.IDM: IDMRow,
    column.LINEAR: IDMRow,
}


def row_class(plain: type[RoadObject], kind: int) -> Any:
    """Return the class of rows that replaces a class of highway-env."""
    return class_with_mixin(plain, _ROW_OF_KIND[kind], RowType)


@cache
def column_names(kind: int) -> tuple[str, ...]:
    """Return the attributes of a kind of row that are columns, in the order in which they can be written."""
    names = [
        name
        for cls in reversed(_ROW_OF_KIND[kind].__mro__)
        for name, value in vars(cls).items()
        if isinstance(value, property) and name not in ("lane", "color")
    ]
    return tuple(names)
