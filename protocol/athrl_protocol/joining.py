"""Join a run: connect to its learner, read the run file, take a name that nobody else has."""

from __future__ import annotations

import logging
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

import zenoh

from athrl_protocol.announcements import fetch_run_file
from athrl_protocol.errors import LearnerNotFound, NameTaken
from athrl_protocol.leaving import await_what_is_on_its_way
from athrl_protocol.presence import PresenceGlance, announce_presence
from athrl_protocol.run_file import NetworkSection, RunFile
from athrl_protocol.session import open_session

NAME_SECONDS = 8.0  # longer than a service that hung or lost its network keeps its name (the session's lease)
NOTICE_SECONDS = 3.0  # without a learner until somebody at a terminal is told what is waited for
PRESENCE_SECONDS = 2.0  # within which those present, at least the learner, have shown
GLANCE_SECONDS = 0.005

log = logging.getLogger(__name__)


def join_run(
    *, role: str, connect: str, run: str, name: str, stop: threading.Event, stack: ExitStack
) -> tuple[zenoh.Session, RunFile] | None:
    """Return session and run file once the name is taken; None if `stop` was set meanwhile.

    `role` is actor or evaluator. What must be closed is put on `stack`.

    Raises:
        LearnerNotFound: nobody answers at the address.
        NotAdmitted: the learner there and this service do not trust each other's certificates.
        RunNotFound: the learner there has another run.
        NameTaken: another live service of that role has the name.
    """
    patience = NetworkSection().patience  # the run's own is not known before its learner is there
    with _notice_at_a_terminal(f"waiting up to {patience:.0f} s for a learner at {connect}"):
        try:
            session = stack.enter_context(
                open_session(connect=connect, timeout=patience, stop=stop, role=role)
            )
            stack.callback(await_what_is_on_its_way, session)
            run_file = fetch_run_file(session, run, timeout=patience, stop=stop)
        except LearnerNotFound:
            if stop.is_set():
                return None
            raise
    return (session, run_file) if _take_name(session, run, role, name, stop, stack) else None


@contextmanager
def _notice_at_a_terminal(text: str) -> Iterator[None]:
    """Say what is waited for, if it takes a while and somebody sits there; a log has the error in the end."""
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
    """Announce the service under its name once nobody else has it; False if `stop` was set meanwhile."""
    with (
        PresenceGlance(session, run, role, name) as namesake,
        PresenceGlance(session, run, "learner") as learner,  # after it, so that it is told after it
    ):
        _wait_until(learner.is_anybody_there, PRESENCE_SECONDS, stop)
        free = _wait_until(lambda: not namesake.is_anybody_there(), NAME_SECONDS, stop)
    if stop.is_set():
        return False
    if not free:
        raise NameTaken(f"the run {run} already has an {role} {name!r}; start this one with another --name")
    stack.enter_context(announce_presence(session, run, role, name))
    return True


def _wait_until(reached: Callable[[], bool], seconds: float, stop: threading.Event) -> bool:
    """Wait until something is so; whether it is, once the time is over or `stop` is set."""
    deadline = time.monotonic() + seconds
    while not reached():
        if time.monotonic() > deadline or stop.wait(GLANCE_SECONDS):
            return reached()
    return True
