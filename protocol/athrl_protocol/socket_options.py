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

import atexit
import contextlib
import logging
import os
import socket
import struct
import threading
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import zenoh

from athrl_protocol.address import split_address
from athrl_protocol.background import Background

_log = logging.getLogger(__name__)

# What happens within this time is seen to together; it is far below the lease, and enough to say goodbye in.
TOGETHER_SECONDS = 0.25
MOST_AT_ONCE = 4096  # events between two looks
END_SECONDS = 1.0  # the longest that a look takes
_DESCRIPTORS = Path("/proc/self/fd")  # of Linux; elsewhere sockets stay as they are
_LINGER = struct.Struct("ii")  # struct linger: whether, seconds


class Ends(NamedTuple):
    """Both ends of a connection, which no other of this process has."""

    here: tuple[str, int]
    there: tuple[str, int]


def see_to_sockets(session: zenoh.Session) -> None:
    """See to the sockets of a session's connections, those that it has and those to come."""
    channel: zenoh.handlers.FifoChannel[zenoh.LinkEvent] = zenoh.handlers.FifoChannel(MOST_AT_ONCE)
    _sockets.listen(session.info.declare_link_events_listener(channel, history=True))


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


class _Sockets:
    """Sees to the sockets of this process, a moment after a connection was made or given up.

    In a thread that asks a few times a second: Zenoh's own, called back, would wait for the interpreter.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._listeners: list[Any] = []
        self._known: frozenset[str] = frozenset()
        self._thread: threading.Thread | None = None
        self._ending = threading.Event()

    def listen(self, listener: Any) -> None:
        """Hear a session's events until it is closed."""
        with self._lock:
            self._listeners.append(listener)
            if len(self._listeners) == 1:
                self._thread = threading.Thread(target=self._run, name="sockets", daemon=True)
                self._thread.start()

    def end(self) -> None:
        """Have the thread end before the interpreter does, which would end it within Zenoh and abort."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join(timeout=END_SECONDS)

    def _run(self) -> None:
        """Look after them as long as there is a session; what goes wrong once is logged."""
        background = Background("the look after sockets", _log)
        while not self._ending.wait(TOGETHER_SECONDS):
            with self._lock:
                heard = [(listener, _events(listener)) for listener in self._listeners]
                self._listeners = [listener for listener, events in heard if events is not None]
                is_over = not self._listeners
            with background.watched():
                self._follow([event for _, events in heard for event in events or ()])
            if is_over:
                return

    def _follow(self, happened: list[zenoh.LinkEvent]) -> None:
        if happened:
            deleted = [event.link for event in happened if event.kind == zenoh.SampleKind.DELETE]
            self._look({_ends_of(link) for link in deleted})

    def _look(self, given_up: set[Ends]) -> None:
        sockets = _own_sockets()
        for name in sockets.keys() - self._known:
            with contextlib.suppress(OSError):  # it was closed meanwhile
                _keep_from_lingering(sockets[name])
        # Not among the new ones, of which one may have the port of an old one.
        _shut_down_among([sockets[name] for name in sockets.keys() & self._known], given_up)
        self._known = frozenset(sockets)


def _events(listener: Any) -> list[zenoh.LinkEvent] | None:
    """Return what a listener has heard; None once its session is closed."""
    events = []
    try:
        while (event := listener.handler.try_recv()) is not None:
            events.append(event)
    except zenoh.ZError:
        return events or None
    return events


_sockets = _Sockets()
atexit.register(_sockets.end)


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
