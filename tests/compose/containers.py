"""A run's containers, driven and looked at with what a user has: Compose, Docker and `athrl status`."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

T = TypeVar("T")

ROOT = Path(__file__).parents[2]
PROJECT = "athrl-compose-check"
RUN = "check"
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
"""An endless run that is small enough for two cores, and keeps its whole log."""

BACK_SECONDS = 120.0
"""Within which a container whose process was killed runs again; a busy machine takes its time."""


def output(*command: str, seconds: float = 60, script: Path | None = None) -> str:
    """Return what a command says, with a script on its standard input; it must end with 0 in time."""
    result = subprocess.run(
        command,
        input=script.read_text() if script else None,
        capture_output=True,
        text=True,
        timeout=seconds,
    )
    assert result.returncode == 0, f"{command}: {result.stdout}\n{result.stderr}"
    return result.stdout


def wait(what: str, condition: Callable[[], T], seconds: float) -> T:
    """Wait until a condition holds, and say for what; return what made it so."""
    print(f"waiting for {what}", flush=True)
    deadline = time.monotonic() + seconds
    while not (value := condition()):
        assert time.monotonic() < deadline, f"{what}: not within {seconds:.0f} s"
        time.sleep(1)
    return value


def inspect(container: str) -> dict[str, Any]:
    return json.loads(output("docker", "inspect", container))[0]


def name_of(actor: str) -> str:
    """Return the name that the learner has given to an actor, as the actor's log says; wait for it."""

    def given() -> str:
        names = re.findall(r"takes part in the run \S+ as (\S+)", said(actor))
        return names[-1] if names else ""

    return wait("the name of an actor", given, 300)


def health(container: str) -> str:
    """Return what the container's health check found last."""
    return str(inspect(container)["State"]["Health"]["Status"])


def said(container: str) -> str:
    """Return what an operator sees with `docker logs`."""
    result = subprocess.run(["docker", "logs", container], capture_output=True, text=True, timeout=60)
    return result.stdout + result.stderr


def kill_by_host_pid(container: str) -> float:
    """Kill a container's main process on the host; return when (monotonic seconds) it ran again."""
    before = inspect(container)
    os.kill(before["State"]["Pid"], signal.SIGKILL)

    def runs_again() -> bool:
        now = inspect(container)
        return now["State"]["Running"] and now["RestartCount"] > before["RestartCount"]

    wait("the killed container to run again", runs_again, BACK_SECONDS)
    assert inspect(container)["State"]["Pid"] != before["State"]["Pid"]
    return time.monotonic()


@dataclass
class Containers:
    """The project's containers.

    Attributes:
        compose: the Compose tool that is there.
        environment: of Compose, with the settings of the run.
        port: of this host at which the learner is published.
        folder: for what the check needs on this host.
    """

    compose: list[str]
    environment: dict[str, str]
    port: int
    folder: Path

    def run(self, *arguments: str, seconds: float = 300) -> str:
        """Run Compose as a user does, with actors that record the outcomes of their chunks."""
        result = self.call(*arguments, seconds=seconds)
        assert result.returncode == 0, f"{arguments}: {result.stdout}\n{result.stderr}"
        return result.stdout

    def call(self, *arguments: str, seconds: float = 300) -> subprocess.CompletedProcess[str]:
        """The same, whether or not Compose succeeds."""
        files = ["--file", "compose.yaml", "--file", "tests/compose/recording_actors.yaml"]
        return subprocess.run(
            [*self.compose, "--project-name", PROJECT, *files, *arguments],
            cwd=ROOT,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=seconds,
        )

    def up(self) -> None:
        """Start or resume the run."""
        self.run("up", "--detach", "--no-build")

    def all(self, *filters: str) -> list[str]:
        """Return the project's containers, running or not."""
        labels = [f"project={PROJECT}", "oneoff=False", *filters]
        wanted = [word for label in labels for word in ("--filter", f"label=com.docker.compose.{label}")]
        return output("docker", "ps", "--all", "--quiet", "--no-trunc", *wanted).split()

    def of(self, service: str) -> str:
        """Return the id of a service's container."""
        (container,) = self.all(f"service={service}")
        return container

    def status(self) -> dict[str, Any]:
        """Return what `athrl status --json` says; empty while the learner does not tell how the run is."""
        where = ["--connect", f"tls/127.0.0.1:{self.port}", "--run", RUN]
        result = subprocess.run(
            [sys.executable, "-m", "athrl", "status", *where, "--certificates", self.viewer(), "--json"],
            capture_output=True,
            text=True,
            timeout=90,
        )
        status = json.loads(result.stdout) if result.returncode == 0 else {}
        return status if status.get("phase") else {}

    def viewer(self) -> str:
        """Return a folder with the viewer's certificate, copied out of its container once it is there."""
        copy = self.folder / "viewer"
        if not (copy / "tls.key").exists():
            source = f"{self.of('viewer')}:/certificates/viewer"
            subprocess.run(["docker", "cp", source, str(self.folder)], capture_output=True, timeout=60)
        return str(copy)

    def copy_run(self) -> Path:
        """Return a copy of the run's folder as it lies in its volume."""
        copy = Path(tempfile.mkdtemp(dir=self.folder))
        volumes = ["--volume", f"{PROJECT}_runs:/runs:ro", "--volume", f"{copy}:/copy"]
        inside = ["--rm", "--user", "0", *volumes, "--entrypoint", "cp", "athrl/learner"]
        output("docker", "run", *inside, "-r", f"/runs/{RUN}", "/copy", seconds=120)
        return copy / RUN
