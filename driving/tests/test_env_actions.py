"""The three kinds of action: their spaces, what they make the ego do, and what is refused."""

import math
import warnings

import athrl_driving  # noqa: F401  (registers the environment)
import gymnasium
import numpy as np
import pytest
from athrl_driving.control import WHEEL_ANGLE_PER_STEERING
from athrl_driving.drivers import DRIVERS, make_driver
from athrl_driving.envs import DirectAction, TownEnv, TownVectorEnv, WaypointAction, WaypointSetAction
from athrl_driving.envs.settings import ACTION_KIND_OF_TYPE
from athrl_driving.traffic.ego_columns import SPEED
from athrl_spaces import ACTION_KINDS, Continuous, Discrete, Limits
from gymnasium import spaces
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import SyncVectorEnv

TYPES = {
    "WaypointAction": WaypointAction,
    "WaypointSetAction": WaypointSetAction,
    "DirectAction": DirectAction,
}
QUIET = {"vehicles_count": 0}


def new_env(action: str, **config: object) -> TownEnv:
    env = TownEnv(config={**QUIET, "action": {"type": action}, **config})
    env.reset(seed=2)
    return env


@pytest.mark.parametrize("action", TYPES)
def test_gymnasiums_checker_finds_nothing(action: str) -> None:
    config = {"vehicles_count": 5, "action": {"type": action}}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(gymnasium.make("athrl/Town03-v0", config=config, render_mode="rgb_array").unwrapped)


def test_every_kind_of_action_has_a_type_and_its_space() -> None:
    assert list(ACTION_KIND_OF_TYPE.values()) == list(ACTION_KINDS)
    for name, kind in ACTION_KIND_OF_TYPE.items():
        env = new_env(name)
        assert type(env.action_type) is TYPES[name]
        described = ACTION_KINDS[kind].describe(Limits())
        if all(isinstance(entry, Discrete) for entry in described):
            assert env.action_space == spaces.MultiDiscrete([len(entry.choices) for entry in described])
        else:
            assert env.action_space == spaces.Box(-1, 1, (2,), np.float32)
            assert all(isinstance(entry, Continuous) for entry in described)


@pytest.mark.parametrize("behaviour", range(3))
@pytest.mark.parametrize("waypoint", range(16))
def test_choices_are_the_speeds_and_places_that_the_papers_set_has(behaviour: int, waypoint: int) -> None:
    env = new_env("WaypointSetAction")
    position, heading = env.vehicle.position.copy(), env.vehicle.heading
    env.step(np.array([behaviour, waypoint]))
    assert env.vehicle.target_speed == pytest.approx([0.0, 3.975, 7.95][behaviour])
    x, y = env.vehicle.waypoint
    distance, angle = (
        math.hypot(x - position[0], y - position[1]),
        math.atan2(y - position[1], x - position[0]),
    )
    assert distance == pytest.approx(4.0 if waypoint < 8 else 8.0)
    expected = -30.0 + 60.0 / 7 * (waypoint % 8)
    assert math.degrees(math.remainder(angle - heading, 2 * math.pi)) == pytest.approx(expected)


def test_a_choice_drives_as_the_same_waypoint_does() -> None:
    chosen, given = new_env("WaypointSetAction"), new_env("WaypointAction")
    for waypoint in (8, 11, 12, 15):
        angle = (2 * (waypoint - 8) / 7 - 1) * math.pi / 6
        for _ in range(2):
            observation = chosen.step(np.array([1, waypoint]))[0]
            expected = given.step(given.action_type.normalised(3.975, angle))[0]
            np.testing.assert_allclose(observation["motion"], expected["motion"], atol=1e-6)


