"""Where a lane ends, who waits there and who drives beside go one after the other."""

import numpy as np
from athrl_driving.maps import lane_pose, load_town
from athrl_driving.traffic.flow import overlapping_pairs
from athrl_driving.traffic.spawn import place_vehicles
from athrl_driving.traffic.state import EGO_FIELDS, Traffic, environment_views, new_traffic
from athrl_driving.traffic.tick import tick

NO_EGO = np.zeros(EGO_FIELDS)
NOWHERE = np.full(1, -1)

WAITING, STREAM = 4, 12
CRAWL = 0.9
"""m/s; so slow nobody changes lanes but who must, so the stream stays as dense as it is."""


def place_on_link(view: Traffic, vehicle: int, link: int, position: float, desired_speed: float) -> None:
    """Let a vehicle stand `position` metres along a link, with the first way on at every fork."""
    rails, background = view.rails, view.background
    rows = rails.rows[rails.row_start[link] : rails.row_start[link + 1]]
    lane = int(rows[np.searchsorted(rails.link_offset[rows], position, side="right") - 1])
    s = position - rails.link_offset[lane]
    background.lane[vehicle], background.s[vehicle], background.speed[vehicle] = lane, s, 0.0
    background.x[vehicle], background.y[vehicle], background.heading[vehicle] = lane_pose(view.graph, lane, s)
    background.desired_speed[vehicle] = desired_speed
    for place in range(background.path.shape[1]):
        background.path[vehicle, place] = link
        link = rails.next[rails.next_start[link]]


def test_a_dense_stream_lets_those_in_whose_lane_ends_one_for_one() -> None:
    traffic = new_traffic(load_town("town04"), 1, WAITING + STREAM)
    place_vehicles(traffic, 0, np.random.default_rng(0), None, 0.0, NO_EGO)
    view = environment_views(traffic, 0)
    rails, background = view.rails, view.background
    last_row = int(np.flatnonzero(rails.way_out == 0)[1])
    ending, beside = rails.link[last_row], rails.beside[last_row, 0]
    through = rails.link[beside]
    # Where the ending lane's last place to stand is, in metres along the lane beside.
    end = rails.link_offset[beside] + rails.room[ending] - rails.link_offset[last_row]
    for vehicle in range(WAITING):
        place_on_link(view, vehicle, ending, rails.room[ending] - 3.0 - 9.0 * vehicle, 8.0)
    for vehicle in range(STREAM):
        place_on_link(view, WAITING + vehicle, through, end + 20.0 - 7.0 * vehicle, CRAWL)

    came: list[int] = []
    for _ in range(6000):
        tick(traffic, 0, NO_EGO, NOWHERE, 0.1)
        assert overlapping_pairs(background) == 0
        at = rails.link_offset[background.lane] + background.s
        past = (rails.link[background.lane] == through) & (at > end + 5.0)
        came += [vehicle for vehicle in np.flatnonzero(past).tolist() if vehicle not in came]
        if len(came) == WAITING + STREAM:
            break
    assert len(came) == WAITING + STREAM
    let_in = [place for place, vehicle in enumerate(came) if vehicle < WAITING]
    # Not after the stream has passed, but out of its middle; and nobody follows right after another.
    assert came[-1] >= WAITING
    assert np.diff(let_in).min() >= 2
