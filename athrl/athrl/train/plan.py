"""Which processes a run on this machine consists of."""

from __future__ import annotations

import importlib.util
import os
import socket
from collections.abc import Sequence
from pathlib import Path

from athrl_protocol.run_file import EnvironmentSection, RunFile

from athrl import runs
from athrl.errors import CommandError
from athrl.train.process import ServiceProcess
from athrl.train.supervisor import Service

RESTARTS = 5
LEARNER_RESTARTS = 3
BACKGROUND = 10  # niceness: the evaluator and the viewer's bridge take what the run leaves them


def actors_that_fit() -> int:
    """Return how many actors this machine's processors carry beside the learner; at least one."""
    return max(1, len(os.sched_getaffinity(0)) - 1)


def require_services() -> None:
    """Raise `CommandError` unless every service of a run is installed."""
    for service in ("learner", "actor", "evaluator"):
        if importlib.util.find_spec(f"athrl_{service}") is None:
            raise CommandError(
                f"a whole run needs athrl[all], athrl[{service}] is missing: pip install 'athrl[all]'"
            )


def require_world(environment: EnvironmentSection) -> None:
    """Raise an error of one line for a map that no actor could drive in, or one with too little room."""
    from athrl_driving.maps import load_town
    from athrl_driving.traffic import starting_places

    places = starting_places(load_town(environment.town))
    if environment.vehicles > places:
        raise CommandError(
            f"environment.vehicles is {environment.vehicles}, {environment.town} has room for {places}"
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

    def learner(self) -> Service:
        """The learner; after a death it goes on from its newest checkpoint."""
        if self.resume:
            arguments = ["learner", "--resume", str(self.folder), *self._overrides]
            again: list[str] = []
        else:
            arguments = ["learner", *self._run_file, *self._overrides]
            again = ["--resume-if-present"]
        process = self._process("learner", arguments, one_thread=False)
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
        self, name: str, arguments: list[str], niceness: int = 0, one_thread: bool = True
    ) -> ServiceProcess:
        return ServiceProcess(name, arguments, self.folder / "logs" / f"{name}.log", niceness, one_thread)


def is_free(port: int) -> bool:
    """Return whether nobody listens at this port of the loopback interface."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
        return True
