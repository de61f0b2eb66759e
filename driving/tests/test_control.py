"""The controllers follow the textbook, keep their memory, and steer to the side of the waypoint."""

import math

import numpy as np
import pytest
from athrl_driving.control import (
    MAXIMUM_ACCELERATION,
    MAXIMUM_STEERING,
    Pid,
    WaypointController,
    angle_in_frame,
)
from hypothesis import given, settings
from hypothesis import strategies as st

GAINS = {"proportional": 0.7, "derivative": 0.005, "integral": 0.001}

WITHOUT_DEADLINE = settings(deadline=None)  # the first example compiles


@WITHOUT_DEADLINE
@given(st.lists(st.floats(-3.0, 3.0), min_size=1, max_size=40))
def test_pid_equals_the_textbook_sum(errors: list[float]) -> None:
    pid = Pid(**GAINS, limit=100.0)
    outputs = [pid.step(error, 0.1) for error in errors]
    slopes = np.diff(errors, prepend=errors[0]) / 0.1
    expected = 0.7 * np.array(errors) + 0.005 * slopes + 0.001 * np.cumsum(errors) * 0.1
    np.testing.assert_allclose(outputs, expected, atol=1e-12)


def test_pid_keeps_to_its_limit() -> None:
    pid = Pid(**GAINS, limit=0.3)
    assert pid.step(50.0, 0.1) == 0.3
    assert pid.step(-50.0, 0.1) == -0.3


def test_integral_does_not_wind_up_on_the_limit() -> None:
    pid = Pid(0.7, 0.0, 1.0, limit=1.0)
    for _ in range(1000):
        pid.step(10.0, 0.1)
    assert pid.error_sum == 0.0
    assert pid.step(-0.5, 0.1) < 0.0


def test_reset_forgets_and_nothing_else_does() -> None:
    pid = Pid(0.0, 0.0, 1.0, limit=10.0)
    assert [round(pid.step(1.0, 0.1), 9) for _ in range(3)] == [0.1, 0.2, 0.3]
    pid.reset()
    assert pid.step(1.0, 0.1) == pytest.approx(0.1)


@pytest.mark.parametrize("heading", [0.0, 1.0, math.pi / 2, 3.0, -2.0, 7.0])
def test_positive_waypoint_angle_is_to_the_drivers_right(heading: float) -> None:
    # highway-env's y points down: facing along x, the driver's right is where y grows.
    right = (10.0 - math.sin(heading), 5.0 + math.cos(heading))
    assert angle_in_frame(10.0, 5.0, heading, right) == pytest.approx(math.pi / 2)
    ahead = (10.0 + math.cos(heading), 5.0 + math.sin(heading))
    assert angle_in_frame(10.0, 5.0, heading, ahead) == pytest.approx(0.0)


@WITHOUT_DEADLINE
@given(st.floats(-0.5, 0.5), st.floats(-10, 10), st.floats(-50, 50), st.floats(-50, 50))
def test_steering_is_symmetric_in_every_frame(angle: float, heading: float, x: float, y: float) -> None:
    def command(side: float) -> float:
        target = (x + 8.0 * math.cos(heading + side), y + 8.0 * math.sin(heading + side))
        return WaypointController().steering(x, y, heading, target, 0.1)

    assert command(angle) == pytest.approx(-command(-angle), abs=1e-9)
    expected = np.clip(0.7 * angle + 0.001 * angle * 0.1, -MAXIMUM_STEERING, MAXIMUM_STEERING)
    assert command(angle) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("radius", [4.0, 8.0])
def test_a_waypoint_at_right_angles_steers_to_its_side_all_the_way_past_it(side: int, radius: float) -> None:
    """The paper's semicircle has waypoints there, of which rounding must not decide."""
    random = np.random.default_rng(0)
    for x, y, heading in random.uniform(-300.0, 300.0, (200, 3)):
        waypoint = x - side * radius * math.sin(heading), y + side * radius * math.cos(heading)
        controller = WaypointController()
        for driven in (0.0, 0.5, 1.0, 2.0):
            place = x + driven * math.cos(heading), y + driven * math.sin(heading)
            assert controller.steering(*place, heading, waypoint, 0.1) == side * MAXIMUM_STEERING


def test_a_waypoint_behind_has_no_effect() -> None:
    assert WaypointController().steering(0.0, 0.0, 0.0, (-3.0, 1.0), 0.1) == 0.0


def test_speeds_have_the_same_unit() -> None:
    controller = WaypointController()
    assert controller.acceleration(5.0, 5.0, 0.1) == 0.0
    assert controller.acceleration(5.0, 6.0, 0.1) == pytest.approx(2.0 + 0.005 / 0.1 + 0.001 * 0.1)


def test_a_higher_gain_brakes_harder_at_low_speed() -> None:
    mild, firm = WaypointController(speed_gain=0.7), WaypointController()
    assert mild.acceleration(1.0, 0.0, 0.1) == pytest.approx(-0.7, abs=0.001)
    assert firm.acceleration(1.0, 0.0, 0.1) == pytest.approx(-2.0, abs=0.001)


def test_acceleration_keeps_to_its_limit() -> None:
    assert WaypointController().acceleration(0.0, 8.0, 0.1) == MAXIMUM_ACCELERATION
    assert WaypointController().acceleration(8.0, 0.0, 0.1) == -MAXIMUM_ACCELERATION
