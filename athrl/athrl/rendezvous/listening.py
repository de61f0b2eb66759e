"""A free port for a learner whose address others read in the run's folder."""

from __future__ import annotations

from athrl_protocol.announcements.address_file import address_at
from athrl_protocol.errors import AddressInUse
from athrl_protocol.run_file import RunFile
from athrl_protocol.transport.address import complete_address, split_address
from athrl_protocol.transport.session import require_free

PORTS_TRIED = 100


def at_free_port(run_file: RunFile, reached_as: str, *, secure: bool) -> RunFile:
    """Return the settings with the first free port at or after that of `network.listen`.

    On a machine that others use too, somebody else's process may have the port.

    Args:
        run_file: the learner's settings.
        reached_as: host name or address by which others reach this machine, which is checked here.
        secure: whether the learner has certificates.

    Raises:
        AddressInUse: none of `PORTS_TRIED` ports is free.
        ProtocolError: `network.listen` is no address of this machine, or `reached_as` no name of one.
    """
    wanted = complete_address(run_file.network.listen, secure=secure)
    address_at(reached_as, wanted)
    _, first = split_address(wanted)
    place = wanted.rpartition(":")[0]
    ports = range(first, min(first + PORTS_TRIED, 65_536))
    address = next((f"{place}:{port}" for port in ports if _is_free(f"{place}:{port}")), wanted)
    require_free(address)
    network = run_file.network.model_copy(update={"listen": address})
    return run_file.model_copy(update={"network": network})


def _is_free(address: str) -> bool:
    try:
        require_free(address)
    except AddressInUse:
        return False
    return True
