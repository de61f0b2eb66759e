"""An actor that drives nothing: sends ready-made chunks as fast as the learner takes them.

Arguments: address, name, decisions in a chunk (else 64). Prints "ready" when it is connected, sends
until its input is closed, and then prints a JSON object with the seconds of a core and the counts of its
chunks.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from dataclasses import asdict

from athrl_protocol import ChunkUploader, new_incarnation, open_session

from benchmarks.experience import synthetic_chunk

RUN = "benchmark"
STEPS = 64
_PATIENCE = 60.0
#: Prepared chunks, so that only the learner is measured.
_READY = 8


def main(address: str, name: str, steps: str = str(STEPS)) -> None:
    """Send until the input is closed."""
    chunks = [synthetic_chunk(int(steps), seed=seed) for seed in range(_READY)]
    stop = threading.Event()
    with (
        open_session(connect=address, timeout=_PATIENCE) as session,
        ChunkUploader(session, RUN, name, new_incarnation(), capacity=64) as uploader,
    ):
        print("ready", flush=True)
        threading.Thread(target=lambda: (sys.stdin.read(), stop.set()), daemon=True).start()
        sent, busy = 0, time.process_time()
        while not stop.is_set():
            sent += uploader.submit(chunks[sent % _READY], timeout=0.1)
        busy = time.process_time() - busy
        uploader.flush(_PATIENCE)
        print(json.dumps({"busy": busy, **asdict(uploader.statistics())}), flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