@pytest.mark.parametrize("gain", [0.7, 2.0])
def test_target_speed_is_approached_with_the_gain_of_the_settings(gain: float) -> None:
    """A car that stands and should drive 1 m/s accelerates by as many m/s2 as the gain is, in every form."""
    action = np.float32([2.0 * 1.0 / 7.95 - 1.0, 0.0])
    env = new_env("WaypointAction", speed_gain=gain, ticks_per_decision=1)
    env.step(action)
    assert env.vehicle.action["acceleration"] == pytest.approx(gain, abs=1e-3)
    assert env.vehicle.controller.speed_loop.proportional == gain
    vector = TownVectorEnv(1, config={**QUIET, "speed_gain": gain, "ticks_per_decision": 1})
    vector.reset(seed=2)
    vector.step(action[None])
    assert vector.episodes.state.progress.ego[0, SPEED] == pytest.approx(0.1 * gain, abs=1e-3)
    vector.close()


def test_acceleration_and_steering_hold_for_the_whole_decision() -> None:
    env = new_env("DirectAction", ticks_per_decision=7)
    env.step(env.action_type.normalised(2.0, 0.0))
    assert env.vehicle.speed == pytest.approx(2.0 * 0.7)
    heading, speed = env.vehicle.heading, env.vehicle.speed
    observation = env.step(env.action_type.normalised(0.0, 0.15))[0]
    assert env.vehicle.speed == pytest.approx(speed)
    assert env.vehicle.steering == pytest.approx(0.15)
    assert observation["motion"][1] == pytest.approx(0.5)
    # The bicycle of 2.85 m: at each tick the heading turns by the same angle.
    slip = math.atan(0.5 * math.tan(0.15 * WHEEL_ANGLE_PER_STEERING))
    assert env.vehicle.heading - heading == pytest.approx(0.7 * speed * math.sin(slip) / 1.425)
    env.step(env.action_type.normalised(-3.0, -0.3))
    assert env.vehicle.speed == 0.0  # brakes do not push it backwards
    assert env.vehicle.action["steering"] == pytest.approx(math.radians(-21.0))


def test_direct_commands_have_no_waypoint_and_their_picture_none() -> None:
    env = TownEnv(config={**QUIET, "action": {"type": "DirectAction"}}, render_mode="rgb_array")
    env.reset(seed=2)
    for _ in range(2):
        scene = env.scene()
        assert scene.waypoint is None
        assert env.vehicle.waypoint is None
        assert math.isnan(scene.target_speed)
        picture = env.render()
        assert not (picture == (240, 110, 20)).all(axis=-1).any()
        env.step(np.array([1.0, 0.0], np.float32))
    assert env.scene().acceleration == pytest.approx(3.0)
    env.close()


def test_without_an_action_direct_commands_hold() -> None:
    env = new_env("DirectAction")
    env.step(np.array([0.5, 0.0], np.float32))
    env.step(None)
    assert env.vehicle.speed == pytest.approx(2 * 0.4 * 1.5)


@pytest.mark.parametrize("action", TYPES)
def test_a_vector_does_what_single_environments_do(action: str) -> None:
    config = {"vehicles_count": 20, "episode_ticks": 24, "action": {"type": action}}
    ours = TownVectorEnv(5, config=config)
    theirs = SyncVectorEnv([lambda: TownEnv(config=config)] * 5)
    assert ours.action_space == theirs.action_space
    assert ours.single_action_space == theirs.single_action_space
    ours.action_space.seed(4)
    ours.reset(seed=3)
    theirs.reset(seed=3)
    ended = 0
    for _ in range(20):
        actions = ours.action_space.sample()
        results, expected = ours.step(actions), theirs.step(actions)
        for name in ("image", "motion"):
            np.testing.assert_array_equal(results[0][name], expected[0][name])
        for result, wanted in zip(results[1:4], expected[1:4], strict=True):
            np.testing.assert_array_equal(result, wanted)
        ended += int((results[2] | results[3]).sum())
    assert ended
    ours.close()


