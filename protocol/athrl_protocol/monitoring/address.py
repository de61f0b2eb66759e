"""Where a service answers Prometheus: a port of the loopback interface, or another address that is named."""

from __future__ import annotations

import ipaddress
import socket
from typing import NamedTuple

from athrl_protocol.errors import ProtocolError

EVERY_ADDRESS = "every-address"
"""Instead of a host: every address of this machine."""
EXPECTED = f"PORT (on loopback), HOST:PORT or {EVERY_ADDRESS}:PORT"

_LOOPBACK = "127.0.0.1"


class MetricsAddress(NamedTuple):
    """A host, empty for every address of this machine, and a port."""

    host: str
    port: int

    def __str__(self) -> str:
        host = f"[{self.host}]" if ":" in self.host else self.host or EVERY_ADDRESS
        return f"{host}:{self.port}"


def metrics_address(text: str) -> MetricsAddress:
    """Return the address that is written as `EXPECTED`.

    The figures are shown to everybody who can connect, without a certificate. So every address is meant only
    where that is said, not where 0.0.0.0 was copied from somewhere.

    Raises:
        ProtocolError: it is no such address, or means every address without saying so.
    """
    host, colon, port = text.rpartition(":")
    if not (port.isascii() and port.isdigit() and len(port) <= 5 and 0 < int(port) < 65_536):
        raise ProtocolError(f"{text!r} is no address for metrics: should be {EXPECTED}, the port 1 to 65535")
    if not colon:
        return MetricsAddress(_LOOPBACK, int(port))
    if host == EVERY_ADDRESS:
        return MetricsAddress("", int(port))
    host = host.removeprefix("[").removesuffix("]")
    if _means_every_address(host):
        raise ProtocolError(
            f"{text!r} is every address of this machine, where everybody who reaches it reads the metrics: "
            f"write {EVERY_ADDRESS}:{port} if that is meant, or {port} for loopback"
        )
    return MetricsAddress(host, int(port))


def _means_every_address(host: str) -> bool:
    if host in ("", "*"):
        return True
    try:
        return socket.inet_aton(host) == bytes(4)  # 0 and 0x0 as well
    except OSError:
        pass
    try:
        address = ipaddress.IPv6Address(host)
    except ValueError:
        return False
    mapped = address.ipv4_mapped
    return address.is_unspecified if mapped is None else mapped.is_unspecified
