"""Containers of a run for a module's tests; they are started only when they are asked for."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))  # tests is no installed package

from tests.compose.containers import RUN, SETTINGS, Containers


@pytest.fixture(autouse=True, scope="session")
def _asked_for(request: pytest.FixtureRequest) -> None:
    if not request.config.getoption("--compose"):
        pytest.skip("containers only with --compose")


@pytest.fixture(scope="module")
def containers(
    tmp_path_factory: pytest.TempPathFactory, free_port: Callable[[], int]
) -> Iterator[Containers]:
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
        "ATHRL_PROMETHEUS_PORT": str(free_port()),
        "ATHRL_METRICS_LISTEN": "every-address:9464",
        "ATHRL_PAGE_PORT": str(free_port()),
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
