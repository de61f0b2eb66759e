"""Zenoh sessions: the learner listens as a router; all others are clients of it or of a router.

Scouting is off, so a session only connects to the given address. A client that loses its learner tries again
every 0.1 to 0.5 s while it is open. Close sessions in `finally` (or use `with`): an open session with a
subscriber keeps its process from ending. Zenoh's own log is not switched on here, because it goes to standard
output (`faults.zenoh_refusals`).

With certificates every connection is mutual TLS, and the learner restricts each role to its permissions
(`security.access`). A client reads its files again for each connection, so it uses a renewed certificate from
the next connection on.
"""

from __future__ import annotations

import json
import socket
import threading
import time
from pathlib import Path
from typing import Any, Protocol

import zenoh
from athrl_spaces.wording import system_reason

from athrl_protocol.errors import AddressInUse, LearnerNotFound, NotAdmitted, ProtocolError
from athrl_protocol.messages.limits import LARGEST_CHUNK, LARGEST_POLICY
from athrl_protocol.security.access import access_list, access_list_of_router
from athrl_protocol.security.certificates import Certificates, find_certificates, read_bound_names
from athrl_protocol.transport.address import complete_address, split_address
from athrl_protocol.transport.connection_monitor import monitor
from athrl_protocol.transport.graceful_close import closed_gracefully
from athrl_protocol.transport.handshake import admission_error
from athrl_protocol.transport.reconnection import Reconnection
from athrl_protocol.transport.size_filter import largest_message, size_filter
from athrl_protocol.transport.socket_options import set_backlog

# Of one learner or router; further clients get the error that there is no answer.
MOST_CONNECTIONS = 10_000
# A silent peer is given up after this time; a killed one at once, as its connection is closed.
LEASE_MILLISECONDS = 5_000
RETRY = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2}
# TCP would retry one connection for minutes, at growing intervals: after an outage a new one is faster.
OPEN_MILLISECONDS = 2_000
# Zenoh's attempts cannot be interrupted by a signal, so each is short.
ATTEMPT_SECONDS = 1.0
# With TLS both are longer: a listener accepts no connection for 0.1 s after each one that was given up before
# its handshake was over (zenoh-link-tls 1.10, TLS_ACCEPT_THROTTLE_TIME), so many clients with short time-outs
# would lock each other out.
SECURE_OPEN_MILLISECONDS = 5_000
SECURE_ATTEMPT_SECONDS = 5.0
# For the same reason the backlog is short: a listener may be paused until clients have given up. TCP retries
# further connections.
MOST_WAITING = 16
# For which a router waits for its learner's answer; all of its clients wait with it.
ROUTER_PATIENCE = 2.0
PAUSE_SECONDS = 0.1
# A refusal may be temporary: certificates are being renewed, a learner is being replaced.
REFUSED_SECONDS = 3.0
_SILENCE = {
    False: "the process that listens there does not answer: a learner that is paused or busy, or no learner",
    True: "the process that listens there does not answer in TLS: a learner that is paused or busy or has no "
    "certificates, or no learner",
}


def open_session(
    *,
    listen: str | None = None,
    connect: str | None = None,
    timeout: float,
    stop: threading.Event | None = None,
    run: str | None = None,
    role: str = "viewer",
    name: str | None = None,
    certificates: str | Path | None = None,
    largest_chunk: int = LARGEST_CHUNK,
) -> zenoh.Session:
    """Open the session of a service; exactly one of `listen` and `connect` is given.

    Args:
        listen: address at which the learner listens, for instance `tcp/127.0.0.1:7447`.
        connect: address of the learner.
        timeout: seconds to wait for the learner at `connect`.
        stop: set by another thread to stop waiting early.
        run: the learner's run, for the keys of its access list and its limits.
        role: role of a client, whose certificate is used.
        name: of an actor, for a certificate that is bound to it.
        certificates: folder of certificates; by default ATHRL_CERTIFICATES. With certificates the address is
            `tls/...`; `tcp/...` means the same.
        largest_chunk: most bytes of a chunk's message that the learner accepts.

    Raises:
        AddressInUse: another process already listens there; raised at once.
        LearnerNotFound: no learner listens there within the timeout, or `stop` was set.
        NotAdmitted: a learner listens there, but one of the two does not trust the other's certificate.
        ProtocolError: the address is not valid, this machine cannot listen there, or certificates are
            missing.
    """
    if (listen is None) == (connect is None):
        raise ValueError("open_session takes either listen or connect")
    if listen is not None:
        shown = find_certificates(certificates, "learner")
        if shown is not None and run is None:
            raise ValueError("a session that listens with certificates needs the name of its run")
        return _listen(complete_address(listen, secure=shown is not None), shown, run, largest_chunk)
    assert connect is not None
    shown = find_certificates(certificates, role, name)
    address = complete_address(connect, secure=shown is not None)
    return _connect(address, shown, timeout, stop or threading.Event())


