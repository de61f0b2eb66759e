"""How the driving goes: what an actor says about itself each second."""

from __future__ import annotations

import time
from collections import defaultdict, deque
from pathlib import PurePath

import numpy as np
from numpy.typing import NDArray

EPISODES = 20  # over which returns and collisions are averaged


class _Episodes:
    """The last episodes, in all towns or in one."""

    def __init__(self) -> None:
        self._returns: deque[float] = deque(maxlen=EPISODES)
        self._collisions: deque[bool] = deque(maxlen=EPISODES)

    def add(self, episode_return: float, collision: bool) -> None:
        self._returns.append(episode_return)
        self._collisions.append(collision)

    def report(self) -> dict[str, float]:
        if not self._returns:
            return {}
        return {
            "return_mean": float(np.mean(self._returns)),
            "collision_rate": float(np.mean(self._collisions)),
        }


class DrivingStatistics:
    """Counts decisions and episodes."""

    def __init__(self) -> None:
        self._decisions = 0
        self._ended = 0
        self._episodes = _Episodes()
        self._by_town: defaultdict[str, _Episodes] = defaultdict(_Episodes)
        self._speeds: list[float] = []
        self._decisions_before = 0
        self._reported_at = time.monotonic()

    def decided(self, speeds: NDArray[np.floating]) -> None:
        """Each environment carried out a decision; `speeds` [environments] are means over it, m/s."""
        self._decisions += len(speeds)
        self._speeds.append(float(speeds.mean()))

    def episode_ended(self, town: str, episode_return: float, collision: bool) -> None:
        """One episode is over."""
        self._ended += 1
        self._episodes.add(episode_return, collision)
        self._by_town[PurePath(town).stem].add(episode_return, collision)

    def report(self) -> dict[str, float]:
        """The values since the last report; what there is nothing to say about yet is left out.

        In several towns, returns and collisions are told of each as well, such as `return_mean/town04`.
        """
        now = time.monotonic()
        seconds = max(1e-9, now - self._reported_at)
        values: dict[str, float] = {
            "decisions": self._decisions,
            "decisions_per_second": (self._decisions - self._decisions_before) / seconds,
            "episodes": self._ended,
        }
        if self._speeds:
            values["speed"] = float(np.mean(self._speeds))
        values |= self._episodes.report()
        if len(self._by_town) > 1:
            for town, episodes in self._by_town.items():
                values |= {f"{name}/{town}": value for name, value in episodes.report().items()}
        self._speeds.clear()
        self._decisions_before, self._reported_at = self._decisions, now
        return values
