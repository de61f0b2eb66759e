"""A planner of one's own is one file, and one line that names it: all else follows from what it says.

Its run is also one over two towns: the actor drives in both, and results say which town they are of.
"""

from __future__ import annotations

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from athrl_driving.policy import OnnxPolicy

pytestmark = pytest.mark.timeout(300)

SECONDS = 200.0
TOWNS = ("town02", "town03")

THE_FILE = '''
"""A planner that decides the speed first and then the way; it is this file and one line that names it."""

from athrl_planners import LevelPlan, Planner
from athrl_planners.settings import ActorCriticSettings
from athrl_spaces import WAYPOINT
from pydantic import Field


class MySettings(ActorCriticSettings):
    """Speed over way."""

    speed_every: int = Field(default=4, ge=1, le=100, description="The speed is decided every so often.")


class MyPlanner(Planner):
    """The way is decided with the speed in sight."""

    kind = "mine"
    summary = "first the speed, then the way"
    settings = MySettings
    action_kind = WAYPOINT

    @classmethod
    def levels(cls, settings, limits):
        """A level for each entry of the action."""
        speed, angle = cls.actions(limits, settings.noise)
        rule = settings.update_rule
        first = LevelPlan("speed", (speed,), rule, every=settings.speed_every)
        return (first, LevelPlan("way", (angle,), rule))
'''
THE_LINE = "mine = my_planner:MyPlanner"


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """The planner as an installed package has it: the file, and what pip makes of the line in its project."""
    package = tmp_path_factory.mktemp("package")
    made_by_pip = package / "my_planner-0.1.dist-info"
    made_by_pip.mkdir(parents=True)
    (package / "my_planner.py").write_text(THE_FILE)
    (made_by_pip / "METADATA").write_text("Metadata-Version: 2.1\nName: my-planner\nVersion: 0.1\n")
    (made_by_pip / "entry_points.txt").write_text(f"[athrl.planners]\n{THE_LINE}\n")
    with pytest.MonkeyPatch.context() as environment:
        environment.setenv("PYTHONPATH", str(package))
        yield


@pytest.fixture(scope="module")
def trained(installed: None, shared_command, another_tiny) -> subprocess.CompletedProcess[str]:
    """The command's result for a run of the planner in two towns."""
    changes = {
        "planner.kind": "mine",
        "planner.speed_every": 2,
        "environment.towns": json.dumps(TOWNS),
        "learner.samples_per_insert": 1.0,
    }
    words = [*another_tiny(changes), "--name", "own", "--viewer-port", "0"]
    result = shared_command.run("train", *words, seconds=SECONDS)
    assert result.returncode == 0, result.stderr
    return result


@pytest.fixture
def folder(trained: subprocess.CompletedProcess[str], shared_command) -> Path:
    """The folder of that run."""
    return shared_command.folder / "runs" / "own"


def test_planner_of_ones_own_is_one_file_and_one_line(trained, folder: Path, shared_command) -> None:
    assert "rule-based" in trained.stdout
    assert "speed_every = 2" in (folder / "run.toml").read_text()
    description = OnnxPolicy.load(folder / "policies" / "latest.onnx").description
    assert description.planner == "mine"
    assert [level.name for level in description.levels] == ["speed", "way"]
    assert json.loads((folder / "policies" / "latest.json").read_text())["updates"] > 10

    policy = str(folder / "policies" / "latest.onnx")
    few = ["--episodes", "2", "--set", "environment.episode_ticks=40", "--set", "environment.vehicles=0"]
    scored = shared_command.run("evaluate", "--policy", policy, *few, "--json", seconds=SECONDS)
    assert scored.returncode == 0, scored.stderr
    of_its_run = {each["town"]: each["episodes"] for each in json.loads(scored.stdout)["towns"]}
    assert of_its_run == dict.fromkeys(TOWNS, 2)


def test_run_over_two_towns_is_scored_in_each(trained, folder: Path) -> None:
    lines = [json.loads(line) for line in (folder / "evaluations.jsonl").read_text().splitlines()]
    scored = [line for line in lines if line["driver"] == "policy"]
    assert scored
    comparison = json.loads((folder / "evaluation.json").read_text())
    assert list(comparison["towns"]) == list(TOWNS)
    for town in TOWNS:
        assert f"in {town}" in trained.stdout
        assert all(f"{town}/return_mean" in line["scores"] for line in scored)
        assert set(comparison["towns"][town]) == {"policy", "random", "blind", "rule-based"}
        assert comparison["towns"][town]["policy"]["episodes"] == 2
    assert comparison["drivers"]["policy"]["episodes"] == 4
    returns = {town: comparison["towns"][town]["rule-based"]["return_mean"] for town in TOWNS}
    assert returns["town02"] != returns["town03"]


@pytest.mark.usefixtures("installed")
def test_planner_of_ones_own_is_documented_and_checked_as_the_others_are(command) -> None:
    written = command.run("run-file", "--planner", "mine", seconds=SECONDS)
    assert written.returncode == 0, written.stderr
    assert "mine (" in written.stdout
    assert (
        "# The speed is decided every so often. (integer, >= 1, <= 100)\nspeed_every = 4\n" in written.stdout
    )
    for words, told in (
        (["planner.kind=mien"], "did you mean mine?"),
        (["planner.speed_every=2"], 'planner.speed_every is a setting of planner.kind = "mine"'),
        (["planner.kind=mine", "planner.speed_every=0"], "integer, >= 1, <= 100"),
    ):
        sets = [word for setting in words for word in ("--set", setting)]
        result = command.run("train", *sets, seconds=SECONDS)
        assert result.returncode == 2
        (line,) = result.stderr.splitlines()
        assert told in line
