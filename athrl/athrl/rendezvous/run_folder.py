"""`--connect RUN_FOLDER`: the learner's address and the certificates are taken from the run's folder."""

from __future__ import annotations

import os
from pathlib import Path

from athrl_protocol.announcements.address_file import ADDRESS_FILE, read_address
from athrl_protocol.security.certificates import VARIABLE

from athrl.errors import CommandError
from athrl.submit.learner_job import describe_learner_job, was_submitted

CERTIFICATES = "certificates"
"""Folder of certificates in a run's folder."""


def folder_in(connect: str) -> Path | None:
    """Return the run's folder if `--connect` names one; None if it is an address.

    Services of this process then use the certificates in the folder, unless others are given.

    Raises:
        CommandError: it looks like a folder and there is none.
    """
    path = Path(connect)
    if not path.is_dir():
        if connect.startswith((".", "/", "~")) or (
            "/" in connect and not connect.startswith(("tcp/", "tls/"))
        ):
            raise CommandError(
                f"--connect {connect}: there is no such folder of a run; an address looks like "
                "tcp/127.0.0.1:7447"
            )
        return None
    if (path / CERTIFICATES).is_dir():
        os.environ.setdefault(VARIABLE, str(path / CERTIFICATES))
    return path.resolve()


def run_named(connect: str, run: str) -> str:
    """Return the name of the run: that of its folder if `--connect` names one, else `run`."""
    folder = folder_in(connect)
    return run if folder is None else folder.name


def learner_address(connect: str) -> str:
    """Return the address of the learner: `connect` itself, or the one in the run's folder that it names.

    Raises:
        CommandError: there is no such folder, or it names no learner; says why if a scheduler knows it.
        ProtocolError: the file with the address is damaged.
    """
    folder = folder_in(connect)
    if folder is None:
        return connect
    address = read_address(folder)
    state = describe_learner_job(folder) if was_submitted(folder) else ""
    if address is not None and not state:
        return address
    where = f"--connect {connect}: no learner runs there"
    raise CommandError(f"{where}: {state}" if state else f"{where}: {folder} has no {ADDRESS_FILE}")
