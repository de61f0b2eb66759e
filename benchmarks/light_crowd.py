"""Many actors that drive nothing in one process, each with session, presence, metrics and uploader.

Arguments: address, name of the first, how many, chunks a second of each. Prints "loaded" once Python has
started, joins the run one by one when it reads a line, and then prints the seconds of a core for that. Starts
to send when it reads another line, and ends when its input is closed; then it prints a JSON object with the
seconds of acknowledgements and the counts of chunks.
"""

from __future__ import annotations

import json
import random
import resource
import sys
import threading
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any

from athrl_protocol import (
    Chunk,
    ChunkUploader,
    MetricsPublisher,
    StateSubscriber,
    join_run,
    new_incarnation,
)

from benchmarks.experience import synthetic_chunk

RUN = "benchmark"
STEPS = 10
_PATIENCE = 60.0
_METRICS_SECONDS = 1.0
_LOOK_SECONDS = 0.04  # resolution of the time of an acknowledgement
_ROLE = "actor"


def resident_mebibytes() -> float:
    """Memory of this process that is not swapped out."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


class LightActor:
    """Sends a chunk every `period` seconds, once the one before is acknowledged."""

    def __init__(self, address: str, name: str, period: float, stack: ExitStack) -> None:
        joined = join_run(
            role=_ROLE, connect=address, run=RUN, name=name, stop=threading.Event(), stack=stack
        )
        assert joined is not None
        session = joined.session
        self.waits: list[float] = []
        self._period = period
        self._due = self._reported_at = self._sent_at = 0.0
        self._waiting = False
        stack.enter_context(StateSubscriber(session, RUN))
        self._metrics = stack.enter_context(MetricsPublisher(session, RUN, _ROLE, name))
        self.uploader = stack.enter_context(ChunkUploader(session, RUN, name, new_incarnation(), capacity=64))

    def look(self, now: float, chunk: Chunk) -> None:
        """Do what is due."""
        if self._waiting and not self.uploader.statistics().waiting:
            self._waiting = False
            self.waits.append(time.monotonic() - self._sent_at)
        if not self._waiting and now >= self._due:
            self._sent_at = time.monotonic()
            self._waiting = self.uploader.submit(chunk, 0.0)
            # Not all at once, as episodes end at different times.
            self._due = now + random.uniform(0.5, 1.5) * self._period
        if now - self._reported_at >= _METRICS_SECONDS:
            self._metrics.publish({"chunks_acknowledged": self.uploader.statistics().acknowledged})
            self._reported_at = now


def main(address: str, first: str, count: str, chunks_per_second: str) -> None:
    """Join, wait for the signal, send."""
    # Threads that wait for the interpreter request it at this interval; hundreds would do nothing else.
    sys.setswitchinterval(0.1)
    chunk, stop = synthetic_chunk(STEPS), threading.Event()
    print("loaded", flush=True)
    sys.stdin.readline()
    busy = time.process_time()
    with ExitStack() as stack:
        names = range(int(first), int(first) + int(count))
        actors = [
            LightActor(address, f"actor-{number}", 1 / float(chunks_per_second), stack) for number in names
        ]
        print(time.process_time() - busy, flush=True)
        sys.stdin.readline()
        busy = time.process_time()
        threading.Thread(target=lambda: (sys.stdin.read(), stop.set()), daemon=True).start()
        while not stop.wait(_LOOK_SECONDS):
            for actor in actors:
                actor.look(time.monotonic(), chunk)
        busy = time.process_time() - busy
        print(json.dumps(report(actors, busy)), flush=True)


def report(actors: list[LightActor], busy: float) -> dict[str, Any]:
    """Counts of the actors' chunks, and costs."""
    counts: Counter[str] = Counter()
    for actor in actors:
        actor.uploader.flush(_PATIENCE)
        statistics = asdict(actor.uploader.statistics())
        statistics.pop("given_up_by_reason")
        counts.update(statistics)
    return {
        "busy": busy,
        "mebibytes": resident_mebibytes(),
        "waits": [round(wait, 4) for actor in actors for wait in actor.waits],
        **counts,
    }


if __name__ == "__main__":
    main(*sys.argv[1:])
