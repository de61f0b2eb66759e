"""Defects of the authors' release that driving must not have; each test fails if its defect comes back.

The numbers are those of its list of nine defects; the remaining ones concern planners and services.
"""

import math

import gymnasium
import numpy as np
import pytest
from athrl_driving.control import WaypointController
from athrl_driving.drivers import RuleBasedDriver
from athrl_driving.envs import TownEnv, TownVectorEnv
from athrl_driving.episode import BEGIN, SET_ACTION, TICK
from gymnasium.vector import AutoresetMode
from hypothesis import given, settings
from hypothesis import strategies as st

ALONE = {"vehicles_count": 0}
ALL_ACTIONS = ["WaypointAction", "WaypointSetAction", "DirectAction"]


def test_defect_3_controllers_keep_their_integral_and_their_last_error_between_ticks() -> None:
    env = TownEnv(config=ALONE)
    env.reset(seed=9)
    reference = WaypointController()
    for decision in range(12):
        action = np.array([-0.2 + 0.03 * decision, 0.02], dtype=np.float32)
        speeds, commands = [], []
        env._do(BEGIN + SET_ACTION, action)
        for _ in range(4):
            speeds.append(env.vehicle.speed)
            env._do(TICK)
            commands.append(env.vehicle.action["acceleration"])
        expected = [reference.acceleration(speed, env.vehicle.target_speed, 0.1) for speed in speeds]
        np.testing.assert_allclose(commands, expected)
    loop = env.vehicle.controller.speed_loop
    assert loop.error_sum == pytest.approx(reference.speed_loop.error_sum)
    assert loop.error_sum != 0.0
    assert loop.last_error is not None
    env.reset(seed=9)
    assert env.vehicle.controller.speed_loop.error_sum == 0.0
    assert env.vehicle.controller.speed_loop.last_error is None


def driven(config: dict, actions: np.ndarray) -> tuple[float, float, float]:
    """Metres ahead and to the right of where an episode on a straight street began, and the angle turned."""
    env = TownEnv(config={**ALONE, "start": ("Meadow Road", -1, 50.0), **config})
    env.reset(seed=4)
    x, y, heading = *env.vehicle.position, env.vehicle.heading
    for action in actions:
        env.step(action)
    dx, dy = env.vehicle.position - (x, y)
    ahead = dx * math.cos(heading) + dy * math.sin(heading)
    right = dy * math.cos(heading) - dx * math.sin(heading)
    return ahead, right, env.vehicle.heading - heading


@settings(deadline=None, max_examples=10)
@given(
    action=st.sampled_from(ALL_ACTIONS),
    first=st.floats(0.1, 1.0),
    sides=st.lists(st.floats(-1.0, 1.0, width=32), min_size=3, max_size=6),
)
def test_defect_4_mirrored_actions_drive_the_mirror_image(
    action: str, first: float, sides: list[float]
) -> None:
    actions = np.array([[first, side] for side in sides], dtype=np.float32)
    mirrored = actions * np.array([1.0, -1.0], dtype=np.float32)
    if action == "WaypointSetAction":
        waypoints = np.array([8 + int((side + 1) * 3.5) for side in sides])
        actions, mirrored = (
            np.stack([np.full(len(sides), 2), each], 1) for each in (waypoints, 23 - waypoints)
        )
    config = {"action": {"type": action}}
    ahead, right, turned = driven(config, actions)
    assert driven(config, mirrored) == pytest.approx((ahead, -right, -turned), abs=1e-6)


@pytest.mark.parametrize("side", [-1, 1])
def test_defect_4_the_car_turns_to_the_side_where_the_waypoint_is(side: int) -> None:
    for heading_of_seed in range(4):
        env = TownEnv(config=ALONE)
        env.reset(seed=heading_of_seed)
        heading = env.vehicle.heading
        for _ in range(3):
            env.step(np.array([0.0, 0.5 * side], dtype=np.float32))
        assert side * (env.vehicle.heading - heading) > 0
        assert side * env.route.lateral > 0
    straight = driven({}, np.array([[0.5, 0.0]] * 6, dtype=np.float32))
    assert straight[0] > 3.0
    assert straight[1] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("speed", [2.0, 5.0, 7.95])
def test_defect_5_the_measured_speed_becomes_the_target_speed(speed: float) -> None:
    env, driver = TownEnv(config=ALONE), RuleBasedDriver()
    env.reset(seed=10)
    for _ in range(40):
        action = driver.act(env)
        action[0] = env.action_type.normalised(speed, 0.0)[0]
        place, info = env.vehicle.position.copy(), env.step(action)[4]
    assert env.vehicle.target_speed == pytest.approx(speed)
    assert env.vehicle.speed == pytest.approx(speed, abs=0.05)
    assert info["speed"] == pytest.approx(speed, abs=0.05)
    assert np.linalg.norm(env.vehicle.position - place) / 0.4 == pytest.approx(speed, rel=0.02)  # m in 0.4 s


@pytest.mark.parametrize("action", ALL_ACTIONS)
def test_defect_9_each_decision_is_one_step_and_each_tick_counts_once(action: str) -> None:
    config = {**ALONE, "action": {"type": action}, "episode_ticks": 14}
    env = gymnasium.make("athrl/Town03-v0", config=config)
    stand = env.action_space.sample() * 0 if action != "DirectAction" else np.zeros(2, np.float32)
    env.reset(seed=2)
    town = env.unwrapped
    for decision, ticks in enumerate((4, 4, 4, 2), start=1):
        *_, truncated, info = env.step(stand)
        assert info["ticks"] == ticks
        assert town.decisions == town.scene().step == decision
        assert town.steps == min(4 * decision, 14)
        assert truncated == (decision == 4)


def test_defect_9_a_vector_counts_a_step_of_each_environment_that_was_stepped() -> None:
    vector = TownVectorEnv(3, config=ALONE, autoreset_mode=AutoresetMode.DISABLED)
    vector.reset(seed=1)
    for _ in range(2):
        vector.step_environments(np.zeros((3, 2), np.float32), np.array([True, False, True]))
    vector.step(np.zeros((3, 2), np.float32))
    assert [vector.scene(e).step for e in range(3)] == [3, 1, 3]
    assert vector.episodes.state.progress.ticks.tolist() == [12, 4, 12]
    vector.close()
