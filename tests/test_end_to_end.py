"""A complete run by the command: it grows, ends, is compared, is interrupted and resumed."""

import json
import re
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from athrl.run_view import RunSnapshot

pytestmark = pytest.mark.timeout(900)

RUN_SECONDS = 200.0
START_SECONDS = 240.0


def checkpoints(folder: Path) -> list[Path]:
    return sorted((folder / "checkpoints").glob("*"))


def test_run_trains_evaluates_and_ends_by_itself(
    command, tiny: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONIOENCODING", "ascii")  # in which output has signs that it lacks
    arguments = ["--name", "short", "--actors", "1", "--viewer-port", "0"]
    result = command.run("train", *tiny, *arguments, seconds=RUN_SECONDS)
    assert result.returncode == 0, result.stderr
    for driver in ("policy", "random", "blind", "rule-based"):
        assert driver in result.stdout
    folder = tmp_path / "runs" / "short"
    comparison: dict[str, Any] = json.loads((folder / "evaluation.json").read_text())
    assert set(comparison["drivers"]) == {"policy", "random", "blind", "rule-based"}
    assert comparison["policy_version"] > 0
    assert comparison["environment_steps"] > 0
    assert (folder / "run.toml").is_file()
    assert list((folder / "recordings").glob("*.mcap"))
    assert list((folder / "tensorboard").rglob("*tfevents*"))
    assert {path.name for path in (folder / "logs").iterdir()} >= {
        "learner.log",
        "actor-1.log",
        "evaluator.log",
    }
    log = (folder / "logs" / "learner.log").read_text()
    assert re.search(r"(warming up|training): \d+ of 800 environment steps", log)
    for driver in (f"policy {comparison['policy_version']}", "random", "blind", "rule-based"):
        assert re.search(rf"{driver} in town03: 2 episodes, return -?\d+ \+- \d+, ", log)
    assert not command.left()

    policy = folder / "policies" / "latest.onnx"
    scores = command.run(
        "evaluate", "--policy", str(policy), "--episodes", "2", "--seed", "5", "--json", seconds=120
    )
    assert scores.returncode == 0, scores.stderr
    facts = json.loads(scores.stdout)
    wanted = (
        "episodes return_mean return_ci95 speed_mps distance_m collision_rate off_lane_rate full_episode_rate"
        " success_rate"
    )
    assert set(wanted.split()) <= set(facts)


def has_updated(more_than: int) -> Callable[[RunSnapshot], bool]:
    """Whether a run's learner has made more than so many updates."""
    return lambda run: run.state is not None and run.state.updates > more_than


LONG = ("--actors", "1", "--viewer-port", "0", "--set", "run.environment_steps=1000000")


def test_interrupted_run_goes_on_and_what_is_killed_in_it_is_started_again(
    command, seen, tiny: list[str], port: int, tmp_path: Path
) -> None:
    address, folder = f"tcp/127.0.0.1:{port}", tmp_path / "runs" / "long"

    first = command.start("train", *tiny, *LONG, "--name", "long")
    seen(address, "long", has_updated(20), START_SECONDS)
    first.send_signal(signal.SIGINT)
    assert first.wait(timeout=90) == 130, command.said(first)
    assert "--resume" in command.said(first)
    assert checkpoints(folder)
    assert not command.left()
    reached = json.loads((folder / "policies" / "latest.json").read_text())

    def kill(service: str) -> None:
        for process in command.left():
            if process.cmdline()[3:4] == [service]:
                process.kill()
                return
        raise AssertionError(f"no {service} is running")

    second = command.start("train", "--resume", "long", "--actors", "1", "--viewer-port", "0")
    seen(address, "long", has_updated(reached["updates"]), START_SECONDS)
    result = command.run("status", "--connect", address, "--run", "long", "--json", seconds=60)
    assert json.loads(result.stdout)["environment_steps"] >= reached["environment_steps"]
    kill("actor")
    command.wait_until_said(second, "actor-1 was ended by signal 9", 30)
    seen(address, "long", lambda now: ("actor", "actor-1") in now.metrics, START_SECONDS)
    # So that it resumes from there.
    seen(address, "long", lambda now: now.learner_metric("checkpoints_written"), START_SECONDS)
    kill("learner")
    command.wait_until_said(second, "learner was ended by signal 9", 30)
    seen(address, "long", has_updated(reached["updates"] + 20), START_SECONDS)
    second.send_signal(signal.SIGTERM)
    assert second.wait(timeout=90) == 130, command.said(second)
    assert not command.left()


def test_no_process_outlives_a_killed_command(command, seen, eventually, tiny: list[str], port: int) -> None:
    run = command.start("train", *tiny, *LONG, "--name", "orphans")
    address = f"tcp/127.0.0.1:{port}"
    seen(address, "orphans", lambda now: ("evaluator", "evaluator") in now.present, START_SECONDS)
    run.kill()
    eventually(lambda: not command.left(), 60)
