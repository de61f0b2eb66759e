"""Every planner through the services that all share: trained, compared, resumed, forced, run serially."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from athrl_driving.policy import OnnxPolicy
from filelock import FileLock

from tests.conftest import Command
from tests.serial_runs import drive_serially, everything, require_equal, torch_left_as_it_was

pytestmark = pytest.mark.timeout(300)

Trained = Callable[[str], tuple[Path, str]]

SECONDS = 200.0
DECISIONS, LONGER = 1500, 1800

# Each with a part that the others leave out: memory, a random policy, an update rule, priorities.
PLANNERS: dict[str, dict[str, object]] = {
    "athrl": {"planner.memory": "lstm", "planner.recurrent_features": 8, "replay.burn_in": 2},
    "hddpg": {"planner.update_rule": "sac"},
    "ddpg": {"planner.update_rule": "ddpg", "planner.critic": "scalar", "planner.mirror": "true"},
    "hdqn": {"replay.prioritised": "true"},
}
ACTIONS = {"athrl": "waypoint", "hddpg": "waypoint", "ddpg": "direct", "hdqn": "waypoint-set"}

SERIAL: dict[str, object] = {
    "serial.enabled": "true",
    "run.environment_steps": 400,
    "environment.vehicles": 10,
    "environment.episode_ticks": 120,
    "exploration.random_decisions": 100,
    "planner.hidden_features": 16,
    "planner.head_features": 16,
    "replay.capacity": 300,
    "replay.sequence_length": 10,
    "learner.batch": 40,
    "learner.samples_per_insert": 4,
    "learner.publish_seconds": 0.5,
    "learner.checkpoint_seconds": 1,
    "actor.environments": 3,
    "evaluator.episodes": 2,
    "evaluator.final_episodes": 2,
    "evaluator.seconds_between": 1,
    "serial.trace_updates": 5,
}


@pytest.fixture(scope="session")
def trained(worker_id: str, tmp_path_factory: pytest.TempPathFactory, another_tiny) -> Trained:
    """Gives the folder of a whole run of a kind of planner, and what the run printed.

    Each is run once, whichever of the processes that run tests asks first; tests only read it.
    """
    own = tmp_path_factory.getbasetemp()
    common = (own if worker_id == "master" else own.parent) / "planners"
    common.mkdir(exist_ok=True)

    def train(kind: str) -> tuple[Path, str]:
        printed = common / f"{kind}.txt"
        with FileLock(common / f"{kind}.lock", timeout=SECONDS):
            if not printed.exists():
                printed.write_text(run_to_its_end(common, kind, another_tiny))
        return common / "runs" / kind, printed.read_text()

    return train


def run_to_its_end(folder: Path, kind: str, another_tiny) -> str:
    """Train a planner, compare it, and return what was printed."""
    settings = another_tiny(
        {
            "planner.kind": kind,
            "run.environment_steps": DECISIONS,
            "learner.samples_per_insert": 1.0,
            "actor.environments": 8,
            **PLANNERS[kind],
        }
    )
    command = Command(folder)
    try:
        result = command.run("train", *settings, "--name", kind, "--viewer-port", "0", seconds=SECONDS)
        assert result.returncode == 0, result.stderr
        assert "was ended" not in result.stdout + result.stderr
        assert "ended with code" not in result.stdout + result.stderr
        assert not command.left()
    finally:
        command.end_all()
    return result.stdout


def contents(folder: Path) -> dict[str, str]:
    """The files of a run by their digests, but for logs and the lock."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and "logs" not in path.parts and path.suffix != ".lock"
    }


@pytest.mark.parametrize("kind", PLANNERS)
def test_planner_is_trained_and_compared_through_the_services(trained: Trained, kind: str) -> None:
    folder, printed = trained(kind)
    for driver in ("policy", "random", "blind", "rule-based"):
        assert driver in printed
    description = OnnxPolicy.load(folder / "policies" / "latest.onnx").description
    assert (description.planner, description.action_kind) == (kind, ACTIONS[kind])
    assert any(level.state_size for level in description.levels) == (kind == "athrl")
    comparison = json.loads((folder / "evaluation.json").read_text())
    assert comparison["environment_steps"] >= DECISIONS
    assert set(comparison["drivers"]) == {"policy", "random", "blind", "rule-based"}
    assert json.loads((folder / "policies" / "latest.json").read_text())["updates"] > 20