def open_router(
    *,
    listen: str,
    connect: str,
    run: str,
    certificates: str | Path | None = None,
    largest_chunk: int = LARGEST_CHUNK,
) -> zenoh.Session:
    """Open a session that passes messages between clients at `listen` and the learner at `connect`.

    It connects to the learner repeatedly, and stays open whether the learner is present or not. With
    certificates it restricts each role to its permissions, as the learner does. Arguments and errors are
    those of `open_session`.
    """
    shown = find_certificates(certificates, "router")
    learner = complete_address(connect, secure=shown is not None)
    settings: dict[str, Any] = {
        "connect/endpoints": [learner],
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": RETRY,
        # Policies must pass; the filter on keys limits the messages of clients.
        "transport/link/rx/max_message_size": LARGEST_POLICY,
        "low_pass_filter": size_filter(run, largest_chunk),
    }
    if shown is not None:
        settings["access_control"] = access_list_of_router(run, read_bound_names(shown))
    session = _open_listener(complete_address(listen, secure=shown is not None), shown, settings)
    monitor(session, Reconnection(session, learner, run, ROUTER_PATIENCE))
    return closed_gracefully(session)


def _configuration(mode: str, shown: Certificates | None, settings: dict[str, Any]) -> zenoh.Config:
    configuration = zenoh.Config()
    everything = {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "scouting/delay": 0,  # a router would wait that long for scouting
        "transport/link/tx/lease": LEASE_MILLISECONDS,
        "transport/unicast/open_timeout": OPEN_MILLISECONDS if shown is None else SECURE_OPEN_MILLISECONDS,
        # Zenoh's own bound is 1,000, which a thousand actors and an evaluator exceed.
        "transport/unicast/max_sessions": MOST_CONNECTIONS,
        # It would bypass the encryption, and take 16 MiB for each connection: 16 GiB for a learner with a
        # thousand actors. It brings no measurable gain.
        "transport/shared_memory/enabled": False,
        **settings,
        **(_encryption(shown) if shown is not None else {"transport/link/protocols": ["tcp"]}),
    }
    for key, value in everything.items():
        configuration.insert_json5(key, json.dumps(value))
    return configuration


def _encryption(shown: Certificates) -> dict[str, Any]:
    return {
        "transport/link/protocols": ["tls"],
        "transport/link/tls": {
            "root_ca_certificate": str(shown.authority),
            "enable_mtls": True,
            "listen_certificate": str(shown.certificate),
            "listen_private_key": str(shown.key),
            "connect_certificate": str(shown.certificate),
            "connect_private_key": str(shown.key),
            "close_link_on_expiration": True,
        },
    }


def _listen(address: str, shown: Certificates | None, run: str | None, largest_chunk: int) -> zenoh.Session:
    settings: dict[str, Any] = {"transport/link/rx/max_message_size": largest_message(largest_chunk)}
    if run is not None:
        settings["low_pass_filter"] = size_filter(run, largest_chunk)
        if shown is not None:
            settings["access_control"] = access_list(run, read_bound_names(shown))
    session = _open_listener(address, shown, settings)
    monitor(session)
    return session


def _open_listener(address: str, shown: Certificates | None, settings: dict[str, Any]) -> zenoh.Session:
    require_free(address)
    try:
        session = zenoh.open(_configuration("router", shown, {"listen/endpoints": [address], **settings}))
    except zenoh.ZError as error:
        if "in use" in str(error):
            raise _in_use(address) from None
        raise ProtocolError(f"cannot listen at {address}: {_first_sentence(error)}") from None
    if shown is not None:
        set_backlog(address, MOST_WAITING)
    return session


def _in_use(address: str) -> AddressInUse:
    return AddressInUse(
        f"{address} is in use, maybe by another learner: stop it, or listen at a free port (network.listen, "
        "or --listen of a router)"
    )


