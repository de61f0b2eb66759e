"""Fixtures for all tests of the package."""

from collections.abc import Iterator

import pytest
from highway_env.vehicle.behavior import IDMVehicle

_DRIVING_STYLE = ("COMFORT_ACC_MAX", "COMFORT_ACC_MIN", "DISTANCE_WANTED", "TIME_WANTED")


@pytest.fixture(autouse=True)
def _highway_envs_vehicles_stay_as_they_are() -> Iterator[None]:
    """highway-env's intersection changes the class of its vehicles for the whole process."""
    before = {name: getattr(IDMVehicle, name) for name in _DRIVING_STYLE}
    yield
    for name, value in before.items():
        setattr(IDMVehicle, name, value)
