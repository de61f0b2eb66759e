"""What it costs an actor to stream its experience: its own code, beside the same rollout without.

The actor is the real one, in this process: environments, perception, exploration, the planner's policy in
ONNX Runtime, chunks, upload. Its learner is a separate process which receives, logs and acknowledges chunks,
without training; it shares the machine. In turns the actor streams, and drives the same environments without
gathering, encoding or sending. The cost of a decision is given by thread: gathering is the part of the
driving thread, with a check of each chunk; the uploader's thread encodes, sends and reads answers; Zenoh's
own threads are the network. These are measured directly. Inference and simulation may become slower or faster
because of shared caches and cores: that is reported separately, as the difference between turns, which is far
less certain. Each figure is the median over many pairs of short turns, one of each kind directly after the
other, as other load on the machine varies. Check, encoding and, within that, compression are also measured
alone, on the sent chunks.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

from athrl.ports import free_address
from athrl.runs import declare_installed_planners
from athrl_actor.actor import ROLE, Actor
from athrl_actor.rollout import Rollout
from athrl_protocol import Chunk, RunFile, join_run, read_run_file
from athrl_protocol.codec.chunks import Identity, encode_checked
from athrl_protocol.codec.images import Compression, pack_images
from athrl_protocol.messages.chunk import check_chunk

RUN = "benchmark"
NAME = "streaming"
_PATIENCE = 60.0
_TURN_SECONDS = 0.5
_KINDS = ("driving", "upload", "network")


def learner(address: str, overrides: list[str], folder: str, policy: Path | None) -> None:
    """Run the learner until the input is closed: publish one policy, receive chunks."""
    from athrl.doctor.light_learner import WritingReceiver
    from athrl_learner import factories
    from athrl_planners import PolicyExporter
    from athrl_protocol import (
        ChunkIntake,
        PolicyPublisher,
        PolicyUpdate,
        announce_presence,
        open_session,
        serve_run_file,
    )

    declare_installed_planners()
    run_file = read_run_file(None, overrides)
    log = factories.make_log(run_file, Path(folder))
    untrained = factories.make_agent(run_file)
    artefact = policy.read_bytes() if policy else PolicyExporter(untrained).artefact()
    with (
        open_session(listen=address, timeout=_PATIENCE) as session,
        serve_run_file(session, run_file),
        announce_presence(session, RUN, "learner", "learner"),
        PolicyPublisher(session, RUN) as policies,
        ChunkIntake(session, RUN, WritingReceiver(log)),
    ):
        policies.publish(PolicyUpdate(0, artefact, False, 1.0, 0, 0, time.time()))
        print("ready", flush=True)
        sys.stdin.read()
    log.close()


@contextlib.contextmanager
def learner_process(overrides: list[str], policy: Path | None) -> Iterator[str]:
    """A learner in a separate process; yields its address."""
    address = free_address()
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "benchmarks.streaming", "--learner", address, "--folder", folder]
        command += ["--policy", str(policy)] if policy else []
        command += [word for override in overrides for word in ("--set", override)]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
            if process.stdout.readline() != b"ready\n":
                sys.exit("the learner could not be started")
            yield address
            process.stdin.close()
            process.wait(_PATIENCE)


class SilentRollout(Rollout):
    """Decides and drives; stores nothing while `silent`."""

    silent = False
    kept: list[Chunk]
    gathering: float
    """CPU seconds of this thread in gathering so far."""

    def _cut(self, *arguments: object) -> list[Chunk]:
        if self.silent:
            return []
        began = time.thread_time()
        chunks = super()._cut(*arguments)
        self.gathering += time.thread_time() - began
        self.kept = (self.kept + chunks)[-64:]
        return chunks


class Turn(NamedTuple):
    """Time of a decision in one turn, microseconds: by the clock, and CPU time by kind of thread."""

    decisions: int
    clock: float
    busy: dict[str, float]
    gathering: float

    @property
    def cpu(self) -> float:
        """CPU time in all threads."""
        return sum(self.busy.values())


def busy_by_thread(main: int, upload: int) -> Counter[str]:
    """CPU seconds of this process so far: driving, upload, network."""
    busy: Counter[str] = Counter()
    for task in Path("/proc/self/task").iterdir():
        with contextlib.suppress(OSError):  # it ended
            number, name = int(task.name), (task / "comm").read_text().strip()
            seconds = int((task / "schedstat").read_text().split()[0]) / 1e9
            if number == upload:
                kind = "upload"
            elif number != main and name.split("-")[0] in ("rx", "tx", "net", "acc", "app"):
                kind = "network"
            else:
                kind = "driving"
            busy[kind] += seconds
    return busy


class Measured:
    """An actor that streams or does not, and what that costs."""

    def __init__(self, actor: Actor) -> None:
        self._actor = actor
        rollout = actor._rollout
        rollout.__class__ = SilentRollout
        assert isinstance(rollout, SilentRollout)
        rollout.kept, rollout.gathering = [], 0.0
        self.rollout = rollout
        self._upload = actor._uploader._thread.native_id

    def warm_up(self) -> None:
        """Wait for the policy, compile, fill caches."""
        deadline = time.monotonic() + 10 * _PATIENCE
        while not self._actor._may_drive():
            if time.monotonic() > deadline:
                sys.exit("there came no policy")
            self._actor._adopt_newest_policy()
            time.sleep(0.01)
        self._drive(2.0)

    def turn(self, streaming: bool) -> Turn:
        """Drive for some seconds in one of the two ways."""
        main = threading.get_native_id()
        self._drive(0.1)  # both begin with full queues and warm caches
        if not streaming:
            self._actor._submit(self.rollout.flush())
            self._actor._uploader.flush(_PATIENCE)
        self.rollout.silent = not streaming
        self.rollout.gathering = 0.0
        before, began = busy_by_thread(main, self._upload), time.perf_counter()
        decisions = self._drive(_TURN_SECONDS)
        clock, after = time.perf_counter() - began, busy_by_thread(main, self._upload)
        gathering = 1e6 * self.rollout.gathering / decisions
        self.rollout.silent = False
        self.rollout.abandon(range(len(self.rollout)))  # what it drove in silence is no experience
        busy = {kind: 1e6 * (after[kind] - before[kind]) / decisions for kind in _KINDS}
        return Turn(decisions, 1e6 * clock / decisions, busy, gathering)

    def _drive(self, seconds: float) -> int:
        """The loop of `Actor.run`; how many decisions it made."""
        actor, steps = self._actor, 0
        until = time.perf_counter() + seconds
        while time.perf_counter() < until:
            actor._adopt_newest_policy()
            actor._report()
            if actor._may_drive():
                chunks = actor._drive()
                began = time.thread_time()
                actor._submit(chunks)
                self.rollout.gathering += time.thread_time() - began
                steps += 1
        return steps * len(self.rollout)


def cost_of(work: Callable[[Chunk], object], chunks: list[Chunk], seconds: float = 0.5) -> float:
    """Microseconds of work for a transition."""
    transitions, began = 0, time.process_time()
    while time.process_time() - began < seconds:
        for chunk in chunks:
            work(chunk)
            transitions += chunk.length
    return 1e6 * (time.process_time() - began) / transitions


def measure(run_file: RunFile, address: str, seconds: float) -> dict[str, float]:
    """Let an actor drive in both ways, in turns."""
    stop = threading.Event()
    with contextlib.ExitStack() as stack:
        joined = join_run(role=ROLE, connect=address, run=RUN, name=NAME, stop=stop, stack=stack)
        assert joined is not None
        actor = Actor(joined.session, run_file, NAME, stop, stack)
        measured = Measured(actor)
        measured.warm_up()
        turns = max(1, round(seconds / _TURN_SECONDS / 2))
        pairs = [(measured.turn(streaming=True), measured.turn(streaming=False)) for _ in range(turns)]
        chunks = measured.rollout.kept
        return {
            **compared(pairs),
            **alone(chunks, run_file.network.compression),
            "decisions": sum(streamed.decisions for streamed, _ in pairs),
            "decisions_per_chunk": statistics.mean(chunk.length for chunk in chunks),
            "chunks_resent": actor._uploader.statistics().resent,
        }


def compared(pairs: list[tuple[Turn, Turn]]) -> dict[str, float]:
    """What streaming costs, from pairs of a streaming and a silent turn."""

    def median(of: Callable[[Turn, Turn], float]) -> float:
        return statistics.median(of(streamed, silent) for streamed, silent in pairs)

    def more(kind: str) -> float:
        return median(lambda streamed, silent: streamed.busy[kind] - silent.busy[kind])

    def own(streamed: Turn, silent: Turn) -> float:
        return streamed.gathering + streamed.busy["upload"] + streamed.busy["network"] - idle(silent)

    def idle(silent: Turn) -> float:
        return silent.gathering + silent.busy["upload"] + silent.busy["network"]

    return {
        "driving_us": median(lambda _, silent: silent.cpu - idle(silent)),
        "streaming_us": median(own),
        "share_of_cpu": median(
            lambda streamed, silent: own(streamed, silent) / (own(streamed, silent) + silent.cpu)
        ),
        "gathering_us": median(lambda streamed, silent: streamed.gathering - silent.gathering),
        "upload_thread_us": more("upload"),
        "network_us": more("network"),
        "slower_beside_it_us": median(
            lambda streamed, silent: streamed.cpu - silent.cpu - own(streamed, silent)
        ),
        "clock_driving_us": median(lambda _, silent: silent.clock),
        "clock_streaming_us": median(lambda streamed, silent: streamed.clock - silent.clock),
        "share_of_clock": median(lambda streamed, silent: 1 - silent.clock / streamed.clock),
    }


def alone(chunks: list[Chunk], compression: Compression) -> dict[str, float]:
    """What can be measured without an actor, on chunks that it made."""

    def encoded(chunk: Chunk) -> bytes:
        return encode_checked(chunk, Identity.of(chunk), compression)

    transitions = sum(chunk.length for chunk in chunks)
    return {
        "checking_us": cost_of(check_chunk, chunks),
        "encoding_us": cost_of(encoded, chunks),
        "compression_us": cost_of(lambda chunk: pack_images(chunk.images, compression), chunks),
        "bytes_per_transition": sum(len(encoded(chunk)) for chunk in chunks) / transitions,
    }


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=30.0, help="of driving, in both ways together")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help="of the run file")
    parser.add_argument(
        "--policy", type=Path, help="drives instead of an untrained one, whose episodes are short"
    )
    parser.add_argument("--learner", help=argparse.SUPPRESS)
    parser.add_argument("--folder", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.learner:
        learner(arguments.learner, arguments.set, arguments.folder, arguments.policy)
        return
    overrides = [f"run.name={RUN}", "run.environment_steps=1000000000", *arguments.set]
    declare_installed_planners()
    run_file = read_run_file(None, overrides)
    load = os.getloadavg()[0]
    with learner_process(overrides, arguments.policy) as address:
        row = {name: round(value, 4) for name, value in measure(run_file, address, arguments.seconds).items()}
    for name, value in row.items():
        print(f"{name:24s} {value:12,.3f}")
    facts = {"cores": os.cpu_count(), "load": load, "environments": run_file.actor.environments}
    facts |= {"longest_chunk": run_file.longest_chunk, "compression": run_file.network.compression}
    print(json.dumps({**facts, **row}))


if __name__ == "__main__":
    main()