def require_free(address: str) -> None:
    """Raise AddressInUse if a process listens at `address`, ProtocolError if none could."""
    host, port = split_address(address)
    try:
        places = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, kind, number, _, place = places[0]
        with socket.socket(family, kind, number) as probe:
            # As Zenoh does: connections of a learner that has just ended are no obstacle.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(place)
            probe.listen(1)
    except OSError as error:
        if isinstance(error, socket.gaierror) or "in use" not in str(error):
            raise ProtocolError(f"cannot listen at {address}: {system_reason(error)}") from None
        raise _in_use(address) from None


def _connect(
    address: str, shown: Certificates | None, timeout: float, stop: threading.Event
) -> zenoh.Session:
    began = time.monotonic()
    while True:
        # With TLS only after an attempt: for the listener a probe is a failed handshake.
        cause, refusal = "" if shown is not None else _probe(address), None
        if not cause:
            left = max(timeout - (time.monotonic() - began), ATTEMPT_SECONDS)
            try:
                session = zenoh.open(_client_configuration(address, shown, left))
            except zenoh.ZError:
                cause, refusal = _connection_error(address, shown)
            else:
                monitor(session, Reconnection(session, address))
                return closed_gracefully(session)
        waited = time.monotonic() - began
        if refusal is not None and waited >= min(timeout, REFUSED_SECONDS):
            raise NotAdmitted(f"the learner at {address} was reached and not joined: {refusal}")
        if waited >= timeout or stop.wait(PAUSE_SECONDS):
            raise LearnerNotFound(
                f"no learner at {address} within {timeout:g} s ({cause}): start it, or give its "
                "address with --connect"
            )


def _connection_error(address: str, shown: Certificates | None) -> tuple[str, str | None]:
    """Return why an attempt failed, and the same again if certificates are the cause."""
    cause = _probe(address)
    refusal = None if cause else admission_error(address, shown, ATTEMPT_SECONDS)
    return cause or refusal or _SILENCE[shown is not None], refusal


def _client_configuration(address: str, shown: Certificates | None, seconds: float) -> zenoh.Config:
    attempt = min(seconds, ATTEMPT_SECONDS if shown is None else SECURE_ATTEMPT_SECONDS)
    return _configuration(
        "client",
        shown,
        {
            "listen/endpoints": [],
            "connect/endpoints": [address],
            "connect/timeout_ms": int(attempt * 1000),
            "connect/exit_on_failure": True,
            "connect/retry": RETRY,
            "transport/link/rx/max_message_size": LARGEST_POLICY,
        },
    )


def listens(address: str) -> bool:
    """Return whether a process listens at `address`, which is complete; waits a second at most."""
    return not _probe(address)


def _probe(address: str) -> str:
    """Return why the address cannot be reached, or an empty text if it can."""
    host, port = split_address(address)
    try:
        socket.create_connection((host, port), timeout=ATTEMPT_SECONDS).close()
    except socket.gaierror:
        return f"the name {host} is not known"
    except ConnectionRefusedError:
        return "no process listens there"
    except OSError as error:
        return system_reason(error)
    return ""


def _first_sentence(error: Exception) -> str:
    return str(error).split(" at /")[0].strip()


class Declared(Protocol):
    """Anything that a session has declared."""

    def undeclare(self) -> None:
        """Undeclare it."""


def undeclare_quietly(declared: Declared) -> None:
    """Undeclare an object, or leave that to the end of its session.

    The session may already be closed, which has undeclared the object. Or another thread may be using it, for
    which Zenoh raises an error: for instance one that waits for room on a link whose other side has just
    left.
    """
    try:
        declared.undeclare()
    except zenoh.ZError:
        return
    except RuntimeError as error:
        if str(error) != "Already borrowed":
            raise


def certificate_hint(session: zenoh.Session) -> str:
    """Return a hint for a silent learner: it may be connected but not permit this client's messages."""
    secure = address_of(session).startswith("tls/")
    doubt = "; maybe the learner does not permit that with this certificate: see its log"
    return doubt if secure else ""


def address_of(session: zenoh.Session) -> str:
    """Return the address to which a client's session is connected, for messages to the user."""
    links = session.info.links()
    return str(links[0].dst) if links else "the learner's address (connection lost)"
