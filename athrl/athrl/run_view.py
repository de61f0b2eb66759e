"""A view of a live run: a client of its learner that only listens."""

from __future__ import annotations

import threading
import time
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import cached_property
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
from athrl_protocol.announcements.answers import fetch_changes
from athrl_protocol.announcements.recent_rate import RecentRate
from athrl_protocol.run_file import RunFile
from athrl_protocol.transport.address import complete_address
from athrl_protocol.transport.session import listens

SILENT_SECONDS = 5.0
"""State and metrics arrive every second; after so long without new ones they are old."""

MOST_REPORTS, MOST_DRIVERS = 20_000, 50
"""Services and drivers that are kept: others make up their names."""

LEAST_SECONDS = 2.0
"""Least time over which a rate is measured."""

PROBE_SECONDS = 5.0
"""Between two looks whether a process listens where the learner was."""


WARNINGS = {
    "intake/lost": "chunks lost",
    "unpublished_policy": "chunks of unpublished policies",
    "rivals/answerers": "keys answered by others",
    "rivals/values": "values published by others",
    "actors_left": "actors that left early",
}
"""Metrics of the learner that are 0 in a healthy run; the learner's log has a line for each."""


@dataclass(frozen=True)
class RunSnapshot:
    """A run at one moment.

    `metrics` are the newest values of each service that reported recently, by (role, name); `evaluations` the
    newest result of each driver; `present` the present services; `steps_per_second` is measured over the last
    minute of the current phase, None at first; `changes` are those of the settings, in one line each;
    `silence` says why the learner is not heard, empty while it is.
    """

    settings: RunFile
    state: RunState | None
    metrics: dict[tuple[str, str], dict[str, float]]
    evaluations: dict[str, EvaluationResult]
    present: frozenset[tuple[str, str]]
    steps_per_second: float | None = None
    changes: tuple[str, ...] = ()
    silence: str = ""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the learner counted that should not happen, in a few words each."""
        counts = [(self.learner_metric(name) or 0.0, what) for name, what in WARNINGS.items()]
        return tuple(f"{what}: {count:,.0f}" for count, what in counts if count > 0)

    @property
    def finished(self) -> bool:
        """Whether all environment steps are done."""
        return self.state is not None and self.state.phase is Phase.FINISHED

    @cached_property
    def _names(self) -> dict[str, list[str]]:
        """The present services of each role, sorted."""
        names: dict[str, list[str]] = {}
        for role, name in sorted(self.present):
            names.setdefault(role, []).append(name)
        return names

    def of_role(self, role: str) -> dict[str, dict[str, float]]:
        """Return the metrics of every present service of a role by its name; empty if it did not report."""
        return {name: self.metrics.get((role, name), {}) for name in self._names.get(role, ())}

    def learner_metric(self, name: str) -> float | None:
        """Return a metric of the learner; None if it was not reported."""
        for values in self.of_role("learner").values():
            if name in values:
                return values[name]
        return None


@dataclass
class RunView:
    """Listens to a run, or with None to the only run at the address; `snapshot` is its current state.

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
    _rate: RecentRate = field(default_factory=RecentRate, init=False)
    _phase: Phase | None = field(default=None, init=False)
    _changes: tuple[str, ...] = field(default=(), init=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, init=False)
    _heard_at: float = field(default=0.0, init=False)
    _probed_at: float = field(default=0.0, init=False)
    _listens: bool = field(default=True, init=False)

    def __enter__(self) -> RunView:
        with ExitStack() as stack:
            session = stack.enter_context(
                open_session(connect=self.connect, timeout=self.timeout, stop=self.stop)
            )
            self.settings = fetch_run_file(session, self.run, timeout=self.timeout)
            run = self.settings.run.name
            self._changes = tuple(fetch_changes(session, run))
            self._session, self._heard_at = session, time.monotonic()
            self._address = complete_address(self.connect, secure=self.connect.startswith("tls/"))
            self._state = stack.enter_context(StateSubscriber(session, run, self._on_state))
            stack.enter_context(MetricsSubscriber(session, run, self._on_metrics))
            stack.enter_context(EvaluationSubscriber(session, run, self._on_evaluation))
            self._presence = stack.enter_context(PresenceWatcher(session, run))
            self._open = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._open.close()

    def _on_state(self, state: RunState) -> None:
        self._heard_at = time.monotonic()

    def _on_metrics(self, report: MetricsReport) -> None:
        who = (report.role, report.name)
        with self._lock:
            self._reports.pop(who, None)  # so that they are in the order of time
            self._reports[who] = (time.monotonic(), report.values)
            if len(self._reports) > MOST_REPORTS:
                del self._reports[next(iter(self._reports))]

    def _on_evaluation(self, result: EvaluationResult) -> None:
        with self._lock:
            if result.driver in self._evaluations or len(self._evaluations) < MOST_DRIVERS:
                self._evaluations[result.driver] = result

    def snapshot(self) -> RunSnapshot:
        """Return the current state."""
        now = time.monotonic()
        state = self._state.newest()
        with self._lock:
            for who in [who for who, (at, _) in self._reports.items() if now - at > SILENT_SECONDS]:
                del self._reports[who]
            metrics = {who: values for who, (_, values) in self._reports.items()}
            evaluations = dict(self._evaluations)
            if state is not None:
                self._note_progress(state)
        present = frozenset(self._presence.present())
        return RunSnapshot(
            self.settings,
            state,
            metrics,
            evaluations,
            present,
            self._rate.per_second(least=LEAST_SECONDS),
            self._changes,
            self._silence(now, present),
        )

    def _note_progress(self, state: RunState) -> None:
        if state.phase is not self._phase:  # the warm-up is many times faster than training
            self._phase = state.phase
            self._rate.restart()
        self._rate.note(state.environment_steps)

    def _silence(self, now: float, present: frozenset[tuple[str, str]]) -> str:
        """Why nothing is heard of the learner; empty while it is heard."""
        seconds = now - self._heard_at
        if seconds <= SILENT_SECONDS:
            return ""
        there = any(role == "learner" for role, _ in present)
        if not there and self._connected():
            what = f"is behind the router at {self._address}, and paused, cut off or absent"
        elif there or self._is_there(now):
            what = "is paused or very busy"
        else:
            what = f"is absent, no process listens at {self._address}"
        return f"the learner {what}: no message from it for {seconds:.0f} s"

    def _connected(self) -> bool:
        """Whether there is a connection; a paused process loses it."""
        return bool(self._session.info.links())

    def _is_there(self, now: float) -> bool:
        """Whether a process listens at the address, as a paused one does; looked up now and then."""
        if now - self._probed_at > PROBE_SECONDS:
            self._probed_at, self._listens = now, listens(self._address)
        return self._listens
