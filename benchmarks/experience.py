"""Chunks of a made-up drive, for benchmarks that need many of them and no simulator."""

from __future__ import annotations

import dataclasses

import numpy as np
from athrl_protocol import Chunk, LevelColumns


def synthetic_chunk(steps: int, *, image_size: int = 32, seed: int = 0) -> Chunk:
    """A chunk of `steps` decisions of the default planner, which remembers nothing.

    There are a road and a few vehicles in the image, everything else is random.
    """
    random = np.random.default_rng(seed)
    levels = {
        "intention": random.uniform(0, 2, (steps, 1)),
        "trajectory": np.stack([random.uniform(0, 7.9, steps), random.uniform(-0.5, 0.5, steps)], axis=1),
    }
    return Chunk(
        actor="benchmark",
        incarnation=1,
        sequence=0,
        environment=0,
        episode_seed=seed,
        first_step=0,
        length=steps,
        state_interval=steps,
        images=np.stack([_image(random, image_size) for _ in range(steps + 1)]),
        motion=random.uniform(-1, 1, (steps + 1, 2)).astype(np.float32),
        levels={
            name: LevelColumns(
                actions.astype(np.float32),
                random.normal(size=steps).astype(np.float32),
                np.zeros((1, 0), np.float32),
            )
            for name, actions in levels.items()
        },
        policy_version=np.zeros(steps, np.int64),
        terminated=False,
        truncated=False,
    )


def numbered(chunk: Chunk, sequence: int) -> Chunk:
    """The same chunk under another number."""
    return dataclasses.replace(chunk, sequence=sequence)


def _image(random: np.random.Generator, size: int) -> np.ndarray:
    image = np.zeros((size, size, 4), np.uint8)
    left, right = np.sort(random.integers(0, size, 2))
    image[:, left : right + 1, 0] = 255  # the road
    image[:, (left + right) // 2, 1] = 255  # the route
    for row, column in random.integers(0, size - 3, (6, 2)):
        image[row : row + 3, column : column + 2, 2] = 255  # vehicles
    image[..., 3] = random.integers(0, 256, (size, 1), dtype=np.uint8)  # lidar
    return image
