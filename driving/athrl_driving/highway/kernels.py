"""The compiled functions that Python calls: a road's `act` and `step`, and its questions."""

from athrl_driving.highway.compiling import entry
from athrl_driving.by_reference import by_reference
from athrl_driving.highway.behaviour import act_all
from athrl_driving.highway.collisions import collide_all
from athrl_driving.highway.columns import FAILED_ROW, LANE, NONE, Integers, Rows, Scratch
from athrl_driving.highway.lanes import Network, closest_lane, lane_coordinates
from athrl_driving.highway.motion import move_all
from athrl_driving.highway.neighbours import begin_frame, neighbours
from athrl_driving.highway.regulation import enforce_road_rules

CLOSE_BEHIND = 2.0
"""Lengths of the observer behind it, within which highway-env shows objects and, if it is told to, vehicles."""


@entry
def act(
    rows: Rows, network: Network, scratch: Scratch, vehicles: int, objects: int, connected: bool
) -> bool:
    """Let all vehicles decide; False where a route leads nowhere, for the row `scratch.counters[FAILED_ROW]`."""
    count = vehicles + objects
    of_rows, of_network, of_scratch = by_reference(rows), by_reference(network), by_reference(scratch)
    begin_frame(of_rows, of_network, of_scratch, count)
    failed = act_all(of_rows, of_network, of_scratch, vehicles, count, connected)
    scratch.counters[FAILED_ROW] = failed
    return failed == NONE


@entry
def step(
    rows: Rows,
    network: Network,
    scratch: Scratch,
    vehicles: int,
    objects: int,
    dt: float,
    regulated: bool,
    yield_duration: float,
) -> bool:
    """Apply the road's rules if they are due, move all vehicles by dt seconds and let them collide.

    False where a route leads nowhere, for the row `scratch.counters[FAILED_ROW]`.
    """
    of_rows, of_network, of_scratch = by_reference(rows), by_reference(network), by_reference(scratch)
    if regulated:
        failed = enforce_road_rules(of_rows, of_network, of_scratch, vehicles, yield_duration)
        scratch.counters[FAILED_ROW] = failed
        if failed != NONE:
            return False
    move_all(of_rows, of_network, vehicles, dt)
    collide_all(of_rows, of_scratch, vehicles, vehicles + objects, dt)
    return True


@entry
def find_lane(network: Network, x: float, y: float, heading: float) -> int:
    """Return the closest lane to a pose."""
    return closest_lane(by_reference(network), x, y, heading, 0)
