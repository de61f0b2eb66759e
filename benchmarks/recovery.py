"""How soon a run recovers after each fault: killed, paused for longer than the lease, disconnected.

A real run with each service in a separate process: learner, an actor at the learner, one behind a router, an
evaluator. The clock starts when a paused process is resumed, the network is restored, or a killed process is
restarted. For a restart, the time until the service is present is reported as well: it has loaded everything
and takes part under its name, which is most of the time on a busy machine. For comparison, a Python that only
loads the libraries is started beside the run. The run has recovered when a chunk of every affected actor is
in the learner's log and the count of updates rises; an evaluator when it reports again. At the end every
chunk must be in the log once, and all acknowledged chunks must be there.

    python -m benchmarks.recovery                   about seven minutes
    python -m benchmarks.recovery --pause 8 --rounds 1
    python -m benchmarks.recovery --cuts 7 8 9 10   only cut networks, for so long each

A partition needs root, `ip` and `iptables`; without them that row is skipped.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

from athrl.ports import free_address
from athrl_protocol import PolicySubscriber, PolicyUpdate, PresenceWatcher

from tests.conftest import Command
from tests.liveness import network
from tests.liveness.fleet import RUN, STARTING, Fleet

NEAR, DISTANT = "actor-near", "actor-distant"
ACTORS = (NEAR, DISTANT)
SETTINGS = {
    "run.environment_steps": 100_000_000,
    "environment.vehicles": 30,
    "exploration.random_decisions": 200,
    "learner.samples_per_insert": 1.0,  # so that the actors never wait for training
    "learner.publish_seconds": 0.1,  # a publication contains the count of updates
    "learner.checkpoint_seconds": 20.0,
    "learner.checkpoints_kept": 1000,  # the complete log is checked at the end
    "actor.environments": 2,
    "evaluator.episodes": 2,
    "evaluator.seconds_between": 0.0,
}
_LIBRARIES = ("torch", "numba, gymnasium, onnxruntime")  # a learner's; an actor's and an evaluator's
_POLL = 0.01
_CALM = 5.0  # between two faults
_PATIENCE = 120.0


class Updates:
    """The learner's count of updates, from its publications."""

    def __init__(self) -> None:
        self._publications: list[tuple[float, int]] = []

    def take(self, policy: PolicyUpdate) -> None:
        """Record a publication."""
        self._publications.append((time.monotonic(), policy.updates))

    def rose_after(self, moment: float, restarted: bool) -> float | None:
        """When it first rose after `moment`; `restarted`: above the first count of a restarted learner."""
        later = [updates for at, updates in self._publications if at > moment]
        earlier = [updates for at, updates in self._publications if at <= moment]
        known = min(later[:1] if restarted else earlier[-1:], default=None)
        if known is None:
            return None
        return next((at for at, updates in self._publications if at > moment and updates > known), None)


class Arrivals:
    """When each service last appeared."""

    def __init__(self) -> None:
        self.at: dict[str, float] = {}
        self._present: frozenset[str] = frozenset()

    def take(self, present: frozenset[tuple[str, str]]) -> None:
        """Record a change."""
        names = frozenset(name for _, name in present)
        self.at |= dict.fromkeys(names - self._present, time.monotonic())
        self._present = names


class Trial:
    """A running fleet and its measurements: times until recovery, and until services are present."""

    def __init__(self, fleet: Fleet) -> None:
        self.fleet = fleet
        self.updates = Updates()
        self.arrivals = Arrivals()
        self.seconds: defaultdict[str, list[dict[str, float]]] = defaultdict(list)

    def kill(self, name: str, actors: Iterable[str]) -> None:
        """Kill a service, and restart it at once."""
        self.fleet.kill(name)
        self._measure(f"{name} killed", lambda: self.fleet.start_again(name), actors, name)

    def stand_still(self, name: str, actors: Iterable[str], seconds: float) -> None:
        """Pause a service."""
        self.fleet.signal([name], signal.SIGSTOP)
        time.sleep(seconds)
        resume = lambda: self.fleet.signal([name], signal.SIGCONT)  # noqa: E731
        self._measure(f"{name} paused {seconds:g} s", resume, actors, name)

    def load_alone(self, libraries: str) -> None:
        """Start a Python beside the run that only loads these libraries: a lower bound for a restart."""
        began = time.monotonic()
        subprocess.run([sys.executable, "-c", f"import {libraries}"], check=True, timeout=_PATIENCE)
        after = {"all": time.monotonic() - began}
        self.seconds[f"(import {libraries})"].append(after)

    def cut(self, island: network.Network, seconds: float) -> None:
        """Disconnect an actor, and the router of another actor."""
        island.cut()
        time.sleep(seconds)
        self._measure(f"network cut {seconds:g} s", island.mend, ACTORS, "")

    def _measure(self, fault: str, comes_back: Callable[[], None], actors: Iterable[str], who: str) -> None:
        mark, began = self.fleet.mark(), time.monotonic()
        comes_back()
        waiting, after = set(actors), {}
        while True:
            now = time.monotonic()
            content = self.fleet.stored_since(mark) if waiting else b""
            for name in [name for name in waiting if name.encode() in content]:
                waiting.discard(name)
                after[name] = now - began
            rose = self.updates.rose_after(began, restarted=who == "learner" and "killed" in fault)
            if rose is not None:
                after["updates"] = rose - began
            reported = who != "evaluator" or self.fleet.last_report_at["evaluator"] > began
            if who == "evaluator" and reported:
                after["words"] = self.fleet.last_report_at["evaluator"] - began
            there = "killed" not in fault or self.arrivals.at[who] > began
            if not waiting and rose is not None and reported and there:
                break
            if now - began > _PATIENCE:
                raise SystemExit(f"the run does not recover\n{self.fleet.story(self.fleet.processes)}")
            time.sleep(_POLL)
        after["all"] = max(after.values())
        if "killed" in fault:
            after["there"] = self.arrivals.at[who] - began
        self.seconds[fault].append(after)
        print(f"{fault:28s}", "  ".join(f"{name} {value:6.2f}" for name, value in after.items()), flush=True)
        time.sleep(_CALM)


