"""Importing the package registers the environment and loads nothing heavy."""

import subprocess
import sys

import athrl_driving
import gymnasium
import pytest
from athrl_driving.maps import load_town


def run(code: str) -> str:
    result = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120
    )
    return result.stdout


def test_import_is_light() -> None:
    loaded = run("import sys, athrl_driving; print('highway_env' in sys.modules, 'numba' in sys.modules)")
    assert loaded.split() == ["False", "False"]


def test_the_environment_is_made_by_name() -> None:
    env = gymnasium.make("athrl/Town03-v0", config={"vehicles_count": 3})
    env.reset(seed=0)
    assert env.unwrapped.config["vehicles_count"] == 3
    assert isinstance(env.unwrapped, athrl_driving.TownEnv)


def test_the_package_can_be_named_with_the_environment() -> None:
    env = gymnasium.make("athrl_driving:athrl/Town03-v0", config={"vehicles_count": 0})
    assert env.spec is not None
    assert env.spec.id == "athrl/Town03-v0"


def test_the_map_may_be_named_by_the_setting_town() -> None:
    env = gymnasium.make("athrl/OpenDrive-v0", config={"town": "town02", "vehicles_count": 0})
    env.reset(seed=0)
    env.reset(seed=0, options={"config": {"vehicles_count": 1}})
    assert env.unwrapped.town.name == "town02"
    with pytest.raises(ValueError, match=r"^no map was named: give map='PATH.xodr'"):
        gymnasium.make("athrl/OpenDrive-v0", config={"vehicles_count": 0})


def test_lane_polylines_cover_the_town() -> None:
    lines = athrl_driving.lane_polylines("town03")
    assert len(lines) == load_town("town03").graph.length.size
    assert all(line.ndim == 2 and line.shape[1] == 2 and len(line) >= 2 for line in lines)
