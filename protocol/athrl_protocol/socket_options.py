"""What becomes of a connection's socket where Zenoh has no setting for it: a lost one is gone at once.

Lingering: Zenoh has it that who closes a connection stands still until the other side has everything, up to
ten seconds. After a network was cut for longer than the lease those are the threads that are to connect anew,
and they wait until TCP sends again by itself, at ever longer intervals. Nothing needs that wait: what matters
is acknowledged, and the kernel delivers what was written before in any case.

Giving up: a thread that writes to somebody who reads no more waits for as long as that one lives. At the end
of the lease Zenoh gives the connection up, but clears up behind it only when that thread comes back, which is
when the other side does. A router that was paused has then connected anew, this is cleared away instead, and
nothing passes through the router from then on (https://github.com/eclipse-zenoh/zenoh/issues/1886). So the
socket of a connection that was given up is shut down.

Waiting: a thousand connections may wait for who listens to take them in. While that is paused, clients with
TLS come and give up again and again, and each that did costs it 0.1 s in which it takes in nobody.
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

from athrl_protocol.address import split_address

_DESCRIPTORS = Path("/proc/self/fd")  # of Linux; elsewhere sockets stay as they are
_LINGER = struct.Struct("ii")  # struct linger: whether, seconds


class Ends(NamedTuple):
    """Both ends of a connection, which no other of this process has."""

    here: tuple[str, int]
    there: tuple[str, int]


def shut_down(links: Iterable[zenoh.Link]) -> None:
    """Give up connections, as if the network had; Zenoh notices at once."""
    _shut_down_among(_own_sockets().values(), {_ends_of(link) for link in links})


def let_wait(address: str, most: int) -> None:
    """Let so many wait to be taken in by who listens at an address in this process."""
    port = split_address(address)[1]
    for descriptor in _own_sockets().values():
        with contextlib.suppress(OSError), _borrowed(descriptor) as listener:  # it was closed meanwhile
            if listener.family not in (socket.AF_INET, socket.AF_INET6):
                continue
            listens = listener.getsockopt(socket.SOL_SOCKET, socket.SO_ACCEPTCONN)
            if listens and listener.getsockname()[1] == port:
                listener.listen(most)


class Sockets:
    """The sockets of this process as they were last seen."""

    def __init__(self) -> None:
        self._known: frozenset[str] = frozenset()

    def follow(self, events: Iterable[zenoh.LinkEvent]) -> None:
        """See to them after connections were made or given up."""
        given_up = {_ends_of(event.link) for event in events if event.kind == zenoh.SampleKind.DELETE}
        sockets = _own_sockets()
        for name in sockets.keys() - self._known:
            with contextlib.suppress(OSError):  # it was closed meanwhile
                _keep_from_lingering(sockets[name])
        # Not among the new ones, of which one may have the port of an old one.
        _shut_down_among([sockets[name] for name in sockets.keys() & self._known], given_up)
        self._known = frozenset(sockets)


def _own_sockets() -> dict[str, int]:
    """Return the descriptors of this process's sockets by the kernel's name of each, which no other has."""
    found = {}
    with contextlib.suppress(FileNotFoundError):
        for entry in os.listdir(_DESCRIPTORS):
            with contextlib.suppress(OSError):  # it was closed meanwhile
                name = os.readlink(_DESCRIPTORS / entry)
                if name.startswith("socket:"):
                    found[name] = int(entry)
    return found


@contextlib.contextmanager
def _borrowed(descriptor: int) -> Iterator[socket.socket]:
    """The socket with this descriptor, which stays its owner's to close; OSError if there is none."""
    borrowed = socket.socket(fileno=descriptor)
    try:
        yield borrowed
    finally:
        borrowed.detach()


def _keep_from_lingering(descriptor: int) -> None:
    """Have a socket linger no more if it does, as only Zenoh's do."""
    with _borrowed(descriptor) as connection:
        if connection.family not in (socket.AF_INET, socket.AF_INET6):
            return
        lingers, _ = _LINGER.unpack(connection.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.size))
        if lingers:
            connection.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _LINGER.pack(0, 0))


def _ends_of(link: zenoh.Link) -> Ends:
    return Ends(split_address(str(link.src)), split_address(str(link.dst)))


def _shut_down_among(descriptors: Iterable[int], given_up: set[Ends]) -> None:
    """Shut down those sockets that are the ones of connections that were given up."""
    if not given_up:
        return
    for descriptor in descriptors:
        with contextlib.suppress(OSError), _borrowed(descriptor) as connection:  # it was closed meanwhile
            if connection.family not in (socket.AF_INET, socket.AF_INET6):
                continue
            if Ends(connection.getsockname()[:2], connection.getpeername()[:2]) in given_up:
                connection.shutdown(socket.SHUT_RDWR)
