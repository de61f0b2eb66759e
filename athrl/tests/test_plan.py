"""What `athrl train` does with a machine's cores, and which runs it refuses before anything starts."""

import io
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import athrl_driving.maps.town
import pytest
from athrl.errors import CommandError
from athrl.train.comparison import comparison_tables
from athrl.train.plan import Plan, divide_cores, require_world
from athrl_protocol import RunFileError
from athrl_protocol.run_file import (
    EnvironmentSection,
    declare_planners,
    declared_planners,
    read_run_file,
    to_toml,
)
from rich.console import Console

from athrl import runs

FOLDER = Path(athrl_driving.maps.town.__file__).parent / "towns"

SCORES = {
    "episodes": 2.0,
    "return_mean": 3200.0,
    "return_ci95": 80.0,
    "speed_mps": 7.5,
    "distance_m": 380.0,
    "collision_rate": 0.0,
    "off_lane_rate": 0.0,
    "full_episode_rate": 1.0,
    "driving_score": 0.9,
}


@pytest.mark.parametrize(
    ("cores", "threads", "actors"), [(1, 1, 1), (2, 2, 1), (3, 3, 1), (4, 4, 2), (7, 7, 3), (16, 16, 6)]
)
def test_learner_trains_on_every_core_and_more_actors_drive_where_there_are_more(
    cores: int, threads: int, actors: int
) -> None:
    division = divide_cores(cores)
    assert (division.threads, division.actors) == (threads, actors)


def test_more_actors_than_a_machine_can_drive_are_refused_before_any_is_started() -> None:
    assert divide_cores(2, actors=64).actors == 64
    with pytest.raises(CommandError) as refused:
        divide_cores(2, actors=65)
    assert str(refused.value).startswith("--actors 65: should be at most 64 on 2 cores")


def test_services_may_leave_once_the_learners_own_file_says_that_all_experience_is_in(tmp_path: Path) -> None:
    wanted = [f"run.folder={tmp_path}", "run.name=known", "run.environment_steps=400"]
    plan = Plan(read_run_file(None, wanted), run_file=None, overrides=wanted, resume=False)
    services = [plan.actor(1), plan.evaluator(), plan.viewer(9877)]
    facts = tmp_path / "known" / "policies" / "latest.json"
    facts.parent.mkdir(parents=True)
    for content, may_leave in (
        (None, False),
        ("no json", False),
        ("[1]", False),
        ('{"environment_steps": 399}', False),
        ('{"environment_steps": 400}', True),
    ):
        if content is not None:
            facts.write_text(content)
        assert [service.may_leave() for service in services] == [may_leave] * 3
    assert plan.learner(1).may_leave()


def test_what_is_settled_already_stays() -> None:
    division = divide_cores(8, threads=3, actors=5)
    assert (division.threads, division.actors) == (3, 5)


@pytest.mark.parametrize(
    ("cores", "told"),
    [
        (1, "1 core: the learner trains with 1 thread, 1 actor drives beside it"),
        (2, "2 cores: the learner trains with 2 threads, 1 actor drives beside it"),
        (4, "4 cores: the learner trains with 4 threads, 2 actors drive beside it"),
    ],
)
def test_division_is_told_in_one_line(cores: int, told: str) -> None:
    assert str(divide_cores(cores)) == told


def test_every_town_must_have_room_for_the_vehicles() -> None:
    require_world(EnvironmentSection(towns={"town03": 1.0, "town02": 1.0}, vehicles=20))
    with pytest.raises(CommandError, match="vehicles is 800, town02 has room for"):
        require_world(EnvironmentSection(towns={"town03": 1.0, "town02": 1.0}, vehicles=800))


def test_a_fault_of_a_map_is_refused_before_a_run_starts_where_maps_are_strict(tmp_path: Path) -> None:
    text = (FOLDER / "town02.xodr").read_text()
    path = tmp_path / "mine.XODR"
    path.write_text(text.replace('unit="mph"', 'unit="MPH"', 1))
    require_world(EnvironmentSection(towns={str(path): 1.0}, vehicles=20))
    with pytest.raises(ValueError, match=r"^mine.XODR: road 1, line \d+: a unit .+ is read strictly$"):
        require_world(EnvironmentSection(towns={str(path): 1.0}, vehicles=20, strict_map=True))


def drawn(comparison: dict[str, Any]) -> str:
    console = Console(width=80, record=True, file=io.StringIO())
    for table in comparison_tables(comparison):
        console.print(table)
    return console.export_text()


def test_closing_table_of_one_town_has_a_row_a_driver() -> None:
    drivers = {"policy": SCORES, "rule-based": SCORES}
    text = drawn({"policy_version": 7, "town": "town03", "drivers": drivers})
    assert "policy 7 and others, 2 episodes each" in text
    assert text.count("3200 ± 80") == 2
    assert "town" not in text


def test_closing_tables_of_several_towns_are_one_each_and_one_over_all() -> None:
    drivers = {"policy": SCORES}
    towns = {"town03": drivers, "town02": drivers}
    text = drawn({"policy_version": 7, "town": "2 towns", "drivers": drivers, "towns": towns})
    places = [text.index(f"others in {where}, ") for where in ("town03", "town02", "2 towns")]
    assert places == sorted(places)
    assert text.count("3200 ± 80") == 3


@pytest.fixture
def planners() -> Iterator[None]:
    """Run files are held to the planners' settings for the time of a test."""
    before = declared_planners()
    runs.declare_installed_planners()
    yield
    declare_planners(before)


@pytest.mark.usefixtures("planners")
@pytest.mark.parametrize(
    ("setting", "told"),
    [
        ("planner.kind=athlr", "did you mean athrl?"),
        ("planner.hidden_feature=3", "hidden_features"),
        ("planner.hidden_features=3", "planner.hidden_features"),
    ],
)
def test_planner_or_setting_of_one_that_does_not_exist_is_refused_with_the_nearest(
    setting: str, told: str
) -> None:
    with pytest.raises(RunFileError) as caught:
        runs.new_settings(None, [setting])
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.usefixtures("planners")
def test_run_of_one_planner_is_not_resumed_as_one_of_another(tmp_path: Path) -> None:
    folder = tmp_path / "old"
    folder.mkdir()
    (folder / "run.toml").write_text(to_toml(read_run_file(None, ["run.name=old", "planner.kind=ddpg"])))
    assert runs.resumed_settings(str(folder), ["planner.kind=ddpg"])[0].planner.kind == "ddpg"
    with pytest.raises(CommandError, match=r"--set planner\.kind=hdqn: .*/old is a run of the planner ddpg"):
        runs.resumed_settings(str(folder), ["planner.kind=hdqn"])


def test_planners_are_known_without_torch() -> None:
    call = "runs.declare_installed_planners()"
    program = f"import sys; from athrl import runs; {call}; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], timeout=120).returncode == 0
