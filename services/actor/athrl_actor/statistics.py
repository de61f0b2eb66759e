"""How the driving goes: what an actor says about itself each second."""

from __future__ import annotations

import time
from collections import deque

import numpy as np

EPISODES = 20  # over which returns and collisions are averaged


class DrivingStatistics:
    """Counts decisions and episodes."""

    def __init__(self) -> None:
        self._decisions = 0
        self._episodes = 0
        self._returns: deque[float] = deque(maxlen=EPISODES)
        self._collisions: deque[bool] = deque(maxlen=EPISODES)
        self._speeds: list[float] = []
        self._decisions_before = 0
        self._reported_at = time.monotonic()

    def decided(self, speed: float) -> None:
        """One environment carried out a decision; `speed` is its mean over the decision, m/s."""
        self._decisions += 1
        self._speeds.append(speed)

    def episode_ended(self, episode_return: float, collision: bool) -> None:
        """One episode is over."""
        self._episodes += 1
        self._returns.append(episode_return)
        self._collisions.append(collision)

    def report(self) -> dict[str, float]:
        """The values since the last report; what there is nothing to say about yet is left out."""
        now = time.monotonic()
        seconds = max(1e-9, now - self._reported_at)
        values: dict[str, float] = {
            "decisions": self._decisions,
            "decisions_per_second": (self._decisions - self._decisions_before) / seconds,
            "episodes": self._episodes,
        }
        if self._speeds:
            values["speed"] = float(np.mean(self._speeds))
        if self._returns:
            values["return_mean"] = float(np.mean(self._returns))
            values["collision_rate"] = float(np.mean(self._collisions))
        self._speeds.clear()
        self._decisions_before, self._reported_at = self._decisions, now
        return values
