"""An accelerated highway-env environment behaves like the slow one."""

import copy
import math
from collections.abc import Iterator
from typing import Any

import gymnasium
import highway_env
import numpy as np
import pytest
from athrl_accelerate import accelerate
from athrl_accelerate.road import AcceleratedRoad
from gymnasium.wrappers import TimeLimit
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.controller import MDPVehicle
from highway_env.vehicle.kinematics import Vehicle

assert highway_env  # importing it registers its environments

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning")

# Few frames per scene: near standstill differences in NumPy's last bit grow (test_free_runs.py).
STEPS = 4

CONTINUOUS = {"action": {"type": "ContinuousAction"}}
FEATURES = ("presence", "x", "y", "vx", "vy", "heading", "cos_h", "sin_h", "cos_d", "sin_d")
FEATURES += ("long_off", "lat_off", "ang_off")
ALL_FEATURES = {
    "observation": {
        "type": "Kinematics",
        "features": list(FEATURES),
        "vehicles_count": 8,
        "see_behind": True,
        "observe_intentions": True,
    }
}


def numbers(value: Any) -> Iterator[float]:
    if isinstance(value, dict):
        for name in value:
            yield from numbers(value[name])
    elif isinstance(value, tuple | list):
        for member in value:
            yield from numbers(member)
    elif value is not None:
        yield from np.asarray(value, dtype=float).ravel().tolist()


def assert_same(one: Any, other: Any) -> None:
    np.testing.assert_allclose(list(numbers(other)), list(numbers(one)), rtol=0, atol=1e-6)


def pair(environment: str, **config: Any) -> list[gymnasium.Env]:
    slow, fast = (gymnasium.make(environment, config=config) for _ in range(2))
    return [slow, accelerate(fast)]


@pytest.mark.parametrize(
    ("environment", "config"),
    [
        ("highway-fast-v0", {}),
        ("highway-fast-v0", CONTINUOUS),
        ("highway-fast-v0", {"action": {"type": "DiscreteAction"}, "controlled_vehicles": 2}),
        ("highway-fast-v0", {"observation": {"type": "OccupancyGrid"}}),
        ("highway-fast-v0", {"observation": {"type": "LidarObservation"}}),
        ("highway-fast-v0", {"observation": {"type": "Kinematics", "order": "shuffled", "absolute": True}}),
        ("highway-fast-v0", {"show_trajectories": True}),
        ("merge-v1", ALL_FEATURES),
        ("merge-generic-v1", {}),
        ("roundabout-v1", ALL_FEATURES),
        ("roundabout-generic-v1", {}),
        ("intersection-v1", {}),
        ("intersection-v2", ALL_FEATURES),
        ("intersection-multi-agent-v1", {}),
        ("two-way-v0", {}),
        ("u-turn-v1", {}),
        ("exit-v1", {}),
        ("racetrack-v1", {}),
        ("parking-v0", {}),
        ("lane-keeping-v0", {}),
    ],
)
def test_highway_observations_and_rewards_stay_those_of_the_slow_one(
    environment: str, config: dict[str, Any]
) -> None:
    peers = pair(environment, **config)
    for seed in (0, 1):
        observations = [peer.reset(seed=seed)[0] for peer in peers]
        assert_same(*observations)
        for peer in peers:
            peer.action_space.seed(seed)
        for _ in range(STEPS):
            steps = [peer.step(peer.action_space.sample()) for peer in peers]
            slow, fast = steps
            assert_same(slow[0], fast[0])
            assert type(slow[0]) is type(fast[0])
            assert getattr(slow[0], "dtype", None) == getattr(fast[0], "dtype", None)
            assert_same(slow[1], fast[1])
            assert slow[2:4] == fast[2:4]
            assert slow[4].keys() == fast[4].keys()
            assert_same(slow[4], fast[4])
            if np.any(slow[2]) or slow[3]:
                break


def test_accelerated_intersection_survives_resets() -> None:
    slow, fast = pair("intersection-v2", spawn_probability=1.0, initial_vehicle_count=6)
    for seed in range(4):
        for peer in (slow, fast):
            peer.reset(seed=seed)
        for _ in range(3):
            for peer in (slow, fast):
                peer.step(1)
            assert [repr(type(v).__name__) for v in slow.unwrapped.road.vehicles] == [
                repr(type(v).__name__) for v in fast.unwrapped.road.vehicles
            ]
        assert isinstance(fast.unwrapped.road, AcceleratedRoad)


def test_accelerating_before_and_after_a_reset_is_the_same() -> None:
    before, after = gymnasium.make("merge-v1"), gymnasium.make("merge-v1")
    accelerate(before).reset(seed=3)
    after.reset(seed=3)
    accelerate(accelerate(after))
    for _ in range(3):
        assert_same(before.step(3)[0], after.step(3)[0])


def test_a_wrapped_environment_is_returned_as_it_is() -> None:
    wrapped = TimeLimit(gymnasium.make("highway-fast-v0"), 5)
    assert accelerate(wrapped) is wrapped
    assert isinstance(wrapped.unwrapped, type(gymnasium.make("highway-fast-v0").unwrapped))


