"""A road whose `act` and `step` are one kernel call each; otherwise highway-env's."""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env.road.regulation import RegulatedRoad
from highway_env.road.road import LaneIndex, Road
from highway_env.vehicle.kinematics import Vehicle
from highway_env.vehicle.objects import RoadObject
from numpy.typing import NDArray

from athrl_accelerate import kernels
from athrl_accelerate.columns import FAILED_ROW, NONE
from athrl_accelerate.mixins import class_with_mixin
from athrl_accelerate.network import CompiledNetwork
from athrl_accelerate.supported_classes import network_class, road_class
from athrl_accelerate.table import Table


class AcceleratedNetwork:
    """Mixin of a network that finds the closest lane with a kernel; its lanes are read when first needed."""

    __slots__ = ()

    def add_lane(self: Any, *arguments: Any, **settings: Any) -> None:
        """Add a lane, so that the lanes are read again."""
        type(self).plain.add_lane(self, *arguments, **settings)
        self.__dict__.pop("_compiled", None)

    @property
    def compiled(self: Any) -> CompiledNetwork:
        """The lanes as arrays. Raises `UnknownClassError`, which names the class of an unknown lane."""
        if "_compiled" not in self.__dict__:
            self.__dict__["_compiled"] = CompiledNetwork(self)
        return self.__dict__["_compiled"]

    def get_closest_lane_index(
        self: Any, position: NDArray[np.float64], heading: float | None = None
    ) -> LaneIndex:
        """Return the index of the lane closest to a position (m) and, where given, a heading (rad)."""
        if heading is None:
            return type(self).plain.get_closest_lane_index(self, position)
        network = self.compiled
        row = kernels.find_lane(network.arrays, float(position[0]), float(position[1]), float(heading))
        return network.indices[row]


class AcceleratedRoad:
    """Mixin of a road whose vehicles are rows of arrays."""

    __slots__ = ()

    @property
    def table(self: Any) -> Table:
        """The arrays of the vehicles and objects that are in the road's lists now."""
        network = self.network.compiled
        if self._table is None or self._table.network is not network:
            self._release()
            self.__dict__["_table"] = Table(network)
        table: Table = self._table
        things = self.vehicles + self.objects
        if things != table.things or len(self.vehicles) != table.vehicle_count:
            table.set_things(self.vehicles, self.objects)
        table.read_parameters()
        return table

    def _release(self: Any) -> None:
        if self._table is not None:
            self._table.set_things((), ())

    def act(self: Any) -> None:
        """Decide the actions of each entity on the road."""
        table = self.table
        objects = len(table.things) - table.vehicle_count
        connected = bool(self.neighbour_vehicles_connected_lanes)
        arrays = table.network.arrays
        if not kernels.act(table.rows, arrays, table.scratch, table.vehicle_count, objects, connected):
            self._raise_for_route(table)

    def step(self: Any, dt: float) -> None:
        """Step the dynamics of each entity on the road by dt seconds."""
        regulated, duration = self._regulation(dt)
        table = self.table
        objects = len(table.things) - table.vehicle_count
        arrays = table.network.arrays
        if not kernels.step(
            table.rows, arrays, table.scratch, table.vehicle_count, objects, dt, regulated, duration
        ):
            self._raise_for_route(table)
        if self.record_history:
            for vehicle in self.vehicles:
                vehicle.history.appendleft(vehicle.create_from(vehicle))

    def close_objects_to(
        self: Any,
        vehicle: Vehicle,
        distance: float,
        count: int | None = None,
        see_behind: bool = True,
        sort: bool = True,
        vehicles_only: bool = False,
    ) -> list[RoadObject]:
        """Return what is within a distance (m) of a vehicle, the closest along its lane first."""
        table = self.table
        if not table.has(vehicle):
            return type(self).plain.close_objects_to(
                self, vehicle, distance, count, see_behind, sort, vehicles_only
            )
        vehicles, things = table.vehicle_count, table.things
        number = kernels.find_close(
            table.rows,
            table.network.arrays,
            vehicles,
            vehicles if vehicles_only else len(things),
            vehicle._row,
            distance,
            2 * vehicle.LENGTH,
            bool(see_behind),
            table.found,
            table.ahead,
        )
        rows = table.found[:number]
        if sort:
            rows = rows[np.argsort(np.abs(table.ahead[:number]), kind="stable")]
        if count:
            rows = rows[:count]
        return [things[row] for row in rows]

    def neighbour_vehicles(
        self: Any, vehicle: Vehicle, lane_index: LaneIndex | None = None
    ) -> tuple[RoadObject | None, RoadObject | None]:
        """Return the neighbours before and behind a vehicle on a lane (None: its own lane)."""
        table = self.table
        if not table.has(vehicle):
            return type(self).plain.neighbour_vehicles(self, vehicle, lane_index)
        lane = table.network.row(lane_index or vehicle.lane_index)
        front, rear = kernels.find_neighbours(
            table.rows,
            table.network.arrays,
            table.scratch,
            table.vehicle_count,
            len(table.things) - table.vehicle_count,
            bool(self.neighbour_vehicles_connected_lanes),
            vehicle._row,
            lane,
        )
        things = table.things
        return None if front == NONE else things[front], None if rear == NONE else things[rear]

    def _regulation(self: Any, dt: float) -> tuple[bool, float]:
        return False, 0.0

    def _raise_for_route(self: Any, table: Table) -> None:
        row = int(table.scratch.counters[FAILED_ROW])
        vehicle: Any = table.things[row]
        raise IndexError(
            f"the route of vehicle {row}, on lane {vehicle.lane_index}, leads to a lane that the road network"
            f" does not have: {vehicle.route}"
        )


class AcceleratedRegulatedRoad(AcceleratedRoad):
    """Mixin of a road with rules of priority."""

    __slots__ = ()

    def _regulation(self: Any, dt: float) -> tuple[bool, float]:
        """Count the step; return whether the rules are due, and for how many rounds a vehicle yields."""
        self.steps += 1
        due = self.steps % int(1 / dt / self.REGULATION_FREQUENCY) == 0
        return due, float(self.YIELD_DURATION * self.REGULATION_FREQUENCY)


def accelerate_road(road: Road) -> None:
    """Let a road, in place, run in kernels. Raises `UnknownClassError` for unknown classes."""
    if isinstance(road, AcceleratedRoad):
        return
    regulated = road_class(road) is RegulatedRoad
    network_class(road.network)
    if not isinstance(road.network, AcceleratedNetwork):
        road.network.__class__ = class_with_mixin(type(road.network), AcceleratedNetwork)
    road.__dict__["_table"] = None
    road.__class__ = class_with_mixin(type(road), AcceleratedRegulatedRoad if regulated else AcceleratedRoad)
    _ = road.table
