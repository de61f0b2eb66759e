"""Actions, their exploration and the kinds that environments take, against figures worked out by hand."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from athrl_spaces import (
    ACTION_KINDS,
    DIRECT,
    WAYPOINT,
    WAYPOINT_SET,
    Continuous,
    Discrete,
    Epsilon,
    Limits,
    Noise,
    Observation,
    action_kind,
    ranks,
)
from athrl_spaces.action_kinds import waypoint_directions


def test_ranks_lie_evenly_and_a_single_one_in_the_middle() -> None:
    assert ranks(1).tolist() == [0.5]
    assert ranks(2).tolist() == [0.0, 1.0]
    np.testing.assert_allclose(ranks(5), [0, 0.25, 0.5, 0.75, 1])


def test_exploration_rises_with_the_rank() -> None:
    places = np.array([0.0, 0.5, 1.0])
    np.testing.assert_allclose(Noise(0.1, 0.5).deviations(places), [0.1, 0.3, 0.5])
    np.testing.assert_allclose(Epsilon(0.02, 0.2).probabilities(places), [0.02, 0.11, 0.2])


def test_continuous_action_is_normalised_about_its_centre() -> None:
    action = Continuous("acceleration", "m/s2", -1.0, 5.0)
    assert (action.centre, action.half_range, action.bounds) == (2.0, 3.0, (-1.0, 5.0))


def test_bounds_of_a_choice_are_its_first_and_last_index() -> None:
    assert Discrete("behaviour", ("stop", "slow", "drive")).bounds == (0.0, 2.0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Noise(0.4, 0.2), "the deviations of noise are 0.4..0.2; they should rise from 0"),
        (lambda: Noise(-0.1, 0.2), "the deviations of noise are -0.1..0.2; they should rise from 0"),
        (lambda: Noise(math.nan, 1.0), "the deviations of noise are nan..1.0; they should rise from 0"),
        (lambda: Noise(0.1, 0.2, 0.0), "the damping of noise is 0.0; it should be above 0, at most 1"),
        (lambda: Epsilon(0.1, 1.2), "epsilon is 0.1..1.2; it should rise within 0..1"),
        (
            lambda: Continuous("angle", "rad", 1.0, 1.0),
            "the range of angle is 1.0..1.0; low must be below high",
        ),
        (lambda: Discrete("side", ("left",)), "side has 1 choices; there should be 2 or more"),
        (
            lambda: Discrete("side", ("left", "right"), mirrored=(1, 1)),
            "the mirrored choices of side should be each of its choices once",
        ),
        (lambda: Observation(7), "image_size is 7; it should be 8 or more"),
        (
            lambda: action_kind("waypoints"),
            "there is no kind of action 'waypoints'; there are waypoint, waypoint-set, direct",
        ),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(make: Any, message: str) -> None:
    with pytest.raises(ValueError) as refused:  # noqa: PT011  (the whole text is compared)
        make()
    assert str(refused.value) == message


def test_kinds_describe_their_entries_under_an_environments_limits() -> None:
    limits = Limits(maximum_speed=10.0, waypoint_radius=6.0, waypoint_half_angle=0.5)
    speed, angle = action_kind(WAYPOINT).describe(limits)
    assert (speed.bounds, angle.bounds) == ((0.0, 10.0), (-0.5, 0.5))
    behaviour, waypoint = action_kind(WAYPOINT_SET).describe(limits)
    assert isinstance(behaviour, Discrete)
    assert isinstance(waypoint, Discrete)
    assert behaviour.choices == ("stop: 0 m/s", "slow: 5 m/s", "drive: 10 m/s")
    assert len(waypoint.choices) == 16
    assert waypoint.choices[0] == "3 m at -28.6 degrees"
    assert waypoint.choices[15] == "6 m at 28.6 degrees"
    acceleration, steering = action_kind(DIRECT).describe(limits)
    assert (acceleration.bounds, steering.bounds) == ((-3.0, 3.0), (-0.3, 0.3))


@pytest.mark.parametrize("name", ACTION_KINDS)
def test_kinds_name_the_entries_that_they_describe(name: str) -> None:
    kind = action_kind(name)
    described = kind.describe(Limits())
    assert tuple(action.name for action in described) == kind.entries
    assert len({type(action) for action in described}) == 1


def test_directions_go_evenly_from_left_to_right() -> None:
    directions = waypoint_directions(0.7)
    np.testing.assert_allclose(directions, np.linspace(-0.7, 0.7, 8))


def test_mirrored_waypoint_is_the_one_at_the_opposite_angle() -> None:
    _, waypoint = action_kind(WAYPOINT_SET).describe(Limits())
    assert isinstance(waypoint, Discrete)
    directions = waypoint_directions(0.5)
    for index, other in enumerate(waypoint.mirrored):
        assert other // 8 == index // 8
        assert directions[other % 8] == pytest.approx(-directions[index % 8])


def test_what_goes_sideways_is_told() -> None:
    sideways = {
        action.name: action.sideways
        for name in (WAYPOINT, DIRECT)
        for action in action_kind(name).describe(Limits())
        if isinstance(action, Continuous)
    }
    assert sideways == {
        "target_speed": False,
        "waypoint_angle": True,
        "acceleration": False,
        "steering": True,
    }
