"""Join a run: connect to its learner, read the run file, take a name that is free."""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

import zenoh

from athrl_protocol.announcements import fetch_run_file
from athrl_protocol.announcements.answers import ask_for_name
from athrl_protocol.announcements.presence import PresencePoll, announce_presence
from athrl_protocol.errors import LearnerNotFound, NameTaken
from athrl_protocol.messages.keys import HOST_ROLE, check_name, new_incarnation
from athrl_protocol.run_file import NetworkSection, RunFile, require_same_maps
from athrl_protocol.transport.graceful_close import drain_incoming
from athrl_protocol.transport.session import open_session

NAME_SECONDS = 8.0  # longer than a hanging or disconnected service keeps its name (the session's lease)
NOTICE_SECONDS = 3.0  # without a learner until a user at a terminal gets a notice
PRESENCE_SECONDS = 2.0  # until present services, at least the learner, are known
POLL_SECONDS = 0.005

log = logging.getLogger(__name__)


class Joined(NamedTuple):
    """A service's part in a run: its session, the run file, and its name in the run."""

    session: zenoh.Session
    run_file: RunFile
    name: str


def join_run(
    *,
    role: str,
    connect: str,
    run: str,
    name: str | None,
    stop: threading.Event,
    stack: ExitStack,
    host: str = "",
) -> Joined | None:
    """Take part in a run under a name that no other service has; None if `stop` was set before.

    Args:
        role: actor or evaluator.
        connect: address of the learner or of a router.
        run: name of the run.
        name: name of the service; None: the learner gives one that is free, `actor-1` and so on.
        stop: set by another thread to stop waiting early.
        stack: gets everything that must be closed.
        host: name of an actor's host and process, by which the host's health check finds it.

    Raises:
        LearnerNotFound: no learner answers at the address.
        NotAdmitted: the learner there and this service do not trust each other's certificates.
        RunNotFound: the learner there has another run.
        NameTaken: another live service of that role has the name.
        RunFileError: a map of the run is missing on this machine, or is another one.
        ProtocolError: a name cannot be one; nobody has been waited for.
    """
    check_name("run name", run)
    if name is not None:
        check_name(role, name)
    patience = NetworkSection().patience  # the run's own setting is only known once its learner answers
    with _notice_at_a_terminal(f"waiting up to {patience:.0f} s for a learner at {connect}"):
        try:
            session = stack.enter_context(
                open_session(connect=connect, timeout=patience, stop=stop, role=role, name=name)
            )
            stack.callback(drain_incoming, session)
            run_file = fetch_run_file(session, run, timeout=patience, stop=stop)
            require_same_maps(run_file)
            found = name or ask_for_name(
                session, run, role, host or f"{role}-{new_incarnation()}", patience, stop
            )
        except LearnerNotFound:
            if stop.is_set():
                return None
            raise
    if found is None or not _take_name(session, run, role, found, stop, stack):
        return None
    log.info("takes part in the run %s as %s", run, found)
    if host and role == "actor":
        stack.enter_context(announce_presence(session, run, HOST_ROLE, host))
    return Joined(session, run_file, found)


@contextmanager
def _notice_at_a_terminal(text: str) -> Iterator[None]:
    """Log what is waited for after some seconds, if a user sees it; a log file only gets the final error."""
    timer = threading.Timer(NOTICE_SECONDS, log.warning, (text,))
    timer.daemon = True
    if sys.stderr.isatty():
        timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _take_name(
    session: zenoh.Session, run: str, role: str, name: str, stop: threading.Event, stack: ExitStack
) -> bool:
    """Announce the service under its name once the name is free; False if `stop` was set before."""
    with (
        PresencePoll(session, run, role, name) as namesake,
        PresencePoll(session, run, "learner") as learner,  # declared second, so that its events come second
    ):
        _wait_until(learner.any_present, PRESENCE_SECONDS, stop)
        free = _wait_until(lambda: not namesake.any_present(), NAME_SECONDS, stop)
    if stop.is_set():
        return False
    if not free:
        raise NameTaken(f"the run {run} already has an {role} {name!r}; start this one with another --name")
    stack.enter_context(announce_presence(session, run, role, name))
    return True


def _wait_until(reached: Callable[[], bool], seconds: float, stop: threading.Event) -> bool:
    """Wait until the condition holds, the time is over or `stop` is set; return whether it holds."""
    deadline = time.monotonic() + seconds
    while not reached():
        if time.monotonic() > deadline or stop.wait(POLL_SECONDS):
            return reached()
    return True
