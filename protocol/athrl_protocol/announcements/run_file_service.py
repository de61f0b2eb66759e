"""The run file: the learner serves it, so a service only needs an address and the name of the run."""

from __future__ import annotations

import threading
import time

import zenoh

from athrl_protocol.announcements.latest_value import LatestPublisher
from athrl_protocol.errors import LearnerNotFound, RunNotFound
from athrl_protocol.messages import athrl_pb2
from athrl_protocol.messages.keys import EVERY_RUN_FILE, Keys, run_of
from athrl_protocol.messages.schema import decode_message, encode_message
from athrl_protocol.run_file import RunFile
from athrl_protocol.transport.session import address_of, certificate_hint

QUERY_SECONDS = 1.0
PAUSE_SECONDS = 0.1
# A learner behind a router may appear a little later than others.
OTHER_RUNS_SECONDS = 2.0


def serve_run_file(session: zenoh.Session, run_file: RunFile) -> LatestPublisher:
    """Serve the run file under the name of its run until the returned publisher is closed."""
    name = run_file.run.name
    publisher = LatestPublisher(session, Keys(name).run_file)
    publisher.publish(encode_message(athrl_pb2.RunFile(run=name, json=run_file.to_json())))
    return publisher


def fetch_run_file(
    session: zenoh.Session, run: str | None, timeout: float, stop: threading.Event | None = None
) -> RunFile:
    """Query the learner for the run file of `run`, or of the only run at the address.

    Args:
        session: an open session to the learner.
        run: name of the run; None if there is only one.
        timeout: seconds to wait for a learner.
        stop: set by another thread to stop waiting early.

    Raises:
        RunNotFound: other runs, or several, are served there; the text names them.
        LearnerNotFound: no run is served there within the timeout, or `stop` was set.
        InvalidMessage: the learner has another release.
        RunFileError: the learner's run file is not valid in this release.
    """
    stop = stop or threading.Event()
    started = time.monotonic()
    key = EVERY_RUN_FILE if run is None else Keys(run).run_file
    while True:
        found = _query(session, key)
        if len(found) > 1:
            names = ", ".join(sorted(run_of(each) for each in found))
            raise RunNotFound(f"there are several runs at {address_of(session)}: name one of {names}")
        for payload in found.values():
            return RunFile.from_json(decode_message(athrl_pb2.RunFile, payload).json)
        waited = time.monotonic() - started
        others = sorted(run_of(other) for other in _query(session, EVERY_RUN_FILE))
        if others and run not in others and waited >= min(timeout, OTHER_RUNS_SECONDS):
            raise RunNotFound(
                f"no run {run!r} at {address_of(session)}: name one of those it has, {', '.join(others)}"
            )
        if waited >= timeout or stop.wait(PAUSE_SECONDS):
            raise LearnerNotFound(
                f"no learner serves {'a run' if run is None else f'run {run!r}'} at {address_of(session)} "
                f"within {timeout:g} s: start it there{certificate_hint(session)}"
            )


def _query(session: zenoh.Session, key: str) -> dict[str, bytes]:
    """Return the payloads of all answers by key."""
    replies = session.get(
        key,
        target=zenoh.QueryTarget.ALL,
        consolidation=zenoh.ConsolidationMode.NONE,
        timeout=QUERY_SECONDS,
    )
    found: dict[str, bytes] = {}
    for reply in replies:
        if reply.ok is not None and reply.ok.kind == zenoh.SampleKind.PUT:
            found[str(reply.ok.key_expr)] = reply.ok.payload.to_bytes()
    return found
