"""A connection that is given up has ended: it blocks no thread and no later connection."""

from __future__ import annotations

import contextlib
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import zenoh
from athrl_protocol import open_session

PATIENCE = 30.0

Open = Callable[[], zenoh.Session]


def _connections(address: str) -> list[bool]:
    """The connections that this process has accepted there, and whether closing one would take its time."""
    port = int(address.rpartition(":")[2])
    found = []
    for entry in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):  # no socket, closed by now, or not connected
            borrowed = socket.socket(fileno=int(entry.name))
            try:
                if borrowed.family == socket.AF_INET and borrowed.getsockname()[1] == port:
                    borrowed.getpeername()
                    lingers = borrowed.getsockopt(socket.SOL_SOCKET, socket.SO_LINGER, 8)[:4] != bytes(4)
                    found.append(lingers)
            finally:
                borrowed.detach()
    return found


def _await(condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_no_connection_holds_up_whoever_closes_it(address: str, listen: Open) -> None:
    listen()
    for _ in range(2):  # later connections as well
        with open_session(connect=address, timeout=PATIENCE):
            _await(lambda: bool(_connections(address)) and not any(_connections(address)))


_ENDS_WITH_AN_OPEN_SESSION = """
import atexit, sys, threading
atexit.register(lambda: print([thread.name for thread in threading.enumerate()]))  # the last of all
from athrl_protocol import open_session
open_session(connect=sys.argv[1], timeout=30)
print([thread.name for thread in threading.enumerate()])
"""


def test_no_thread_is_inside_zenoh_when_the_interpreter_ends(address: str, listen: Open) -> None:
    """It would be ended there by force, which Zenoh takes for a fault and aborts the process."""
    listen()
    done = subprocess.run(
        [sys.executable, "-c", _ENDS_WITH_AN_OPEN_SESSION, address],
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )
    during, after = done.stdout.splitlines()
    assert "connections" in during
    assert after == "['MainThread']"
    assert done.returncode == 0, done.stderr
