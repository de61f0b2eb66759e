"""The processes of a run on this machine."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from athrl_protocol.run_file import EnvironmentSection, RunFile
from athrl_spaces.untrusted import UntrustedFile, parser_errors, read_json
from athrl_spaces.wording import counted

from athrl import runs
from athrl.errors import CommandError
from athrl.train.process import ServiceProcess
from athrl.train.supervisor import EARLY_SECONDS, Service

RESTARTS = 5
LEARNER_RESTARTS = 3
BACKGROUND = 10  # niceness of the evaluator and of the viewer's bridge


CORES_FOR_ANOTHER_ACTOR = 3
"""Additional cores for each additional actor."""

MOST_ACTORS_A_CORE = 32
"""Each is a process; far more than the cores can drive only take the machine's memory."""


@dataclass(frozen=True)
class CoreDivision:
    """Division of this machine's cores in a run.

    Attributes:
        cores: usable cores.
        threads: training threads of the learner.
        actors: actor processes, with one thread each.
    """

    cores: int
    threads: int
    actors: int

    def __str__(self) -> str:
        cores, threads = counted(self.cores, "core"), counted(self.threads, "thread")
        drive = "drives" if self.actors == 1 else "drive"
        actors = f"{counted(self.actors, 'actor')} {drive} beside it"
        return f"{cores}: the learner trains with {threads}, {actors}"


def divide_cores(cores: int, *, threads: int = 0, actors: int | None = None) -> CoreDivision:
    """Divide the cores, except for given numbers.

    The learner has a thread for each core: at 8 samples per insert, driving takes about a fifth of the time
    of training, and the operating system shares the cores with the actors. One actor keeps a learner with
    three threads busy.

    Args:
        cores: usable cores.
        threads: training threads in the settings; 0: one for each core.
        actors: number of actors on the command line, if given.

    Raises:
        CommandError: there are far more actors than the cores can drive.
    """
    most = MOST_ACTORS_A_CORE * cores
    if actors is not None and actors > most:
        raise CommandError(
            f"--actors {actors}: should be at most {most} on {counted(cores, 'core')}; more drive on other "
            "machines, by athrl actor --connect"
        )
    fitting = 1 + max(0, cores - 1) // CORES_FOR_ANOTHER_ACTOR
    return CoreDivision(cores, threads or max(1, cores), fitting if actors is None else actors)


def usable_cores() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0))


def require_services() -> None:
    """Raise `CommandError` unless every service of a run is installed."""
    for service in ("learner", "actor", "evaluator"):
        if importlib.util.find_spec(f"athrl_{service}") is None:
            raise CommandError(
                f"a complete run needs athrl[all], athrl[{service}] is missing: pip install 'athrl[all]'"
            )


def require_world(environment: EnvironmentSection) -> None:
    """Raise an error of one line for a map that cannot be driven, or has too little room for the vehicles."""
    from athrl_driving.episode.room_for_vehicles import places_beside_an_ego
    from athrl_driving.maps import load_town

    for town in environment.towns:
        places = places_beside_an_ego(load_town(town, strict=environment.strict_map))
        if environment.vehicles > places:
            raise CommandError(
                f"environment.vehicles is {environment.vehicles}, {town} has room for {places}"
            )


class Plan:
    """The services of one run, each with its command line, its log and its restarts."""

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
        """The learner with a number of training threads; a restarted one resumes the newest checkpoint."""
        if self.resume:
            arguments = ["learner", "--resume", str(self.folder), *self._run_file, *self._overrides]
            again: list[str] = []
        else:
            arguments = ["learner", *self._run_file, *self._overrides]
            again = ["--resume-if-present"]
        process = self._process("learner", arguments, threads=threads)
        return Service(process, LEARNER_RESTARTS, errors_are_final=True, restart_arguments=again)

    def actor(self, number: int) -> Service:
        """An actor."""
        name = f"actor-{number}"
        return self._needed_to_the_end(self._process(name, ["actor", *self._where(), "--name", name]))

    def evaluator(self) -> Service:
        """The evaluator."""
        arguments = ["evaluator", *self._where(), "--folder", str(self.folder.parent)]
        return self._needed_to_the_end(self._process("evaluator", arguments, niceness=BACKGROUND))

    def viewer(self, port: int) -> Service:
        """The bridge to rerun; the run continues without it."""
        arguments = ["watch", *self._where(), "--serve", str(port)]
        process = self._process("viewer", arguments, niceness=BACKGROUND)
        return self._needed_to_the_end(process, optional=True)

    def experience_is_complete(self) -> bool:
        """Return whether the learner has published a policy after all of the run's environment steps.

        Known from its file: what arrives over the network may be of another process.
        """
        try:
            with parser_errors(UntrustedFile):
                facts = read_json(self.folder / "policies" / "latest.json")
                return int(facts["environment_steps"]) >= self.settings.run.environment_steps
        except UntrustedFile:  # none is published yet
            return False

    def _needed_to_the_end(self, process: ServiceProcess, *, optional: bool = False) -> Service:
        """A service that must not leave before the run's experience is complete."""
        return Service(
            process,
            RESTARTS,
            optional=optional,
            may_leave=self.experience_is_complete,
            # The learner tells actors that it needs no more before it publishes the next policy.
            early_seconds=max(EARLY_SECONDS, 2 * self.settings.learner.publish_seconds),
        )

    def _where(self) -> list[str]:
        return ["--connect", self.address, "--run", self.settings.run.name]

    def _process(
        self, name: str, arguments: list[str], niceness: int = 0, threads: int = 1
    ) -> ServiceProcess:
        return ServiceProcess(name, arguments, self.folder / "logs" / f"{name}.log", niceness, threads)
