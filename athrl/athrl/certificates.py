"""`athrl certificates`: a certificate authority, and a certificate for each role of a run.

The folder holds `authority/` with the authority's key, and for each role a folder with exactly the files that
its service needs: `ca.crt`, `tls.crt` and `tls.key`, as they are named in Kubernetes. A role is the common
name of its certificate; only certificates of learner and router may serve. `actors/NAME` has the certificate
that is bound to this actor's name; learner and router then have `actors.txt` with all such names.
"""

from __future__ import annotations

import datetime
import ipaddress
import os
import socket
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from athrl_protocol.errors import ProtocolError
from athrl_protocol.security.certificates import (
    AUTHORITY_FILE,
    BOUND_ACTORS,
    CERTIFICATE_FILE,
    KEY_FILE,
    NAMES_FILE,
    ROLES,
    SERVERS,
    Certificates,
    bound_common_name,
    read_bound_names,
)
from athrl_spaces.untrusted import parser_errors
from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from athrl.certificate_files import load_certificate, names_in, pem, read_file, write_file
from athrl.errors import CommandError
from athrl.options import given_folder

AUTHORITY = "authority"
AUTHORITY_DAYS = 3650
RENEWAL_DAYS = 30
"""`--if-missing` renews certificates that expire sooner than this."""
CLOCK_DIFFERENCE = datetime.timedelta(minutes=5)
"""A certificate is valid from a little before now, for machines whose clocks are behind."""


@dataclass(frozen=True)
class Identity:
    """A private key and the certificate of its public key."""

    key: ec.EllipticCurvePrivateKey
    certificate: x509.Certificate


def certificates(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", parser=given_folder, help="Folder of the certificates.")
    ],
    names: Annotated[
        list[str] | None,
        typer.Option(
            "--name",
            "--names",
            metavar="NAME",
            help="Host name or address of the learner or a router, repeated or separated by commas; "
            "localhost, 127.0.0.1, ::1, the role's and this machine's name are always included.",
        ),
    ] = None,
    actors: Annotated[
        list[str] | None,
        typer.Option(
            "--actor",
            metavar="NAME",
            help="Also make a certificate that is bound to this actor's name, which nobody else may use; "
            "repeated or separated by commas.",
        ),
    ] = None,
    days: Annotated[
        int, typer.Option(min=1, max=AUTHORITY_DAYS, help="Days for which the roles' certificates are valid.")
    ] = 365,
    renew: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ROLE", help=f"Make a new key and certificate for {', '.join(ROLES)} or actor/NAME."
        ),
    ] = None,
    if_missing: Annotated[
        bool,
        typer.Option(
            "--if-missing",
            help=f"Only make missing certificates, and renew those that expire within {RENEWAL_DAYS} days.",
        ),
    ] = False,
) -> None:
    """Make an authority and a certificate for each role, so that services can authenticate each other."""
    hosts, bound = _hosts(names or []), _given(actors or [])
    _require_bindable(bound)
    if renew and bound:
        raise CommandError(f"--renew with --actor: renew it with --renew {bound_common_name(bound[0])}")
    _require_folder(folder)
    if renew:
        made = renew_roles(folder, renew, hosts if names else None, days)
    elif if_missing:
        made = complete(folder, hosts, days, required=_given(names or []), actors=bound)
    elif bound and (folder / AUTHORITY / CERTIFICATE_FILE).exists():
        made = bind_actors(folder, bound, days)
    else:
        made = make_all(folder, hosts, days, actors=bound)
    for role in made:
        certificate = load_certificate(folder / role / CERTIFICATE_FILE)
        print(f"{folder / role}: valid until {certificate.not_valid_after_utc:%Y-%m-%d}")
    if bound:
        print(f"learner and router read the names of actors from their {NAMES_FILE} when they start")
    if not made:
        print(f"{folder}: all certificates exist")


def make_all(folder: Path, hosts: Iterable[str], days: int, actors: Iterable[str] = ()) -> list[str]:
    """Make the authority and every role's certificate; return the names of the folders made.

    Raises:
        CommandError: the folder already holds certificates, or cannot be written.
    """
    for name in (AUTHORITY, *ROLES, *map(_place_of_actor, actors)):
        if any((folder / name / file).exists() for file in (CERTIFICATE_FILE, KEY_FILE)):
            raise CommandError(
                f"{folder / name} already holds a certificate, which is not overwritten: "
                f"name another folder, or renew a role with --renew {ROLES[0]}"
            )
    return complete(folder, hosts, days, actors=actors)


def bind_actors(folder: Path, actors: Iterable[str], days: int) -> list[str]:
    """Make certificates that are bound to actors' names; return the names of the folders made.

    Raises:
        CommandError: an actor has one already, or the folder has no authority.
    """
    authority, names = _load_authority(folder), list(actors)
    for name in names:
        if any((folder / _place_of_actor(name) / file).exists() for file in (CERTIFICATE_FILE, KEY_FILE)):
            raise CommandError(
                f"{folder / _place_of_actor(name)} already holds a certificate, which is not overwritten: "
                f"renew it with --renew {bound_common_name(name)}"
            )
    for name in names:
        _write_bound(folder, name, authority, days)
    _add_names(folder, names)
    return [_place_of_actor(name) for name in names]


