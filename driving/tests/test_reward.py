"""Each term of the reward, calculated by hand from the weights 200, 1, 10, 1, 5, 0.2 and -0.1."""

import math

import pytest
from athrl_driving.reward import REWARD_TERMS, has_left_lane, tick_reward_terms

STANDING = {
    "collision": False,
    "speed": 0.0,
    "heading_error": 0.0,
    "lateral_offset": 0.0,
    "steering": 0.0,
}


def terms(**changes: object) -> dict[str, float]:
    return tick_reward_terms(**{**STANDING, **changes})  # type: ignore[arg-type]


def test_standing_costs_a_tenth_a_tick() -> None:
    assert terms() == {**dict.fromkeys(REWARD_TERMS, 0.0), "constant": -0.1}


def test_a_clean_tick_at_five_metres_a_second() -> None:
    assert sum(terms(speed=5.0).values()) == pytest.approx(4.9)


def test_only_speed_along_the_route_counts() -> None:
    assert terms(speed=6.0, heading_error=math.pi / 3)["speed"] == pytest.approx(3.0)
    assert terms(speed=6.0, heading_error=math.pi)["speed"] == pytest.approx(-6.0)


@pytest.mark.parametrize(("speed", "expected"), [(7.95, 0.0), (8.0, 0.0), (8.01, -10.0)])
def test_more_than_eight_metres_a_second_costs_ten(speed: float, expected: float) -> None:
    assert terms(speed=speed)["fast"] == expected


def test_fast_is_judged_along_the_route() -> None:
    assert terms(speed=9.0, heading_error=math.pi / 3)["fast"] == 0.0


def test_a_collision_costs_two_hundred() -> None:
    assert terms(collision=True)["collision"] == -200.0


@pytest.mark.parametrize(("offset", "left"), [(2.0, False), (-2.0, False), (2.001, True), (-2.001, True)])
def test_two_metres_off_the_route_is_out_on_either_side(offset: float, left: bool) -> None:
    assert has_left_lane(offset) is left
    assert terms(lateral_offset=offset)["out"] == (-1.0 if left else 0.0)


@pytest.mark.parametrize("side", [1, -1])
def test_steering_costs_by_its_square_and_by_lateral_acceleration(side: int) -> None:
    result = terms(speed=4.0, steering=0.2 * side)
    assert result["steer"] == pytest.approx(-5 * 0.04)
    assert result["lateral"] == pytest.approx(-0.2 * 0.2 * 16)
    assert sum(result.values()) == pytest.approx(4.0 - 0.2 - 0.64 - 0.1)
