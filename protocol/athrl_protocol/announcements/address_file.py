"""Where a run's learner is, as a file in the run's folder: for clients that share the folder with it.

A scheduler decides only when the learner starts on which machine that is, and after a restart it may be
another one.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from athrl_spaces.untrusted import UntrustedFile, read_untrusted
from athrl_spaces.whole_files import write_whole
from athrl_spaces.wording import system_reason

from athrl_protocol.errors import ProtocolError
from athrl_protocol.transport.address import split_address

ADDRESS_FILE = "learner.address"
_LONGEST = 512


def read_address(folder: Path) -> str | None:
    """Return the address of the learner in a run's folder; None if the folder names none.

    Raises:
        ProtocolError: the file cannot be read, or holds no address.
    """
    path = folder / ADDRESS_FILE
    if not os.path.lexists(path):
        return None
    try:
        address = read_untrusted(path, _LONGEST).decode(errors="replace").strip()
    except UntrustedFile as error:
        if not os.path.lexists(path):  # its learner has just ended
            return None
        raise ProtocolError(f"{path} {error}") from None
    try:
        split_address(address)
    except ProtocolError as error:
        raise ProtocolError(f"{path}: {error}") from None
    return address


def address_at(host: str, address: str) -> str:
    """Return the address of a listener for clients that reach its machine as `host`.

    Raises:
        ProtocolError: `host` is neither a host name nor an address.
    """
    protocol, _, _ = address.partition("/")
    _, port = split_address(address)
    name = f"[{host}]" if ":" in host else host
    if not host or any(sign.isspace() or sign == "/" for sign in host):
        raise ProtocolError(f"{host!r} should be a host name or an address")
    return f"{protocol}/{name}:{port}"


@contextlib.contextmanager
def address_announced(folder: Path, address: str) -> Iterator[None]:
    """Name the learner's address in its run's folder while the block runs.

    Readers see the whole file or none. A killed learner leaves it there; the next one replaces it.

    Raises:
        ProtocolError: the folder cannot be written.
    """
    path = folder / ADDRESS_FILE
    try:
        write_whole(path, f"{address}\n".encode())
    except OSError as error:
        raise ProtocolError(f"cannot write {path}: {system_reason(error)}") from None
    try:
        yield
    finally:
        with contextlib.suppress(OSError):
            path.unlink()
