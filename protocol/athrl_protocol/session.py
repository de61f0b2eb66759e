"""Zenoh sessions: the learner listens as a router, everybody else is its client.

Scouting is off, so a session talks to the address it was given and to nobody else. A client that loses
its learner tries again every 0.1 to 0.5 s for as long as it is open. Close sessions in `finally` (or use
`with`): one that is left open with a subscriber keeps its process from ending. Zenoh's own log is not
switched on, because it goes to standard output.
"""

from __future__ import annotations

import contextlib
import json
import socket
import threading
import time
from typing import Any, Protocol

import zenoh

from athrl_protocol.errors import AddressInUse, LearnerNotFound, ProtocolError

# A silent peer is given up after this time; a killed one at once, by its closed connection.
LEASE_MILLISECONDS = 5_000
RETRY = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2}
# Zenoh's attempts cannot be interrupted by a signal, so each is short.
ATTEMPT_SECONDS = 1.0
PAUSE_SECONDS = 0.1


def open_session(
    *,
    listen: str | None = None,
    connect: str | None = None,
    timeout: float,
    stop: threading.Event | None = None,
) -> zenoh.Session:
    """Open the session of a service; exactly one of `listen` and `connect` is given.

    Args:
        listen: address at which the learner listens, for instance `tcp/127.0.0.1:7447`.
        connect: address of the learner.
        timeout: seconds to wait for the learner at `connect`.
        stop: set by somebody else to give up waiting early.

    Raises:
        AddressInUse: another process listens there already; raised at once.
        LearnerNotFound: nobody listens there within the timeout, or `stop` was set.
        ProtocolError: no address, or one at which this machine cannot listen.
    """
    if (listen is None) == (connect is None):
        raise ValueError("open_session takes either listen or connect")
    if listen is not None:
        return _listen(complete_address(listen))
    assert connect is not None
    return _connect(complete_address(connect), timeout, stop or threading.Event())


def complete_address(address: str) -> str:
    """Return the address as Zenoh writes it: `host:port` becomes `tcp/host:port`.

    Raises:
        ProtocolError: it is no address.
    """
    complete = address if "/" in address else f"tcp/{address}"
    split_address(complete)
    return complete


def split_address(address: str) -> tuple[str, int]:
    """Return host and port of an address such as `tcp/127.0.0.1:7447`.

    Raises:
        ProtocolError: it is no address.
    """
    protocol, _, place = address.partition("/")
    host, _, port = place.rpartition(":")
    if protocol != "tcp" or not host or not port.isdigit() or not 0 < int(port) < 65536:
        raise ProtocolError(f"{address!r} is not an address: it should look like tcp/127.0.0.1:7447")
    return host.strip("[]"), int(port)


def _configuration(mode: str, **settings: Any) -> zenoh.Config:
    configuration = zenoh.Config()
    everything = {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "scouting/delay": 0,  # a router would wait that long for what scouting finds
        "transport/link/tx/lease": LEASE_MILLISECONDS,
        **settings,
    }
    for key, value in everything.items():
        configuration.insert_json5(key, json.dumps(value))
    return configuration


def _listen(address: str) -> zenoh.Session:
    require_free(address)
    configuration = _configuration("router", **{"listen/endpoints": [address]})
    try:
        return zenoh.open(configuration)
    except zenoh.ZError as error:
        if "in use" in str(error):
            raise _in_use(address) from None
        raise ProtocolError(f"cannot listen at {address}: {_first_sentence(error)}") from None


def _in_use(address: str) -> AddressInUse:
    return AddressInUse(
        f"{address} is in use, maybe by another learner: stop it, or set network.listen to a free port"
    )


def require_free(address: str) -> None:
    """Raise AddressInUse if somebody listens at `address` already, ProtocolError if nobody could."""
    host, port = split_address(address)
    try:
        places = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, kind, number, _, place = places[0]
        with socket.socket(family, kind, number) as probe:
            # As Zenoh does it: what a learner that has just ended left behind is no obstacle.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(place)
            probe.listen(1)
    except OSError as error:
        if isinstance(error, socket.gaierror) or "in use" not in str(error):
            raise ProtocolError(f"cannot listen at {address}: {error.strerror or error}") from None
        raise _in_use(address) from None


def _connect(address: str, timeout: float, stop: threading.Event) -> zenoh.Session:
    deadline = time.monotonic() + timeout
    cause = "nobody listens there"
    while True:
        cause = _probe(address)
        if not cause:
            try:
                return zenoh.open(_client_configuration(address))
            except zenoh.ZError:
                cause = "somebody listens there who is no learner"
        if time.monotonic() >= deadline or stop.wait(PAUSE_SECONDS):
            raise LearnerNotFound(
                f"no learner at {address} within {timeout:g} s ({cause}): start it, or give its address"
            )


def _client_configuration(address: str) -> zenoh.Config:
    return _configuration(
        "client",
        **{
            "listen/endpoints": [],
            "connect/endpoints": [address],
            "connect/timeout_ms": int(ATTEMPT_SECONDS * 1000),
            "connect/exit_on_failure": True,
            "connect/retry": RETRY,
        },
    )


def _probe(address: str) -> str:
    """Return why nobody can be reached at the address, or nothing if somebody can."""
    host, port = split_address(address)
    try:
        socket.create_connection((host, port), timeout=ATTEMPT_SECONDS).close()
    except socket.gaierror:
        return f"the name {host} is not known"
    except ConnectionRefusedError:
        return "nobody listens there"
    except OSError as error:
        return (error.strerror or str(error)).lower()
    return ""


def _first_sentence(error: Exception) -> str:
    return str(error).split(" at /")[0].strip()


class Declared(Protocol):
    """Whatever a session has declared."""

    def undeclare(self) -> None:
        """Take it back."""


def undeclare_quietly(declared: Declared) -> None:
    """Undeclare something whose session may be closed already, which has undeclared it too."""
    with contextlib.suppress(zenoh.ZError):
        declared.undeclare()


def address_of(session: zenoh.Session) -> str:
    """Return the address to which a client's session is connected, for messages to the user."""
    links = session.info.links()
    return str(links[0].dst) if links else "the learner's address (connection lost)"
