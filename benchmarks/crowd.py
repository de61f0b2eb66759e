"""A thousand actors on one learner: time until all are received, of acknowledgements, and costs.

Each actor has its own Zenoh session, presence, metrics and uploader, and joins the run as any actor; but it
does not drive and takes no policies. Some hundred share a process. The learner's side is its intake, log and
replay, its presence watcher, and state and metrics once a second, without training. A separate process
receives the actors' metrics, as an evaluator or a viewer does.

Measured are: joining, from the start signal, which the processes get once Python and its libraries are
loaded, until the last actor has its name; receiving, from the signal to send, which all get when all have
joined, until a chunk of each is stored.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from athrl.ports import free_address
from athrl.runs import declare_installed_planners
from athrl_learner import factories
from athrl_learner.components import make_experience
from athrl_learner.intake.arrivals import Arrivals
from athrl_learner.intake.store import ExperienceStore
from athrl_protocol import (
    ChunkIntake,
    MetricsPublisher,
    Phase,
    PresenceWatcher,
    RunFile,
    RunState,
    StatePublisher,
    announce_presence,
    open_session,
    read_run_file,
    serve_run_file,
)

from benchmarks.light_crowd import RUN, STEPS, resident_mebibytes

_PATIENCE = 60.0


class Crowd:
    """The processes of the actors."""

    def __init__(self, address: str, actors: int, processes: int, transitions_per_second: float) -> None:
        """Start them, one after the other, and return when all are ready to join."""
        share, rate = actors // processes, transitions_per_second / actors / STEPS
        command = [sys.executable, "-m", "benchmarks.light_crowd", address]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        self._processes = [
            subprocess.Popen([*command, str(number * share), str(share), str(rate)], **pipes)
            for number in range(processes)
        ]
        self._words()

    def join(self) -> float:
        """Let them join; return when every actor has, with the total seconds of a core."""
        self.begin()
        return sum(float(word) for word in self._words())

    def begin(self) -> None:
        """Start the next phase: join, or send."""
        for process in self._processes:
            process.stdin.write(b"\n")
            process.stdin.flush()

    def _words(self) -> list[bytes]:
        words = [process.stdout.readline() for process in self._processes]
        if not all(words):
            sys.exit("a crowd could not be started")
        return words

    def end(self) -> list[dict[str, Any]]:
        """Stop them; return the report of each process."""
        for process in self._processes:
            process.stdin.close()
        return [json.loads(process.stdout.readline()) for process in self._processes]

    def close(self) -> None:
        """End all processes."""
        for process in self._processes:
            process.stdin.close()
        for process in self._processes:
            try:
                process.wait(_PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()


@contextlib.contextmanager
def listener(address: str) -> Iterator[Callable[[], int]]:
    """A process that receives all metrics; yields a function that returns how many actors have reported."""
    command = [sys.executable, "-m", "benchmarks.light_listener", address]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        if process.stdout.readline() != b"ready\n":
            sys.exit("the listener could not be started")

        def actors_heard() -> int:
            process.stdin.write(b"\n")
            process.stdin.flush()
            return int(process.stdout.readline())

        yield actors_heard


@contextlib.contextmanager
def news(session: Any, run_file: RunFile, store: ExperienceStore, arrivals: Arrivals) -> Iterator[Any]:
    """A learner's other messages besides the intake; yields a function that reports once."""
    with (
        serve_run_file(session, run_file),
        announce_presence(session, RUN, "learner", "learner"),
        PresenceWatcher(session, RUN) as presence,
        StatePublisher(session, RUN) as state,
        MetricsPublisher(session, RUN, "learner", "learner") as metrics,
    ):

        def report() -> int:
            """Publish state and metrics; return how many actors are present."""
            with store.held():
                values = arrivals.metrics()
            state.publish(RunState(Phase.TRAINING, store.environment_steps, 10**9, 0, 0, ""))
            metrics.publish(values)
            return sum(role == "actor" for role, _ in presence.present())

        yield report


