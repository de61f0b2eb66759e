"""The main loop of a run on this machine: start, supervise, closing comparison, or drain."""

from __future__ import annotations

import os
import threading
import time
from contextlib import ExitStack

from athrl_protocol import LearnerNotFound, Phase, RunNotFound
from athrl_protocol.monitoring.endpoint import require_free_endpoints
from athrl_protocol.transport.session import require_free

from athrl.display import Display
from athrl.errors import CommandError
from athrl.options import METRICS_VARIABLE
from athrl.ports import is_free
from athrl.run_view import RunSnapshot, RunView
from athrl.service_names import program
from athrl.services import CHECKPOINT_SECONDS
from athrl.train import simulation
from athrl.train.plan import CoreDivision, Plan
from athrl.train.supervisor import Supervisor

START_SECONDS = 120.0
"""Limit for the learner's first answer."""
POLL_SECONDS = 0.2
DRAIN_SECONDS = 20.0
STOP_SECONDS = DRAIN_SECONDS + CHECKPOINT_SECONDS + 10.0
"""Limit for draining all services after the first signal, the learner last."""
COMPARISON_SECONDS = 1800.0
"""Limit for the evaluator after the learner has ended."""


class TrainingSession:
    """One run: its services under a supervisor, shown by a display."""

    def __init__(
        self,
        plan: Plan,
        supervisor: Supervisor,
        display: Display,
        division: CoreDivision,
        viewer_port: int,
    ) -> None:
        self._plan = plan
        self._supervisor = supervisor
        self._display = display
        self._division = division
        self._learner = plan.learner(division.threads)
        self._actors = [plan.actor(number) for number in range(1, division.actors + 1)]
        self._evaluator = plan.evaluator()
        self._viewer_port = viewer_port
        self._comparison_until = 0.0
        self._where_to_look = [f"run folder {plan.folder}, logs of all processes in {plan.folder / 'logs'}"]

    def run(self, stop: threading.Event) -> bool:
        """Run to the end; return whether the run is finished rather than stopped.

        No service is running any more when this returns or raises.

        Raises:
            ServiceDied: a service could not be kept alive.
            CommandError: the learner never answered.
        """
        try:
            return self._run(stop)
        finally:
            self._supervisor.end()

    def _run(self, stop: threading.Event) -> bool:
        self._display.say(f"run {self._plan.settings.run.name} in {self._plan.folder}: starting the learner")
        self._display.say(str(self._division))
        require_free(self._plan.settings.network.listen)
        require_free_endpoints(
            {
                "metrics.listen, for the learner": self._plan.settings.metrics.listen,
                f"{METRICS_VARIABLE}, for the evaluator": os.environ.get(METRICS_VARIABLE, ""),
            }
        )
        self._supervisor.start(self._learner)
        with ExitStack() as stack:
            view = self._open_view(stop, stack)
            if view is None:
                self._drain()
                return False
            self._start_others()
            while not self._over(view.snapshot()):
                if stop.wait(POLL_SECONDS):
                    self._drain()
                    return False
                self._supervisor.check()
                if not self._learner.finished:  # afterwards there is no learner to show
                    self._display.show(view.snapshot(), self._where_to_look)
            return not self._stopped_early(view.snapshot())

    def _open_view(self, stop: threading.Event, stack: ExitStack) -> RunView | None:
        """Wait until the learner answers and return a view of the run; None if `stop` was set before."""
        deadline = time.monotonic() + START_SECONDS
        while not stop.is_set():
            self._supervisor.check()
            try:
                return stack.enter_context(
                    RunView(self._plan.address, self._plan.settings.run.name, timeout=1.0, stop=stop)
                )
            except (LearnerNotFound, RunNotFound):  # the latter: another learner uses the address
                if time.monotonic() > deadline:
                    log = self._learner.process.log
                    raise CommandError(
                        f"the learner did not answer within {START_SECONDS:.0f} s: see {log}"
                    ) from None
        return None

    def _start_others(self) -> None:
        if not simulation.is_compiled():
            self._display.say("compiling the simulation, about a minute, once per installation")
        for service in [*self._actors, self._evaluator]:
            self._supervisor.start(service)
        self._where_to_look += self._start_viewer()
        for line in self._where_to_look:
            self._display.say(line)

    def _start_viewer(self) -> list[str]:
        """Start the bridge to rerun if its port is free; return how to watch."""
        name, address = self._plan.settings.run.name, self._plan.address
        by_command = f"{program('athrl')} watch --connect {address} --run {name}"
        if self._viewer_port == 0:
            return [f"to watch: {by_command}"]
        if not is_free(self._viewer_port):
            return [
                f"port {self._viewer_port} is in use, so no viewer is served there; to watch: {by_command}"
            ]
        self._supervisor.start(self._plan.viewer(self._viewer_port))
        viewer = f"{program('rerun')} rerun+http://127.0.0.1:{self._viewer_port}/proxy"
        return [f"to watch: {viewer}, or {by_command}"]

    def _over(self, snapshot: RunSnapshot) -> bool:
        """Return whether learner and evaluator are done; end the actors when the learner is."""
        if not self._learner.finished:
            return False
        self._supervisor.stop(self._actors, DRAIN_SECONDS)
        if self._stopped_early(snapshot):
            return True
        self._comparison_until = self._comparison_until or time.monotonic() + COMPARISON_SECONDS
        return self._evaluator.finished or time.monotonic() > self._comparison_until

    @staticmethod
    def _stopped_early(snapshot: RunSnapshot) -> bool:
        """Return whether the learner was drained by another process before the end of the run."""
        return snapshot.state is not None and snapshot.state.phase is Phase.DRAINING

    def _drain(self) -> None:
        """Stop all services in order: the learner last, so that it receives what the others still hold."""
        self._display.say("stopping; a second signal stops at once")
        others = [service for service in self._supervisor.services if service is not self._learner]
        self._supervisor.stop(others, DRAIN_SECONDS)
        self._supervisor.stop([self._learner], CHECKPOINT_SECONDS)
