"""`athrl router`: passes on what the services of a node or a network and their learner say to each other.

It holds nothing back and keeps nothing, so it may be killed and started again at any time: clients keep what
is not acknowledged, and both sides connect anew by themselves.
"""

from __future__ import annotations

import logging
import threading
from contextlib import ExitStack
from typing import Annotated

import typer
import zenoh
from athrl_protocol import (
    LearnerNotFound,
    Phase,
    PresenceWatcher,
    RunFile,
    StateSubscriber,
    announce_presence,
    fetch_run_file,
    open_session,
)
from athrl_protocol.address import complete_address
from athrl_protocol.certificates import find_certificates
from athrl_protocol.leaving import await_what_is_on_its_way
from athrl_protocol.limits import largest_chunk_of
from athrl_protocol.session import open_router

from athrl.names import own_name
from athrl.options import (
    DEFAULTS,
    CertificatesOption,
    ConnectOption,
    LiveRunOption,
    NameOption,
    refusals_told,
)
from athrl.stopping import stop_on_signal

ROLE = "router"
POLL_SECONDS = 0.5
FAREWELL_SECONDS = 2.0  # for news of the end that are on their way

log = logging.getLogger(__name__)


def router(
    listen: Annotated[
        str,
        typer.Option(
            metavar="ADDRESS", help="Where services reach this router; they are given it as --connect."
        ),
    ],
    connect: ConnectOption = DEFAULTS.network.listen,
    run: LiveRunOption = None,
    name: NameOption = None,
    certificates: CertificatesOption = None,
) -> None:
    """Stand between actors, evaluators, viewers and their learner; ends with the run."""
    shown = find_certificates(certificates, ROLE)
    if shown is not None:
        shown.check_may_serve(ROLE)
    at, learner = (complete_address(address, secure=shown is not None) for address in (listen, connect))
    with stop_on_signal() as stop, refusals_told(certificates is not None):
        run_file = _await_run(connect, run, stop)
        if run_file is None:
            return
        with ExitStack() as stack:
            session = stack.enter_context(
                open_router(
                    listen=listen,
                    connect=connect,
                    run=run_file.run.name,
                    certificates=certificates,
                    largest_chunk=largest_chunk_of(run_file),
                )
            )
            stack.callback(await_what_is_on_its_way, session)
            log.info("router for run %s at %s, its learner at %s", run_file.run.name, at, learner)
            _stay(session, run_file.run.name, name or own_name(), stop)


def _await_run(connect: str, run: str | None, stop: threading.Event) -> RunFile | None:
    """Ask the learner for its run file, which says how large messages may be; None if `stop` was set."""
    patience = DEFAULTS.network.patience
    try:
        with open_session(connect=connect, timeout=patience, stop=stop, role=ROLE) as session:
            return fetch_run_file(session, run, timeout=patience, stop=stop)
    except LearnerNotFound:
        if stop.is_set():
            return None
        raise


def _stay(session: zenoh.Session, run: str, name: str, stop: threading.Event) -> None:
    """Wait until the run is finished and its learner has left, or until asked to stop."""
    with (
        announce_presence(session, run, ROLE, name),
        StateSubscriber(session, run) as states,
        PresenceWatcher(session, run) as presence,
    ):
        while not stop.wait(POLL_SECONDS):
            state = states.newest()
            learner_left = not any(role == "learner" for role, _ in presence.present())
            if state is not None and state.phase is Phase.FINISHED and learner_left:
                stop.wait(FAREWELL_SECONDS)
                log.info("run %s is finished", run)
                return
