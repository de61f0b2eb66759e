"""Checks of a live run: connection, release, present services, waiting."""

from __future__ import annotations

import statistics
import threading
import time
from collections.abc import Iterator

import zenoh
from athrl_protocol import (
    InvalidMessage,
    MetricsReport,
    MetricsSubscriber,
    PresenceWatcher,
    StateSubscriber,
    fetch_run_file,
    open_session,
)
from athrl_protocol.messages.keys import HOST_ROLE

from athrl.doctor.finding import Finding, failed, ok, warning

ANSWER_SECONDS = 5.0
METRICS_SECONDS = 3.0
"""Services report once a second."""
SLOW_SECONDS, CLOCK_SECONDS = 0.5, 1.0
LAG_VERSIONS = 10
_QUESTIONS = 7


class _LearnerMetrics:
    """The newest metrics of the learner and their time of arrival."""

    def __init__(self) -> None:
        self.values: dict[str, float] = {}
        self.difference = 0.0  # between its clock and this one, seconds, including the network delay
        self.arrived = threading.Event()

    def __call__(self, report: MetricsReport) -> None:
        if report.role == "learner":
            self.values, self.difference = report.values, report.time - time.time()
            self.arrived.set()


def live_run(connect: str, run: str | None) -> Iterator[Finding]:
    """Check the run at an address; its name is not needed if there is only one."""
    with open_session(connect=connect, timeout=ANSWER_SECONDS) as session:
        yield ok("learner", f"reached at {connect}")
        try:
            name = fetch_run_file(session, run, timeout=ANSWER_SECONDS).run.name
        except InvalidMessage as error:
            yield failed("release", str(error), "install the learner's release here, or this one there")
            return
        yield ok("release", f"run {name}, the same schema as here")
        seconds = _round_trip(session, name)
        yield _speed(seconds)
        yield from _services(session, name, seconds)


def _round_trip(session: zenoh.Session, run: str) -> float:
    """Return the median time of a query and its answer, seconds."""
    seconds = []
    for _ in range(_QUESTIONS):
        began = time.perf_counter()
        fetch_run_file(session, run, timeout=ANSWER_SECONDS)
        seconds.append(time.perf_counter() - began)
    return statistics.median(seconds)


def _speed(seconds: float) -> Finding:
    seen = f"{seconds * 1000:.1f} ms for a query and its answer"
    if seconds > SLOW_SECONDS:
        return warning("round trip", seen, "check the network and the load of the learner")
    return ok("round trip", seen)


def _services(session: zenoh.Session, run: str, seconds: float) -> Iterator[Finding]:
    metrics = _LearnerMetrics()
    with (
        MetricsSubscriber(session, run, metrics),
        StateSubscriber(session, run) as states,
        PresenceWatcher(session, run) as presence,
    ):
        state = states.wait(ANSWER_SECONDS)
        arrived = metrics.arrived.wait(METRICS_SECONDS)
        there = sorted(service for service in presence.present() if service[0] != HOST_ROLE)
    yield _presence(there)
    if state is None:
        yield warning("state", "the learner does not report it", "see the learner's log")
        return
    steps = f"{state.environment_steps} of {state.environment_steps_target} steps, {state.updates} updates"
    yield ok("state", f"{state.phase.name.lower().replace('_', ' ')}, {steps}, policy {state.policy_version}")
    yield ok("waiting", state.waiting or "nothing waits")
    if not arrived:
        yield warning(
            "metrics",
            f"no metrics of the learner for {METRICS_SECONDS:.0f} s",
            "it is very busy, or this certificate may not read them: use a viewer's",
        )
        return
    yield _clock(metrics.difference + seconds / 2)
    yield _lag(metrics.values)


def _presence(there: list[tuple[str, str]]) -> Finding:
    seen = ", ".join(f"{role} {name}" for role, name in there) or "no services"
    if not any(role == "actor" for role, _ in there):
        return warning("present", seen, "no actor is running: athrl actor --connect ADDRESS --run RUN")
    return ok("present", seen)


def _clock(difference: float) -> Finding:
    seen = f"the learner's is {abs(difference):.2f} s {'ahead' if difference > 0 else 'behind'}"
    if abs(difference) > CLOCK_SECONDS:
        return warning("clock", seen, "synchronise both by NTP: policies and certificates need that")
    return ok("clock", seen)


def _lag(values: dict[str, float]) -> Finding:
    lag = values.get("policy_lag", 0.0)
    seen = f"the worst actor's last chunk was {lag:.0f} versions behind"
    if lag > LAG_VERSIONS:
        cause = "it sends what it collected while the learner was away, or its machine or network is too slow"
        return warning("policy lag", seen, f"{cause}: see athrl status")
    return ok("policy lag", seen)
