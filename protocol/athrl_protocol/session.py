"""Zenoh sessions: the learner listens as a router, everybody else is its client, or the client of a router.

Scouting is off, so a session talks to the address it was given and to nobody else. A client that loses
its learner tries again every 0.1 to 0.5 s for as long as it is open. Close sessions in `finally` (or use
`with`): one that is left open with a subscriber keeps its process from ending. Zenoh's own log is not
switched on here, because it goes to standard output (`refusal_log`).

With certificates every connection is TLS of both sides, and the learner lets each role do its part only
(`access`). A client reads its files anew for each connection, so a renewed certificate is shown with the
next.
"""

from __future__ import annotations

import json
import socket
import threading
import time
from pathlib import Path
from typing import Any, Protocol

import zenoh

from athrl_protocol.access import access_list, access_list_of_router
from athrl_protocol.address import complete_address, split_address
from athrl_protocol.certificates import Certificates, find_certificates
from athrl_protocol.errors import AddressInUse, LearnerNotFound, NotAdmitted, ProtocolError
from athrl_protocol.handshake import why_not_admitted
from athrl_protocol.leaving import closing_at_the_end
from athrl_protocol.limits import LARGEST_CHUNK, LARGEST_POLICY, largest_message, size_filter
from athrl_protocol.reconnection import Reconnection
from athrl_protocol.session_care import look_after
from athrl_protocol.socket_options import let_wait

# At one learner or router; who comes after them is told that nobody answers there.
MOST_CONNECTIONS = 10_000
# A silent peer is given up after this time; a killed one at once, by its closed connection.
LEASE_MILLISECONDS = 5_000
RETRY = {"period_init_ms": 100, "period_max_ms": 500, "period_increase_factor": 2}
# TCP would try one connection for minutes, at ever longer intervals: after a cut a new one is sooner through.
OPEN_MILLISECONDS = 2_000
# Zenoh's attempts cannot be interrupted by a signal, so each is short.
ATTEMPT_SECONDS = 1.0
# With TLS both are longer: who listens takes in nobody for 0.1 s after each connection that was given up
# before its handshake was over (zenoh-link-tls 1.10, TLS_ACCEPT_THROTTLE_TIME), so a crowd of impatient
# clients would keep itself out.
SECURE_OPEN_MILLISECONDS = 5_000
SECURE_ATTEMPT_SECONDS = 5.0
# For the same reason few may wait to be taken in: who listens may be paused until they have given up. Others
# come again by TCP's own means.
MOST_WAITING = 16
# For which a router waits for its learner's answer: all of its clients have none meanwhile.
ROUTER_PATIENCE = 2.0
PAUSE_SECONDS = 0.1
# A refusal may pass: certificates are being renewed, a learner is being replaced.
REFUSED_SECONDS = 3.0
_SILENCE = {
    False: "somebody listens there who is no learner",
    True: "somebody listens there who does not answer in TLS, no learner or one without certificates",
}


def open_session(
    *,
    listen: str | None = None,
    connect: str | None = None,
    timeout: float,
    stop: threading.Event | None = None,
    run: str | None = None,
    role: str = "viewer",
    certificates: str | Path | None = None,
    largest_chunk: int = LARGEST_CHUNK,
) -> zenoh.Session:
    """Open the session of a service; exactly one of `listen` and `connect` is given.

    Args:
        listen: address at which the learner listens, for instance `tcp/127.0.0.1:7447`.
        connect: address of the learner.
        timeout: seconds to wait for the learner at `connect`.
        stop: set by somebody else to give up waiting early.
        run: the learner's run, for whose keys its access list and its limits are made.
        role: of a client, whose certificate is shown.
        certificates: folder of certificates; by default the one that ATHRL_CERTIFICATES names. With it the
            address is `tls/...`, and written as `tcp/...` is taken for that.
        largest_chunk: bytes of a chunk's message that the learner takes.

    Raises:
        AddressInUse: another process listens there already; raised at once.
        LearnerNotFound: nobody listens there within the timeout, or `stop` was set.
        NotAdmitted: somebody listens there, but one of the two does not trust the other's certificate.
        ProtocolError: no address, one at which this machine cannot listen, or certificates are missing.
    """
    if (listen is None) == (connect is None):
        raise ValueError("open_session takes either listen or connect")
    if listen is not None:
        shown = find_certificates(certificates, "learner")
        if shown is not None and run is None:
            raise ValueError("a session that listens with certificates needs the name of its run")
        return _listen(complete_address(listen, secure=shown is not None), shown, run, largest_chunk)
    assert connect is not None
    shown = find_certificates(certificates, role)
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
    """Open a session that passes on what clients at `listen` and the learner at `connect` say to each other.

    It connects to the learner by itself, again and again, and is open whether the learner is there or not.
    With certificates it lets each role do its part only, as the learner does. Arguments and errors are those
    of `open_session`.
    """
    shown = find_certificates(certificates, "router")
    learner = complete_address(connect, secure=shown is not None)
    settings: dict[str, Any] = {
        "connect/endpoints": [learner],
        "connect/timeout_ms": -1,
        "connect/exit_on_failure": False,
        "connect/retry": RETRY,
        # Policies come through; clients' messages are held down by the filter on the keys.
        "transport/link/rx/max_message_size": LARGEST_POLICY,
        "low_pass_filter": size_filter(run, largest_chunk),
    }
    if shown is not None:
        settings["access_control"] = access_list_of_router(run)
    session = _open_listener(complete_address(listen, secure=shown is not None), shown, settings)
    look_after(session, Reconnection(session, learner, run, ROUTER_PATIENCE))
    return closing_at_the_end(session)


