"""Files of certificates: read them, and write them atomically."""

from __future__ import annotations

from pathlib import Path

from athrl_protocol.errors import ProtocolError
from athrl_protocol.security.certificates import read_certificate_file
from athrl_spaces.untrusted import parser_errors
from athrl_spaces.whole_files import write_whole
from athrl_spaces.wording import system_reason
from cryptography import x509
from cryptography.hazmat.primitives import serialization
from cryptography.x509.oid import NameOID

from athrl.errors import CommandError

_REFUSALS = (x509.InvalidVersion, x509.DuplicateExtension, x509.UnsupportedGeneralNameType)
"""What the library raises for certificates besides errors of Python's own."""


def load_certificate(path: Path) -> x509.Certificate:
    """Read a certificate; raises CommandError, naming the file."""
    content = read_file(path)
    with parser_errors(lambda reason: CommandError(f"{path} is no certificate"), *_REFUSALS):
        certificate = x509.load_pem_x509_certificate(content)
        # Parsed only when they are asked for, so asked for here.
        _ = certificate.subject, certificate.extensions
        _ = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    return certificate


def read_file(path: Path) -> bytes:
    """Read a file of certificates or a key; raises CommandError, naming the file."""
    try:
        return read_certificate_file(path)
    except ProtocolError as error:
        raise CommandError(str(error)) from None


def common_name(certificate: x509.Certificate) -> str:
    """Return the common name of a certificate, which says its role; empty if it has none."""
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if names else ""


def names_in(certificate_file: Path) -> list[str]:
    """Return the host names and addresses in a certificate."""
    extensions = load_certificate(certificate_file).extensions
    try:
        names = extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        raise CommandError(
            f"{certificate_file} has no host names, should be a server's certificate"
        ) from None
    return [str(name.value) for name in names]


def pem(certificate: x509.Certificate) -> bytes:
    """Return a certificate as the text of its file."""
    return certificate.public_bytes(serialization.Encoding.PEM)


def write_file(path: Path, content: bytes, mode: int) -> None:
    """Write a file atomically; a key can only be read by its owner at any time."""
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        write_whole(path, content, mode)
    except OSError as error:
        raise CommandError(f"cannot write {path}: {system_reason(error)}") from None
