"""The run recovers from pauses and kills of every service: no chunk is lost or stored twice."""

from __future__ import annotations

import signal
import time
from collections.abc import Callable

import pytest

from tests.liveness.fleet import RETURN, STARTING, Fleet

pytestmark = pytest.mark.timeout(900)

PAUSE = 30.0
SHORT_PAUSE, SHORT_PAUSES = 7.0, 3
"""Just longer than the lease: clients are still sending to a paused router when it returns."""
ACTORS = ("near", "distant")


@pytest.fixture
def running_fleet(fleet: Fleet, free_address: Callable[[], str]) -> Fleet:
    """A run with an actor at the learner, one behind a router, and an evaluator; all started at once."""
    router = free_address()
    fleet.start("router", "router", "--listen", router, "--connect", fleet.address)
    fleet.start_client("distant", "actor", router)
    fleet.start_client("near", "actor")
    fleet.start_client("evaluator", "evaluator", router)
    fleet.start_learner()
    return fleet


@pytest.mark.slow
def test_run_recovers_when_paused_services_are_resumed(running_fleet: Fleet, record_property) -> None:
    fleet = running_fleet
    with fleet.watch():
        fleet.await_storing(ACTORS, fleet.mark(), STARTING)
        fleet.await_word("evaluator", STARTING)

        fleet.signal(["learner"], signal.SIGSTOP)
        time.sleep(PAUSE)
        mark = fleet.mark()
        fleet.signal(["learner"], signal.SIGCONT)
        record_property("after the learner's pause", fleet.await_storing(ACTORS, mark, RETURN))
        fleet.await_word("evaluator", RETURN)

        others = ["near", "router", "evaluator"]
        fleet.signal(others, signal.SIGSTOP)
        time.sleep(PAUSE)
        published = fleet.reports["learner"].values["policy_version"]
        mark = fleet.mark()
        fleet.signal(others, signal.SIGCONT)
        record_property("after the others' pause", fleet.await_storing(ACTORS, mark, RETURN))
        fleet.await_word("evaluator", RETURN)
        for name in ACTORS:
            _await_policy(fleet, name, published)

        for _ in range(SHORT_PAUSES):
            fleet.signal(["router"], signal.SIGSTOP)
            time.sleep(SHORT_PAUSE)
            mark = fleet.mark()
            fleet.signal(["router"], signal.SIGCONT)
            record_property("after the router's pause", fleet.await_storing(["distant"], mark, RETURN))
            time.sleep(1.0)
        fleet.leave()


@pytest.mark.slow
def test_run_recovers_when_killed_services_are_restarted(running_fleet: Fleet, record_property) -> None:
    fleet = running_fleet
    with fleet.watch():
        fleet.await_storing(ACTORS, fleet.mark(), STARTING)
        time.sleep(12.0)  # there is a checkpoint, and experience that came after it
        published = fleet.reports["learner"].values["policy_version"]
        for name, affected in (("learner", ACTORS), ("router", ("distant",)), ("near", ("near",))):
            fleet.kill(name)
            fleet.start_again(name)
            began = time.monotonic()
            fleet.await_word(name if name != "router" else "distant", STARTING)
            mark = fleet.mark()
            after = fleet.await_storing(affected, mark, RETURN)
            record_property(f"after {name} was killed", (time.monotonic() - began, after))
        fleet.kill("evaluator")
        fleet.start_again("evaluator")
        fleet.await_word("evaluator", STARTING)
        for name in ACTORS:  # also though the learner went back to a checkpoint, and never to an older one
            _await_policy(fleet, name, published)
        fleet.leave()


def _await_policy(fleet: Fleet, name: str, version: float) -> None:
    """Wait until an actor drives with this version or a newer one."""
    deadline = time.monotonic() + RETURN
    while fleet.reports[name].values.get("policy_version", -1) < version:
        assert time.monotonic() < deadline, fleet.story([name])
        time.sleep(0.05)
