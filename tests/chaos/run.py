"""The run for fault injection: its folder, settings, services and certificates."""

from __future__ import annotations

import socket
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from athrl.certificates import make_all
from athrl.runs import declare_installed_planners
from athrl_protocol.run_file import RunFile, read_run_file

from tests.chaos.link_proxy import HOST, Link
from tests.chaos.processes import Service

RUN = "chaos"
LEARNER, EVALUATOR, ROUTER = "learner", "evaluator", "router"
LONG_MINUTES = 5.0
"""From this duration on the policy must improve."""

# Endless, with little training, a replay that wraps around, and frequent segments and checkpoints.
_SETTINGS = {
    "run.environment_steps": 1_000_000_000,
    "environment.vehicles": 10,
    "environment.episode_ticks": 200,
    "exploration.random_decisions": 500,
    "planner.hidden_features": 64,
    "planner.head_features": 64,
    "planner.memory": "lstm",
    "planner.recurrent_features": 32,
    "planner.shared_trunk": "false",
    "replay.capacity": 8_000,
    "replay.sequence_length": 10,
    "learner.batch": 80,
    "learner.samples_per_insert": 4.0,
    "learner.publish_seconds": 1.0,
    "learner.checkpoint_seconds": 5.0,
    "durability.segment_mebibytes": 0.5,
    "actor.environments": 4,
    "evaluator.episodes": 2,
    "evaluator.seconds_between": 10.0,
    "evaluator.recordings_kept": 4,
}
_LONG = {"replay.capacity": 40_000, "learner.samples_per_insert": 8.0, "planner.average_decay": 0.99}


@dataclass(frozen=True)
class ChaosRun:
    """Files and addresses before the services are started.

    Attributes:
        folder: folder with all others.
        port: port of the learner.
        router_port: port of the router.
        actors: names of the actors; the last one is behind the router.
        long: whether the policy must improve.
    """

    folder: Path
    port: int
    router_port: int
    actors: tuple[str, ...]
    long: bool

    @property
    def certificates(self) -> Path:
        """Folder of the certificates of all roles."""
        return self.folder / "certificates"

    @property
    def run_folder(self) -> Path:
        """Folder of the run."""
        return self.disk / "runs" / RUN

    @property
    def disk(self) -> Path:
        """Everything that the run writes; a separate disk if possible."""
        return self.folder / "disk"

    @property
    def evidence(self) -> Path:
        """Folder of the actors' records."""
        return self.folder / "evidence"

    @property
    def archive(self) -> Path:
        """Folder of all segments of the log, including those that the learner has removed.

        On the run's disk, for hard links.
        """
        return self.disk / "archive"

    @property
    def logs(self) -> Path:
        """Folder of the services' output."""
        return self.folder / "logs"

    @property
    def address(self) -> str:
        """The learner's address, bypassing all links."""
        return f"tcp/{HOST}:{self.port}"

    @property
    def behind_router(self) -> tuple[str, ...]:
        """Actors that connect to the router."""
        return self.actors[-1:]

    @property
    def next_ports(self) -> dict[str, int]:
        """For each service the port to which its link connects."""
        clients = (*self.actors, EVALUATOR, ROUTER)
        return {name: self.router_port if name in self.behind_router else self.port for name in clients}

    @property
    def targets(self) -> dict[str, list[str]]:
        """Possible targets of each family of faults."""
        return {
            "learner": [LEARNER],
            "actor": list(self.actors),
            "evaluator": [EVALUATOR],
            "router": [ROUTER],
            "connection": [*self.actors, *self.actors, EVALUATOR, ROUTER],
            "disk": [LEARNER],
            "intruder": [LEARNER],
        }

    @property
    def overrides(self) -> list[str]:
        """The settings that differ from the defaults."""
        values: dict[str, object] = {
            **_SETTINGS,
            **(_LONG if self.long else {}),
            "run.name": RUN,
            "run.folder": str(self.disk / "runs"),
            "network.listen": self.address,
        }
        return [f"{key}={value}" for key, value in values.items()]

    def settings(self) -> RunFile:
        """Return the run file as the learner has it."""
        declare_installed_planners()
        return read_run_file(None, self.overrides)

    def services(self, links: dict[str, Link]) -> list[Service]:
        """Return the learner, the router, the actors and the evaluator, none of them started."""
        learner = [word for setting in self.overrides for word in ("--set", setting)]
        services = [self._service(LEARNER, ["athrl", "learner", "--resume-if-present", *learner])]
        router = ["athrl", "router", "--name", ROUTER, "--listen", f"tcp/{HOST}:{self.router_port}"]
        services.append(self._service(ROUTER, [*router, *_where(links[ROUTER])]))
        for name in self.actors:
            recorder = ["tests.chaos.recording_actor", str(self.evidence / f"{name}.txt")]
            services.append(self._service(name, [*recorder, "actor", "--name", name, *_where(links[name])]))
        evaluator = ["athrl", "evaluator", "--name", EVALUATOR, "--folder", str(self.disk / "runs")]
        services.append(self._service(EVALUATOR, [*evaluator, *_where(links[EVALUATOR])]))
        return services

    def _service(self, name: str, words: list[str]) -> Service:
        environment = {"ATHRL_CERTIFICATES": str(self.certificates), "OMP_NUM_THREADS": "1"}
        return Service(name, words, self.logs, environment)


def lay_out(folder: Path, actors: int, *, long: bool) -> ChaosRun:
    """Make the subfolders and the certificates, and find free ports."""
    names = tuple(f"actor-{number}" for number in range(1, actors + 1))
    run = ChaosRun(folder.resolve(), *_free_ports(2), names, long)
    for path in (run.evidence, run.archive, run.logs):
        path.mkdir(parents=True)
    make_all(run.certificates, [HOST, "localhost"], 2)
    return run


def _free_ports(count: int) -> list[int]:
    with ExitStack() as stack:
        probes = [stack.enter_context(socket.create_server((HOST, 0))) for _ in range(count)]
        return [int(probe.getsockname()[1]) for probe in probes]


def _where(link: Link) -> list[str]:
    return ["--connect", link.address, "--run", RUN]
