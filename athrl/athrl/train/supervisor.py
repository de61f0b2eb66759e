"""Keeps a run's services alive: one that dies is started again a few times, then the run is taken down."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from athrl.errors import EXPECTED_ERROR, CommandError
from athrl.train.process import ServiceProcess

STEADY_SECONDS = 120.0
"""A service that has run for so long is forgiven its earlier deaths."""


class ServiceDied(CommandError):  # noqa: N818  (the name says what happened)
    """A service died more often than it may."""


@dataclass
class Service:
    """A process with what its death means.

    `restarts` deaths are made good; an `optional` service is then left dead and the run goes on without it.
    With `errors_are_final` a service that ended with an error of its own words is not started again: what it
    was given will not get better.
    """

    process: ServiceProcess
    restarts: int
    optional: bool = False
    errors_are_final: bool = False
    restart_arguments: list[str] = field(default_factory=list)
    deaths: int = field(default=0, init=False)
    finished: bool = field(default=False, init=False)
    restart_at: float | None = field(default=None, init=False)

    @property
    def name(self) -> str:
        """The process's name."""
        return self.process.name

    def start(self) -> None:
        """Start the process; after a death with the arguments for that case."""
        self.restart_at = None
        self.process.start(self.restart_arguments if self.deaths else None)


class Supervisor:
    """Starts services, restarts the dead and takes all of them down.

    Not thread-safe: `check` is called again and again from one loop.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self.services: list[Service] = []
        self._say = say

    def start(self, service: Service) -> None:
        """Start a service and watch over it from now on."""
        self.services.append(service)
        service.start()

    def check(self) -> None:
        """Look after every service once; raises `ServiceDied` when one may not be started again."""
        for service in self.services:
            self._check_one(service)

    def _check_one(self, service: Service) -> None:
        now = time.monotonic()
        if service.finished:
            return
        if service.restart_at is not None:
            if now >= service.restart_at:
                service.start()
            return
        code = service.process.exit_code
        if code is None:
            return
        service.process.end()  # whatever it had started itself
        if code == 0:
            service.finished = True
            return
        if now - service.process.started_at > STEADY_SECONDS:
            service.deaths = 0
        service.deaths += 1
        final = service.errors_are_final and code == EXPECTED_ERROR
        if service.deaths <= service.restarts and not final:
            pause = _pause(service.deaths)
            service.restart_at = now + pause
            when = f"in {pause:.0f} s" if pause else "at once"
            self._say(f"{service.name} {describe_exit(code)}; it is started again {when}")
            if not pause:
                service.start()
        elif service.optional:
            service.finished = True
            self._say(f"{service.name} {describe_exit(code)}: {' '.join(service.process.last_lines(1))}")
        else:
            raise ServiceDied(self._obituary(service, code))

    def _obituary(self, service: Service, code: int) -> str:
        lines = service.process.last_lines()
        if code == EXPECTED_ERROR and lines:  # the service has said it in one line already
            return lines[-1].removeprefix("athrl: ")
        return f"{service.name} {describe_exit(code)}, see {service.process.log}: {' | '.join(lines)}"

    def stop(self, services: Iterable[Service], seconds: float) -> None:
        """Ask services to drain, wait at most so long for all of them together, and end the rest."""
        asked = [service for service in services if not service.finished]
        for service in asked:
            service.finished = True
            service.process.terminate()
        deadline = time.monotonic() + seconds
        for service in asked:
            if not service.process.wait(deadline - time.monotonic()):
                self._say(f"{service.name} did not drain within {seconds:.0f} s and is ended")
            service.process.end()

    def end(self) -> None:
        """End everything and wait for it."""
        for service in self.services:
            service.finished = True
            service.process.end()

    def kill(self) -> None:
        """End everything without waiting; may be called from any thread."""
        for service in self.services:
            service.process.kill()


def _pause(deaths: int) -> float:
    """Return seconds until the next start: none after a single death, then ever more."""
    return 0.0 if deaths == 1 else 2.0 ** (deaths - 2)


def describe_exit(code: int) -> str:
    """Say how a process ended."""
    return f"was ended by signal {-code}" if code < 0 else f"ended with code {code}"
