"""Free ports of the loopback interface, for processes that this command starts."""

from __future__ import annotations

import random
import socket

from athrl.errors import CommandError

_PORTS, _TRIES = range(20_000, 32_000), 100
"""Below those that the system gives to outgoing connections, else one of these could take a port before the
process listens."""


def is_free(port: int) -> bool:
    """Return whether this port of the loopback interface is free."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except OSError:
            return False
        return True


def free_address() -> str:
    """Return an address of the loopback interface at which nothing listens now.

    Raises:
        CommandError: no port is found free.
    """
    for port in random.SystemRandom().sample(_PORTS, _TRIES):
        if is_free(port):
            return f"tcp/127.0.0.1:{port}"
    raise CommandError(
        f"no port from {_PORTS.start} to {_PORTS.stop - 1} is free: stop a process that listens there"
    )
