"""The run as containers: it grows, a killed actor comes back, and nothing is left of it.

Needs a Docker engine, the Compose tool and the images (`make images`). The run is looked at with what a user
has: `athrl status --json` at the learner's published port, and Docker.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parents[2]
PROJECT = "athrl-compose-check"
RUN = "check"
# A run that is long enough to be watched and small enough for two cores; it is taken down before its end.
SETTINGS = {
    "run.environment_steps": 100_000,
    "environment.vehicles": 20,
    "environment.episode_ticks": 120,
    "exploration.random_decisions": 200,
    "planner.hidden_features": 32,
    "planner.recurrent_features": 16,
    "replay.capacity": 5000,
    "learner.batch": 8,
    "learner.samples_per_insert": 4.0,
    "actor.environments": 4,
    "evaluator.episodes": 2,
    "evaluator.seconds_between": 5.0,
}

pytestmark = pytest.mark.timeout(1200)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@dataclass
class Containers:
    """The project's containers, driven by the Compose tool that is there."""

    compose: list[str]
    environment: dict[str, str]
    port: int
    operator: Path

    def run(self, *arguments: str, seconds: float) -> str:
        result = subprocess.run(
            [*self.compose, "--project-name", PROJECT, *arguments],
            cwd=ROOT,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=seconds,
        )
        assert result.returncode == 0, f"{arguments}: {result.stdout}\n{result.stderr}"
        return result.stdout

    def up(self) -> None:
        """Start the run with two actors."""
        self.run("up", "--detach", "--no-build", "--scale", "actor=2", seconds=300)

    def of(self, service: str) -> list[str]:
        """Return the ids of a service's containers."""
        return self.run("ps", "-q", service, seconds=60).split()

    def certificates(self) -> Path:
        """Return a folder with the viewer's certificate, copied out of its container once it is there."""
        for container in self.of("viewer"):
            if not (self.operator / "viewer" / "tls.key").exists():
                copy = ["docker", "cp", f"{container}:/certificates/viewer", str(self.operator)]
                subprocess.run(copy, capture_output=True, timeout=60)
        return self.operator

    def status(self) -> dict[str, Any]:
        """Return what `athrl status --json` says; empty while the learner cannot be reached."""
        address = f"tls/127.0.0.1:{self.port}"
        where = ["--connect", address, "--run", RUN, "--certificates", str(self.certificates())]
        result = subprocess.run(
            [sys.executable, "-m", "athrl", "status", *where, "--json"],
            capture_output=True,
            text=True,
            timeout=90,
        )
        return json.loads(result.stdout) if result.returncode == 0 else {}


def inspect(container: str) -> dict[str, Any]:
    output = subprocess.run(
        ["docker", "inspect", container], capture_output=True, text=True, timeout=60, check=True
    ).stdout
    return json.loads(output)[0]


def wait(what: str, condition: Callable[[], object], seconds: float) -> None:
    """Wait until a condition holds, and say for what."""
    print(f"waiting for {what}", flush=True)
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"{what}: not within {seconds:.0f} s"
        time.sleep(2)


def compose_command() -> list[str]:
    """Return Compose 2 where it is there, else Compose 1."""
    for command in (["docker", "compose"], ["docker-compose"]):
        try:
            if subprocess.run([*command, "version"], capture_output=True, timeout=60).returncode == 0:
                return command
        except FileNotFoundError:
            continue
    pytest.fail("neither docker compose nor docker-compose is installed")


@pytest.fixture
def containers(tmp_path: Path) -> Iterator[Containers]:
    """The run's containers; whatever happens, they are taken down again with their volume."""
    port = free_port()
    environment = {
        **os.environ,
        "ATHRL_RUN": RUN,
        "ATHRL_SET": " ".join(f"{key}={value}" for key, value in SETTINGS.items()),
        "ATHRL_PORT": str(port),
        "ATHRL_VIEWER_PORT": str(free_port()),
    }
    containers = Containers(compose_command(), environment, port, tmp_path)
    containers.run("down", "--volumes", "--timeout", "10", seconds=300)
    try:
        yield containers
    finally:
        print(containers.run("logs", "--tail", "20", "--no-color", seconds=60))
        containers.run("down", "--volumes", "--timeout", "10", seconds=300)


