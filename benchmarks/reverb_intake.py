"""How much a dm-reverb server receives from 1, 4 and 16 writers, for comparison with `benchmarks.intake`.

dm-reverb needs versions of TensorFlow and NumPy that conflict with the rest, so it has its own environment:

    python3.11 -m venv reverb && reverb/bin/pip install "dm-reverb[tensorflow]==0.14.0"
    reverb/bin/python -m benchmarks.reverb_intake

The same columns in the same sizes: a whole chunk is one step of an item, which is what costs Reverb least. It
holds items in memory and writes nothing to a disk.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time

import numpy as np

_STEPS = 64
_READY = 8
_TABLE = "experience"


def columns(seed: int) -> dict[str, np.ndarray]:
    """A chunk's columns; the image is the one of `benchmarks.experience`."""
    random = np.random.default_rng(seed)
    images = np.zeros((_STEPS + 1, 32, 32, 4), np.uint8)
    for image in images:
        left, right = np.sort(random.integers(0, 32, 2))
        image[:, left : right + 1, 0] = 255
        image[:, (left + right) // 2, 1] = 255
        for row, column in random.integers(0, 29, (6, 2)):
            image[row : row + 3, column : column + 2, 2] = 255
        image[..., 3] = random.integers(0, 256, (32, 1), dtype=np.uint8)
    return {
        "images": images,
        "motion": random.normal(size=(_STEPS + 1, 2)).astype(np.float32),
        "actions": random.normal(size=(_STEPS, 3)).astype(np.float32),
        "rewards": random.normal(size=(_STEPS, 2)).astype(np.float32),
        "states": random.normal(size=256).astype(np.float32),
        "policy_version": np.zeros(_STEPS, np.int64),
    }


def write(port: str) -> None:
    """Write until the input is closed."""
    import threading

    import reverb

    chunks = [columns(seed) for seed in range(_READY)]
    stop = threading.Event()
    print("ready", flush=True)
    threading.Thread(target=lambda: (sys.stdin.read(), stop.set()), daemon=True).start()
    with reverb.Client(f"localhost:{port}").trajectory_writer(num_keep_alive_refs=1) as writer:
        sent = 0
        while not stop.is_set():
            writer.append(chunks[sent % _READY])
            trajectory = {name: column[-1:] for name, column in writer.history.items()}
            writer.create_item(_TABLE, priority=1.0, trajectory=trajectory)
            writer.flush(block_until_num_items=8)  # as many may be in flight as in our window
            sent += 1


def rate(writers: int, seconds: float) -> float:
    """Transitions a second that the server receives."""
    import reverb

    table = reverb.Table(
        _TABLE, reverb.selectors.Uniform(), reverb.selectors.Fifo(), 1600, reverb.rate_limiters.MinSize(1)
    )
    server = reverb.Server([table])
    command = [sys.executable, "-m", "benchmarks.reverb_intake", "--write", str(server.port)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    processes = [subprocess.Popen(command, **pipes) for _ in range(writers)]
    for process in processes:
        process.stdout.readline()
    time.sleep(1.0)

    def inserted() -> int:
        return server.localhost_client().server_info()[_TABLE].rate_limiter_info.insert_stats.completed

    before, began = inserted(), time.perf_counter()
    time.sleep(seconds)
    taken = (inserted() - before) * _STEPS / (time.perf_counter() - began)
    for process in processes:
        process.stdin.close()
    for process in processes:
        process.wait(60)
    server.stop()
    return taken


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--writers", type=int, nargs="+", default=[1, 4, 16])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--write", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.write is not None:
        write(arguments.write)
        return
    rows = []
    for writers in arguments.writers:
        taken = rate(writers, arguments.seconds)
        rows.append({"writers": writers, "transitions_per_second": round(taken)})
        print(f"{writers:3d} writers: {taken:9,.0f} transitions/s")
    print(json.dumps({"cores": os.cpu_count(), "rows": rows}))


if __name__ == "__main__":
    main()