@pytest.mark.parametrize(
    "kind", ["athrl", *(pytest.param(kind, marks=pytest.mark.slow) for kind in PLANNERS if kind != "athrl")]
)
def test_planner_is_resumed_through_the_services(command, trained: Trained, kind: str) -> None:
    folder = command.folder / "runs" / kind
    shutil.copytree(trained(kind)[0], folder)
    reached = json.loads((folder / "policies" / "latest.json").read_text())
    longer = ["--resume", kind, "--set", f"run.environment_steps={LONGER}", "--viewer-port", "0"]
    resumed = command.run("train", *longer, seconds=SECONDS)
    assert resumed.returncode == 0, resumed.stderr
    assert "rule-based" in resumed.stdout
    assert json.loads((folder / "evaluation.json").read_text())["environment_steps"] >= LONGER
    assert json.loads((folder / "policies" / "latest.json").read_text())["updates"] > reached["updates"]
    assert not command.left()


@pytest.mark.parametrize(
    ("kind", "forced"), [("athrl", "intention=0"), ("ddpg", "steering=0"), ("hdqn", "behaviour=2")]
)
def test_decision_is_forced_on_a_policy_that_makes_it(
    shared_command, trained: Trained, kind: str, forced: str
) -> None:
    policy = trained(kind)[0] / "policies" / "latest.onnx"
    few = ["--episodes", "2", "--set", "environment.episode_ticks=40", "--set", "environment.vehicles=0"]
    words = ["evaluate", "--policy", str(policy), "--force", forced, "--json", *few]
    result = shared_command.run(*words, seconds=SECONDS)
    assert result.returncode == 0, result.stderr
    assert json.loads(result.stdout)["episodes"] == 2


@pytest.mark.parametrize("forced", ["intention=0", "target_speed=100", "target_speed", "waypoint_angle=left"])
def test_decision_that_a_policy_does_not_make_is_refused_in_one_line(
    shared_command, trained: Trained, forced: str
) -> None:
    policy = trained("hddpg")[0] / "policies" / "latest.onnx"
    words = ["evaluate", "--policy", str(policy), "--force", forced, "--episodes", "2", "--json"]
    result = shared_command.run(*words, seconds=SECONDS)
    assert result.returncode == 2, result.stderr
    (line,) = result.stderr.splitlines()
    assert line.startswith(f"athrl: --force {forced}: "), line
    assert result.stdout == ""


@pytest.mark.parametrize("service", ["train", "learner"])
def test_run_is_resumed_as_its_own_planner_alone(shared_command, trained: Trained, service: str) -> None:
    folder, _ = trained("hddpg")
    before = contents(folder)
    words = [service, "--resume", str(folder), "--set", "planner.kind=ddpg"]
    result = shared_command.run(*words, seconds=SECONDS)
    assert result.returncode == 2, result.stderr
    (line,) = result.stderr.splitlines()
    assert "hddpg" in line
    assert "planner.kind=ddpg" in line
    assert contents(folder) == before


def test_checkpoint_of_another_planner_is_refused_and_nothing_is_written(
    shared_command, trained: Trained
) -> None:
    folder = shared_command.folder / "runs" / "swapped"
    shutil.copytree(trained("hddpg")[0], folder)
    of_another = shared_command.run("run-file", "--planner", "ddpg", seconds=SECONDS).stdout
    (folder / "run.toml").write_text(of_another)
    before = contents(folder)
    result = shared_command.run("learner", "--resume", str(folder), seconds=SECONDS)
    assert result.returncode == 2, result.stderr
    (line,) = [line for line in result.stderr.splitlines() if line.startswith("athrl: ")]
    assert "hddpg" in line
    assert "ddpg" in line.replace("hddpg", "")
    assert "Traceback" not in result.stderr
    assert contents(folder) == before


@pytest.fixture(scope="module")
def serial_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Where serial runs of this process are written."""
    with torch_left_as_it_was():
        yield tmp_path_factory.mktemp("serial")


@pytest.mark.parametrize("kind", PLANNERS)
def test_two_halves_of_a_serial_run_equal_the_whole_bit_for_bit(serial_folder: Path, kind: str) -> None:
    chosen = {**SERIAL, "planner.kind": kind, **PLANNERS[kind]}
    settings = [f"{key}={value}" for key, value in chosen.items()]
    whole, halves = f"{kind}-whole", f"{kind}-halves"
    assert drive_serially(serial_folder, whole, settings)
    assert not drive_serially(serial_folder, halves, settings, stop_at=200)
    assert drive_serially(serial_folder, halves, settings, resume=True)
    expected = everything(serial_folder / whole)
    assert expected["state"]["updates"] > 20
    require_equal(expected, everything(serial_folder / halves))
