"""What may stand between actors and learner in a benchmark: nothing, `athrl router`, or zenohd.

zenohd is Zenoh's own router, built by

    cargo install zenohd --version 1.10.2 --locked

(about 11 minutes of a core). It is looked for in the PATH.
"""

from __future__ import annotations

import contextlib
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator

from athrl.ports import free_address

KINDS = ("nothing", "router", "zenohd")
_PATIENCE = 60.0


@contextlib.contextmanager
def standing_before(learner: str, kind: str, run: str) -> Iterator[str]:
    """Let a router of the kind stand before the learner at an address; gives the address for actors."""
    if kind == "nothing":
        yield learner
        return
    address = free_address()
    process = subprocess.Popen(_command(kind, address, learner, run), stdout=subprocess.DEVNULL)
    try:
        _wait_until_it_listens(address, process)
        yield address
    finally:
        process.terminate()
        process.wait(_PATIENCE)


def _command(kind: str, address: str, learner: str, run: str) -> list[str]:
    if kind == "router":
        # As the command of that name, from the environment that this Python is of.
        command = [sys.executable, "-c", "from athrl.command import main; main()", "router"]
        return [*command, "--listen", address, "--connect", learner, "--run", run]
    program = shutil.which("zenohd")
    if program is None:
        sys.exit("there is no zenohd in the PATH: cargo install zenohd --version 1.10.2 --locked")
    return [program, "--listen", address, "--connect", learner, "--no-multicast-scouting"]


def _wait_until_it_listens(address: str, process: subprocess.Popen[bytes]) -> None:
    host, port = address.removeprefix("tcp/").split(":")
    deadline = time.monotonic() + _PATIENCE
    while time.monotonic() < deadline and process.poll() is None:
        try:
            socket.create_connection((host, int(port)), timeout=1).close()
            return
        except OSError:
            time.sleep(0.1)
    sys.exit(f"no router listens at {address}")
