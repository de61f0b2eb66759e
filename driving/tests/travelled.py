"""What tests let another process do with an environment that has come to it."""

from __future__ import annotations

import hashlib
from typing import Any

import gymnasium
import numpy as np


def drive_on(env: Any, decisions: int) -> str:
    """Drive an environment or a vector on from where it is; return a hash of everything that it answers.

    An episode that ends is followed by one with the environment's own random numbers, as are the actions.
    """
    digest = hashlib.sha256()
    for _ in range(decisions):
        observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        info.get("episode", {}).pop("t", None)  # the wall clock, of a wrapper that counts
        digest.update(observation["image"].tobytes() + observation["motion"].tobytes())
        digest.update(repr((reward, terminated, truncated, info)).encode())
        if isinstance(env, gymnasium.Env) and (terminated or truncated):
            digest.update(env.reset()[0]["image"].tobytes())
    return digest.hexdigest()


def same_moment(env: Any, other: Any) -> bool:
    """Whether two environments show the same scene, to the last bit."""
    scenes = [each.unwrapped.scene() for each in (env, other)]
    return all(
        np.array_equal(one, two, equal_nan=True) if isinstance(one, np.ndarray) else repr(one) == repr(two)
        for one, two in zip(*(vars(scene).values() for scene in scenes), strict=True)
    )
