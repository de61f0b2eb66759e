"""The ego moves as highway-env's bicycle does, and brakes only stop it."""

import math

import numpy as np
import pytest
from athrl_driving.envs import EgoVehicle
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.kinematics import Vehicle
from hypothesis import given, settings
from hypothesis import strategies as st

ROAD = Road(RoadNetwork.straight_road_network(1), np_random=np.random.default_rng(0))
COMMANDS = st.lists(st.tuples(st.floats(-0.36, 0.36), st.floats(-3, 3)), min_size=1, max_size=20)


class LongWheelbase(EgoVehicle):
    """The car with its axles where highway-env has them: at the bumpers."""

    WHEELBASE = EgoVehicle.LENGTH


class Reference(Vehicle):
    """highway-env's own motion for a car of the same length."""

    LENGTH = EgoVehicle.LENGTH


@settings(deadline=None)  # the first example compiles
@given(COMMANDS, st.floats(0, 8), st.floats(-4, 4))
def test_motion_is_highway_envs(commands: list[tuple[float, float]], speed: float, heading: float) -> None:
    ego, reference = (
        LongWheelbase(ROAD, [5.0, 1.0], heading, speed),
        Reference(None, [5.0, 1.0], heading, speed),
    )
    for steering, acceleration in commands:
        # Braking beyond a standstill is where the two differ on purpose.
        acceleration = max(acceleration, -reference.speed / 0.1)
        for vehicle in (ego, reference):
            Vehicle.act(vehicle, {"steering": steering, "acceleration": acceleration})
        ego.step(0.1)
        reference.step(0.1)
        np.testing.assert_allclose(ego.position, reference.position, atol=1e-9)
        assert ego.heading == pytest.approx(reference.heading, abs=1e-9)
        assert ego.speed == pytest.approx(reference.speed, abs=1e-9)


def test_brakes_stop_the_car_and_do_not_push_it_back() -> None:
    ego = EgoVehicle(ROAD, [0.0, 0.0], 0.0, 1.0)
    ego.follow(0.0, (8.0, 0.0))
    for _ in range(200):
        ego.act()
        ego.step(0.1)
        assert ego.speed >= 0.0
    assert ego.speed < 0.01


def test_full_lock_is_21_degrees_and_turns_within_eight_metres() -> None:
    ego = EgoVehicle(ROAD, [0.0, 0.0], 0.0, 3.0)
    ego.follow(3.0, (5.0, 5.0))
    ego.act()
    assert ego.steering == pytest.approx(0.3)
    assert ego.action["steering"] == pytest.approx(math.radians(21))
    ego.action = {**ego.action, "acceleration": 0.0}
    places = []
    for _ in range(170):
        ego.step(0.1)
        places.append(ego.position.copy())
    diameter = np.ptp(np.array(places)[:, 1])
    assert 14.0 < diameter < 16.0
    assert np.array(places)[:, 1].max() > 10.0  # to the right, where y grows
