"""Lane changes of the traffic follow MOBIL: the own gain, and a part of that of both vehicles behind."""

import itertools

import numpy as np
import pytest
from athrl_driving.kernels.by_reference import by_reference
from athrl_driving.kernels.compilation import entry
from athrl_driving.maps import lane_pose, load_town
from athrl_driving.traffic.ego_columns import EGO_SIZE
from athrl_driving.traffic.idm import REFERENCE_LENGTH, idm_acceleration
from athrl_driving.traffic.mobil import POLITENESS, gain_of_change
from athrl_driving.traffic.spawn import place_vehicles
from athrl_driving.traffic.state import Traffic, environment_traffic, environment_views, new_traffic
from athrl_driving.traffic.tick import advance

NO_EGO = np.zeros(EGO_SIZE)
NOWHERE = np.full(1, -1)
DISTANCE = 20.0


@entry
def gain(traffic: Traffic, vehicle: int, lane: int, other: int, side: int) -> float:
    """The gain of a change in the first environment, after all have found their leaders."""
    own = by_reference(environment_traffic(by_reference(traffic), 0))
    advance(own, NO_EGO, NOWHERE, 0.0)
    return gain_of_change(own, vehicle, lane, other, side, DISTANCE, False)


class Road:
    """Two lanes beside each other in town04, with vehicles at places on them."""

    def __init__(self, vehicles: list[tuple[bool, float, float, float]]) -> None:
        """Each is whether it is on the lane beside, its s (m), its speed and its desired speed (m/s)."""
        self.traffic = new_traffic(load_town("town04"), 1, len(vehicles))
        place_vehicles(self.traffic, 0, np.random.default_rng(0), None, 0.0, NO_EGO)
        self.view = environment_views(self.traffic, 0)
        graph, links = self.view.graph, self.view.lane_links
        inbound = self.view.right_of_way.inbound
        self.lane, self.other = next(
            (lane, int(graph.right[lane]))
            for lane in np.flatnonzero((graph.right >= 0) & (graph.length > 250.0)).tolist()
            if links.mandatory_side[lane] < 0 and inbound[links.link[graph.right[lane]]] == 0
        )
        for vehicle, (beside, s, speed, desired) in enumerate(vehicles):
            self._put(vehicle, self.other if beside else self.lane, s, speed, desired)
        self.view.lane_changes.distance[:] = 0.0

    def _put(self, vehicle: int, lane: int, s: float, speed: float, desired: float) -> None:
        background, links = self.view.background, self.view.lane_links
        background.lane[vehicle], background.s[vehicle], background.speed[vehicle] = lane, s, speed
        background.x[vehicle], background.y[vehicle], background.heading[vehicle] = lane_pose(
            self.view.graph, lane, s
        )
        background.desired_speed[vehicle] = desired
        link = links.link[lane]
        for place in range(background.path.shape[1]):
            background.path[vehicle, place] = link
            link = links.next[links.next_start[link]]

    def gain(self) -> float:
        return float(gain(self.traffic, 0, self.lane, self.other, 1))

    def bumpers(self, behind: int, ahead: int) -> float:
        background = self.view.background
        length = 0.5 * float(background.length[behind] + background.length[ahead])
        return float(background.s[ahead] - background.s[behind]) - length


def acceleration(speed: float, desired: float, gap: float, leader_speed: float) -> float:
    return float(idm_acceleration(speed, desired, gap + REFERENCE_LENGTH, leader_speed))


@pytest.mark.parametrize(("speed", "gap"), list(itertools.product([4.0, 6.0], [12.0, 20.0])))
def test_slow_vehicle_counts_what_the_one_behind_it_gains(speed: float, gap: float) -> None:
    alone = Road([(False, 120.0, speed, speed)]).gain()
    queued = Road([(False, 120.0, speed, speed), (False, 120.0 - gap, speed, 9.0)])
    before = acceleration(speed, 9.0, queued.bumpers(1, 0), speed)
    after = acceleration(speed, 9.0, np.inf, 0.0)
    assert alone == pytest.approx(0.0)
    assert queued.gain() == pytest.approx(POLITENESS * (after - before))
    assert queued.gain() > 0.3


def test_all_three_terms_add_up() -> None:
    road = Road(
        [
            (False, 120.0, 6.0, 9.0),
            (False, 140.0, 4.0, 4.0),  # the leader
            (False, 100.0, 6.0, 8.0),  # the old follower
            (True, 165.0, 7.0, 7.0),  # the new leader
            (True, 85.0, 6.0, 8.0),  # the new follower
        ]
    )
    own = acceleration(6.0, 9.0, road.bumpers(0, 3), 7.0) - acceleration(6.0, 9.0, road.bumpers(0, 1), 4.0)
    old = acceleration(6.0, 8.0, road.bumpers(2, 1), 4.0) - acceleration(6.0, 8.0, road.bumpers(2, 0), 6.0)
    new = acceleration(6.0, 8.0, road.bumpers(4, 0), 6.0) - acceleration(6.0, 8.0, road.bumpers(4, 3), 7.0)
    assert road.gain() == pytest.approx(own + POLITENESS * (old + new), rel=1e-6)


def test_change_that_makes_the_vehicle_behind_brake_hard_is_not_safe() -> None:
    road = Road([(False, 120.0, 4.0, 9.0), (False, 130.0, 2.0, 2.0), (True, 108.0, 9.0, 9.0)])
    assert road.gain() == -np.inf