def test_run_grows_comes_back_and_leaves_nothing(containers: Containers) -> None:
    containers.up()
    status = containers.status
    wait("two actors", lambda: len(status().get("actors", {})) == 2, 300)
    wait("the first updates", lambda: status().get("updates", 0) > 0, 300)
    updates = status()["updates"]
    wait("more updates", lambda: status().get("updates", 0) > updates, 120)
    wait("a policy's first score", lambda: "policy" in status().get("evaluations", {}), 300)
    scored = status()["evaluations"]["policy"]["policy_version"]
    wait("a newer policy's score", lambda: newest_scored(status()) > scored, 300)

    for service in ("learner", "actor", "evaluator"):
        for container in containers.of(service):
            wait(f"a healthy {service}", lambda container=container: health(container) == "healthy", 120)
    killed_actor_comes_back_and_is_heard(containers)
    each_service_has_only_its_own_key(containers)
    nobody_without_a_certificate_gets_in(containers)

    reached = status()["environment_steps"]
    containers.run("down", seconds=300)
    assert not left()
    containers.up()
    # Nothing that was acknowledged is lost: the run goes on where it was.
    first: list[int] = []
    wait("the learner again", lambda: first or first.extend(steps_now(status())) or first, 300)
    assert first[0] >= reached
    wait("the run to go on", lambda: status().get("environment_steps", 0) > first[0], 300)

    containers.run("down", "--volumes", seconds=300)
    assert not left()
    volumes = subprocess.run(
        ["docker", "volume", "ls", "--quiet"], capture_output=True, text=True, timeout=60
    )
    assert f"{PROJECT}_runs" not in volumes.stdout.split()


def test_finished_run_stays_finished(containers: Containers) -> None:
    containers.environment["ATHRL_SET"] += " run.environment_steps=600 evaluator.final_episodes=2"
    containers.up()
    services = [container for name in ("learner", "actor", "evaluator") for container in containers.of(name)]
    assert len(services) == 4
    wait("the run's end", lambda: all(inspect(each)["State"]["Status"] == "exited" for each in services), 600)
    for container in services:
        assert inspect(container)["State"]["ExitCode"] == 0
        assert inspect(container)["RestartCount"] == 0


def health(container: str) -> str:
    """Return what the container's health check found last."""
    return str(inspect(container)["State"]["Health"]["Status"])


def steps_now(status: dict[str, Any]) -> list[int]:
    """Return the run's environment steps; nothing while its state is not known."""
    return [int(status["environment_steps"])] if status.get("phase") else []


def newest_scored(status: dict[str, Any]) -> int:
    """Return the version of the policy that was scored last."""
    return int(status.get("evaluations", {}).get("policy", {}).get("policy_version", -1))


def killed_actor_comes_back_and_is_heard(containers: Containers) -> None:
    """Kill one actor's process from the host and wait for transitions of its successor."""
    actor = containers.of("actor")[0]
    before = inspect(actor)
    name = before["Config"]["Hostname"]

    def heard() -> float:
        return float(containers.status().get("learner", {}).get(f"transitions/{name}", 0))

    wait("the actor to be heard", lambda: heard() > 0, 120)
    os.kill(before["State"]["Pid"], signal.SIGKILL)
    wait(
        "the killed actor's container to run again",
        lambda: (
            inspect(actor)["RestartCount"] > before["RestartCount"] and inspect(actor)["State"]["Running"]
        ),
        120,
    )
    assert inspect(actor)["State"]["Pid"] != before["State"]["Pid"]
    so_far = heard()
    wait("its successor to be heard", lambda: heard() > so_far, 180)


def each_service_has_only_its_own_key(containers: Containers) -> None:
    """Look into the containers for keys."""
    for service in ("learner", "actor", "evaluator", "viewer"):
        for container in containers.of(service):
            search = [
                "docker",
                "exec",
                container,
                "find",
                "/certificates",
                "-name",
                "*.key",
                "-printf",
                "%p %m\n",
            ]
            found = subprocess.run(search, capture_output=True, text=True, timeout=60, check=True)
            assert found.stdout.splitlines() == [f"/certificates/{service}/tls.key 600"]


def nobody_without_a_certificate_gets_in(containers: Containers) -> None:
    """Ask the learner's published port without a certificate."""
    for address in (f"tcp/127.0.0.1:{containers.port}", f"tls/127.0.0.1:{containers.port}"):
        command = [sys.executable, "-m", "athrl", "status", "--connect", address, "--run", RUN, "--json"]
        result = subprocess.run(command, capture_output=True, text=True, timeout=90)
        assert result.returncode == 2
        assert "certificate" in result.stderr


def left() -> list[str]:
    """Return the containers of the project that are there, running or not."""
    label = f"label=com.docker.compose.project={PROJECT}"
    command = ["docker", "ps", "--all", "--quiet", "--filter", label]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=True).stdout.split()
