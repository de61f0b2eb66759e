"""What intake and routers cost at full load: actors that only send, in racks, directly or behind routers."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from athrl_learner import factories
from athrl_learner.components import make_experience
from athrl_learner.intake.arrivals import Arrivals
from athrl_protocol import ChunkIntake, RunFile, open_session, serve_run_file

from benchmarks.light_actor import RUN
from benchmarks.light_actors import light_actors, wait_until_filled
from benchmarks.scale.processes import PATIENCE, reading, router
from benchmarks.scale.racks import Rack

WAYS = ("directly", "one router", "two layers of routers")
_PORT, _MIDDLE_PORT, _RACK_PORT = 17_447, 17_448, 17_449


@dataclass(frozen=True)
class Flooded:
    """What was taken in on one way, and what it cost.

    Attributes:
        way: one of WAYS.
        decisions: taken in while it was measured.
        per_second: of them.
        learner_cpu: seconds of a core of the learner's process for 1,000 decisions.
        router_cpu: the same of the router that all pass; 0 without one.
        bytes_a_decision: that came from the racks, with the headers of IP and TCP.
    """

    way: str
    decisions: int
    per_second: float
    learner_cpu: float
    router_cpu: float
    bytes_a_decision: float


def flood(
    way: str, run_file: RunFile, racks: Sequence[Rack], actors: int, seconds: float, folder: Path
) -> Flooded:
    """Let actors in the racks send as fast as they are taken in; everything acknowledged must be stored."""
    folder.mkdir()
    store = make_experience(
        run_file, factories.make_agent(run_file), Arrivals(), factories.make_log(run_file, folder / "log")
    )
    listen = f"tcp/0.0.0.0:{_PORT}"
    with (
        contextlib.closing(store.log),
        open_session(listen=listen, timeout=PATIENCE) as session,
        serve_run_file(session, run_file),
        ChunkIntake(session, RUN, store) as intake,
        ExitStack() as stack,
    ):
        middle, addresses = _routers(way, racks, folder, stack)
        chosen = [number % len(racks) for number in range(actors)]
        with light_actors(
            [addresses[number] for number in chosen],
            run_file.replay.sequence_length,
            [racks[number].within for number in chosen],
        ) as reports:
            wait_until_filled(store)
            before = store.environment_steps, time.perf_counter(), time.process_time()
            came, passed = _came(racks), reading(middle).cpu if middle else 0.0
            time.sleep(seconds)
            taken = store.environment_steps - before[0]
            elapsed, busy = time.perf_counter() - before[1], time.process_time() - before[2]
            came, passed = _came(racks) - came, (reading(middle).cpu if middle else 0.0) - passed
        stored, steps = intake.statistics().stored, store.environment_steps
    acknowledged = sum(report["acknowledged"] for report in reports)
    if not acknowledged == stored == steps / run_file.replay.sequence_length:
        sys.exit(f"{way}: {acknowledged} chunks acknowledged, {stored} stored: something was lost")
    thousands = taken / 1000
    return Flooded(way, taken, taken / elapsed, busy / thousands, passed / thousands, came / taken)


def _routers(
    way: str, racks: Sequence[Rack], folder: Path, stack: ExitStack
) -> tuple[subprocess.Popen[bytes] | None, list[str]]:
    """Start a way's routers; return the one that all pass, and the address for each rack's actors."""
    if way == "directly":
        return None, [f"tcp/{rack.here}:{_PORT}" for rack in racks]
    middle = stack.enter_context(
        router(f"tcp/0.0.0.0:{_MIDDLE_PORT}", f"tcp/127.0.0.1:{_PORT}", RUN, folder / "router.log")
    )
    if way == "one router":
        return middle, [f"tcp/{rack.here}:{_MIDDLE_PORT}" for rack in racks]
    own = f"tcp/127.0.0.1:{_RACK_PORT}"
    for number, rack in enumerate(racks):
        up, log = f"tcp/{rack.here}:{_MIDDLE_PORT}", folder / f"rack-{number}.log"
        stack.enter_context(router(own, up, RUN, log, rack.within))
    return middle, [own for _ in racks]


def _came(racks: Sequence[Rack]) -> int:
    return sum(rack.bytes_received() for rack in racks)
