"""Checks of the learner's address and of the certificates."""

from __future__ import annotations

import datetime
import functools
import os
import stat
from collections.abc import Iterator
from pathlib import Path

from athrl_protocol.run_file import RunFile
from athrl_protocol.security.certificates import (
    BOUND_ACTORS,
    ROLES,
    VARIABLE,
    Certificates,
    find_certificates,
    role_and_bound_name,
)
from athrl_protocol.transport.address import complete_address, is_loopback, split_address
from athrl_protocol.transport.session import require_free
from cryptography import x509
from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
from cryptography.x509.oid import ExtendedKeyUsageOID

from athrl.certificate_files import common_name, load_certificate
from athrl.certificates import RENEWAL_DAYS
from athrl.doctor.finding import Finding, failed, findings_of, ok, warning


def port(settings: RunFile) -> Iterator[Finding]:
    """Check that `network.listen` is free."""
    secure = certificate_folder(settings) is not None
    address = complete_address(settings.network.listen, secure=secure)
    require_free(address)
    yield ok("port", f"{settings.network.listen} is free")
    host, _ = split_address(address)
    if not secure and not is_loopback(host):
        yield warning(
            "exposure",
            f"the learner would listen at {host} without certificates: every client may do everything",
            "athrl certificates FOLDER, and set network.certificates",
        )


def certificate_folder(settings: RunFile) -> Path | None:
    """Return the folder of certificates; None without certificates."""
    named = os.environ.get(VARIABLE) or settings.network.certificates
    return Path(named) if named else None


def certificates(settings: RunFile) -> Iterator[Finding]:
    """Check the certificate of every role in the folder."""
    folder = certificate_folder(settings)
    if folder is None:
        yield ok("certificates", "none are used")
        return
    roles = [role for role in ROLES if (folder / role).is_dir()]
    if not roles:  # the folder of a single role
        yield from findings_of("certificates", functools.partial(_role, folder, None))
    for role in roles:
        yield from findings_of(f"certificate {role}", functools.partial(_role, folder, role))
    for bound in sorted(folder.glob(f"{BOUND_ACTORS}/*")):
        yield from findings_of(f"certificate actor/{bound.name}", functools.partial(_role, bound, None))


def _role(folder: Path, role: str | None) -> Iterator[Finding]:
    found = find_certificates(folder, role or "viewer")
    assert found is not None
    certificate = load_certificate(found.certificate)
    name = common_name(certificate)
    check = f"certificate {role or name}"
    remedy = f"athrl certificates {folder} --renew {role or name}"
    problems = [
        *_wrong_role(certificate, name, role, remedy, check),
        *_wrong_authority(certificate, found, check),
        *_wrong_time(certificate, remedy, check),
        *_readable_key(found, check),
    ]
    yield from problems
    if not problems:
        yield ok(check, f"valid until {certificate.not_valid_after_utc:%Y-%m-%d}")


def _wrong_role(
    certificate: x509.Certificate, name: str, role: str | None, remedy: str, check: str
) -> Iterator[Finding]:
    if role_and_bound_name(name)[0] is None or (role is not None and name != role):
        yield failed(check, f"its common name is {name!r}, which is no role or another role", remedy)
    if name == "learner" and ExtendedKeyUsageOID.SERVER_AUTH not in _purposes(certificate):
        yield failed(check, "it may not serve", remedy)


def _purposes(certificate: x509.Certificate) -> list[x509.ObjectIdentifier]:
    try:
        return list(certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value)
    except x509.ExtensionNotFound:
        return [ExtendedKeyUsageOID.SERVER_AUTH]


def _wrong_authority(certificate: x509.Certificate, found: Certificates, check: str) -> Iterator[Finding]:
    authority = load_certificate(found.authority)
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature, UnsupportedAlgorithm):
        yield failed(
            check,
            f"{found.certificate} is not of the authority {found.authority}",
            "give it the ca.crt of the authority that made it, or make it again",
        )


def _wrong_time(certificate: x509.Certificate, remedy: str, check: str) -> Iterator[Finding]:
    now = datetime.datetime.now(datetime.UTC)
    begins, ends = certificate.not_valid_before_utc, certificate.not_valid_after_utc
    if now > ends:
        yield failed(check, f"it expired on {ends:%Y-%m-%d}", remedy)
    elif now < begins:
        yield failed(check, f"it is valid from {begins:%Y-%m-%d %H:%M} UTC on", "set this machine's clock")
    elif ends - now < min(datetime.timedelta(days=RENEWAL_DAYS), (ends - begins) / 3):
        yield warning(check, f"it expires on {ends:%Y-%m-%d}", remedy)


def _readable_key(found: Certificates, check: str) -> Iterator[Finding]:
    mode = stat.S_IMODE(found.key.stat().st_mode)
    if mode & 0o077:
        yield warning(check, f"other users may read {found.key} (mode {mode:04o})", f"chmod 600 {found.key}")
