"""What a folder that holds one role's certificate is good for, told before anybody waits for a learner.

A learner drops in silence what it does not let a certificate do, so the wrong one looks like a run in which
nothing happens.
"""

from __future__ import annotations

from pathlib import Path

from athrl_protocol.access import ONLOOKERS
from athrl_protocol.certificates import CERTIFICATE_FILE, ROLES

from athrl.errors import CommandError, say


def role_of(folder: Path | None) -> str | None:
    """Return whose certificate lies in `folder` itself; None in that of all roles, or if it is no role's."""
    if folder is None or not (folder / CERTIFICATE_FILE).is_file():
        return None
    # Only here: it takes a while, and most services are started without certificates.
    from athrl.certificates import common_name, load_certificate

    try:
        name = common_name(load_certificate(folder / CERTIFICATE_FILE))
    except CommandError:  # whoever opens a session with it says what is wrong
        return None
    return name if name in ROLES else None


def require_role(folder: Path | None, role: str) -> None:
    """Refuse the folder of a single role that is another one than `role`.

    Raises:
        CommandError: it is.
    """
    shown = None if folder is None or (folder / role).is_dir() else role_of(folder)
    if shown not in (None, role):
        raise CommandError(
            f"{folder}: its certificate is for the role {shown}, it should be for {role}: "
            f"athrl certificates FOLDER makes it as FOLDER/{role}"
        )


def require_all_roles(folder: Path | None) -> None:
    """Refuse the folder of a single role for a whole run, whose other services would never get in.

    Raises:
        CommandError: it is one.
    """
    shown = role_of(folder)
    if shown is not None:
        raise CommandError(
            f"{folder}: it has the certificate of the role {shown} alone, and a run needs "
            "those of learner, actor, evaluator and viewer: name the folder that athrl certificates made"
        )


def warn_who_sees_little(folder: Path | None) -> None:
    """Say which certificate lets see where a run is and neither metrics nor evaluations."""
    shown = None if folder is None or (folder / "viewer").is_dir() else role_of(folder)
    if shown is not None and shown not in ONLOOKERS:
        say(
            f"{folder}: its role {shown} may not read evaluations, nor all metrics, so they "
            "are left out as if there were none: the viewer's certificate shows them"
        )
