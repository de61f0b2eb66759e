"""Classes that the kernels do not know are refused in one line that names them; all others are accepted."""

from typing import Any

import gymnasium
import highway_env
import numpy as np
import pytest
from athrl_accelerate import accelerate
from athrl_accelerate.supported_classes import UnknownClassError
from highway_env.road.lane import PolyLaneFixedWidth, StraightLane
from highway_env.road.road import Road, RoadNetwork
from highway_env.vehicle.behavior import IDMVehicle
from highway_env.vehicle.objects import Obstacle

assert highway_env  # importing it registers its environments


class Cautious(IDMVehicle):
    TIME_WANTED = 3.0

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self.purpose = "to arrive"

    def honk(self) -> str:
        return "honk"


class Reckless(IDMVehicle):
    def mobil(self, lane_index: tuple) -> bool:
        return True


class Growing(IDMVehicle):
    @property
    def LENGTH(self) -> float:  # noqa: N802
        return 5.0 + 0.1 * self.speed


class Braking(Obstacle):
    def handle_collisions(self, other: object, dt: float = 0) -> None:
        pass


class Rutted(StraightLane):
    def width_at(self, longitudinal: float) -> float:
        return 3.0 + 0.1 * np.sin(longitudinal)


class Icy(Road):
    def step(self, dt: float) -> None:
        super().step(2 * dt)


@pytest.fixture
def environment() -> gymnasium.Env:
    return gymnasium.make("highway-fast-v0", config={"vehicles_count": 3}).unwrapped


def position(environment: Any) -> np.ndarray:
    return environment.vehicle.position + np.array([30.0, 0.0])


def test_unknown_vehicle_class_is_named(environment: Any) -> None:
    environment.road.vehicles.append(Reckless(environment.road, position(environment)))
    with pytest.raises(UnknownClassError, match=r"class .*Reckless: it overrides IDMVehicle\.mobil"):
        accelerate(environment)


def test_an_unknown_vehicle_that_comes_later_is_named(environment: Any) -> None:
    accelerate(environment)
    environment.road.vehicles.append(Reckless(environment.road, position(environment)))
    with pytest.raises(UnknownClassError, match=r"Reckless: it overrides IDMVehicle\.mobil"):
        environment.step(1)


def test_a_method_of_one_vehicle_alone_is_named(environment: Any) -> None:
    environment.road.vehicles[1].act = lambda action=None: None
    with pytest.raises(UnknownClassError, match="IDMVehicle: this one has its own act"):
        accelerate(environment)


def test_a_method_that_one_vehicle_is_given_later_is_named(environment: Any) -> None:
    accelerate(environment)
    with pytest.raises(UnknownClassError, match="MDPVehicle: this one is given its own act"):
        environment.vehicle.act = lambda action=None: None


def test_a_vehicle_whose_size_is_computed_is_named(environment: Any) -> None:
    environment.road.vehicles.append(Growing(environment.road, position(environment)))
    with pytest.raises(UnknownClassError, match=r"Growing: its LENGTH is no number, but computed"):
        accelerate(environment)


def test_unknown_object_class_is_named(environment: Any) -> None:
    environment.road.objects.append(Braking(environment.road, position(environment)))
    with pytest.raises(UnknownClassError, match=r"Braking: it overrides Obstacle\.handle_collisions"):
        accelerate(environment)


def test_unknown_lane_class_is_named(environment: Any) -> None:
    environment.road.network.add_lane("0", "1", Rutted([0, 20], [100, 20]))
    with pytest.raises(UnknownClassError, match=r"lane class .*Rutted: it overrides StraightLane\.width_at"):
        accelerate(environment)


def test_lanes_of_points_are_named(environment: Any) -> None:
    environment.road.network.add_lane("0", "1", PolyLaneFixedWidth([(0, 0), (10, 0), (20, 5)]))
    with pytest.raises(UnknownClassError, match=r"lane class .*PolyLaneFixedWidth: known are StraightLane"):
        accelerate(environment)


def test_unknown_road_and_network_classes_are_named(environment: Any) -> None:
    network = RoadNetwork.straight_road_network(2)
    with pytest.raises(UnknownClassError, match=r"road class .*Icy: it overrides Road\.step"):
        accelerate(environment).road = Icy(network)
    network.__class__ = type("Maze", (RoadNetwork,), {"next_lane": lambda self, index: index})
    with pytest.raises(UnknownClassError, match=r"Maze: it overrides RoadNetwork\.next_lane"):
        environment.road = Road(network)


def test_what_is_not_highway_envs_is_named() -> None:
    with pytest.raises(UnknownClassError, match="CartPoleEnv: it is not an environment of highway-env"):
        accelerate(gymnasium.make("CartPole-v1"))
    with pytest.raises(UnknownClassError, match="str: it is not an environment of highway-env"):
        accelerate("highway-v0")  # type: ignore[type-var]


def test_a_subclass_with_its_own_constructor_parameters_and_helpers_is_known(environment: Any) -> None:
    cautious = Cautious(environment.road, position(environment), speed=20.0)
    environment.road.vehicles.append(cautious)
    accelerate(environment).step(1)
    assert cautious.honk() == "honk"
    assert cautious.purpose == "to arrive"
    assert isinstance(cautious, Cautious)
