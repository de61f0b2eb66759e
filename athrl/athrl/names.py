"""How services are named when nobody names them, and programs where somebody is told to call them."""

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
    """Return a name that no other service of the run has: the host's and, if need be, the process's.

    In a container the process is number 1 and the host's name tells the containers apart; it stays the same
    when the container is started again.
    """
    return host_name() if os.getpid() == 1 else f"{host_name()}-{os.getpid()}"


def is_own_name(name: str) -> bool:
    """Return whether a service of this host has such a name when nobody names it."""
    return re.fullmatch(rf"{re.escape(host_name())}(-\d+)?", name) is not None


def program(name: str) -> str:
    """Return how a program that was installed with this one is called: by its name, or where it lies."""
    if shutil.which(name) is not None:
        return name
    return os.path.relpath(Path(sys.executable).parent / name)