@contextlib.contextmanager
def whole_run(folder: Path, island: network.Network | None) -> Iterator[Fleet]:
    """All services running; with an island an actor and the router are in it. All end at the end."""
    command = Command(folder)
    port = free_address().rpartition(":")[2]
    address = f"tcp/{island.here if island else '127.0.0.1'}:{port}"
    settings = {**SETTINGS, "network.listen": address}
    words = [word for key, value in settings.items() for word in ("--set", f"{key}={value}")]
    fleet = Fleet(command, words, address)
    within = island.within if island else ()
    router = free_address()
    try:
        fleet.start_learner()
        fleet.start_client(NEAR, "actor", within=within)
        fleet.start(
            "router", "router", "--listen", router, "--connect", address, "--name", "router", within=within
        )
        fleet.start_client(DISTANT, "actor", router, within=within)
        if island is None:
            fleet.start_client("evaluator", "evaluator", router)
        yield fleet
    finally:
        command.end_all()


@contextlib.contextmanager
def at_work(fleet: Fleet) -> Iterator[Trial]:
    """Wait until all services work; end them at the end and check every chunk."""
    trial = Trial(fleet)
    with (
        fleet.watch() as session,
        PolicySubscriber(session, RUN, trial.updates.take),
        PresenceWatcher(session, RUN, trial.arrivals.take),
    ):
        fleet.await_storing(ACTORS, fleet.mark(), STARTING)
        if "evaluator" in fleet.processes:
            fleet.await_word("evaluator", STARTING)
        deadline = time.monotonic() + STARTING
        while trial.updates.rose_after(0.0, restarted=True) is None:
            if time.monotonic() > deadline:
                raise SystemExit(f"nothing is trained\n{fleet.story(['learner'])}")
            time.sleep(_POLL)
        time.sleep(_CALM)
        yield trial
        fleet.leave()


def faults_of_processes(rounds: int, pause: float) -> dict[str, list[dict[str, float]]]:
    """Kill and pause each service in turn."""
    with (
        tempfile.TemporaryDirectory() as folder,
        whole_run(Path(folder), None) as fleet,
        at_work(fleet) as trial,
    ):
        hit = {"learner": ACTORS, NEAR: (NEAR,), "router": (DISTANT,), "evaluator": ()}
        for _ in range(rounds):
            for name, actors in hit.items():
                trial.kill(name, actors)
            for libraries in _LIBRARIES:
                trial.load_alone(libraries)
        for name, actors in hit.items():
            trial.stand_still(name, actors, pause)
    return dict(trial.seconds)


def partition(cuts: Iterable[float]) -> dict[str, list[dict[str, float]]]:
    """Disconnect an actor and a router for each of these durations."""
    with (
        tempfile.TemporaryDirectory() as folder,
        network.Network() as island,
        whole_run(Path(folder), island) as fleet,
        at_work(fleet) as trial,
    ):
        for seconds in cuts:
            trial.cut(island, seconds)
    return dict(trial.seconds)


def _row(measured: list[dict[str, float]]) -> dict[str, float]:
    every = [after["all"] for after in measured]
    there = [after["there"] for after in measured if "there" in after]
    row = {"times": len(every), "median_s": statistics.median(every), "worst_s": max(every)}
    return row | ({"there_s": statistics.median(there)} if there else {})


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3, help="kills of each")
    parser.add_argument("--pause", type=float, default=30.0, help="seconds of a pause and of a cut network")
    parser.add_argument(
        "--cuts", type=float, nargs="+", help="only cut the network, for so many seconds each"
    )
    arguments = parser.parse_args()
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # an installation has its modules compiled
    reason = network.why_not()
    if reason and arguments.cuts:
        parser.error(f"no network can be cut: {reason}")
    seconds = {} if arguments.cuts else faults_of_processes(arguments.rounds, arguments.pause)
    if reason:
        print(f"no network is cut: {reason}")
    else:
        seconds |= partition(arguments.cuts or [arguments.pause])
    print("| fault | times | there again, s | continues after, s, median | worst |\n|---|---|---|---|---|")
    rows = {}
    for fault, measured in seconds.items():
        rows[fault] = row = _row(measured)
        there = f"{row['there_s']:.1f}" if "there_s" in row else ""
        print(f"| {fault} | {len(measured)} | {there} | {row['median_s']:.1f} | {row['worst_s']:.1f} |")
    rounded = {fault: {name: round(value, 2) for name, value in row.items()} for fault, row in rows.items()}
    print(json.dumps({"cores": os.cpu_count(), "load": round(os.getloadavg()[0], 1), "seconds": rounded}))


if __name__ == "__main__":
    main()
