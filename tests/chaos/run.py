"""The run that the storm comes over: its folder, its settings, its services and their certificates."""

from __future__ import annotations

import socket
from dataclasses import dataclass
from pathlib import Path

from athrl.certificates import make_all
from athrl_protocol.run_file import RunFile, read_run_file

from tests.chaos.cutter import HOST, Link
from tests.chaos.processes import Service

RUN = "storm"
LEARNER, EVALUATOR = "learner", "evaluator"
LONG_MINUTES = 5.0
"""From here on a storm has to leave a better policy behind."""

# It never ends by itself, trains on little, wraps its replay round, and ends segments and checkpoints often.
_SETTINGS = {
    "run.environment_steps": 1_000_000_000,
    "environment.vehicles": 10,
    "environment.episode_ticks": 200,
    "exploration.random_decisions": 500,
    "planner.hidden_features": 64,
    "planner.recurrent_features": 32,
    "replay.capacity": 8_000,
    "learner.batch": 8,
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
class StormyRun:
    """What is on the disk before anything is started.

    Attributes:
        folder: of the storm; holds all the others.
        port: at which the learner listens.
        actors: their names.
        long: whether the storm is one after which the policy has to be better.
    """

    folder: Path
    port: int
    actors: tuple[str, ...]
    long: bool

    @property
    def certificates(self) -> Path:
        """Of every role."""
        return self.folder / "certificates"

    @property
    def run_folder(self) -> Path:
        """The run's own."""
        return self.folder / "runs" / RUN

    @property
    def evidence(self) -> Path:
        """Where actors write down what they know."""
        return self.folder / "evidence"

    @property
    def archive(self) -> Path:
        """Where every segment of the log stays, also those that the learner needs no more."""
        return self.folder / "archive"

    @property
    def logs(self) -> Path:
        """Where each service's output goes."""
        return self.folder / "logs"

    @property
    def address(self) -> str:
        """The learner's own, past all links."""
        return f"tcp/{HOST}:{self.port}"

    @property
    def overrides(self) -> list[str]:
        """The settings that differ from the defaults."""
        values: dict[str, object] = {
            **_SETTINGS,
            **(_LONG if self.long else {}),
            "run.name": RUN,
            "run.folder": str(self.folder / "runs"),
            "network.listen": self.address,
        }
        return [f"{key}={value}" for key, value in values.items()]

    def settings(self) -> RunFile:
        """Return the run file as the learner has it."""
        return read_run_file(None, self.overrides)

    def services(self, links: dict[str, Link]) -> list[Service]:
        """Return the learner, the actors and the evaluator, none of them started."""
        learner = [word for setting in self.overrides for word in ("--set", setting)]
        services = [self._service(LEARNER, ["athrl", "learner", "--resume-if-present", *learner])]
        for name in self.actors:
            witness = ["tests.chaos.witness", str(self.evidence / f"{name}.txt")]
            services.append(self._service(name, [*witness, "actor", "--name", name, *_where(links[name])]))
        evaluator = ["athrl", "evaluator", "--name", EVALUATOR, "--folder", str(self.folder / "runs")]
        services.append(self._service(EVALUATOR, [*evaluator, *_where(links[EVALUATOR])]))
        return services

    def _service(self, name: str, words: list[str]) -> Service:
        environment = {"ATHRL_CERTIFICATES": str(self.certificates), "OMP_NUM_THREADS": "1"}
        return Service(name, words, self.logs, environment)


def lay_out(folder: Path, actors: int, *, long: bool) -> StormyRun:
    """Make the folder's folders and the certificates, and find a free port."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        port = int(probe.getsockname()[1])
    names = tuple(f"actor-{number}" for number in range(1, actors + 1))
    run = StormyRun(folder.resolve(), port, names, long)
    for path in (run.evidence, run.archive, run.logs):
        path.mkdir(parents=True)
    make_all(run.certificates, [HOST, "localhost"], 2)
    return run


def _where(link: Link) -> list[str]:
    return ["--connect", link.address, "--run", RUN]
