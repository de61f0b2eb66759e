"""Checks that a folder with a single role's certificate fits the command, before it waits for a learner.

A learner silently drops messages that a certificate does not permit, so a wrong certificate looks like a run
in which nothing happens.
"""

from __future__ import annotations

from pathlib import Path

from athrl_protocol.security.access import OBSERVERS
from athrl_protocol.security.certificates import CERTIFICATE_FILE, role_and_bound_name

from athrl.errors import CommandError, say


def role_of(folder: Path | None) -> str | None:
    """Return the role of the certificate in `folder`; None in a folder of all roles, or without a role."""
    return _holder_of(folder)[0]


def name_of_actor(folder: Path | None, name: str | None) -> str | None:
    """Return an actor's name: the given one, or the one to which the certificate in `folder` is bound.

    Raises:
        CommandError: the certificate is bound to another name than the given one.
    """
    _, bound = _holder_of(folder)
    if bound is not None and name not in (None, bound):
        raise CommandError(
            f"{folder}: its certificate is bound to the actor {bound}, --name is {name}: leave --name out, "
            "or use the certificate of that actor"
        )
    return bound or name


def _holder_of(folder: Path | None) -> tuple[str | None, str | None]:
    """Return role and bound name of the certificate in `folder`."""
    if folder is None or not (folder / CERTIFICATE_FILE).is_file():
        return None, None
    # Imported here: it takes time, and most services are started without certificates.
    from athrl.certificate_files import common_name, load_certificate

    try:
        return role_and_bound_name(common_name(load_certificate(folder / CERTIFICATE_FILE)))
    except CommandError:  # the session that uses it reports the error
        return None, None


def require_role(folder: Path | None, role: str) -> None:
    """Refuse the folder of a single role if that is not `role`.

    Raises:
        CommandError: it is the folder of another role.
    """
    shown = None if folder is None or (folder / role).is_dir() else role_of(folder)
    if shown not in (None, role):
        raise CommandError(
            f"{folder}: its certificate is for the role {shown}, it should be for {role}: "
            f"athrl certificates FOLDER makes it as FOLDER/{role}"
        )


def require_all_roles(folder: Path | None) -> None:
    """Refuse the folder of a single role for a complete run, whose other services could not connect.

    Raises:
        CommandError: it is the folder of a single role.
    """
    shown = role_of(folder)
    if shown is not None:
        raise CommandError(
            f"{folder}: it has the certificate of the role {shown} alone, and a run needs "
            "those of learner, actor, evaluator and viewer: name the folder that athrl certificates made"
        )


def warn_limited_view(folder: Path | None) -> None:
    """Warn about a certificate that may see the state of a run, but neither metrics nor evaluations."""
    shown = None if folder is None or (folder / "viewer").is_dir() else role_of(folder)
    if shown is not None and shown not in OBSERVERS:
        say(
            f"{folder}: its role {shown} may not read evaluations, nor all metrics, so they "
            "are missing here: use the viewer's certificate to see them"
        )
