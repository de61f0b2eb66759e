"""How fast a chunk is encoded and decoded, beside the same arrays as compressed npz, in one process.

The images are those of a real episode, so they compress as they do in a run.
"""

from __future__ import annotations

import argparse
import io
import json
import time
from collections.abc import Callable

import athrl_driving  # noqa: F401  (importing it registers the towns)
import gymnasium
import numpy as np
from athrl_protocol import Chunk, LevelColumns, decode_chunk, encode_chunk
from athrl_protocol.codec.images import Compression

COMPRESSIONS: tuple[Compression, ...] = ("lz4", "zstd", "none")


def real_chunk(steps: int) -> Chunk:
    """A chunk of an episode at the town's middle target speed."""
    environment = gymnasium.make("athrl/Town03-v0", config={"episode_ticks": 10 * steps})
    observation, _ = environment.reset(seed=1)
    observations = [observation]
    while len(observations) <= steps:
        observation, _, terminated, truncated, _ = environment.step(np.zeros(2, np.float32))
        observations.append(observation)
        if terminated or truncated:
            observation, _ = environment.reset(seed=len(observations))
    zeros = np.zeros(steps, np.float32)
    return Chunk(
        actor="benchmark",
        incarnation=1,
        sequence=0,
        environment=0,
        episode_seed=1,
        first_step=0,
        length=steps,
        state_interval=steps,
        images=np.stack([observation["image"] for observation in observations]),
        motion=np.stack([observation["motion"] for observation in observations]),
        levels={
            "intention": LevelColumns(
                np.zeros((steps, 1), np.float32), zeros, np.zeros((1, 128), np.float32)
            ),
            "trajectory": LevelColumns(
                np.zeros((steps, 2), np.float32), zeros, np.zeros((1, 128), np.float32)
            ),
        },
        policy_version=np.zeros(steps, np.int64),
        terminated=False,
        truncated=False,
    )


def there_and_back(chunk: Chunk, compression: Compression) -> int:
    """Encode and decode as a run does; returns the bytes."""
    encoded = encode_chunk(chunk, compression)
    decode_chunk(encoded)
    return len(encoded)


def there_and_back_npz(chunk: Chunk) -> int:
    """The same columns as npz; returns the bytes."""
    file = io.BytesIO()
    columns = {"images": chunk.images, "motion": chunk.motion, "policy_version": chunk.policy_version}
    for name, level in chunk.levels.items():
        columns |= {f"{name}/{column}": values for column, values in vars(level).items()}
    np.savez_compressed(file, **columns)
    size = file.tell()
    file.seek(0)
    with np.load(file, allow_pickle=False) as archive:
        for name in archive.files:
            archive[name]
    return size


def rate(function: Callable[[Chunk], int], chunk: Chunk, seconds: float) -> float:
    """Transitions a CPU second."""
    count, began = 0, time.process_time()
    while time.process_time() - began < seconds:
        function(chunk)
        count += chunk.length
    return count / (time.process_time() - began)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=10, help="length of a chunk")
    parser.add_argument("--seconds", type=float, default=10.0, help="CPU seconds in all")
    arguments = parser.parse_args()

    chunk = real_chunk(arguments.steps)
    seconds = arguments.seconds / (len(COMPRESSIONS) + 1)
    npz = rate(there_and_back_npz, chunk, seconds)
    print(f"{arguments.steps} steps as npz: {there_and_back_npz(chunk)} bytes, {npz:.0f} transitions/s")
    rows = []
    for compression in COMPRESSIONS:

        def ours(chunk: Chunk, compression: Compression = compression) -> int:
            return there_and_back(chunk, compression)

        row = {"bytes": ours(chunk), "transitions": round(rate(ours, chunk, seconds))}
        rows.append({"compression": compression, **row, "ratio": round(row["transitions"] / npz, 1)})
        print(f"{compression:5s} {row['bytes']:7d} bytes, {row['transitions']:9d} transitions/s")
    print(json.dumps({"steps": arguments.steps, "npz": round(npz), "rows": rows}))


if __name__ == "__main__":
    main()