def measure(arguments: argparse.Namespace, folder: Path) -> dict[str, float]:
    """Let a crowd join and send, and return the measurements."""
    declare_installed_planners()
    run_file = read_run_file(
        None,
        [
            f"run.name={RUN}",
            f"replay.sequence_length={STEPS}",
            "learner.samples_per_insert=0.001",
            "run.environment_steps=1000000000",
        ],
    )
    arrivals = Arrivals()
    store = make_experience(
        run_file, factories.make_agent(run_file), arrivals, factories.make_log(run_file, folder)
    )
    address = free_address()
    with (
        contextlib.closing(store.log),
        open_session(listen=address, timeout=_PATIENCE) as session,
        news(session, run_file, store, arrivals) as report,
        ChunkIntake(session, RUN, store) as intake,
        listener(address) as actors_heard,
    ):
        memory_alone = resident_mebibytes()
        crowd = Crowd(address, arguments.actors, arguments.processes, arguments.transitions)
        with contextlib.closing(crowd):
            began, joining = time.monotonic(), time.process_time()
            actors_joining = crowd.join()
            joined, joining = time.monotonic() - began, time.process_time() - joining
            print(f"{arguments.actors} actors joined in {joined:.0f} s", flush=True)
            crowd.begin()
            began, busy = time.monotonic(), time.process_time()
            received = wait_until_all_are_received(intake, arguments.actors)
            until = began + max(arguments.seconds, received + 5)
            present = 0
            while time.monotonic() < until:
                time.sleep(1.0)
                present = report()
            elapsed, busy = time.monotonic() - began, time.process_time() - busy
            reporting = actors_heard()
            taken, memory = store.environment_steps, resident_mebibytes()
            reports = crowd.end()
        stored = intake.statistics().stored
    waits = np.array([wait for one in reports for wait in one["waits"]])
    counts = {
        name: sum(one[name] for one in reports) for name in ("acknowledged", "given_up", "resent", "waiting")
    }
    if counts["acknowledged"] != stored:
        sys.exit(f"{counts['acknowledged']} chunks acknowledged, {stored} stored")
    return {
        "actors": arguments.actors,
        "present": present,
        "reporting": reporting,
        "joined_s": joined,
        "learner_ms_a_joining": 1000 * joining / arguments.actors,
        "actor_ms_a_joining": 1000 * actors_joining / arguments.actors,
        "all_heard_s": received,
        "transitions_per_second": taken / elapsed,
        "ack_p50_s": float(np.quantile(waits, 0.5)),
        "ack_p99_s": float(np.quantile(waits, 0.99)),
        "ack_max_s": float(waits.max()),
        "learner_cores": busy / elapsed,
        "actors_cores": sum(one["busy"] for one in reports) / elapsed,
        "learner_mebibytes": memory,
        "learner_mebibytes_alone": memory_alone,
        "actors_mebibytes": sum(one["mebibytes"] for one in reports),
        **counts,
    }


def wait_until_all_are_received(intake: ChunkIntake, actors: int) -> float:
    """Seconds until a chunk of every actor is stored."""
    began = time.monotonic()
    while len(intake.ledger()) < actors:
        if time.monotonic() - began > _PATIENCE:
            sys.exit(f"only {len(intake.ledger())} of {actors} actors were received in {_PATIENCE:.0f} s")
        time.sleep(0.1)
    return time.monotonic() - began


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--actors", type=int, default=1000)
    parser.add_argument("--processes", type=int, default=5)
    parser.add_argument("--transitions", type=float, default=5000, help="a second, of all actors together")
    parser.add_argument("--seconds", type=float, default=20.0)
    arguments = parser.parse_args()
    if arguments.actors < 1 or arguments.processes < 1 or arguments.actors % arguments.processes:
        parser.error(
            f"--actors {arguments.actors} is not to be shared evenly by --processes {arguments.processes}, "
            "it should be a multiple"
        )
    with tempfile.TemporaryDirectory() as folder:
        row = measure(arguments, Path(folder) / "experience")
    row = {name: round(value, 3) for name, value in row.items()}
    for name, value in row.items():
        print(f"{name:24s} {value:10,g}")
    print(json.dumps({"cores": os.cpu_count(), "load": os.getloadavg()[0], **row}))


if __name__ == "__main__":
    main()
