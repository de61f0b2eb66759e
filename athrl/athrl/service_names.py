"""Default names of services, and names of programs in messages to the user."""

from __future__ import annotations

import os
import re
import shutil
import socket
import sys
from pathlib import Path


def host_name() -> str:
    """Return this host's name as a part of a key."""
    return re.sub(r"[^a-z0-9-]+", "-", socket.gethostname().lower()).strip("-") or "host"


def own_name() -> str:
    """Return a unique name of a process: the host's name and, if necessary, the process number.

    A router has this name. In a container the process is number 1 and the host's name distinguishes
    containers; it stays the same when the container is restarted.
    """
    return host_name() if os.getpid() == 1 else f"{host_name()}-{os.getpid()}"


def is_own_name(name: str) -> bool:
    """Return whether this is a default name of a service on this host."""
    return re.fullmatch(rf"{re.escape(host_name())}(-\d+)?", name) is not None


def program(name: str) -> str:
    """Return how to call a program that was installed with this one: its name, or else its path.

    The path is relative only from a folder that holds it: elsewhere `../..` would be of no use after a `cd`.
    """
    if shutil.which(name) is not None:
        return name
    path = Path(sys.executable).parent.absolute() / name
    return str(path.relative_to(Path.cwd()) if path.is_relative_to(Path.cwd()) else path)
