"""Keeps a run's services alive: a dead one is restarted a few times, then the run is ended.

A service that ended well although it is still needed is started again, too, as often as that happens: it may
have been told by another process that the run is finished.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from athrl.errors import EXPECTED_ERROR, CommandError
from athrl.train.process import ServiceProcess

STEADY_SECONDS = 120.0
"""After this uptime a service's earlier deaths no longer count."""
EARLY_SECONDS = 5.0
LATEST_SECONDS = 60.0
"""Most seconds until a service that left too early is started again."""


class ServiceDied(CommandError):  # noqa: N818  (the name says what happened)
    """A service died more often than it may."""


@dataclass
class Service:
    """A process with its rules for restarts.

    After `restarts` deaths the run ends, or, for an `optional` service, continues without it. With
    `errors_are_final` a service that ended with an expected error is not restarted: it would fail again.
    A service that ended well is started again after `early_seconds`, which double each time, unless
    `may_leave` says by then that it is not needed any more.
    """

    process: ServiceProcess
    restarts: int
    optional: bool = False
    errors_are_final: bool = False
    restart_arguments: list[str] = field(default_factory=list)
    may_leave: Callable[[], bool] = lambda: True
    early_seconds: float = EARLY_SECONDS
    deaths: int = field(default=0, init=False)
    left_early: int = field(default=0, init=False)
    finished: bool = field(default=False, init=False)
    restart_at: float | None = field(default=None, init=False)

    @property
    def name(self) -> str:
        """Name of the process."""
        return self.process.name

    def start(self) -> None:
        """Start the process; after a death with the arguments for a restart."""
        self.restart_at = None
        self.process.start(self.restart_arguments if self.deaths else None)


class Supervisor:
    """Starts services, restarts dead ones and ends all of them.

    Not thread-safe: `check` is called repeatedly from one loop.
    """

    def __init__(self, say: Callable[[str], None]) -> None:
        self.services: list[Service] = []
        self._say = say

    def start(self, service: Service) -> None:
        """Start a service and supervise it from now on."""
        self.services.append(service)
        service.start()

    def check(self) -> None:
        """Check every service once; raises `ServiceDied` if one may not be restarted."""
        for service in self.services:
            self._check_one(service)

    def _check_one(self, service: Service) -> None:
        now = time.monotonic()
        if service.finished:
            return
        code = service.process.exit_code
        if service.restart_at is not None:
            if now >= service.restart_at:
                self._start_again(service, left=code == 0)
            return
        if code is None:
            return
        service.process.end()  # and its child processes
        if code == 0:
            pause = min(LATEST_SECONDS, service.early_seconds * 2**service.left_early)
            service.finished = service.may_leave()
            service.restart_at = None if service.finished else now + pause
            return
        if now - service.process.started_at > STEADY_SECONDS:
            service.deaths = 0
        service.deaths += 1
        final = service.errors_are_final and code == EXPECTED_ERROR
        if service.deaths <= service.restarts and not final:
            pause = _pause(service.deaths)
            service.restart_at = now + pause
            when = f"in {pause:.0f} s" if pause else "at once"
            self._say(f"{service.name} {describe_exit(code)}; restarting it {when}")
            if not pause:
                service.start()
        elif service.optional:
            service.finished = True
            self._say(f"{service.name} {describe_exit(code)}: {' '.join(service.process.last_lines(1))}")
        else:
            raise ServiceDied(self._death_message(service, code))

    def _start_again(self, service: Service, *, left: bool) -> None:
        """Start a service after its pause, unless it has left and is not needed any more."""
        if left and service.may_leave():
            service.finished = True
            return
        if left:
            service.left_early += 1
            self._say(f"{service.name} left before its learner ended; restarting it")
        service.start()

    def _death_message(self, service: Service, code: int) -> str:
        lines = service.process.last_lines()
        if code == EXPECTED_ERROR and lines:  # the service has already printed it in one line
            return lines[-1].removeprefix("athrl: ")
        return f"{service.name} {describe_exit(code)}, see {service.process.log}: {' | '.join(lines)}"

    def stop(self, services: Iterable[Service], seconds: float) -> None:
        """Ask services to drain, wait at most `seconds` for all of them together, and end the rest."""
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
        """End all services and wait for them; raises CommandError if one is still there."""
        for service in self.services:
            service.finished = True
        self.kill()  # all of them, before one that does not end is waited for
        for service in self.services:
            service.process.end()

    def kill(self) -> None:
        """End all services without waiting; may be called from any thread."""
        for service in self.services:
            service.process.kill()


def _pause(deaths: int) -> float:
    """Return seconds until the restart: 0 after the first death, then growing."""
    return 0.0 if deaths == 1 else 2.0 ** (deaths - 2)


def describe_exit(code: int) -> str:
    """Describe how a process ended."""
    return f"was ended by signal {-code}" if code < 0 else f"ended with code {code}"
