"""Join a run: connect to its learner, read the run file, take a name that nobody else has."""

from __future__ import annotations

import os
import re
import socket
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack

import zenoh
from athrl_protocol import (
    LearnerNotFound,
    PresenceWatcher,
    ProtocolError,
    announce_presence,
    fetch_run_file,
    open_session,
)
from athrl_protocol.run_file import NetworkSection, RunFile

ROLE = "evaluator"
NAME_SECONDS = 8.0  # longer than a service that hung or lost its network keeps its name (the session's lease)
PRESENCE_SECONDS = 2.0  # within which those present, at least the learner, have shown


class NameTaken(ProtocolError):  # noqa: N818  (the name says what is wrong)
    """Another live service of the run has this name."""


def join_run(
    *, connect: str, run: str, name: str | None, stop: threading.Event, stack: ExitStack
) -> tuple[zenoh.Session, RunFile, str] | None:
    """Return session, run file and the name that was taken; None if `stop` was set meanwhile.

    What must be closed is put on `stack`. Raises LearnerNotFound, RunNotFound or NameTaken. Without a `name`
    the host's name and the process's number are it.
    """
    patience = NetworkSection().patience  # the run's own is not known before its learner is there
    try:
        session = stack.enter_context(open_session(connect=connect, timeout=patience, stop=stop))
        run_file = fetch_run_file(session, run, timeout=patience, stop=stop)
    except LearnerNotFound:
        if stop.is_set():
            return None
        raise
    taken = _take_name(session, run, name, stop, stack)
    return None if taken is None else (session, run_file, taken)


def _take_name(
    session: zenoh.Session, run: str, name: str | None, stop: threading.Event, stack: ExitStack
) -> str | None:
    """Announce the service under its name once nobody else has it; None if `stop` was set meanwhile."""
    with PresenceWatcher(session, run) as watcher:
        _wait_until(lambda: any(role == "learner" for role, _ in watcher.present()), PRESENCE_SECONDS, stop)
        name = name or _own_name({taken for role, taken in watcher.present() if role == ROLE})
        free = _wait_until(lambda: (ROLE, name) not in watcher.present(), NAME_SECONDS, stop)
    if stop.is_set():
        return None
    if not free:
        raise NameTaken(f"the run {run} already has an {ROLE} {name!r}; start this one with another --name")
    stack.enter_context(announce_presence(session, run, ROLE, name))
    return name


def _own_name(taken: set[str]) -> str:
    """The host's name and the process's number, and another number behind it where even that is taken."""
    host = re.sub(r"[^a-z0-9-]+", "-", socket.gethostname().lower()).strip("-") or ROLE
    names = [
        f"{host}-{os.getpid()}",
        *(f"{host}-{os.getpid()}-{number}" for number in range(2, len(taken) + 3)),
    ]
    return next(name for name in names if name not in taken)


def _wait_until(reached: Callable[[], bool], seconds: float, stop: threading.Event) -> bool:
    """Wait until something is so; whether it is, once the time is over or `stop` is set."""
    deadline = time.monotonic() + seconds
    while not reached():
        if time.monotonic() > deadline or stop.wait(0.02):
            return reached()
    return True
