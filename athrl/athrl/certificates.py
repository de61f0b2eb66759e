"""`athrl certificates`: an authority of one's own, and a certificate for each role of a run.

The folder holds `authority/` with the authority's key, and for each role a folder with what its service needs
and nothing else: `ca.crt`, `tls.crt` and `tls.key`, the names that Kubernetes gives them. A role is the
common name of its certificate; only those of learner and router may serve.
"""

from __future__ import annotations

import contextlib
import datetime
import ipaddress
import os
import socket
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from athrl_protocol.certificates import AUTHORITY_FILE, CERTIFICATE_FILE, KEY_FILE, ROLES, SERVERS
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from athrl.errors import CommandError

AUTHORITY = "authority"
AUTHORITY_DAYS = 3650
RENEWAL_DAYS = 30
"""`--if-missing` renews what ends sooner than this."""
CLOCK_DIFFERENCE = datetime.timedelta(minutes=5)
"""A certificate is valid a little earlier than now, for machines whose clocks are behind."""


@dataclass(frozen=True)
class Identity:
    """A key and the certificate of its public half."""

    key: ec.EllipticCurvePrivateKey
    certificate: x509.Certificate


def certificates(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Where the certificates are kept.")],
    names: Annotated[
        list[str] | None,
        typer.Option(
            "--name",
            "--names",
            metavar="NAME",
            help="A host name or address by which the learner, or a router, is reached; several, or "
            "separated by commas. localhost, 127.0.0.1, ::1, the role's and this machine's name always are.",
        ),
    ] = None,
    days: Annotated[
        int, typer.Option(min=1, max=AUTHORITY_DAYS, help="How long the roles' certificates are valid.")
    ] = 365,
    renew: Annotated[
        list[str] | None,
        typer.Option(metavar="ROLE", help=f"Make a new key and certificate for {', '.join(ROLES)}."),
    ] = None,
    if_missing: Annotated[
        bool,
        typer.Option(
            "--if-missing",
            help=f"Make only what is not there, and renew what ends within {RENEWAL_DAYS} days.",
        ),
    ] = False,
) -> None:
    """Make an authority and a certificate for each role, so that a run's services know each other."""
    hosts = _hosts(names or [])
    _require_folder(folder)
    if renew:
        made = renew_roles(folder, renew, hosts if names else None, days)
    elif if_missing:
        made = complete(folder, hosts, days, required=_given(names or []))
    else:
        made = make_all(folder, hosts, days)
    for role in made:
        certificate = load_certificate(folder / role / CERTIFICATE_FILE)
        print(f"{folder / role}: valid until {certificate.not_valid_after_utc:%Y-%m-%d}")
    if not made:
        print(f"{folder}: all certificates are there")


def make_all(folder: Path, hosts: Iterable[str], days: int) -> list[str]:
    """Make the authority and every role's certificate; return the names of the folders made.

    Raises:
        CommandError: the folder holds certificates already, or cannot be written.
    """
    for name in (AUTHORITY, *ROLES):
        if any((folder / name / file).exists() for file in (CERTIFICATE_FILE, KEY_FILE)):
            raise CommandError(
                f"{folder / name} holds a certificate already, which is not overwritten: "
                f"name another folder, or renew a role with --renew {ROLES[0]}"
            )
    return complete(folder, hosts, days)


def complete(folder: Path, hosts: Iterable[str], days: int, required: Iterable[str] = ()) -> list[str]:
    """Make what is missing or ends soon, and a server's if a required name is not in it.

    Returns the names of the folders made.
    """
    names = list(hosts)
    made = []
    if not (folder / AUTHORITY / CERTIFICATE_FILE).exists():
        _write_identity(folder / AUTHORITY, _new_authority())
        made.append(AUTHORITY)
    authority = _load_authority(folder)
    for role in ROLES:
        lacks = role in SERVERS and not _has_names(folder / role, required)
        if AUTHORITY in made or lacks or _is_due(folder / role, authority):
            _write_role(folder / role, _new_role(authority, role, names, days), authority)
            made.append(role)
    return made


def renew_roles(folder: Path, roles: Iterable[str], hosts: Iterable[str] | None, days: int) -> list[str]:
    """Make new keys and certificates of the same authority; servers keep their names unless given some.

    Raises:
        CommandError: there is no such role, or no authority in the folder.
    """
    wanted = list(roles)
    for role in wanted:
        if role not in ROLES:
            raise CommandError(f"--renew {role}: there is no such role; it is one of {', '.join(ROLES)}")
    authority = _load_authority(folder)
    for role in wanted:
        names = list(hosts) if hosts is not None else _names_of(folder / role / CERTIFICATE_FILE)
        _write_role(folder / role, _new_role(authority, role, names, days), authority)
    return wanted


def _require_folder(folder: Path) -> None:
    """Refuse a path at which, or on the way to which, there is something else than a folder."""
    there = next((place for place in (folder, *folder.parents) if os.path.lexists(place)), folder)
    if os.path.lexists(there) and not os.path.isdir(there):
        raise CommandError(f"{folder}: {there} is a file, it should be a folder, or a name that is free")


def _hosts(given: Iterable[str]) -> list[str]:
    """Return all names of a server but its role, each once; raises `CommandError` for what is none."""
    hosts = dict.fromkeys([*_given(given), "localhost", socket.gethostname().lower(), "127.0.0.1", "::1"])
    for host in hosts:
        _subject_name(host)
    return list(hosts)


def _given(names: Iterable[str]) -> list[str]:
    return [name.strip() for several in names for name in several.split(",")]


