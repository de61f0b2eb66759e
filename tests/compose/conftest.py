"""Containers of a run for a module's tests; they are started only when they are asked for."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))  # tests is no installed package

from tests.compose.containers import RUN, Containers

# A run that never ends by itself, is small enough for two cores, and keeps its whole log.
SETTINGS = {
    "run.environment_steps": 10_000_000,
    "environment.vehicles": 20,
    "environment.episode_ticks": 120,
    "exploration.random_decisions": 200,
    "planner.hidden_features": 32,
    "planner.head_features": 32,
    "planner.memory": "lstm",
    "planner.recurrent_features": 16,
    "replay.capacity": 100_000,
    "learner.batch": 128,
    "learner.samples_per_insert": 4.0,
    "actor.environments": 4,
    "evaluator.episodes": 2,
    "evaluator.final_episodes": 2,
    "evaluator.seconds_between": 5.0,
}


@pytest.fixture(autouse=True, scope="session")
def _asked_for(request: pytest.FixtureRequest) -> None:
    if not request.config.getoption("--compose"):
        pytest.skip("containers only with --compose")


@pytest.fixture(scope="module")
def containers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Containers]:
    """The run's containers, none of them started; at the end they are taken down with their volumes."""
    folder = tmp_path_factory.mktemp("compose")
    evidence = folder / "evidence"
    evidence.mkdir()
    evidence.chmod(0o777)  # for the user in the containers
    port = free_port()
    environment = {
        **os.environ,
        "COMPOSE_PROFILES": "router",
        "ATHRL_RUN": RUN,
        "ATHRL_SET": " ".join(f"{key}={value}" for key, value in SETTINGS.items()),
        "ATHRL_PORT": str(port),
        "ATHRL_VIEWER_PORT": str(free_port()),
        "ATHRL_EVIDENCE": str(evidence),
    }
    containers = Containers(compose_command(), environment, port, folder)
    containers.run("down", "--volumes", "--timeout", "10")
    try:
        yield containers
    finally:
        print(containers.run("logs", "--tail", "20", "--no-color"))
        containers.run("down", "--volumes", "--timeout", "10")


def compose_command() -> list[str]:
    """Return Compose 2 where it is there, else Compose 1."""
    for command in (["docker", "compose"], ["docker-compose"]):
        try:
            if subprocess.run([*command, "version"], capture_output=True, timeout=60).returncode == 0:
                return command
        except FileNotFoundError:
            continue
    pytest.fail("neither docker compose nor docker-compose is installed")


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
