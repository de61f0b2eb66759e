"""`athrl router`: passes messages between the services of a node or network and their learner.

It stores nothing, so it may be killed and restarted at any time: clients keep unacknowledged chunks, and both
sides reconnect. With a run's folder as `--connect` it follows the learner to other machines.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import Counter
from contextlib import ExitStack
from typing import Annotated

import typer
import zenoh
from athrl_protocol import (
    LearnerNotFound,
    Phase,
    PresenceWatcher,
    RunFile,
    RunState,
    StateSubscriber,
    announce_presence,
    fetch_run_file,
    open_session,
)
from athrl_protocol.monitoring.endpoint import serve_metrics
from athrl_protocol.monitoring.figures import ServiceFigures
from athrl_protocol.monitoring.table import ROUTER
from athrl_protocol.security.certificates import find_certificates
from athrl_protocol.transport.address import complete_address
from athrl_protocol.transport.graceful_close import drain_incoming
from athrl_protocol.transport.session import open_router
from athrl_protocol.transport.size_filter import largest_chunk_of

from athrl.options import (
    DEFAULTS,
    CertificatesOption,
    FollowOption,
    LiveRunOption,
    MetricsListenOption,
    NameOption,
    logged_refusals,
)
from athrl.rendezvous.following import follow
from athrl.rendezvous.run_folder import folder_in
from athrl.service_names import own_name
from athrl.stopping import stop_on_signal

ROLE = "router"
SERVICES = ("learner", "actor", "evaluator", "router")
"""Roles whose present services are counted."""
POLL_SECONDS = 0.5
CLOSING_SECONDS = 2.0  # for messages about the end that are in flight

log = logging.getLogger(__name__)


def router(
    listen: Annotated[
        str,
        typer.Option(metavar="ADDRESS", help="Address at which services connect to this router."),
    ],
    connect: FollowOption = DEFAULTS.network.listen,
    run: LiveRunOption = None,
    name: NameOption = None,
    certificates: CertificatesOption = None,
    metrics_listen: MetricsListenOption = "",
) -> None:
    """Route messages between actors, evaluators, viewers and the learner; ends with the run."""
    folder = folder_in(connect)  # which may have the certificates
    wanted = run if folder is None else folder.name
    shown = find_certificates(certificates, ROLE)
    if shown is not None:
        shown.check_may_serve(ROLE)
    at = complete_address(listen, secure=shown is not None)
    learner = f"named in {folder}" if folder else f"at {complete_address(connect, secure=shown is not None)}"

    def serve(address: str, over: threading.Event) -> None:
        run_file = _await_run(address, wanted, over)
        if run_file is None:
            return
        with ExitStack() as stack:
            session = stack.enter_context(
                open_router(
                    listen=listen,
                    connect=address,
                    run=run_file.run.name,
                    certificates=certificates,
                    largest_chunk=largest_chunk_of(run_file),
                )
            )
            stack.callback(drain_incoming, session)
            log.info("router for run %s at %s, its learner %s", run_file.run.name, at, learner)
            figures = ServiceFigures(ROUTER, {"run": run_file.run.name})
            stack.enter_context(serve_metrics(metrics_listen, figures))
            _stay(session, run_file.run.name, name or own_name(), figures, over)

    with stop_on_signal() as stop, logged_refusals(shown is not None):
        follow(connect, stop, serve)


def _await_run(connect: str, run: str | None, stop: threading.Event) -> RunFile | None:
    """Read the learner's run file, which determines size limits; None if `stop` was set."""
    patience = DEFAULTS.network.patience
    try:
        with open_session(connect=connect, timeout=patience, stop=stop, role=ROLE) as session:
            return fetch_run_file(session, run, timeout=patience, stop=stop)
    except LearnerNotFound:
        if stop.is_set():
            return None
        raise


def _stay(
    session: zenoh.Session, run: str, name: str, figures: ServiceFigures, stop: threading.Event
) -> None:
    """Wait until the run is finished and its learner has left, or until `stop` is set."""
    learner = _LearnerHeard()
    with (
        announce_presence(session, run, ROLE, name),
        StateSubscriber(session, run, learner.heard) as states,
        PresenceWatcher(session, run) as presence,
    ):
        while not stop.wait(POLL_SECONDS):
            state = states.newest()
            present = Counter(role for role, _ in presence.present())
            figures.show(
                {
                    "connections": float(len(session.info.links())),
                    "learner_silent_seconds": learner.silent_seconds,
                    **{f"services/{role}": float(present[role]) for role in SERVICES},
                }
            )
            if state is not None and state.phase is Phase.FINISHED and not present["learner"]:
                stop.wait(CLOSING_SECONDS)
                log.info("run %s is finished", run)
                return


class _LearnerHeard:
    """When the learner last told the state of the run, as it does once a second."""

    def __init__(self) -> None:
        self._at = time.monotonic()

    def heard(self, state: RunState) -> None:
        self._at = time.monotonic()

    @property
    def silent_seconds(self) -> float:
        return time.monotonic() - self._at
