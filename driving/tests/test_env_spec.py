"""What names an environment: its id, its arguments, and the spec that gymnasium makes of them."""

from __future__ import annotations

import copy
from collections.abc import Callable
from pathlib import Path

import athrl_driving
import gymnasium
import numpy as np
import pytest
from athrl_driving.envs import TownEnv, TownVectorEnv
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode

TOWN02 = Path(athrl_driving.__path__[0]) / "maps" / "towns" / "town02.xodr"


@pytest.fixture
def start() -> tuple[str, int, float]:
    town = TownEnv({"vehicles_count": 0}, map="town02").town
    return town.road_name[0], int(town.lane_id[0]), 5.0


def test_a_spec_with_a_path_is_written_as_json_and_makes_the_same_environment(
    start: tuple[str, int, float],
) -> None:
    config = {"vehicles_count": np.int64(3), "start": start}
    env = gymnasium.make("athrl/OpenDrive-v0", map=TOWN02, config=config)
    assert env.spec is not None
    text = env.spec.to_json()
    again = gymnasium.make(EnvSpec.from_json(text))
    assert again.spec is not None
    assert again.spec.to_json() == text
    first, second = env.reset(seed=4), again.reset(seed=4)
    np.testing.assert_array_equal(first[0]["image"], second[0]["image"])
    assert env.unwrapped.scene().ego == again.unwrapped.scene().ego


def test_the_spec_of_a_vector_makes_the_same_vector() -> None:
    arguments = {"map": TOWN02, "config": {"vehicles_count": 3}, "autoreset_mode": AutoresetMode.SAME_STEP}
    envs = gymnasium.make_vec("athrl/OpenDrive-v0", num_envs=2, **arguments)
    assert envs.spec is not None
    again = gymnasium.make_vec(EnvSpec.from_json(envs.spec.to_json()))
    assert again.num_envs == 2
    assert again.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
    np.testing.assert_array_equal(envs.reset(seed=4)[0]["image"], again.reset(seed=4)[0]["image"])


def test_a_spec_that_is_given_stays_as_it_was() -> None:
    given = copy.deepcopy(gymnasium.spec("athrl/OpenDrive-v0"))
    given.kwargs["map"] = TOWN02
    assert gymnasium.make(given, config={"vehicles_count": 0}).unwrapped.town.name == "town02"
    assert given.kwargs["map"] is TOWN02


@pytest.mark.parametrize("kind", ["make", "make_vec"])
def test_a_map_is_named_by_a_town_a_text_a_path_or_a_home(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "mine.xodr").symlink_to(TOWN02)
    make = getattr(gymnasium, kind)
    for name in ("town02", str(TOWN02), TOWN02, "~/mine.xodr", Path("~/mine.xodr")):
        env = make("athrl/OpenDrive-v0", map=name, config={"vehicles_count": 0}).unwrapped
        assert env.town.lane_kilometres > 1
        assert env.config["town"] == str(name)
        same = make("athrl/Town03-v0", map=name, config={"vehicles_count": 0, "town": name}).unwrapped
        assert same.config["town"] == str(name)


@pytest.mark.parametrize("make", [TownEnv, TownVectorEnv])
@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"mapp": "town02"}, r"no argument 'mapp', did you mean 'map'\?"),
        ({"senario": "x"}, r"no argument 'senario', did you mean 'scenario'\?"),
        ({"vehicle_count": 3}, r"'vehicle_count', did you mean the setting config=\{'vehicles_count': 3\}\?"),
        ({"vehicles_count": 3}, r"'vehicles_count'; a setting is given as config=\{'vehicles_count': 3\}"),
        ({"qqq": 3}, r"no argument 'qqq', there are .*config, render_mode, map, scenario"),
    ],
)
def test_a_misspelt_argument_is_refused_with_the_nearest(
    make: Callable[..., object], arguments: dict[str, object], message: str
) -> None:
    with pytest.raises(TypeError, match=message) as error:
        make(**arguments)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("make", [TownEnv, TownVectorEnv])
def test_a_map_that_is_no_name_is_refused_in_one_line(make: Callable[..., object]) -> None:
    with pytest.raises(ValueError, match=r"map is 3, it should be one of town02, .*\(.xodr\)"):
        make(map=3)
    with pytest.raises(ValueError, match=r"the setting town is b'town02', it should be one of town02"):
        make(config={"town": b"town02"})
