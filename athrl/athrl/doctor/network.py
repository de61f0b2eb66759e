"""Whether the learner could listen where the run file says, and whether the certificates are good."""

from __future__ import annotations

import datetime
import functools
import os
import stat
from collections.abc import Iterator
from pathlib import Path

from athrl_protocol.address import complete_address, split_address
from athrl_protocol.certificates import ROLES, VARIABLE, Certificates, find_certificates
from athrl_protocol.run_file import RunFile
from athrl_protocol.session import require_free
from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.x509.oid import ExtendedKeyUsageOID

from athrl.certificates import RENEWAL_DAYS, common_name
from athrl.doctor.finding import Finding, failed, findings_of, ok, warning

LOOPBACK = ("127.", "localhost", "::1")


def port(settings: RunFile) -> Iterator[Finding]:
    """Look whether `network.listen` is free."""
    address = settings.network.listen
    require_free(complete_address(address, secure=False))
    yield ok("port", f"{address} is free")
    host, _ = split_address(complete_address(address, secure=False))
    if not host.startswith(LOOPBACK) and certificate_folder(settings) is None:
        yield warning(
            "exposure",
            f"the learner would listen at {host} without certificates: whoever reaches it may do everything",
            "athrl certificates FOLDER, and set network.certificates",
        )


def certificate_folder(settings: RunFile) -> Path | None:
    """Return where the certificates lie, None without any."""
    named = os.environ.get(VARIABLE) or settings.network.certificates
    return Path(named) if named else None


def certificates(settings: RunFile) -> Iterator[Finding]:
    """Look at every role's certificate that is there."""
    folder = certificate_folder(settings)
    if folder is None:
        yield ok("certificates", "none are used")
        return
    roles = [role for role in ROLES if (folder / role).is_dir()]
    if not roles:  # the folder of a single role
        yield from findings_of("certificates", functools.partial(_role, folder, None))
    for role in roles:
        yield from findings_of(f"certificate {role}", functools.partial(_role, folder, role))


def _role(folder: Path, role: str | None) -> Iterator[Finding]:
    found = find_certificates(folder, role or "viewer")
    assert found is not None
    certificate = x509.load_pem_x509_certificate(found.certificate.read_bytes())
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
    if name not in ROLES or (role is not None and name != role):
        yield failed(check, f"its common name is {name!r}, which is no role or another's", remedy)
    if name == "learner" and ExtendedKeyUsageOID.SERVER_AUTH not in _purposes(certificate):
        yield failed(check, "it may not serve", remedy)


def _purposes(certificate: x509.Certificate) -> list[x509.ObjectIdentifier]:
    try:
        return list(certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value)
    except x509.ExtensionNotFound:
        return [ExtendedKeyUsageOID.SERVER_AUTH]


def _wrong_authority(certificate: x509.Certificate, found: Certificates, check: str) -> Iterator[Finding]:
    authority = x509.load_pem_x509_certificate(found.authority.read_bytes())
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature):
        yield failed(
            check,
            f"{found.certificate} is not of the authority {found.authority}",
            "give it the ca.crt of the authority that made it, or make it anew",
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
        yield warning(check, f"others may read {found.key} (mode {mode:04o})", f"chmod 600 {found.key}")
