"""What can be known of a live run from outside: a client of its learner that only listens."""

from __future__ import annotations

import threading
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from types import TracebackType

from athrl_protocol import (
    EvaluationResult,
    EvaluationSubscriber,
    MetricsReport,
    MetricsSubscriber,
    Phase,
    PresenceWatcher,
    RunState,
    StateSubscriber,
    fetch_run_file,
    open_session,
)
from athrl_protocol.run_file import RunFile

SILENT_SECONDS = 5.0
"""Metrics come every second; after so long without they are old."""


@dataclass(frozen=True)
class RunSnapshot:
    """A run at one moment.

    `metrics` holds the newest values of each service that spoke lately, by (role, name); `evaluations` the
    newest result of each driver; `present` the services that are there; `steps_per_second` is measured over
    the last half minute of the present phase, None at first.
    """

    settings: RunFile
    state: RunState | None
    metrics: dict[tuple[str, str], dict[str, float]]
    evaluations: dict[str, EvaluationResult]
    present: frozenset[tuple[str, str]]
    steps_per_second: float | None = None

    @property
    def finished(self) -> bool:
        """Whether all environment steps are done."""
        return self.state is not None and self.state.phase is Phase.FINISHED

    def of_role(self, role: str) -> dict[str, dict[str, float]]:
        """Return the metrics of every present service of a role, by its name; empty where it is silent."""
        return {
            name: self.metrics.get((role, name), {}) for found, name in sorted(self.present) if found == role
        }

    def learner_metric(self, name: str) -> float | None:
        """Return a value of the learner, None where it has not said it."""
        for values in self.of_role("learner").values():
            if name in values:
                return values[name]
        return None


@dataclass
class RunView:
    """Listens to a run, or with None to the only one that is there; `snapshot` is what is known now.

    Use it in `with`.

    Raises on entering: LearnerNotFound, RunNotFound (`athrl_protocol`).
    """

    connect: str
    run: str | None
    timeout: float
    stop: threading.Event | None = None
    settings: RunFile = field(init=False)
    _open: ExitStack = field(default_factory=ExitStack, init=False)
    _reports: dict[tuple[str, str], tuple[float, dict[str, float]]] = field(default_factory=dict, init=False)
    _evaluations: dict[str, EvaluationResult] = field(default_factory=dict, init=False)
    _progress: list[tuple[float, int]] = field(default_factory=list, init=False)
    _phase: Phase | None = field(default=None, init=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, init=False)

    def __enter__(self) -> RunView:
        with ExitStack() as stack:
            session = stack.enter_context(
                open_session(connect=self.connect, timeout=self.timeout, stop=self.stop)
            )
            self.settings = fetch_run_file(session, self.run, timeout=self.timeout)
            run = self.settings.run.name
            self._state = stack.enter_context(StateSubscriber(session, run))
            stack.enter_context(MetricsSubscriber(session, run, self._on_metrics))
            stack.enter_context(EvaluationSubscriber(session, run, self._on_evaluation))
            self._presence = stack.enter_context(PresenceWatcher(session, run))
            self._open = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.close()

    def _on_metrics(self, report: MetricsReport) -> None:
        with self._lock:
            self._reports[report.role, report.name] = (time.monotonic(), report.values)

    def _on_evaluation(self, result: EvaluationResult) -> None:
        with self._lock:
            self._evaluations[result.driver] = result

    def snapshot(self) -> RunSnapshot:
        """Return what is known at this moment."""
        now = time.monotonic()
        state = self._state.newest()
        with self._lock:
            metrics = {
                who: values for who, (at, values) in self._reports.items() if now - at <= SILENT_SECONDS
            }
            evaluations = dict(self._evaluations)
            if state is not None:
                self._note_progress(now, state)
            rate = self._rate()
        return RunSnapshot(
            self.settings, state, metrics, evaluations, frozenset(self._presence.present()), rate
        )

    def _note_progress(self, now: float, state: RunState) -> None:
        if state.phase is not self._phase:  # the warm-up is many times faster than what follows
            self._phase = state.phase
            self._progress.clear()
        self._progress.append((now, state.environment_steps))
        self._progress = [(at, steps) for at, steps in self._progress if now - at <= 30.0]

    def _rate(self) -> float | None:
        """Environment steps a second over what is remembered."""
        if len(self._progress) < 2:
            return None
        (first_at, first), (last_at, last) = self._progress[0], self._progress[-1]
        return (last - first) / (last_at - first_at) if last_at - first_at >= 2.0 else None
