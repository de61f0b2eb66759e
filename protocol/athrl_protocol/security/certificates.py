"""Certificates of services, and the location of their files.

A folder of certificates is either made by `athrl certificates`, with a folder for each role, or the folder of
one role, for a service on its own machine or in its own container.

The common name of a certificate is a role, or that of one actor, such as `actor/rig-1`: it is bound to the
name `rig-1`. Learner and router know the bound names from a file beside their own certificates.
"""

from __future__ import annotations

import contextlib
import os
import ssl
from dataclasses import dataclass
from pathlib import Path

from athrl_spaces.untrusted import UntrustedFile, parser_errors, read_untrusted

from athrl_protocol.errors import ProtocolError
from athrl_protocol.messages.keys import check_name

ROLES = ("learner", "actor", "evaluator", "viewer", "router")
SERVERS = ("learner", "router")
"""Roles whose certificates may serve: clients connect to them."""
AUTHORITY_FILE = "ca.crt"
CERTIFICATE_FILE = "tls.crt"
KEY_FILE = "tls.key"
NAMES_FILE = "actors.txt"
"""In the folder of a server: the names of actors that are bound to certificates, one a line."""
BOUND_ACTORS = "actors"
"""Folder with a folder for each certificate that is bound to an actor's name."""
LONGEST_BOUND_NAME = 58
"""A common name has at most 64 characters."""
MOST_BYTES = 2**20
"""Of each file; one with all public authorities has a quarter of that."""
VARIABLE = "ATHRL_CERTIFICATES"
"""Environment variable with the folder, unless it is given otherwise."""


@dataclass(frozen=True)
class Certificates:
    """Files of a service: the authority that it trusts, its own certificate and its key."""

    authority: Path
    certificate: Path
    key: Path

    def context(self) -> ssl.SSLContext:
        """Return a context for Python's own TLS, which explains a refusal better than Zenoh.

        Raises:
            ProtocolError: a file is no certificate or key, or the key belongs to another certificate.
        """
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
        try:
            context.load_verify_locations(self.authority)
        except (ssl.SSLError, OSError):
            raise ProtocolError(f"{self.authority} is no certificate of an authority") from None
        try:
            context.load_cert_chain(self.certificate, self.key)
        except (ssl.SSLError, OSError):
            raise ProtocolError(f"{self.key} is not the key of the certificate {self.certificate}") from None
        return context

    def check_may_serve(self, role: str) -> None:
        """Make a handshake as a client would, to find errors before the first client does.

        Raises:
            ProtocolError: clients would refuse this certificate, for instance an actor's or an expired one.
        """
        as_server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        as_server.load_cert_chain(self.certificate, self.key)
        as_client = self.context()
        as_client.check_hostname = False  # only a client knows the name by which it connects
        to_client, to_server = ssl.MemoryBIO(), ssl.MemoryBIO()
        client = as_client.wrap_bio(to_client, to_server)
        server = as_server.wrap_bio(to_server, to_client, server_side=True)
        try:
            for side in (client, server, client):
                with contextlib.suppress(ssl.SSLWantReadError):
                    side.do_handshake()
        except ssl.SSLError as error:
            reason = getattr(error, "verify_message", None) or error.reason
            raise ProtocolError(
                f"{self.certificate} is no certificate that clients of a {role} accept "
                f"({reason}): give it one that athrl certificates made for a {role}"
            ) from None


def bound_common_name(actor: str) -> str:
    """Return the common name of a certificate that is bound to an actor's name.

    Raises:
        ProtocolError: the name cannot be part of a key, or is too long for a certificate.
    """
    if len(check_name("actor", actor)) > LONGEST_BOUND_NAME:
        raise ProtocolError(
            f"actor {actor!r} cannot be bound to a certificate: its name has {len(actor)} characters, should "
            f"have at most {LONGEST_BOUND_NAME}"
        )
    return f"actor/{actor}"


def role_and_bound_name(common_name: str) -> tuple[str | None, str | None]:
    """Return the role of a certificate and the name of the actor to which it is bound; None for neither."""
    role, slash, name = common_name.partition("/")
    if role not in ROLES or (slash and role != "actor"):
        return None, None
    return role, name or None


def read_bound_names(server: Certificates) -> tuple[str, ...]:
    """Return the names of actors that are bound to certificates, as learner or router know them.

    Raises:
        ProtocolError: the file of names cannot be read, or a line is no such name.
    """
    path = server.certificate.with_name(NAMES_FILE)
    if not os.path.lexists(path):
        return ()
    with parser_errors(lambda reason: ProtocolError(f"cannot read {path}: {reason}")):
        lines = read_certificate_file(path).decode().split("\n")
    names = dict.fromkeys(line.strip() for line in lines if line.strip())
    for name in names:
        try:
            bound_common_name(name)
        except ProtocolError as error:
            raise ProtocolError(f"{path}: {error}") from None
    return tuple(names)


def read_certificate_file(path: Path) -> bytes:
    """Return the content of a file with certificates, a key or names.

    Raises:
        ProtocolError: it cannot be read, is no file, or is too large.
    """
    try:
        return read_untrusted(path, MOST_BYTES)
    except UntrustedFile as error:
        raise ProtocolError(f"cannot read {path}: {str(error).removeprefix('cannot be read: ')}") from None


def find_certificates(folder: str | Path | None, role: str, name: str | None = None) -> Certificates | None:
    """Return a service's certificate in `folder` or else in ATHRL_CERTIFICATES; None if neither is given.

    It is that of the role, or, of an actor, the one that is bound to its name, if there is one.

    Raises:
        ProtocolError: the folder has no such files, a file cannot be read, or key and certificate differ.
    """
    named = folder or os.environ.get(VARIABLE)
    if not named:
        return None
    place = Path(named)
    if role == "actor" and name is not None and (place / BOUND_ACTORS / check_name(role, name)).is_dir():
        place = place / BOUND_ACTORS / name
    elif (place / role).is_dir():
        place = place / role
    found = Certificates(place / AUTHORITY_FILE, place / CERTIFICATE_FILE, place / KEY_FILE)
    for path in (found.authority, found.certificate, found.key):
        try:
            content = read_certificate_file(path)
        except ProtocolError as error:
            raise ProtocolError(f"{error}; athrl certificates FOLDER makes what a {role} needs") from None
        if b"ENCRYPTED" in content:  # OpenSSL would ask for the password at the terminal
            raise ProtocolError(f"{path} is encrypted with a password, should be a key without one")
    found.context()
    return found
