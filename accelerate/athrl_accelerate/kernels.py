"""The compiled functions that Python calls: a road's `act` and `step`, and its queries."""

import math

from athrl_driving.kernels.by_reference import by_reference
from athrl_driving.kernels.compilation import entry

from athrl_accelerate.behaviour import act_all
from athrl_accelerate.collisions import collide_all
from athrl_accelerate.columns import FAILED_ROW, LANE, NONE, Floats, Integers, Rows, Scratch
from athrl_accelerate.lanes import Network, closest_lane, lane_coordinates
from athrl_accelerate.motion import move_all
from athrl_accelerate.neighbours import begin_frame, neighbours
from athrl_accelerate.regulation import enforce_road_rules


@entry
def act(rows: Rows, network: Network, scratch: Scratch, vehicles: int, objects: int, connected: bool) -> bool:
    """Let all vehicles decide.

    False where a route leads to a lane that does not exist, for the row `scratch.counters[FAILED_ROW]`.
    """
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

    False where a route leads to a lane that does not exist, for the row `scratch.counters[FAILED_ROW]`.
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


@entry
def find_neighbours(
    rows: Rows,
    network: Network,
    scratch: Scratch,
    vehicles: int,
    objects: int,
    connected: bool,
    row: int,
    lane: int,
) -> tuple[int, int]:
    """Return the rows before and behind a vehicle on a lane, NONE where there is none."""
    of_rows, of_network, of_scratch = by_reference(rows), by_reference(network), by_reference(scratch)
    begin_frame(of_rows, of_network, of_scratch, vehicles + objects)
    along = lane_coordinates(network.lanes, lane, rows.position[row, 0], rows.position[row, 1])[0]
    return neighbours(of_rows, of_network, of_scratch, vehicles + objects, connected, row, lane, along)


@entry
def find_close(
    rows: Rows,
    network: Network,
    vehicles: int,
    count: int,
    row: int,
    distance: float,
    farthest_behind: float,
    see_behind: bool,
    found: Integers,
    ahead: Floats,
) -> int:
    """Write the rows within `distance` (m) of a vehicle, and how far each is ahead along its lane, m.

    Objects, and vehicles unless `see_behind`, count only if they are less than `farthest_behind` m behind.
    Returns their number.
    """
    lanes, lane = network.lanes, rows.marks[LANE, row]
    x, y = rows.position[row, 0], rows.position[row, 1]
    own = lane_coordinates(lanes, lane, x, y)[0]
    number = 0
    for other in range(count):
        east, south = rows.position[other, 0] - x, rows.position[other, 1] - y
        if other == row or not math.sqrt(east * east + south * south) < distance:
            continue
        further = lane_coordinates(lanes, lane, rows.position[other, 0], rows.position[other, 1])[0] - own
        if (see_behind and other < vehicles) or -farthest_behind < further:
            found[number], ahead[number] = other, further
            number += 1
    return number
