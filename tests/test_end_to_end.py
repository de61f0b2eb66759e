"""A complete run by the command: it grows, ends, is compared, is interrupted and resumed."""

import json
import re
import signal
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.timeout(300)

RUN_SECONDS = 200.0


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


def test_interrupted_run_leaves_a_checkpoint_and_goes_on(
    command, eventually, tiny: list[str], port: int, tmp_path: Path
) -> None:
    arguments = [
        "--name",
        "long",
        "--actors",
        "1",
        "--viewer-port",
        "0",
        "--set",
        "run.environment_steps=1000000",
    ]
    address = f"tcp/127.0.0.1:{port}"

    def status() -> dict[str, Any]:
        result = command.run("status", "--connect", address, "--run", "long", "--json", seconds=60)
        return json.loads(result.stdout) if result.returncode == 0 else {}

    first = command.start("train", *tiny, *arguments)
    eventually(lambda: status().get("updates", 0) > 20, 120)
    first.send_signal(signal.SIGINT)
    assert first.wait(timeout=90) == 130, command.said(first)
    assert "--resume" in command.said(first)
    assert checkpoints(tmp_path / "runs" / "long")
    assert not command.left()
    reached = json.loads((tmp_path / "runs" / "long" / "policies" / "latest.json").read_text())

    second = command.start("train", "--resume", "long", "--actors", "1", "--viewer-port", "0")
    eventually(lambda: status().get("updates", 0) > reached["updates"], 120)
    assert status()["environment_steps"] >= reached["environment_steps"]
    second.send_signal(signal.SIGTERM)
    assert second.wait(timeout=90) == 130, command.said(second)
    assert not command.left()


def test_killed_actor_and_killed_learner_are_started_again(
    command, eventually, tiny: list[str], port: int
) -> None:
    arguments = [
        "--name",
        "hit",
        "--actors",
        "1",
        "--viewer-port",
        "0",
        "--set",
        "run.environment_steps=1000000",
    ]
    address = f"tcp/127.0.0.1:{port}"

    def status() -> dict[str, Any]:
        result = command.run("status", "--connect", address, "--run", "hit", "--json", seconds=60)
        return json.loads(result.stdout) if result.returncode == 0 else {}

    def kill(service: str) -> None:
        for process in command.left():
            if process.cmdline()[3:4] == [service]:
                process.kill()
                return
        raise AssertionError(f"no {service} is running")

    run = command.start("train", *tiny, *arguments)
    eventually(lambda: status().get("updates", 0) > 20, 120)
    kill("actor")
    command.wait_until_said(run, "actor-1 was ended by signal 9", 30)
    eventually(lambda: "actor-1" in status().get("actors", {}), 60)
    # The learner's first checkpoint is two seconds old by now: it resumes from there.
    kill("learner")
    command.wait_until_said(run, "learner was ended by signal 9", 30)
    eventually(lambda: status().get("updates", 0) > 20, 120)
    run.send_signal(signal.SIGINT)
    assert run.wait(timeout=90) == 130, command.said(run)


def test_no_process_outlives_a_killed_command(command, eventually, tiny: list[str], port: int) -> None:
    arguments = ["--name", "orphans", "--actors", "1", "--viewer-port", "0"]
    run = command.start("train", *tiny, *arguments, "--set", "run.environment_steps=1000000")
    address = f"tcp/127.0.0.1:{port}"
    status = ["status", "--connect", address, "--run", "orphans", "--check", "evaluator"]
    eventually(lambda: command.run(*status, seconds=60).returncode == 0, 120)
    run.kill()
    eventually(lambda: not command.left(), 60)
