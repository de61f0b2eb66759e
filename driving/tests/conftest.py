"""What every test of the room has around it."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from athrl_driving.maps import TOWNS, Town, load_town
from highway_env.vehicle.behavior import IDMVehicle

_CARLA = Path(os.environ.get("ATHRL_TOWNS", Path(__file__).resolve().parents[3] / "shared" / "towns"))
_DRIVING_STYLE = ("COMFORT_ACC_MAX", "COMFORT_ACC_MIN", "DISTANCE_WANTED", "TIME_WANTED")


@pytest.fixture(autouse=True)
def _highway_envs_vehicles_stay_as_they_are() -> Iterator[None]:
    """highway-env's intersection changes the class of its vehicles for the whole process."""
    before = {name: getattr(IDMVehicle, name) for name in _DRIVING_STYLE}
    yield
    for name, value in before.items():
        setattr(IDMVehicle, name, value)


@pytest.fixture(scope="session")
def load_any() -> Callable[[str], Town]:
    """Load a town of the project by its name or one of CARLA's by its file's; skip where that is absent."""

    def load(name: str) -> Town:
        if name in TOWNS:
            return load_town(name)
        if not (_CARLA / name).exists():
            pytest.skip(f"CARLA's {name} is not in {_CARLA}; set ATHRL_TOWNS to the folder that has it")
        return load_town(_CARLA / name)

    return load
