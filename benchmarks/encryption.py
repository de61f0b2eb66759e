"""What encryption and the access list cost on the way of a chunk: actor's uploader to learner's intake.

    python -m benchmarks.encryption --seconds 5

Actors are processes of their own that upload as fast as the learner acknowledges. Rounds of plain TCP, of TLS
of both sides with the access list, and of that with the log of refusals (as `athrl learner` has it) follow
each other, so that a busy machine is busy for all; the medians and their ratios to plain TCP are printed, in
the last line as one JSON object.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import queue
import statistics
import sys
import tempfile
import threading
import time
from contextlib import nullcontext
from multiprocessing.queues import Queue
from pathlib import Path

import numpy as np
from athrl.certificates import make_all
from athrl.ports import free_address
from athrl_protocol import Chunk, ChunkIntake, ChunkUploader, LevelColumns, new_incarnation, open_session
from athrl_protocol.faults.zenoh_refusals import refusals_logged

TIME, SIZE = 10, 32
RUN = "benchmark"
JOINED_WITHIN = 60.0
MEASURED_WITHIN = 120.0  # beside the seconds of the measurement
KINDS = ("plain", "encrypted", "encrypted, refusals logged")


def chunk() -> Chunk:
    """Return a chunk of the default size, with a picture that compresses about as a bird's eye view does."""
    random = np.random.default_rng(0)

    def floats(*shape: int) -> np.ndarray:
        return random.standard_normal(shape).astype(np.float32)

    images = np.kron(
        random.integers(0, 2, (TIME + 1, SIZE // 4, SIZE // 4, 4), dtype=np.uint8),
        np.ones((1, 4, 4, 1), np.uint8),
    )
    return Chunk(
        actor="unset",
        incarnation=0,
        sequence=0,
        environment=0,
        episode_seed=1,
        first_step=0,
        length=TIME,
        state_interval=TIME,
        images=images * np.uint8(255),
        motion=floats(TIME + 1, 2),
        levels={
            "intention": LevelColumns(floats(TIME, 1), floats(TIME), floats(1, 128)),
            "trajectory": LevelColumns(floats(TIME, 2), floats(TIME), floats(1, 128)),
        },
        policy_version=np.zeros(TIME, np.int64),
        terminated=False,
        truncated=False,
    )


def upload(address: str, certificates: str | None, name: str, stop: threading.Event, cpu: Queue) -> None:
    """Upload until told to stop; the body of an actor's process."""
    made = chunk()
    with (
        open_session(connect=address, timeout=30, role="actor", certificates=certificates) as session,
        ChunkUploader(session, RUN, name, new_incarnation(), capacity=64) as uploader,
    ):
        began = time.process_time()
        while not stop.is_set():
            uploader.submit(made, timeout=0.2)
        cpu.put((time.process_time() - began) / max(1, uploader.statistics().acknowledged))


def measure(kind: str, certificates: Path, actors: int, seconds: float) -> tuple[float, float]:
    """Return transitions a second, and CPU seconds of learner and actors for a thousand chunks."""
    address = free_address().removeprefix("tcp/")  # TLS where there are certificates
    folder = None if kind == "plain" else str(certificates)
    context = multiprocessing.get_context("spawn")
    stop, cpu = context.Event(), context.Queue()
    logged = refusals_logged() if kind.endswith("logged") else nullcontext()
    with (
        logged,
        open_session(
            listen=address, timeout=30, run=RUN, certificates=folder, largest_chunk=2**18
        ) as session,
        ChunkIntake(session, RUN, lambda taken: None) as intake,
    ):
        processes = [
            context.Process(target=upload, args=(address, folder, f"actor-{number}", stop, cpu))
            for number in range(actors)
        ]
        for process in processes:
            process.start()
        deadline = time.monotonic() + JOINED_WITHIN
        while intake.statistics().active_actors < actors:
            if time.monotonic() > deadline:
                stop.set()
                sys.exit(f"{kind}: not all of {actors} actors sent anything within {JOINED_WITHIN:g} s")
            time.sleep(0.05)
        time.sleep(0.5)
        before, began, used = intake.statistics(), time.monotonic(), time.process_time()
        time.sleep(seconds)
        after, elapsed = intake.statistics(), time.monotonic() - began
        used = time.process_time() - used
        stop.set()
        of_actors = sum(cpu.get(timeout=30) for _ in processes) / actors
        for process in processes:
            process.join(timeout=30)
    chunks = after.chunks - before.chunks
    return (after.transitions - before.transitions) / elapsed, 1000 * (used / max(1, chunks) + of_actors)


def _measure_alone(arguments: tuple[str, Path, int, float], results: Queue) -> None:
    results.put(measure(*arguments))


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--actors", type=int, default=2)
    arguments = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    context = multiprocessing.get_context("spawn")
    found: dict[str, list[tuple[float, float]]] = {kind: [] for kind in KINDS}
    with tempfile.TemporaryDirectory() as folder:
        certificates = Path(folder) / "certificates"
        make_all(certificates, ["127.0.0.1"], days=2)
        for _ in range(arguments.rounds):
            for kind in KINDS:
                # A process for each: Zenoh's log stays switched on in the one that has it.
                results = context.Queue()
                what = (kind, certificates, arguments.actors, arguments.seconds)
                process = context.Process(target=_measure_alone, args=(what, results))
                process.start()
                try:
                    found[kind].append(results.get(timeout=MEASURED_WITHIN + arguments.seconds))
                except queue.Empty:
                    process.kill()
                    sys.exit(f"{kind}: no figures within {MEASURED_WITHIN + arguments.seconds:g} s")
                process.join(timeout=30)
    rates = {kind: statistics.median(rate for rate, _ in each) for kind, each in found.items()}
    costs = {kind: statistics.median(cost for _, cost in each) for kind, each in found.items()}
    for kind in KINDS:
        print(
            f"{kind:28s} {rates[kind]:9,.0f} transitions/s ({rates[kind] / rates['plain']:.2f} of plain)  "
            f"{costs[kind]:6.3f} CPU s per 1,000 chunks ({costs[kind] / costs['plain']:.2f} of plain)"
        )
    rows = {
        kind: {
            "transitions_per_second": round(rates[kind]),
            "of_plain": round(rates[kind] / rates["plain"], 2),
            "cpu_seconds_per_1000_chunks": round(costs[kind], 3),
            "cost_of_plain": round(costs[kind] / costs["plain"], 2),
        }
        for kind in KINDS
    }
    print(json.dumps({"cores": os.cpu_count(), "actors": arguments.actors, "rows": rows}))


if __name__ == "__main__":
    main()
