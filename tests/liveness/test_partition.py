"""A network that was cut for longer than the lease: both sides find each other again by themselves."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import pytest

from tests.liveness import network
from tests.liveness.fleet import RETURN, STARTING, Fleet

pytestmark = [
    pytest.mark.timeout(900),
    pytest.mark.skipif(bool(reason := network.why_not()), reason=reason or "networks can be made"),
]

CUT = 23.0
"""Several leases, and long enough for TCP to pause for 13 s between two attempts to send again."""
BLINK = 3.0
"""Shorter than the lease: the outage is not noticed, and TCP must send lost data again."""


@pytest.fixture
def island() -> Iterator[network.Network]:
    with network.Network() as made:
        yield made


@pytest.mark.slow
def test_run_goes_on_when_a_cut_network_is_mended(
    command,
    steady: list[str],
    port: int,
    free_address: Callable[[], str],
    island: network.Network,
    record_property,
) -> None:
    router = free_address()  # the island's own loopback
    address = f"tcp/{island.here}:{port}"
    fleet = Fleet(command, [*steady, "--set", f"network.listen={address}"], address)
    fleet.start_learner()
    fleet.start_client("direct", "actor", within=island.within)
    fleet.start("router", "router", "--listen", router, "--connect", address, within=island.within)
    fleet.start_client("routed", "actor", router, within=island.within)
    actors = ("direct", "routed")
    with fleet.watch():
        fleet.await_storing(actors, fleet.mark(), STARTING)
        for seconds in (CUT, BLINK):
            island.cut()
            time.sleep(seconds)
            mark = fleet.mark()
            island.mend()
            after = fleet.await_storing(actors, mark, RETURN)
            record_property(f"after {seconds:.0f} s without a network", after)
            time.sleep(2.0)
        fleet.leave()
