"""Logs what Zenoh refuses in the learner's process.

Zenoh silently drops what its access list or its limits forbid; only its own trace on standard output shows
it. `refusals_logged` reads that trace and logs what an operator needs, one line each and at a limited rate:
which client was refused and why, what a client was not allowed to do, and, for debugging, which client
connected with which certificate. Everything else on standard output is passed on.
"""

from __future__ import annotations

import fcntl
import logging
import os
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

import zenoh

from athrl_protocol.faults.bounded_log import BoundedLog, shortened

_log = logging.getLogger(__name__)
_connections_log = logging.getLogger("athrl_protocol.connections")

_TARGETS = "zenoh_link_tls=debug,zenoh::net::routing::interceptor=trace"
_PIPE_BYTES = 2**20
_CLIENTS_KEPT = 1_000
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_ZENOH = re.compile(rb"ThreadId\((?P<thread>\d+)\)\S* \S*?(?P<target>zenoh[a-z_:]*)")
_INTERCEPTOR = b"zenoh::net::routing::interceptor"
_CLIENT = re.compile(rb"(?P<client>[0-9a-f]+) on \S*?CertCommonName\((?P<name>.*?)\)")
_ACCEPTED = re.compile(r"Accepted TLS connection on .*?: (?P<address>\S+)\. Common Name: (?P<name>.*)\.$")
_COMPLAINT = re.compile(r"(?:WARN|ERROR) .*?zenoh_link_tls\S* (?P<reason>.*)$")
_VERDICT = re.compile(
    r"(?P<client>[0-9a-f]+) (?:on .*? )?is (?P<verdict>authorized|unauthorized) to "
    r"(?P<action>[A-Za-z/ ]+) \((?P<flow>ingress|egress)\) on (?P<key>.*)$"
)


class TraceReader:
    """Turns lines of Zenoh's trace into lines for an operator.

    Zenoh logs its verdict on a message first, and then, if so, that a message was dropped. So the last
    verdict of each thread is kept.

    Args:
        refused: called with each refusal.
        connected: called with each connection.
    """

    def __init__(self, refused: Callable[[str], None], connected: Callable[[str], None]) -> None:
        self._refused = refused
        self._connected = connected
        self._accepted: dict[bytes, str] = {}  # thread -> the client that it accepted last
        self._verdicts: dict[bytes, bytes] = {}  # thread -> its last line
        self._names: dict[bytes, str] = {}  # client -> common name of its certificate

    def take(self, line: bytes) -> bool:
        """Process a line; return whether it is a trace line of Zenoh, which is not passed on."""
        found = _ZENOH.search(line)
        if found is None:
            return False
        thread, target = found["thread"], found["target"]
        if target.startswith(b"zenoh_link_tls"):
            self._take_handshake(thread, _plain(line))
            return True
        if target.startswith(_INTERCEPTOR):
            self._take_decision(thread, line)
            return True
        return False

    def _take_handshake(self, thread: bytes, text: str) -> None:
        accepted = _ACCEPTED.search(text)
        if accepted is not None:
            self._accepted[thread] = f"{shortened(accepted['name'])} from {accepted['address']}"
            self._connected(f"connected with the certificate {self._accepted[thread]}")
            return
        complaint = _COMPLAINT.search(text)
        if complaint is not None:
            # The hint is always about open files, whatever the cause.
            reason = complaint["reason"].split(". Hint:")[0]
            # A client only checked whether the port is open, as our own clients do before they connect.
            if reason != "tls handshake eof":
                self._refused(f"a connection was refused: {shortened(reason)}")

    def _take_decision(self, thread: bytes, line: bytes) -> None:
        if b"Msg intercepted!" in line:
            self._take_drop(self._verdicts.pop(thread, b""))
        elif b"did not match any configured ACL subject" in line:
            self._refused(
                f"the certificate {self._accepted.get(thread, 'of a client')} has no role in this run: "
                "it may do nothing"
            )
        else:
            self._verdicts[thread] = line
            client = _CLIENT.search(line)
            if client is not None:
                self._remember(client["client"], client["name"])

    def _remember(self, client: bytes, name: bytes) -> None:
        if len(self._names) >= _CLIENTS_KEPT:
            self._names.clear()
        self._names[client] = name.decode(errors="replace")

    def _take_drop(self, line: bytes) -> None:
        verdict = _VERDICT.search(_plain(line))
        if verdict is None or verdict["flow"] != "ingress":
            return  # a message of the learner to a client is not an action of the client
        who = self._names.get(verdict["client"].encode(), "?")
        what = f"{verdict['action']} on {shortened(verdict['key'])} with the certificate {shortened(who)}"
        if verdict["verdict"] == "unauthorized":
            self._refused(f"not allowed: {what}")
        else:  # allowed by the access list, so it was dropped for its size
            self._refused(f"too large: {what}")


def _plain(line: bytes) -> str:
    return _COLOUR.sub("", line.decode(errors="replace")).rstrip("\n")


@contextmanager
def refusals_logged() -> Iterator[None]:
    """Log Zenoh's refusals in this process inside the block; for a process that listens with certificates.

    Must be entered before the process opens its first session with Zenoh's own log. Inside the block standard
    output goes through a pipe; a thread removes Zenoh's lines and passes on the rest.
    """
    reader, writer = os.pipe()
    with suppress(OSError):  # a smaller pipe works as well
        fcntl.fcntl(writer, fcntl.F_SETPIPE_SZ, _PIPE_BYTES)
    # If this process is too busy to read, trace lines are dropped; the trace must not block the network.
    os.set_blocking(writer, False)
    output = os.dup(1)
    os.dup2(writer, 1)
    os.close(writer)
    _switch_trace_on()
    thread = threading.Thread(target=_read_trace, args=(reader, output), name="refusals", daemon=True)
    thread.start()
    try:
        yield
    finally:
        os.dup2(output, 1)  # closes the end of the pipe, so the thread ends
        thread.join(timeout=5.0)


def _switch_trace_on() -> None:
    """Let Zenoh write the trace that we need, in addition to the user's RUST_LOG."""
    before = os.environ.get("RUST_LOG")
    os.environ["RUST_LOG"] = f"{before},{_TARGETS}" if before else _TARGETS
    try:
        zenoh.init_log_from_env_or("off")
    finally:
        if before is None:
            del os.environ["RUST_LOG"]
        else:
            os.environ["RUST_LOG"] = before


def _read_trace(reader: int, output: int) -> None:
    trace = TraceReader(BoundedLog(_log.warning), BoundedLog(_connections_log.debug))
    with os.fdopen(reader, "rb") as lines, os.fdopen(output, "wb", buffering=0) as rest:
        for line in lines:
            try:
                if not trace.take(line):
                    rest.write(line)
            except Exception:  # the pipe must be read in any case
                _log.exception("a line of Zenoh's trace was not understood")
