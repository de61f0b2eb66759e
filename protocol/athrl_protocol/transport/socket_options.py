"""Socket options for which Zenoh has no setting, so that a lost connection ends at once.

Lingering: with Zenoh's options, closing a connection blocks until the other side has received everything, up
to ten seconds. After an outage longer than the lease this blocks the threads that should reconnect, until TCP
sends again, at growing intervals. That wait is not needed: important messages are acknowledged, and the
kernel delivers earlier data in any case.

Giving up: a thread that writes to a peer that no longer reads waits as long as the peer lives. At the end of
the lease Zenoh gives the connection up, but cleans it up only when that thread returns, which is when the
peer returns. A paused router has then reconnected; the new connection is cleaned up instead, and no message
passes through the router any more (https://github.com/eclipse-zenoh/zenoh/issues/1886). So the socket of a
connection that was given up is shut down.

Backlog: a thousand connections may wait to be accepted by a listener. While it is paused, clients with TLS
connect and give up again and again, and each one that gave up costs 0.1 s in which it accepts none.
"""

from __future__ import annotations

import contextlib
import os
import socket
import struct
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import zenoh

from athrl_protocol.transport.address import split_address

_DESCRIPTORS = Path("/proc/self/fd")  # Linux only; elsewhere sockets are not changed
_LINGER = struct.Struct("ii")  # struct linger: on or off, seconds


class Endpoints(NamedTuple):
    """Both endpoints of a connection, unique within this process."""

    here: tuple[str, int]
    there: tuple[str, int]


def shut_down(links: Iterable[zenoh.Link]) -> None:
    """Shut connections down, as if the network had failed; Zenoh notices at once."""
    _shut_down_among(_own_sockets().values(), {_endpoints_of(link) for link in links})


def set_backlog(address: str, most: int) -> None:
    """Set how many connections may wait for the listener at an address in this process."""
    port = split_address(address)[1]
    for descriptor in _own_sockets().values():
        with contextlib.suppress(OSError), _borrowed(descriptor) as listener:  # it may be closed by now
            if listener.family not in (socket.AF_INET, socket.AF_INET6):
                continue
            listens = listener.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN)
            if listens and listener.getsockname()[1] == port:
                listener.listen(most)


class Sockets:
    """The sockets of this process at the last update."""

    def __init__(self) -> None:
        self._known: frozenset[str] = frozenset()

    def update(self, events: Iterable[zenoh.LinkEvent]) -> None:
        """Set options of new sockets, and shut down those of connections that were given up."""
        given_up = {_endpoints_of(event.link) for event in events if event.kind == zenoh.SampleKind.DELETE}
        sockets = _own_sockets()
        for name in sockets.keys() - self._known:
            with contextlib.suppress(OSError):  # it may be closed by now
                _disable_lingering(sockets[name])
        # Not among the new sockets, of which one may have the port of an old one.
        _shut_down_among([sockets[name] for name in sockets.keys() & self._known], given_up)
        self._known = frozenset(sockets)


def _own_sockets() -> dict[str, int]:
    """Return the descriptors of this process's sockets by the kernel's unique name of each."""
    found = {}
    with contextlib.suppress(FileNotFoundError):
        for entry in os.listdir(_DESCRIPTORS):
            with contextlib.suppress(OSError):  # it may be closed by now
                name = os.readlink(_DESCRIPTORS / entry)
                if name.startswith("socket:"):
                    found[name] = int(entry)
    return found


@contextlib.contextmanager
def _borrowed(descriptor: int) -> Iterator[socket.socket]:
    """The socket with this descriptor, which is not closed; raises OSError if there is none."""
    borrowed = socket.socket(fileno=descriptor)
    try:
        yield borrowed
    finally:
        borrowed.detach()


def _disable_lingering(descriptor: int) -> None:
    """Switch lingering off if it is on, which is only so for Zenoh's sockets."""
    with _borrowed(descriptor) as connection:
        if connection.family not in (socket.AF_INET, socket.AF_INET6):
            return
        lingers, _ = _LINGER.unpack(connection.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.size))
        if lingers:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.pack(0, 0))


def _endpoints_of(link: zenoh.Link) -> Endpoints:
    return Endpoints(split_address(str(link.src)), split_address(str(link.dst)))


def _shut_down_among(descriptors: Iterable[int], given_up: set[Endpoints]) -> None:
    """Shut down the sockets of connections that were given up."""
    if not given_up:
        return
    for descriptor in descriptors:
        with contextlib.suppress(OSError), _borrowed(descriptor) as connection:  # it may be closed by now
            if connection.family not in (socket.AF_INET, socket.AF_INET6):
                continue
            if Endpoints(connection.getsockname()[:2], connection.getpeername()[:2]) in given_up:
                connection.shutdown(socket.SHUT_RDWR)
