"""How threads of torch should wait for each other: `python -m benchmarks.peers.waiting` measures one way.

By default they spin, which suits idle cores. If other threads need a core, such as the environments'
threads, it is kept from them, and an update may take ten times as long. The peers get the way that is faster
on this machine as it is.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

VARIABLE = "OMP_WAIT_POLICY"
UPDATES = 10
BATCH = 512
ROOT = Path(__file__).parents[2]


def faster_waiting(cores: int) -> dict[str, str]:
    """The environment variables under which torch trains faster on so many cores; empty: as it is."""
    if cores == 1 or VARIABLE in os.environ:
        return {}
    ways: list[dict[str, str]] = [{}, {VARIABLE: "PASSIVE"}]
    return min(ways, key=lambda way: _seconds(cores, way))


def _seconds(cores: int, way: dict[str, str]) -> float:
    """Seconds of the updates in a separate process."""
    environment = {**os.environ, "OMP_NUM_THREADS": str(cores), **way}
    command = [sys.executable, "-m", "benchmarks.peers.waiting"]
    return float(subprocess.check_output(command, cwd=ROOT, env=environment, text=True))


def main() -> None:
    """Print how many seconds some updates of the peers' network take in this process."""
    import torch

    from benchmarks.peers.network import Encoder

    encoder = Encoder().to(memory_format=torch.channels_last)
    images, motion = torch.rand(BATCH, 4, 32, 32), torch.rand(BATCH, 2)
    for update in range(2 * UPDATES):
        if update == UPDATES:  # the first half warms up
            began = time.perf_counter()
        encoder(images, motion).mean().backward()
    print(time.perf_counter() - began)


if __name__ == "__main__":
    main()
