"""Where a lane ends, waiting vehicles and those on the lane beside merge one by one."""

import numpy as np
from athrl_driving.maps import lane_pose, load_town
from athrl_driving.traffic.ego_columns import EGO_SIZE
from athrl_driving.traffic.flow import overlapping_pairs
from athrl_driving.traffic.spawn import place_vehicles
from athrl_driving.traffic.state import Traffic, environment_views, new_traffic
from athrl_driving.traffic.tick import tick

NO_EGO = np.zeros(EGO_SIZE)
NOWHERE = np.full(1, -1)

WAITING, STREAM = 4, 12
CRAWL = 0.9
"""m/s; at this speed only mandatory lane changes begin, so the stream stays as dense as it is."""


def place_on_link(view: Traffic, vehicle: int, link: int, position: float, desired_speed: float) -> None:
    """Let a vehicle stand `position` metres along a link, with the first link at every fork as its path."""
    lane_links, background = view.lane_links, view.background
    lanes = lane_links.lanes[lane_links.lane_start[link] : lane_links.lane_start[link + 1]]
    lane = int(lanes[np.searchsorted(lane_links.link_offset[lanes], position, side="right") - 1])
    s = position - lane_links.link_offset[lane]
    background.lane[vehicle], background.s[vehicle], background.speed[vehicle] = lane, s, 0.0
    background.x[vehicle], background.y[vehicle], background.heading[vehicle] = lane_pose(view.graph, lane, s)
    background.desired_speed[vehicle] = desired_speed
    for place in range(background.path.shape[1]):
        background.path[vehicle, place] = link
        link = lane_links.next[lane_links.next_start[link]]


def test_a_dense_stream_lets_those_in_whose_lane_ends_one_for_one() -> None:
    traffic = new_traffic(load_town("town04"), 1, WAITING + STREAM)
    place_vehicles(traffic, 0, np.random.default_rng(0), None, 0.0, NO_EGO)
    view = environment_views(traffic, 0)
    lane_links, background = view.lane_links, view.background
    last_lane = int(np.flatnonzero(lane_links.mandatory_side == 0)[1])
    ending, beside = lane_links.link[last_lane], lane_links.beside[last_lane, 0]
    through = lane_links.link[beside]
    # Where the ending lane's last place to stand is, in metres along the lane beside.
    end = lane_links.link_offset[beside] + lane_links.room[ending] - lane_links.link_offset[last_lane]
    for vehicle in range(WAITING):
        place_on_link(view, vehicle, ending, lane_links.room[ending] - 3.0 - 9.0 * vehicle, 8.0)
    for vehicle in range(STREAM):
        place_on_link(view, WAITING + vehicle, through, end + 20.0 - 7.0 * vehicle, CRAWL)

    came: list[int] = []
    for _ in range(6000):
        tick(traffic, 0, NO_EGO, NOWHERE, 0.1)
        assert overlapping_pairs(background) == 0
        at = lane_links.link_offset[background.lane] + background.s
        past = (lane_links.link[background.lane] == through) & (at > end + 5.0)
        came += [vehicle for vehicle in np.flatnonzero(past).tolist() if vehicle not in came]
        if len(came) == WAITING + STREAM:
            break
    assert len(came) == WAITING + STREAM
    let_in = [place for place, vehicle in enumerate(came) if vehicle < WAITING]
    # They merge into the middle of the stream, not after it, and no two of them right after each other.
    assert came[-1] >= WAITING
    assert np.diff(let_in).min() >= 2
