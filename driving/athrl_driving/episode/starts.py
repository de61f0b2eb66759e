"""Where the episodes of an environment start and where they end."""

from __future__ import annotations

import difflib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from athrl_driving.episode.ego import EGO_LENGTH
from athrl_driving.errors import DrivingError
from athrl_driving.maps import Town
from athrl_driving.maps.lane_graph import LaneGraph
from athrl_driving.maps.road_names import BY_ID
from athrl_driving.metrics import COMPLETION_SPEED
from athrl_driving.route import PLAN_LANES, dead_end_distance, plan_length, shortest_route

ROOM_BEFORE_END = 70.0
"""Metres before the end of a lane that the ego needs: for changing to another one, or to drive a little."""

RANDOM = "random"
"""A destination that is drawn at random for every episode."""

_RANDOM_TURNS = np.empty(0, dtype=np.int64)
_ATTEMPTS = 50
_IDS_NAMED = 5

Place = tuple[int, float]
"""A lane of the lane graph, and metres along it."""


@dataclass(frozen=True)
class Journey:
    """The start and the route of an episode."""

    start: NDArray[np.float64]
    """[4] lane, m along it, m along the plan's last lane, m of the whole route; see `episode.beginning`."""
    plan: NDArray[np.int64]
    """[n] lanes to drive; none where turns are drawn at random."""


class Journeys:
    """Draws the journeys of a town's episodes, each `seconds` long at most.

    Without a `start` an ego starts at a random place on a lane outside junctions, a car's length or more from
    its ends, and not shortly before a dead end, as it needs room to change to the adjacent lane, or before
    the map's edge. Where the whole map is shorter than that it may start nearer, at last anywhere on a lane.
    Without a `destination` turns are random; RANDOM means that it is drawn like a start.
    """

    def __init__(
        self, town: Town, seconds: float, start: Place | None = None, destination: Place | str | None = None
    ) -> None:
        self._town = town
        self._margin, room = room_to_start(town.graph)
        self._ends = np.cumsum(room)
        self._start, self._destination = start, destination
        self._random_goal = COMPLETION_SPEED * seconds

    @property
    def have_start(self) -> bool:
        """Whether all episodes start at the same place."""
        return self._start is not None

    @property
    def have_destination(self) -> bool:
        """Whether episodes have a destination; without one random turns last until the time limit."""
        return self._destination is not None

    def draw(self, generator: np.random.Generator) -> Journey:
        """Draw a journey; raises ValueError where no route leads to the destination."""
        lane, s = self._start or self._anywhere(generator)
        if self._destination is None:
            return Journey(np.array([lane, s, 0.0, self._random_goal]), _RANDOM_TURNS)
        fixed = None if isinstance(self._destination, str) else self._destination
        for _ in range(_ATTEMPTS):
            try:
                return self._journey_to(lane, s, fixed or self._anywhere(generator))
            except ValueError:
                if self._start is not None and fixed is not None:
                    raise
                # Parts of a map, and the lanes that lead off it, cannot be reached from everywhere.
                lane, s = self._start or self._anywhere(generator)
        raise DrivingError(
            f"on the map {self._town.name} no start leads to its destination, of {_ATTEMPTS} that were drawn"
        )

    def _anywhere(self, generator: np.random.Generator) -> Place:
        place = generator.random() * self._ends[-1]
        lane = int(np.searchsorted(self._ends, place, side="right"))
        before = self._ends[lane - 1] if lane else 0.0
        return lane, self._margin + float(place - before)

    def _journey_to(self, lane: int, s: float, destination: Place) -> Journey:
        goal, goal_s = destination
        try:
            around = goal == lane and goal_s <= s
            plan = shortest_route(self._town.graph, lane, goal, start=s, goal=goal_s, around=around)
        except DrivingError:
            start, end = self._town.lane_called(lane), self._town.lane_called(goal)
            raise DrivingError(f"on the map {self._town.name} no way leads from {start} to {end}") from None
        if plan.size > PLAN_LANES:
            raise DrivingError(f"the way to the destination has {plan.size} lanes, it may have {PLAN_LANES}")
        way = plan_length(self._town.graph, plan, s, goal_s)
        return Journey(np.array([lane, s, goal_s, max(way, 1.0)]), plan)


