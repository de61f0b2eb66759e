"""Where the episodes of an environment start and where they lead to."""

from __future__ import annotations

import difflib
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from athrl_driving.episode.ego import EGO_LENGTH
from athrl_driving.errors import DrivingError
from athrl_driving.maps import Town
from athrl_driving.metrics import COMPLETION_SPEED
from athrl_driving.route import PLAN_ROWS, dead_end_distance, plan_length, shortest_route

ROOM_BEFORE_DEAD_END = 70.0
"""Metres before the end of a lane that the ego needs for changing to another one."""

RANDOM = "random"
"""A destination that is drawn for every episode."""

_RANDOM_TURNS = np.empty(0, dtype=np.int64)
_ATTEMPTS = 50

Place = tuple[int, float]
"""A row of the lane graph, and metres along it."""


@dataclass(frozen=True)
class Journey:
    """Where an episode starts and where it leads."""

    start: NDArray[np.float64]
    """[4] row, m along it, m along the plan's last row, m of the whole way; see `episode.beginning`."""
    plan: NDArray[np.int64]
    """[n] rows to drive; none where turns are drawn at random."""


class Journeys:
    """Draws the journeys of a town's episodes, each `seconds` long at most.

    Without a `start` an ego starts anywhere on an ordinary lane, a car's length from its ends, and not where
    the lane is about to end: it needs room to change to the one beside it. Without a `destination` turns are
    random; with RANDOM it is drawn like a start.
    """

    def __init__(
        self, town: Town, seconds: float, start: Place | None = None, destination: Place | str | None = None
    ) -> None:
        graph = town.graph
        before_end = np.minimum(graph.length - EGO_LENGTH, dead_end_distance(graph) - ROOM_BEFORE_DEAD_END)
        room = np.where(graph.junction < 0, np.maximum(before_end - EGO_LENGTH, 0.0), 0.0)
        self._graph = graph
        self._ends = np.cumsum(room)
        self._start, self._destination = start, destination
        self._random_goal = COMPLETION_SPEED * seconds

    @property
    def have_destination(self) -> bool:
        """Whether an episode leads somewhere, or random turns last until its time is up."""
        return self._destination is not None

    def draw(self, generator: np.random.Generator) -> Journey:
        """Draw a journey; raises ValueError where no way leads to the destination."""
        row, s = self._start or self._anywhere(generator)
        if self._destination is None:
            return Journey(np.array([row, s, 0.0, self._random_goal]), _RANDOM_TURNS)
        if not isinstance(self._destination, str):
            return self._lead(row, s, self._destination)
        for _ in range(_ATTEMPTS):
            try:
                return self._lead(row, s, self._anywhere(generator))
            except ValueError:
                continue
        raise DrivingError(f"no way leads from lane {row} of the map to any of {_ATTEMPTS} places on it")

    def _anywhere(self, generator: np.random.Generator) -> Place:
        place = generator.random() * self._ends[-1]
        row = int(np.searchsorted(self._ends, place, side="right"))
        before = self._ends[row - 1] if row else 0.0
        return row, EGO_LENGTH + float(place - before)

    def _lead(self, row: int, s: float, destination: Place) -> Journey:
        goal, goal_s = destination
        plan = shortest_route(self._graph, row, goal, around=goal == row and goal_s <= s)
        if plan.size > PLAN_ROWS:
            raise DrivingError(f"the way to the destination has {plan.size} lanes, it may have {PLAN_ROWS}")
        way = plan_length(self._graph, plan, s, goal_s)
        return Journey(np.array([row, s, goal_s, max(way, 1.0)]), plan)


def place_on_map(town: Town, place: tuple[str, int, float]) -> Place:
    """The row of a place on a town's map: its road's name, its lane's id, and metres along the lane.

    The metres count in the direction of driving, over all rows of the lane. Raises ValueError in one line
    where there is no such road, lane or place.
    """
    road, lane, s = place
    roads = np.array(town.road_name) == road
    if not roads.any():
        near = difflib.get_close_matches(road, town.road_name, n=1)
        hint = f", did you mean {near[0]!r}?" if near else ": load_town(...).road_name has them all"
        raise DrivingError(f"the map {town.name} has no road {road!r}{hint}")
    rows = np.flatnonzero(roads & (town.lane_id == lane))
    if not rows.size:
        lanes = ", ".join(str(each) for each in np.unique(town.lane_id[roads]))
        raise DrivingError(f"the road {road!r} of {town.name} has no lane {lane}, its lanes are {lanes}")
    chain = _chain(town, rows)
    end = 0.0
    for row in chain:
        if s <= end + town.graph.length[row] and s >= 0.0:
            return row, float(s - end)
        end += float(town.graph.length[row])
    raise DrivingError(f"lane {lane} of the road {road!r} of {town.name} is {end:.1f} m long, not {s:g} m")


def _chain(town: Town, rows: NDArray[np.int64]) -> list[int]:
    """The rows that follow each other along a lane, from the first that none of them leads to."""
    left = set(rows.tolist())
    following = {row: [other for other in _successors(town, row) if other in left] for row in left}
    reached = {other for others in following.values() for other in others}
    row = min(left - reached, default=min(left))
    chain = []
    while row in left:
        chain.append(row)
        left.remove(row)
        row = next((other for other in following[row] if other in left), -1)
    return chain


def _successors(town: Town, row: int) -> list[int]:
    start, end = town.graph.successor_start[row : row + 2]
    following: list[int] = town.graph.successor[start:end].tolist()
    return following
