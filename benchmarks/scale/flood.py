"""What intake and routers cost at full load: actors that only send, in racks, directly or behind routers."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from athrl_learner import factories
from athrl_learner.components import make_experience
from athrl_learner.intake.arrivals import Arrivals
from athrl_learner.intake.store import ExperienceStore
from athrl_protocol import ChunkIntake, RunFile, open_session, serve_run_file

from benchmarks.light_actor import RUN
from benchmarks.scale.processes import PATIENCE, reading, router
from benchmarks.scale.racks import Rack

WAYS = ("directly", "one router", "two layers of routers")
_PORT, _MIDDLE_PORT, _RACK_PORT = 17_447, 17_448, 17_449
_FILLED_WITHIN = 240.0


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


@contextlib.contextmanager
def sending(places: Sequence[tuple[Rack, str]], steps: int) -> Iterator[list[dict[str, Any]]]:
    """Run a light actor at each place, a rack and an address; their reports are in the list afterwards."""
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    program = [sys.executable, "-m", "benchmarks.light_actor"]
    actors = [
        subprocess.Popen([*rack.within, *program, address, f"actor-{number}", str(steps)], **pipes)
        for number, (rack, address) in enumerate(places)
    ]
    try:
        if not all(actor.stdout.readline() == b"ready\n" for actor in actors):
            sys.exit("an actor could not be started: see the error above")
        reports: list[dict[str, Any]] = []
        yield reports
        for actor in actors:
            actor.stdin.close()
        reports += [json.loads(actor.stdout.readline()) for actor in actors]
    finally:
        for actor in actors:
            actor.stdin.close()
        for actor in actors:
            try:
                actor.wait(PATIENCE)
            except subprocess.TimeoutExpired:
                actor.kill()


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
        places = [(racks[number % len(racks)], addresses[number % len(racks)]) for number in range(actors)]
        with sending(places, run_file.replay.sequence_length) as reports:
            _fill(store)
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


def _fill(store: ExperienceStore) -> None:
    """Wait until the replay is full; until then its memory is touched for the first time, which costs."""
    deadline = time.monotonic() + _FILLED_WITHIN
    while store.replay.sequences < store.replay.slots:
        if time.monotonic() > deadline:
            sys.exit(f"the replay was not full within {_FILLED_WITHIN:g} s")
        time.sleep(0.1)
