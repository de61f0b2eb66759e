"""Car-following is that of highway-env, and no vehicle has to brake too late."""

import math

import numpy as np
import pytest
from athrl_driving.traffic.collision import rectangles_touch
from athrl_driving.traffic.idm import approach_speed, idm_acceleration
from highway_env.road.lane import StraightLane
from highway_env.road.road import Road, RoadNetwork
from highway_env.utils import are_polygons_intersecting
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import given, settings
from hypothesis import strategies as st

SPEEDS = st.floats(0.0, 15.0)


def straight_road() -> Road:
    network = RoadNetwork()
    network.add_lane("a", "b", StraightLane((0.0, 0.0), (500.0, 0.0), speed_limit=13.9))
    return Road(network=network)


ROAD = straight_road()


@settings(deadline=None)
@given(
    speed=SPEEDS,
    target=st.floats(0.0, 20.0),
    gap=st.one_of(st.none(), st.floats(0.5, 200.0)),
    leader_speed=SPEEDS,
)
def test_acceleration_is_that_of_highway_env(
    speed: float, target: float, gap: float | None, leader_speed: float
) -> None:
    follower = IDMVehicle(ROAD, (10.0, 0.0), speed=speed)
    follower.target_speed = target
    leader = None if gap is None else Vehicle(ROAD, (10.0 + gap, 0.0), speed=leader_speed)
    expected = follower.acceleration(follower, leader)
    distance = math.inf if leader is None else float(leader.position[0] - follower.position[0])
    found = idm_acceleration(speed, min(target, 13.9), distance, leader_speed)
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9)


@given(distance=st.floats(0.0, 100.0), speed_there=st.floats(0.0, 10.0), deceleration=st.floats(1.0, 6.0))
def test_a_vehicle_that_keeps_the_approach_speed_arrives_slowly_enough(
    distance: float, speed_there: float, deceleration: float
) -> None:
    dt = 0.1
    speed = approach_speed(distance, speed_there, deceleration, dt)
    for _ in range(2000):
        distance -= speed * dt
        if distance <= 0.0 or speed <= speed_there:
            break
        following = approach_speed(distance, speed_there, deceleration, dt)
        assert following >= speed - deceleration * dt - 1e-6
        speed = following
    assert distance >= -1e-6 or speed <= speed_there + 1e-6


@settings(deadline=None)
@given(
    x=st.floats(-6.0, 6.0),
    y=st.floats(-6.0, 6.0),
    heading=st.floats(-4.0, 4.0),
    other_heading=st.floats(-4.0, 4.0),
)
def test_vehicles_touch_when_highway_envs_polygons_intersect(
    x: float, y: float, heading: float, other_heading: float
) -> None:
    one, other = Vehicle(None, (0.0, 0.0), heading), Vehicle(None, (x, y), other_heading)
    expected = are_polygons_intersecting(one.polygon(), other.polygon(), np.zeros(2), np.zeros(2))[0]
    assert rectangles_touch(0.0, 0.0, heading, 5.0, 2.0, x, y, other_heading, 5.0, 2.0) == expected