def _subject_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        pass
    try:
        allowed = host.isascii() and all(part and len(part) < 64 for part in host.split("."))
        if allowed and host.replace(".", "").replace("-", "").replace("*", "").replace("_", "").isalnum():
            return x509.DNSName(host)
    except ValueError:
        pass
    raise CommandError(f"--names {host!r}: this is neither a host name nor an address")


def _new_authority() -> Identity:
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "athrl authority")])
    builder = (
        _builder(name, name, key, AUTHORITY_DAYS)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_key_usage(signs_certificates=True), critical=True)
    )
    return Identity(key, builder.sign(key, hashes.SHA256()))


def _new_role(authority: Identity, role: str, hosts: list[str], days: int) -> Identity:
    key = ec.generate_private_key(ec.SECP256R1())
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, role)])
    purposes = [ExtendedKeyUsageOID.CLIENT_AUTH]
    if role in SERVERS:
        purposes.append(ExtendedKeyUsageOID.SERVER_AUTH)
    identifier = x509.AuthorityKeyIdentifier.from_issuer_public_key(authority.key.public_key())
    builder = (
        _builder(name, authority.certificate.subject, key, days)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_key_usage(signs_certificates=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(purposes), critical=False)
        .add_extension(identifier, critical=False)
    )
    if role in SERVERS:
        named = dict.fromkeys([*hosts, role])
        names = x509.SubjectAlternativeName([_subject_name(host) for host in named])
    else:  # rustls takes no certificate without a name
        names = x509.SubjectAlternativeName([x509.DNSName(f"{role}.athrl.invalid")])
    builder = builder.add_extension(names, critical=False)
    return Identity(key, builder.sign(authority.key, hashes.SHA256()))


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, days: int
) -> x509.CertificateBuilder:
    now = datetime.datetime.now(datetime.UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - CLOCK_DIFFERENCE)
        .not_valid_after(now + datetime.timedelta(days=days))
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )


def _key_usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        encipher_only=False,
        decipher_only=False,
    )


def _is_due(role_folder: Path, authority: Identity) -> bool:
    """Whether a role has no certificate of this authority, or one that ends soon."""
    if not all((role_folder / file).exists() for file in (AUTHORITY_FILE, CERTIFICATE_FILE, KEY_FILE)):
        return True
    certificate = load_certificate(role_folder / CERTIFICATE_FILE)
    ends = certificate.not_valid_after_utc
    margin = min(datetime.timedelta(days=RENEWAL_DAYS), (ends - certificate.not_valid_before_utc) / 3)
    return (
        ends - margin < datetime.datetime.now(datetime.UTC)
        or certificate.issuer != authority.certificate.subject
    )


def _has_names(role_folder: Path, names: Iterable[str]) -> bool:
    wanted = {str(_subject_name(name).value) for name in names}
    path = role_folder / CERTIFICATE_FILE
    return path.exists() and wanted <= set(_names_of(path))


def _names_of(certificate_file: Path) -> list[str]:
    """Return the host names and addresses in a certificate."""
    extension = load_certificate(certificate_file).extensions.get_extension_for_class(
        x509.SubjectAlternativeName
    )
    return [str(name.value) for name in extension.value]


def _load_authority(folder: Path) -> Identity:
    certificate = load_certificate(folder / AUTHORITY / CERTIFICATE_FILE)
    path = folder / AUTHORITY / KEY_FILE
    try:
        key = serialization.load_pem_private_key(path.read_bytes(), password=None)
    except OSError as error:
        raise CommandError(f"cannot read {path}: {(error.strerror or str(error)).lower()}") from None
    except ValueError:
        key = None
    if not isinstance(key, ec.EllipticCurvePrivateKey) or key.public_key() != certificate.public_key():
        raise CommandError(f"{path} is not the key of {folder / AUTHORITY / CERTIFICATE_FILE}")
    return Identity(key, certificate)


def common_name(certificate: x509.Certificate) -> str:
    """Return the name in a certificate, which is its role; empty where there is none."""
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if names else ""


def load_certificate(path: Path) -> x509.Certificate:
    """Read a certificate; raises CommandError, naming the file."""
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except OSError as error:
        raise CommandError(f"cannot read {path}: {(error.strerror or str(error)).lower()}") from None
    except ValueError:
        raise CommandError(f"{path} is no certificate") from None


def _write_role(folder: Path, identity: Identity, authority: Identity) -> None:
    _write(folder / AUTHORITY_FILE, _pem(authority.certificate), mode=0o644)
    _write_identity(folder, identity)


def _write_identity(folder: Path, identity: Identity) -> None:
    key = identity.key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    _write(folder / KEY_FILE, key, mode=0o600)
    # Last, because who sees the certificate expects its key.
    _write(folder / CERTIFICATE_FILE, _pem(identity.certificate), mode=0o644)


def _pem(certificate: x509.Certificate) -> bytes:
    return certificate.public_bytes(serialization.Encoding.PEM)


def _write(path: Path, content: bytes, mode: int) -> None:
    """Put a file in its place as a whole; at no moment can anybody but its owner read a key."""
    part = path.with_name(f"{path.name}.part")
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        part.unlink(missing_ok=True)
        descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
        with os.fdopen(descriptor, "wb") as file:
            file.write(content)
            os.fsync(file.fileno())
        part.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):  # the cause may be that there can be no such file
            part.unlink(missing_ok=True)
        raise CommandError(f"cannot write {path}: {(error.strerror or str(error)).lower()}") from None
