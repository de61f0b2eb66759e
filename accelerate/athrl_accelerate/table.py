"""The arrays of a road, with its vehicles and objects as rows, and how these enter and leave the arrays."""

from __future__ import annotations

from collections.abc import Sequence
from operator import attrgetter
from typing import Any

import numpy as np
from highway_env.road.road import LaneIndex
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.objects import RoadObject

from athrl_accelerate import columns as column
from athrl_accelerate.columns import (
    ACCELERATION_PARAMETERS,
    MARK_COLUMNS,
    NONE,
    PARAMETER_COLUMNS,
    SCALAR_PARAMETERS,
    STATE_COLUMNS,
    STEERING_PARAMETERS,
    TRAJECTORY_POINTS,
    VECTOR_PARAMETERS,
    Rows,
    Scratch,
)
from athrl_accelerate.network import CompiledNetwork
from athrl_accelerate.rows import Route, Row, column_names, row_class
from athrl_accelerate.supported_classes import object_kind

ROOM = 16
"""Initial capacity in rows, and in roads of a route."""
LISTS = 16
"""Capacity of the lists of rows on lanes, as a multiple of all rows; full lists are rebuilt."""

_POSITIONS = {name: index for index, name in enumerate(SCALAR_PARAMETERS)}


class Table:
    """The rows of one road. A `Row` is in at most one table, at its place in the road's lists."""

    def __init__(self, network: CompiledNetwork) -> None:
        self.network = network
        self.things: list[Row] = []
        self.vehicle_count = 0
        self.classes: set[type] = set()
        """The classes of highway-env among the rows."""
        self._stale: list[Row] = []
        self._class_parameters: dict[type, tuple] = {}
        self.rows = _new_rows(ROOM, ROOM)
        self._make_room(ROOM)

    def __getstate__(self) -> dict[str, Any]:
        """Return everything but the working memory of a frame."""
        return {
            name: value for name, value in self.__dict__.items() if name not in ("scratch", "found", "ahead")
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Take the rows into arrays of its own: those of a pickle may be read only, or another's memory."""
        self.__dict__.update(state)
        self.rows = Rows._make(map(np.array, self.rows))
        self._make_room(len(self.rows.position))

    def set_things(self, vehicles: Sequence[RoadObject], objects: Sequence[RoadObject]) -> None:
        """Let the rows be these vehicles and objects, in this order; others become ordinary objects again."""
        things = [*vehicles, *objects]
        kinds = [self._kind(thing) for thing in things]
        staying = {id(thing) for thing in things}
        for thing in self.things:
            if id(thing) not in staying and self.has(thing):
                self.take_out(thing)
        old = [thing._row if self.has(thing) else NONE for thing in things]
        self._arrange(old)
        for row, (thing, kind) in enumerate(zip(things, kinds, strict=True)):
            if old[row] == NONE:
                self._put_in(thing, kind, row)
            else:
                thing.__dict__["_row"] = row
        self.things, self.vehicle_count = things, len(vehicles)
        self.classes = {type(thing).plain for thing in things}
        self._class_parameters = {cls: self._class_parameters.get(cls, ()) for cls in self.classes}

    def _make_room(self, room: int) -> None:
        self.scratch = _new_scratch(room, len(self.network.lanes))
        self.found, self.ahead = np.zeros(room, np.int64), np.zeros(room)

    def has(self, thing: Any) -> bool:
        """Return whether a vehicle or an object is a row of this table."""
        return isinstance(thing, Row) and thing._table is self

    def _kind(self, thing: RoadObject) -> int:
        if self.has(thing):
            return NONE  # it has been checked
        if isinstance(thing, Row):
            thing._table.take_out(thing)
        return object_kind(thing)

    def _arrange(self, old: list[int]) -> None:
        """Move rows to their places in the new order; new ones get rows of zeros."""
        count, room = len(old), len(self.rows.position)
        taken = np.array([0 if row == NONE else row for row in old], np.int64)
        if count > room:
            room = max(count, 2 * room)
            self._make_room(room)
        rows = _new_rows(room, self.rows.route.shape[1])
        rows.position[:count] = self.rows.position[taken]
        rows.state[:, :count] = self.rows.state[:, taken]
        rows.parameters[:, :count] = self.rows.parameters[:, taken]
        rows.marks[:, :count] = self.rows.marks[:, taken]
        rows.route[:count] = self.rows.route[taken]
        self.rows = rows

    def _put_in(self, thing: Any, kind: int, row: int) -> None:
        values = thing.__dict__
        plain = type(thing)
        color = values.pop("color", None) if kind >= column.CONTROLLED else None
        columns = {name: values.pop(name, None) for name in column_names(kind)}
        values.pop("lane", None)
        values.update(_table=self, _row=row)
        if color is not None:
            values["_color"] = color
        marks = self.rows.marks
        marks[:, row] = 0
        marks[column.KIND, row] = kind
        marks[column.IS_MDP, row] = issubclass(plain, MDPVehicle)
        if kind >= column.CONTROLLED:
            values["_route"] = None
        thing.__class__ = row_class(plain, kind)
        for name, value in columns.items():
            if value is not None or name in ("impact", "route"):
                setattr(thing, name, value)
        self._read_parameters(thing)

    def take_out(self, thing: Any) -> None:
        """Make a row an ordinary object again, with its present state."""
        kind = int(self.rows.marks[column.KIND, thing._row])
        state = {name: getattr(thing, name) for name in column_names(kind)}
        state["position"] = state["position"].copy()
        state["lane"] = thing.lane
        if "action" in state:
            state["action"] = dict(state["action"])
        if state.get("route") is not None:
            state["route"] = list(state["route"])
        if not state.get("is_yielding"):
            state.pop("is_yielding", None)
            state.pop("yield_timer", None)
        color = getattr(thing, "color", None)
        values = thing.__dict__
        for name in ("_table", "_row", "_route", "_color"):
            values.pop(name, None)
        thing.__class__ = type(thing).plain
        values.update(state)
        if color is not None:
            values["color"] = color

    def write_route(self, thing: Any, route: Sequence[LaneIndex] | None) -> None:
        """Set a vehicle's route."""
        rows, row = self.rows, thing._row
        roads = () if route is None else route
        if len(roads) > rows.route.shape[1]:
            longer = np.zeros((len(rows.route), 2 * len(roads), 3), np.int64)
            longer[:, : rows.route.shape[1]] = rows.route
            self.rows = rows = rows._replace(route=longer)
        for place, index in enumerate(roads):
            rows.route[row, place] = self._numbers(index)
        rows.marks[column.ROUTE_HEAD, row], rows.marks[column.ROUTE_END, row] = 0, len(roads)
        if isinstance(route, Route) and route._of is thing:
            route.dropped = 0
            thing.__dict__["_route"] = route
        else:
            thing.__dict__["_route"] = None if route is None else Route(thing, route)

    def _numbers(self, index: LaneIndex) -> tuple[int, int, int]:
        origin, destination, number = index
        nodes = self.network.nodes
        ends = nodes.get(origin, len(nodes)), nodes.get(destination, len(nodes))
        if number is None:
            return (*ends, NONE)
        count = self.network.lane_count.get(ends, 0)
        return (*ends, int(number) + count if number < 0 else int(number))

    def read_again(self, thing: Row) -> None:
        """Note that a vehicle's own parameters have changed."""
        self._stale.append(thing)

    def read_parameters(self) -> None:
        """Read the parameters of vehicles and classes that have changed since the last frame."""
        for cls, known in self._class_parameters.items():
            now = _class_parameters(cls)
            if now != known:
                self._class_parameters[cls] = now
                self._stale += [thing for thing in self.things if type(thing).plain is cls]
        if self._stale:
            for thing in self._stale:
                if self.has(thing):
                    self._read_parameters(thing)
            self._stale = []

    def _read_parameters(self, thing: Any) -> None:
        parameters, row = self.rows.parameters, thing._row
        for name, index in _POSITIONS.items():
            parameters[index, row] = getattr(thing, name, 0.0)
        if hasattr(thing, "ACCELERATION_PARAMETERS"):
            parameters[ACCELERATION_PARAMETERS:STEERING_PARAMETERS, row] = thing.ACCELERATION_PARAMETERS
            parameters[STEERING_PARAMETERS:PARAMETER_COLUMNS, row] = thing.STEERING_PARAMETERS
        predicts = getattr(thing, "prediction_type", None) != "zero_steering"
        self.rows.marks[column.PREDICTS_STEERING, row] = predicts


_NAMES_OF_CLASS: dict[type, attrgetter] = {}


def _class_parameters(cls: type) -> tuple:
    """Return the parameters that a class has now."""
    names = _NAMES_OF_CLASS.get(cls)
    if names is None:
        names = attrgetter(*(name for name in SCALAR_PARAMETERS if hasattr(cls, name)))
        _NAMES_OF_CLASS[cls] = names
    values = names(cls)
    if hasattr(cls, "ACCELERATION_PARAMETERS"):
        values += tuple(tuple(getattr(cls, name)) for name in VECTOR_PARAMETERS)
    return values


def _new_rows(room: int, roads: int) -> Rows:
    return Rows(
        position=np.zeros((room, 2)),
        state=np.zeros((STATE_COLUMNS, room)),
        parameters=np.zeros((PARAMETER_COLUMNS, room)),
        marks=np.zeros((MARK_COLUMNS, room), np.int64),
        route=np.zeros((room, roads, 3), np.int64),
    )


def _new_scratch(room: int, lanes: int) -> Scratch:
    return Scratch(
        x=np.zeros(room),
        y=np.zeros(room),
        cosine=np.zeros(room),
        sine=np.zeros(room),
        along=np.zeros(room),
        radius=np.zeros(room),
        listed=np.zeros((lanes, 3), np.int64),
        pool_along=np.zeros(LISTS * room),
        pool_row=np.zeros(LISTS * room, np.int64),
        near=np.zeros(room, np.int64),
        member=np.zeros(room, np.int64),
        counters=np.zeros(4, np.int64),
        trajectory=np.zeros((room, TRAJECTORY_POINTS, 3)),
        reach=np.zeros((room, 4)),
        corners=np.zeros((10, 2)),
    )
