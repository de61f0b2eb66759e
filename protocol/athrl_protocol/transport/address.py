"""Addresses of a learner, as Zenoh writes them."""

from __future__ import annotations

from athrl_protocol.errors import ProtocolError

LONGEST_HOST = 253
"""Characters of a host's name in the DNS."""


def complete_address(address: str, *, secure: bool = False) -> str:
    """Return the address as Zenoh writes it: `host:port` becomes `tcp/host:port`, or `tls/...` if `secure`.

    A service with certificates never communicates without them, so `secure` makes `tls/...` of `tcp/...` too.

    Raises:
        ProtocolError: it is no address, or is `tls/...` without certificates.
    """
    complete = address if "/" in address else f"tcp/{address}"
    split_address(complete)
    if complete.startswith("tls/") and not secure:
        raise ProtocolError(
            f"{complete} needs certificates: name their folder with --certificates or ATHRL_CERTIFICATES"
        )
    return f"tls/{complete[4:]}" if secure else complete


def split_address(address: str) -> tuple[str, int]:
    """Return host and port of an address such as `tcp/127.0.0.1:7447`.

    Raises:
        ProtocolError: it is no address.
    """
    protocol, _, place = address.partition("/")
    host, _, port = place.rpartition(":")
    if protocol not in ("tcp", "tls") or not host or not (port.isascii() and port.isdigit()):
        raise ProtocolError(f"{address!r} is not an address: it should look like tcp/127.0.0.1:7447")
    if len(port) > 5 or not 0 < int(port) < 65536:
        raise ProtocolError(f"{address!r} is not an address: its port should be 1 to 65535")
    if not _is_host(host.strip("[]")):
        raise ProtocolError(f"{address!r:.100} is not an address: {host!r:.60} is no host's name or number")
    return host.strip("[]"), int(port)


def _is_host(host: str) -> bool:
    """Whether the system can look a host up, or say that it is not known."""
    if not 1 <= len(host) <= LONGEST_HOST or not host.isprintable() or " " in host:
        return False
    try:
        host.encode("idna")
    except UnicodeError:  # a part that is empty or has more than 63 characters
        return False
    return True


def is_loopback(host: str) -> bool:
    """Whether only this machine reaches an address with this host."""
    return host in ("localhost", "::1") or host.startswith("127.")