def room_to_start(graph: LaneGraph) -> tuple[float, NDArray[np.float64]]:
    """Return from which metre of a lane on the ego may start, and over how many metres of each lane, [L]."""
    margin = EGO_LENGTH
    room = _room_between(
        graph, margin, np.minimum(graph.length - margin, dead_end_distance(graph) - ROOM_BEFORE_END)
    )
    if not room.any():
        room = _room_between(graph, margin, graph.length - margin)
    if not room.any():
        margin, room = 0.0, _room_between(graph, 0.0, graph.length)
    return margin, room


def _room_between(graph: LaneGraph, start: float, end: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the metres from `start` to `end` [L] of each lane outside junctions, [L]."""
    return np.where(graph.junction < 0, np.maximum(end - start, 0.0), 0.0)


def place_on_map(town: Town, place: tuple[str, int, float]) -> Place:
    """The lane of the lane graph at a place on a town's map, and the metres along that lane.

    A place is a road, a lane's id, and metres along the road's lane of that id. They count in the direction
    of driving, over all lanes of the graph that are part of it. A road is called by its name, or "road ID".
    Raises ValueError in one line where there is no such road, lane or place, or where several roads are
    called so.
    """
    road, lane_id, s = place
    roads = _called(town, road)
    lanes = np.flatnonzero(roads & (town.lane_id == lane_id))
    if not lanes.size:
        ids = ", ".join(str(each) for each in np.unique(town.lane_id[roads]))
        raise DrivingError(f"the road {road!r} of {town.name} has no lane {lane_id}, its lanes are {ids}")
    chain = in_driving_order(town, lanes)
    _refuse_shared_name(town, road, lanes.tolist(), chain)
    end = 0.0
    for lane in chain:
        if s <= end + town.graph.length[lane] and s >= 0.0:
            return lane, float(s - end)
        end += float(town.graph.length[lane])
    raise DrivingError(f"lane {lane_id} of the road {road!r} of {town.name} is {end:.1f} m long, not {s:g} m")


def _called(town: Town, road: str) -> NDArray[np.bool_]:
    """Return which lanes are of the roads of a name, else of the road of an id ("road ID"), [L]."""
    roads = np.array(town.road_name) == road
    if not roads.any() and road.startswith(BY_ID):
        roads = np.array(town.road_id) == road.removeprefix(BY_ID)
    if not roads.any():
        near = difflib.get_close_matches(road, town.road_name, n=1)
        hint = f", did you mean {near[0]!r}?" if near else ": load_town(...).road_name has them all"
        raise DrivingError(f"the map {town.name} has no road {road!r}{hint}")
    return roads


def _refuse_shared_name(town: Town, road: str, lanes: list[int], chain: list[int]) -> None:
    """Refuse a name of several roads; those that follow each other are one street, on which metres count."""
    of_name = dict.fromkeys(town.road_id[lane] for lane in lanes)
    if len(of_name) == len({town.road_id[lane] for lane in chain}):
        return
    ids = ", ".join(repr(f"{BY_ID}{number}") for number in list(of_name)[:_IDS_NAMED])
    more = ", ..." if len(of_name) > _IDS_NAMED else ""
    raise DrivingError(
        f"{len(of_name)} roads of {town.name} with such a lane are called {road!r}, "
        f"the place should name one of them by its id: {ids}{more}"
    )


def in_driving_order(town: Town, lanes: NDArray[np.int64]) -> list[int]:
    """The lanes in the order in which they follow each other, from the first without a predecessor."""
    left = set(lanes.tolist())
    following = {lane: [other for other in _successors(town, lane) if other in left] for lane in left}
    reached = {other for others in following.values() for other in others}
    lane = min(left - reached, default=min(left))
    chain = []
    while lane in left:
        chain.append(lane)
        left.remove(lane)
        lane = next((other for other in following[lane] if other in left), -1)
    return chain


def _successors(town: Town, lane: int) -> list[int]:
    start, end = town.graph.successor_start[lane : lane + 2]
    following: list[int] = town.graph.successor[start:end].tolist()
    return following