@pytest.mark.parametrize("kind", [int, np.int8, np.uint64, np.float32, float])
def test_choices_are_whole_numbers_of_any_type(kind: type) -> None:
    env, vector = (
        new_env("WaypointSetAction"),
        TownVectorEnv(2, config={"action": {"type": "WaypointSetAction"}}),
    )
    env.step(np.array([2, 15], kind))
    assert env.vehicle.target_speed == pytest.approx(7.95)
    vector.reset(seed=1)
    vector.step(np.array([[2, 15], [0, 0]], kind))
    assert vector.environment(0).vehicle.target_speed == pytest.approx(7.95)


@pytest.mark.parametrize(
    ("action", "message"),
    [
        (
            [-1, 0],
            r"the action is \[-1.0, 0.0\], it should be a behaviour from 0 to 2 and a waypoint from 0 to 15",
        ),
        ([3, 0], "a behaviour from 0 to 2"),
        ([0, 16], "a waypoint from 0 to 15"),
        ([0, 7.5], r"the action is \[0.0, 7.5\], it should"),
        ([0, np.nan], r"the action is \[0.0, nan\], it should"),
        ([0, np.inf], r"the action is \[0.0, inf\], it should"),
        ([0, 10**400], "it should be whole numbers"),
        ([0], r"the action has shape \(1,\), it should be \(2,\)"),
        (3, r"the action has shape \(\), it should be \(2,\)"),
        (["stop", "left"], "it should be whole numbers"),
        ([True, False], "it should be whole numbers"),
        ([[1], [2, 3]], "it should be whole numbers"),
    ],
)
def test_an_unknown_choice_is_refused_before_anything_moves(action: object, message: str) -> None:
    env = new_env("WaypointSetAction")
    with pytest.raises(ValueError, match=message) as error:
        env.step(action)
    assert "\n" not in str(error.value)
    assert env.time == 0
    assert env.decisions == 0


@pytest.mark.parametrize("action", [[np.nan, 0.0], [0.0, -np.inf], [0.0], ["1", "0"], [1j, 0.0]])
def test_invalid_commands_are_refused_before_anything_moves(action: object) -> None:
    env = new_env("DirectAction")
    with pytest.raises(ValueError, match="the action") as error:
        env.step(action)
    assert "\n" not in str(error.value)
    assert env.time == 0


def test_a_vector_names_the_environments_with_unknown_choices() -> None:
    vector = TownVectorEnv(3, config={**QUIET, "action": {"type": "WaypointSetAction"}})
    vector.reset(seed=1)
    with pytest.raises(ValueError, match=r"of environments \[1, 2\] is \[0.0, 16.0\]"):
        vector.step(np.array([[0, 0], [0, 16], [-1, 0]]))
    vector.close()


@pytest.mark.parametrize(
    ("action", "message"),
    [
        ({"type": "WaypointAktion"}, "did you mean 'WaypointAction'?"),
        ({"type": "direct"}, "WaypointAction, WaypointSetAction, DirectAction"),
        ({"type": "DirectAction", "speed": 3}, "it should be {'type': 'WaypointAction'}"),
        ({}, "the setting action is {}, it should"),
        ("DirectAction", "did you mean 'DirectAction'?"),
        ({"type": ["DirectAction"]}, "it should be"),
    ],
)
@pytest.mark.parametrize("make", [TownEnv, lambda config: TownVectorEnv(2, config=config)])
def test_an_unknown_action_is_refused_with_its_nearest(make: object, action: object, message: str) -> None:
    with pytest.raises(ValueError, match=r".+") as error:
        make(config={"action": action})
    assert message in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("driver", DRIVERS)
@pytest.mark.parametrize("action", ["WaypointSetAction", "DirectAction"])
def test_drivers_say_that_they_decide_waypoints(driver: str, action: str) -> None:
    env = new_env(action)
    with pytest.raises(ValueError, match=f"decides in WaypointAction, the environment takes {action}"):
        make_driver(driver).reset(env, 0)