def test_parameters_that_a_scene_gives_its_classes_count_for_vehicles_that_are_there(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    slow, fast = pair("highway-fast-v0", vehicles_density=2)
    for peer in (slow, fast):
        peer.reset(seed=1)
        peer.step(1)
    monkeypatch.setattr(IDMVehicle, "COMFORT_ACC_MAX", 0.5)
    for peer in (slow, fast):
        peer.unwrapped.road.vehicles[3].DISTANCE_WANTED = 30.0
        peer.unwrapped.road.vehicles[4].MAX_SPEED = 10.0
    speeds = []
    for peer in (slow, fast):
        peer.step(1)
        speeds.append([vehicle.speed for vehicle in peer.unwrapped.road.vehicles])
    np.testing.assert_allclose(speeds[1], speeds[0], rtol=0, atol=1e-9)


def test_vehicles_that_are_added_and_removed_are_noticed() -> None:
    peers = pair("highway-fast-v0")
    gone = []
    for peer in peers:
        peer.reset(seed=2)
        peer.step(1)
        road = peer.unwrapped.road
        road.vehicles[5].DELTA = 4.2
        gone.append(road.vehicles.pop(5))
        front = peer.unwrapped.vehicle.position + np.array([20.0, 0.0])
        road.vehicles.append(IDMVehicle(road, front, speed=15.0))
        road.vehicles[3], road.vehicles[4] = road.vehicles[4], road.vehicles[3]
        peer.step(1)
    ours, theirs = ([v.position for v in peer.unwrapped.road.vehicles] for peer in peers)
    np.testing.assert_allclose(ours, theirs, rtol=0, atol=1e-9)
    assert type(gone[1]) is IDMVehicle
    np.testing.assert_allclose(gone[1].position, gone[0].position, rtol=0, atol=1e-9)
    assert gone[1].lane_index == gone[0].lane_index
    assert gone[1].target_speed == pytest.approx(gone[0].target_speed)


def test_a_vehicle_can_move_to_another_road() -> None:
    first, second = (accelerate(gymnasium.make("highway-fast-v0")).unwrapped for _ in range(2))
    for environment in (first, second):
        environment.reset(seed=0)
    vehicle = first.road.vehicles[4]
    second.road.vehicles.append(vehicle)
    second.step(1)
    moved = vehicle.position.copy()
    first.road.vehicles.remove(vehicle)
    first.step(1)
    np.testing.assert_array_equal(vehicle.position, moved)


def test_a_copy_is_independent() -> None:
    environment = accelerate(gymnasium.make("highway-fast-v0")).unwrapped
    environment.reset(seed=0)
    environment.step(1)
    twin = copy.deepcopy(environment)
    positions = [vehicle.position.copy() for vehicle in environment.road.vehicles]
    twin.step(3)
    np.testing.assert_array_equal([vehicle.position for vehicle in environment.road.vehicles], positions)
    environment.step(3)
    assert twin.vehicle.lane is twin.road.network.get_lane(twin.vehicle.lane_index)
    assert twin.vehicle.lane is not environment.vehicle.lane
    np.testing.assert_array_equal(
        [vehicle.position for vehicle in twin.road.vehicles],
        [vehicle.position for vehicle in environment.road.vehicles],
    )


def test_a_vehicle_predicts_its_own_trajectory_as_before() -> None:
    slow, fast = pair("highway-fast-v0", vehicles_count=3)
    for peer in (slow, fast):
        peer.reset(seed=0)
        peer.step(1)
    trajectories = [
        [
            state.position
            for state in peer.unwrapped.vehicle.predict_trajectory(["FASTER", "IDLE"], 1, 0.5, 0.1)
        ]
        for peer in (slow, fast)
    ]
    np.testing.assert_allclose(trajectories[1], trajectories[0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("action", ["DiscreteMetaAction", "ContinuousAction"])
def test_pictures_stay_the_same(action: str) -> None:
    pictures = []
    for accelerated in (False, True):
        environment = gymnasium.make(
            "highway-fast-v0", render_mode="rgb_array", config={"action": {"type": action}}
        )
        if accelerated:
            accelerate(environment)
        environment.reset(seed=0)
        environment.action_space.seed(0)
        environment.step(environment.action_space.sample())
        pictures.append(environment.render())
        environment.close()
    np.testing.assert_array_equal(pictures[0], pictures[1])


def test_rows_are_highway_envs_vehicles() -> None:
    environment = accelerate(gymnasium.make("intersection-v2")).unwrapped
    environment.reset(seed=0)
    ego, other = environment.vehicle, environment.road.vehicles[0]
    assert isinstance(ego, MDPVehicle)
    assert isinstance(other, IDMVehicle)
    assert type(ego) == MDPVehicle  # noqa: E721  highway-env's renderer compares so
    assert type(other) != Vehicle  # noqa: E721
    ego.position[0] += 1.0
    ego.position += np.array([0.0, 2.0])
    ego.action["steering"] = 0.25
    assert ego.action == {"steering": 0.25, "acceleration": ego.action["acceleration"]}
    ego.heading = math.pi
    np.testing.assert_allclose(ego.direction, [-1.0, 0.0], atol=1e-12)
    assert ego.route[0] == ego.lane_index
    length = len(ego.route)
    ego.route.pop(0)
    ego.route.append(("o1", "somewhere", None))
    assert len(ego.route) == length
    ego.route = None
    assert ego.route is None
    assert not hasattr(other, "color")
    other.color = (1, 2, 3)
    assert other.color == (1, 2, 3)


def test_a_lane_that_the_network_does_not_have_is_named() -> None:
    environment = accelerate(gymnasium.make("merge-v1")).unwrapped
    environment.reset(seed=0)
    with pytest.raises(ValueError, match=r"lane index is \('b', 'x', 0\), but the road network has no"):
        environment.vehicle.target_lane_index = ("b", "x", 0)
    environment.vehicle.target_lane_index = ("a", "b", -1)
    assert environment.vehicle.target_lane_index == ("a", "b", 1)
