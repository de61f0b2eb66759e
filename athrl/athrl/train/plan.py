"""Which processes a run on this machine consists of."""

from __future__ import annotations

import importlib.util
import os
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from athrl_protocol.run_file import EnvironmentSection, RunFile

from athrl import runs
from athrl.errors import CommandError
from athrl.train.process import ServiceProcess
from athrl.train.supervisor import Service

RESTARTS = 5
LEARNER_RESTARTS = 3
BACKGROUND = 10  # niceness: the evaluator and the viewer's bridge take what the run leaves them


CORES_FOR_ANOTHER_ACTOR = 3
"""Further cores from which on another actor drives."""


@dataclass(frozen=True)
class CoreDivision:
    """What the cores of this machine do in a run.

    Attributes:
        cores: that the run may use.
        threads: with which the learner trains.
        actors: processes that drive beside it, with one thread each.
    """

    cores: int
    threads: int
    actors: int

    def __str__(self) -> str:
        cores, threads = _counted(self.cores, "core"), _counted(self.threads, "thread")
        drive = "drives" if self.actors == 1 else "drive"
        actors = f"{_counted(self.actors, 'actor')} {drive} beside it"
        return f"{cores}: the learner trains with {threads}, {actors}"


def divide_cores(cores: int, *, threads: int = 0, actors: int | None = None) -> CoreDivision:
    """Return what so many cores do, apart from what is settled already.

    The learner has a thread for each core: at 8 samples per insert, driving takes about a fifth of the time
    of training, which the system gives to the actors beside it. One actor keeps a learner of three threads
    busy.

    Args:
        cores: that the run may use.
        threads: of the learner, where the settings say so; 0: as it fits.
        actors: where the command line says so.
    """
    fitting = 1 + max(0, cores - 1) // CORES_FOR_ANOTHER_ACTOR
    return CoreDivision(cores, threads or max(1, cores), fitting if actors is None else actors)


def usable_cores() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0))


def _counted(number: int, name: str) -> str:
    return f"{number} {name}" if number == 1 else f"{number} {name}s"


def require_services() -> None:
    """Raise `CommandError` unless every service of a run is installed."""
    for service in ("learner", "actor", "evaluator"):
        if importlib.util.find_spec(f"athrl_{service}") is None:
            raise CommandError(
                f"a whole run needs athrl[all], athrl[{service}] is missing: pip install 'athrl[all]'"
            )


def require_world(environment: EnvironmentSection) -> None:
    """Raise an error of one line for a map in which no actor could drive, or one with too little room."""
    from athrl_driving.maps import load_town
    from athrl_driving.traffic import starting_places

    for town in environment.towns:
        places = starting_places(load_town(town))
        if environment.vehicles > places:
            raise CommandError(
                f"environment.vehicles is {environment.vehicles}, {town} has room for {places}"
            )


class Plan:
    """The services of one run, each with its command line, its log and what its death means."""

    def __init__(
        self, settings: RunFile, *, run_file: Path | None, overrides: Sequence[str], resume: bool
    ) -> None:
        self.settings = settings
        self.folder = runs.run_folder(settings)
        self._overrides = [word for override in overrides for word in ("--set", override)]
        self._run_file = ["--run-file", str(run_file)] if run_file is not None else []
        self.resume = resume
        address = settings.network.listen
        self.address = address.replace("/0.0.0.0:", "/127.0.0.1:").replace("/[::]:", "/[::1]:")

    def learner(self, threads: int) -> Service:
        """The learner, which trains with so many threads; after a death it resumes its newest checkpoint."""
        if self.resume:
            arguments = ["learner", "--resume", str(self.folder), *self._overrides]
            again: list[str] = []
        else:
            arguments = ["learner", *self._run_file, *self._overrides]
            again = ["--resume-if-present"]
        process = self._process("learner", arguments, threads=threads)
        return Service(process, LEARNER_RESTARTS, errors_are_final=True, restart_arguments=again)

    def actor(self, number: int) -> Service:
        """An actor."""
        name = f"actor-{number}"
        return Service(self._process(name, ["actor", *self._where(), "--name", name]), RESTARTS)

    def evaluator(self) -> Service:
        """The evaluator."""
        arguments = ["evaluator", *self._where(), "--folder", str(self.folder.parent)]
        return Service(self._process("evaluator", arguments, niceness=BACKGROUND), RESTARTS)

    def viewer(self, port: int) -> Service:
        """The bridge to rerun; the run goes on without it."""
        arguments = ["watch", *self._where(), "--serve", str(port)]
        return Service(self._process("viewer", arguments, niceness=BACKGROUND), RESTARTS, optional=True)

    def _where(self) -> list[str]:
        return ["--connect", self.address, "--run", self.settings.run.name]

    def _process(
        self, name: str, arguments: list[str], niceness: int = 0, threads: int = 1
    ) -> ServiceProcess:
        return ServiceProcess(name, arguments, self.folder / "logs" / f"{name}.log", niceness, threads)


def is_free(port: int) -> bool:
    """Return whether nobody listens at this port of the loopback interface."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
        return True
