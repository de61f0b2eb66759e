"""The time to collision equals that of two cars with constant speed and heading, found by sampling."""

import math

import numpy as np
import pytest
from athrl_driving.episode.collision_checks import HORIZON, time_to_collision
from athrl_driving.kernels.compilation import compiled
from athrl_driving.kernels.pinned_arrays import Pinned
from athrl_driving.maps import load_town
from athrl_driving.traffic.collision import rectangles_touch
from athrl_driving.traffic.ego_columns import EGO_SIZE
from athrl_driving.traffic.state import Background, environment_views, new_traffic
from hypothesis import given, settings
from hypothesis import strategies as st

EGO_SPEED = 7.0


@compiled
def seconds(background: Background, ego: np.ndarray) -> float:
    return time_to_collision(background, ego)


def one_vehicle(x: float, y: float, heading: float, speed: float, elevation: float = 0.0) -> Background:
    background = environment_views(new_traffic(load_town("town03"), 1, 1), 0).background
    values = {"x": x, "y": y, "heading": heading, "speed": speed, "elevation": elevation}
    for column, value in values.items():
        getattr(background, column)[0] = value
    return background


def ego(speed: float = EGO_SPEED) -> np.ndarray:
    return np.array([0.0, 0.0, 0.0, speed, 4.9, 2.1, 0.0, 1.0])


def by_sampling(background: Background, car: np.ndarray) -> float:
    """The first sampled moment at which the two rectangles touch."""
    for time in np.arange(0.0, HORIZON, 0.005):
        x = background.x[0] + time * background.speed[0] * math.cos(background.heading[0])
        y = background.y[0] + time * background.speed[0] * math.sin(background.heading[0])
        size = background.length[0], background.width[0]
        if rectangles_touch(car[3] * time, 0.0, 0.0, 4.9, 2.1, x, y, background.heading[0], *size):
            return float(time)
    return math.inf


@settings(deadline=None, max_examples=60)
@given(st.floats(6, 40), st.floats(-15, 15), st.floats(-4, 4), st.floats(0, 9))
def test_it_is_when_the_bodies_meet(x: float, y: float, heading: float, speed: float) -> None:
    background = one_vehicle(x, y, heading, speed)
    found, expected = seconds(background, ego()), by_sampling(background, ego())
    if math.isinf(expected) or math.isinf(found):
        # A contact may be shorter than the sampling interval, or begin where sampling ends.
        assert found == expected or min(found, expected) > 0.0
    if math.isfinite(expected):
        assert found == pytest.approx(expected, abs=0.006)


def test_slower_followers_and_vehicles_on_a_bridge_are_no_danger() -> None:
    assert seconds(one_vehicle(20.0, 0.0, 0.0, 0.0), ego()) == pytest.approx((20.0 - 4.95) / EGO_SPEED)
    assert math.isinf(seconds(one_vehicle(20.0, 0.0, 0.0, 0.0), ego(speed=0.0)))
    assert math.isinf(seconds(one_vehicle(-20.0, 0.0, 0.0, 9.0), ego()))
    assert math.isinf(seconds(one_vehicle(20.0, 0.0, 0.0, 0.0, elevation=6.0), ego()))
    assert math.isinf(seconds(one_vehicle(20.0, 0.0, 0.0, EGO_SPEED), ego()))


def test_pinned_tuples_refuse_what_compiled_code_could_not_read() -> None:
    with pytest.raises(TypeError, match="a str cannot be pinned: only arrays, numbers and tuples of them"):
        Pinned(("text",))


def test_the_ego_has_as_many_numbers_as_the_traffic_expects() -> None:
    assert ego().size == EGO_SIZE