def complete(
    folder: Path,
    hosts: Iterable[str],
    days: int,
    required: Iterable[str] = (),
    actors: Iterable[str] = (),
) -> list[str]:
    """Make missing or soon expiring certificates, and a server's if a required name is not in it.

    A server keeps the names that it has unless some are required. Returns the names of the folders made.
    """
    names, wanted = list(hosts), list(required)
    made = []
    if not (folder / AUTHORITY / CERTIFICATE_FILE).exists():
        _write_identity(folder / AUTHORITY, _new_authority())
        made.append(AUTHORITY)
    authority = _load_authority(folder)
    for role in ROLES:
        lacks = role in SERVERS and not _has_names(folder / role, wanted)
        if AUTHORITY in made or lacks or _is_due(folder / role, authority):
            kept = [] if wanted or role not in SERVERS else _present_names(folder / role)
            _write_role(folder / role, _new_role(authority, role, [*names, *kept], days), authority)
            made.append(role)
    bound = dict.fromkeys([*actors, *_actors_in(folder)])
    for name in bound:
        place = _place_of_actor(name)
        if AUTHORITY in made or _is_due(folder / place, authority):
            _write_bound(folder, name, authority, days)
            made.append(place)
    _add_names(folder, bound)
    return made


def renew_roles(folder: Path, roles: Iterable[str], hosts: Iterable[str] | None, days: int) -> list[str]:
    """Make new keys and certificates of the same authority; servers keep their names unless some are given.

    Returns the names of the folders made.

    Raises:
        CommandError: there is no such role or bound actor, or the folder has no authority.
    """
    wanted, given = list(roles), None if hosts is None else list(hosts)
    bound = {bound_common_name(name): name for name in _actors_in(folder)}
    for role in wanted:
        if role not in ROLES and role not in bound:
            raise CommandError(
                f"--renew {role}: there is no such role; it is one of {', '.join([*ROLES, *bound])}"
            )
    authority = _load_authority(folder)
    for role in wanted:
        if role in bound:
            _write_bound(folder, bound[role], authority, days)
            continue
        names = given if given is not None else names_in(folder / role / CERTIFICATE_FILE)
        _write_role(folder / role, _new_role(authority, role, names, days), authority)
    return [_place_of_actor(bound[role]) if role in bound else role for role in wanted]


def _require_bindable(actors: Iterable[str]) -> None:
    for name in actors:
        try:
            bound_common_name(name)
        except ProtocolError as error:
            raise CommandError(f"--actor {name}: {error}") from None


def _place_of_actor(name: str) -> str:
    return f"{BOUND_ACTORS}/{name}"


def _actors_in(folder: Path) -> list[str]:
    """Return the names of the actors whose bound certificates lie in the folder."""
    return sorted(path.parent.name for path in folder.glob(f"{BOUND_ACTORS}/*/{CERTIFICATE_FILE}"))


def _write_bound(folder: Path, actor: str, authority: Identity, days: int) -> None:
    identity = _new_role(authority, bound_common_name(actor), [], days)
    _write_role(folder / _place_of_actor(actor), identity, authority)


def _add_names(folder: Path, actors: Iterable[str]) -> None:
    """Add bound names to those that learner and router know; names of earlier calls stay."""
    for server in SERVERS:
        place = folder / server
        known = read_bound_names(
            Certificates(place / AUTHORITY_FILE, place / CERTIFICATE_FILE, place / KEY_FILE)
        )
        names = dict.fromkeys([*known, *actors])
        if len(names) > len(known):
            write_file(place / NAMES_FILE, "".join(f"{name}\n" for name in names).encode(), mode=0o644)


def _require_folder(folder: Path) -> None:
    """Refuse a path that is, or leads through, something other than a folder."""
    there = next((place for place in (folder, *folder.parents) if os.path.lexists(place)), folder)
    if os.path.lexists(there) and not os.path.isdir(there):
        raise CommandError(f"{folder}: {there} is a file, it should be a folder or not exist yet")


def _hosts(given: Iterable[str]) -> list[str]:
    """Return all names of a server except its role, each once; raises `CommandError` for an invalid name."""
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
    else:  # rustls accepts no certificate without a name
        names = x509.SubjectAlternativeName([x509.DNSName(f"{role.partition('/')[0]}.athrl.invalid")])
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
    """Whether a role has no certificate of this authority, or one that expires soon."""
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
    return path.exists() and wanted <= set(names_in(path))


def _present_names(role_folder: Path) -> list[str]:
    path = role_folder / CERTIFICATE_FILE
    return names_in(path) if path.exists() else []


def _load_authority(folder: Path) -> Identity:
    certificate = load_certificate(folder / AUTHORITY / CERTIFICATE_FILE)
    path = folder / AUTHORITY / KEY_FILE
    wrong = CommandError(f"{path} is not the key of {folder / AUTHORITY / CERTIFICATE_FILE}")
    content = read_file(path)
    with parser_errors(lambda reason: wrong, UnsupportedAlgorithm):
        key = serialization.load_pem_private_key(content, password=None)
        if not isinstance(key, ec.EllipticCurvePrivateKey) or key.public_key() != certificate.public_key():
            raise wrong
    return Identity(key, certificate)


def _write_role(folder: Path, identity: Identity, authority: Identity) -> None:
    write_file(folder / AUTHORITY_FILE, pem(authority.certificate), mode=0o644)
    _write_identity(folder, identity)


def _write_identity(folder: Path, identity: Identity) -> None:
    key = identity.key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    write_file(folder / KEY_FILE, key, mode=0o600)
    # Last, because a reader of the certificate expects its key.
    write_file(folder / CERTIFICATE_FILE, pem(identity.certificate), mode=0o644)
