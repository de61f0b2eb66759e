"""Finds out why a TLS connection failed: Zenoh only says that there was no answer."""

from __future__ import annotations

import socket
import ssl

from athrl_protocol.errors import ProtocolError
from athrl_protocol.security.certificates import Certificates
from athrl_protocol.transport.address import split_address

# With TLS 1.3 the other side's refusal of a certificate arrives after the handshake.
REFUSAL_SECONDS = 0.5


def admission_error(address: str, shown: Certificates | None, timeout: float) -> str | None:
    """Return why a connection was refused because of certificates, or None if that is not the cause.

    Args:
        address: of a process that accepts connections.
        shown: this side's certificate; None if it has none.
        timeout: seconds for the handshake.
    """
    host, port = split_address(address)
    try:
        with (
            socket.create_connection((host, port), timeout=timeout) as plain,
            _context(shown).wrap_socket(plain, server_hostname=host) as secure,
        ):
            if shown is None:
                return "it asks for a certificate: name a folder with --certificates or ATHRL_CERTIFICATES"
            secure.settimeout(REFUSAL_SECONDS)
            secure.recv(1)
    except ProtocolError as error:
        return str(error)
    except ssl.SSLError as error:
        return _reason(error, shown)
    except OSError:  # no answer, or a closed connection: not because of certificates
        return None
    return None


def _context(shown: Certificates | None) -> ssl.SSLContext:
    if shown is not None:
        return shown.context()
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname = False
    context.verify_mode = ssl.CERT_NONE
    return context


def _reason(error: ssl.SSLError, shown: Certificates | None) -> str | None:
    said = (error.reason or str(error)).lower().replace("_", " ")
    if "unexpected eof" in said:  # closed without an answer, as by a forwarder whose learner is away
        return None
    if shown is None:
        # A server without TLS is reported elsewhere.
        return None if _is_no_tls(said) else "it asks for a certificate: name a folder with --certificates"
    if isinstance(error, ssl.SSLCertVerificationError):
        return f"its certificate is not accepted by {shown.authority} ({error.verify_message.rstrip('.')})"
    if _is_no_tls(said):
        return "it speaks without encryption, and this service has certificates: give them to both or to none"
    if "alert" in said or "certificate" in said:
        said = said.replace("tlsv1 ", "").replace("tlsv13 ", "").replace("sslv3 ", "").replace("alert ", "")
        return f"it refuses {shown.certificate} ({said})"
    return None


def _is_no_tls(said: str) -> bool:
    return any(words in said for words in ("wrong version", "record layer", "http"))
