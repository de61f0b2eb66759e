"""Which certificate a service shows, and where its files lie.

A folder of certificates is either what `athrl certificates` makes, with a folder for each role, or the folder
of one role, as a service on its own machine or in its own container has it.
"""

from __future__ import annotations

import contextlib
import os
import ssl
from dataclasses import dataclass
from pathlib import Path

from athrl_protocol.errors import ProtocolError

ROLES = ("learner", "actor", "evaluator", "viewer", "router")
SERVERS = ("learner", "router")
"""Whose certificates may serve: others connect to them."""
AUTHORITY_FILE = "ca.crt"
CERTIFICATE_FILE = "tls.crt"
KEY_FILE = "tls.key"
VARIABLE = "ATHRL_CERTIFICATES"
"""Environment variable that names the folder where nobody else does."""


@dataclass(frozen=True)
class Certificates:
    """What a service needs: the authority that it trusts, its own certificate and the key of that."""

    authority: Path
    certificate: Path
    key: Path

    def context(self) -> ssl.SSLContext:
        """Return these for Python's own TLS, which says more about a refusal than Zenoh does.

        Raises:
            ProtocolError: a file is no certificate or key, or the key is another certificate's.
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
        """Shake hands with itself as a client would, who otherwise is the first to say what is wrong.

        Raises:
            ProtocolError: clients would refuse this certificate, say because it is an actor's or has expired.
        """
        as_server = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        as_server.load_cert_chain(self.certificate, self.key)
        as_client = self.context()
        as_client.check_hostname = False  # by which of its names it is reached, only the client knows
        to_client, to_server = ssl.MemoryBIO(), ssl.MemoryBIO()
        client = as_client.wrap_bio(to_client, to_server)
        server = as_server.wrap_bio(to_server, to_client, server_side=True)
        try:
            for side in (client, server, client):
                with contextlib.suppress(ssl.SSLWantReadError):
                    side.do_handshake()
        except ssl.SSLCertVerificationError as error:
            raise ProtocolError(
                f"{self.certificate} is no certificate that clients of a {role} accept "
                f"({error.verify_message}): give it one that athrl certificates made for a {role}"
            ) from None


def find_certificates(folder: str | Path | None, role: str) -> Certificates | None:
    """Return a role's certificate in `folder`, or in the one that ATHRL_CERTIFICATES names; None without any.

    Raises:
        ProtocolError: the folder does not hold them, a file cannot be read, or key and certificate differ.
    """
    named = folder or os.environ.get(VARIABLE)
    if not named:
        return None
    place = Path(named)
    if (place / role).is_dir():
        place = place / role
    found = Certificates(place / AUTHORITY_FILE, place / CERTIFICATE_FILE, place / KEY_FILE)
    for path in (found.authority, found.certificate, found.key):
        try:
            path.open("rb").close()
        except OSError as error:
            raise ProtocolError(
                f"cannot read {path}: {(error.strerror or str(error)).lower()}; "
                f"athrl certificates FOLDER makes what a {role} needs"
            ) from None
    found.context()
    return found
