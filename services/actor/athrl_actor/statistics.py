"""Driving statistics that an actor reports each second."""

from __future__ import annotations

from collections import defaultdict, deque
from pathlib import PurePath

import numpy as np
from athrl_protocol.announcements.recent_rate import RecentRate
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
    """Counts decisions and episodes, and averages over them."""

    def __init__(self) -> None:
        self._decisions = 0
        self._ended = 0
        self._episodes = _Episodes()
        self._by_town: defaultdict[str, _Episodes] = defaultdict(_Episodes)
        self._speeds: list[float] = []
        self._rate = RecentRate()
        self._rate.note(0)

    def decided(self, speeds: NDArray[np.floating]) -> None:
        """Count a decision of each environment; `speeds` [environments] are means over the decision, m/s."""
        self._decisions += len(speeds)
        self._speeds.append(float(speeds.mean()))

    def episode_ended(self, town: str, episode_return: float, collision: bool) -> None:
        """Count an episode that has ended."""
        self._ended += 1
        self._episodes.add(episode_return, collision)
        self._by_town[PurePath(town).stem].add(episode_return, collision)

    def report(self) -> dict[str, float]:
        """The present values; those that are not known yet are left out.

        The rate is that of the last minute, the speed that since the last report.

        With several towns, returns and collisions are also reported by town, such as `return_mean/town04`.
        """
        self._rate.note(self._decisions)
        values: dict[str, float] = {
            "decisions": self._decisions,
            "decisions_per_second": self._rate.per_second() or 0.0,
            "episodes": self._ended,
        }
        if self._speeds:
            values["speed"] = float(np.mean(self._speeds))
        values |= self._episodes.report()
        if len(self._by_town) > 1:
            for town, episodes in self._by_town.items():
                values |= {f"{name}/{town}": value for name, value in episodes.report().items()}
        self._speeds.clear()
        return values