def _configuration(mode: str, shown: Certificates | None, settings: dict[str, Any]) -> zenoh.Config:
    configuration = zenoh.Config()
    everything = {
        "mode": mode,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "scouting/delay": 0,  # a router would wait that long for what scouting finds
        "transport/link/tx/lease": LEASE_MILLISECONDS,
        "transport/unicast/open_timeout": OPEN_MILLISECONDS if shown is None else SECURE_OPEN_MILLISECONDS,
        # Zenoh's own bound is 1,000, which a thousand actors and an evaluator exceed.
        "transport/unicast/max_sessions": MOST_CONNECTIONS,
        # It would pass by the encryption, and take 16 MiB for each connection: 16 GiB of a learner of a
        # thousand actors. It saves a chunk nothing that could be measured.
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
            settings["access_control"] = access_list(run)
    session = _open_listener(address, shown, settings)
    look_after(session)
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
        let_wait(address, MOST_WAITING)
    return session


def _in_use(address: str) -> AddressInUse:
    return AddressInUse(
        f"{address} is in use, maybe by another learner: stop it, or listen at a free port (network.listen, "
        "or --listen of a router)"
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


def _connect(
    address: str, shown: Certificates | None, timeout: float, stop: threading.Event
) -> zenoh.Session:
    began = time.monotonic()
    while True:
        # With TLS only after an attempt: to who listens a probe is a handshake that was given up.
        cause, refusal = "" if shown is not None else _probe(address), None
        if not cause:
            left = max(timeout - (time.monotonic() - began), ATTEMPT_SECONDS)
            try:
                session = zenoh.open(_client_configuration(address, shown, left))
            except zenoh.ZError:
                cause, refusal = _why_not(address, shown)
            else:
                look_after(session, Reconnection(session, address))
                return closing_at_the_end(session)
        waited = time.monotonic() - began
        if refusal is not None and waited >= min(timeout, REFUSED_SECONDS):
            raise NotAdmitted(f"the learner at {address} was reached and not joined: {refusal}")
        if waited >= timeout or stop.wait(PAUSE_SECONDS):
            raise LearnerNotFound(
                f"no learner at {address} within {timeout:g} s ({cause}): start it, or give its address"
            )


def _why_not(address: str, shown: Certificates | None) -> tuple[str, str | None]:
    """Return why an attempt was in vain, and the same again if the cause is a want of trust."""
    cause = _probe(address)
    refusal = None if cause else why_not_admitted(address, shown, ATTEMPT_SECONDS)
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
    """Undeclare something, or leave that to the end of its session.

    The session may be closed already, which has undeclared it too. Or another thread may be using what was
    declared, which Zenoh refuses: one that waits for room on a link whose other side has just left.
    """
    try:
        declared.undeclare()
    except zenoh.ZError:
        return
    except RuntimeError as error:
        if str(error) != "Already borrowed":
            raise


def doubt_about_certificate(session: zenoh.Session) -> str:
    """Return what to add where a learner is silent: it may be reached and yet not speak to this client."""
    secure = address_of(session).startswith("tls/")
    doubt = "; perhaps the learner does not let this certificate take part in that way: its log tells"
    return doubt if secure else ""


def address_of(session: zenoh.Session) -> str:
    """Return the address to which a client's session is connected, for messages to the user."""
    links = session.info.links()
    return str(links[0].dst) if links else "the learner's address (connection lost)"
