"""The episodes of a batch of environments: begins them, drives them on several threads, tells about them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..compilation import announce_compilation
from ..maps import Town
from ..metrics import summary
from ..reward import REWARD_TERMS
from ..route import dead_end_distance
from ..traffic.spawn import place_vehicles
from .beginning import begin
from .drive import SEE, drive
from .ego import EGO_LENGTH, X, Y
from .state import DriveSettings, EpisodeState, new_state

CLEARANCE = 8.0
"""No vehicle's centre is within this distance (m) of the ego's when an episode begins."""

ROOM_BEFORE_DEAD_END = 70.0
"""Metres before the end of a lane that the ego needs for changing to another one."""

ROWS_PER_THREAD = 4
"""Environments below which another thread costs more than it brings."""

_COMPILE_SECONDS = 30
_RANDOM_TURNS = np.empty(0, dtype=np.int64)


class Episodes:
    """E episodes of one town; `state` holds their arrays.

    What happens in an environment depends on its seed and its actions alone: not on the others, on how many
    there are or on the number of threads.
    """

    def __init__(
        self,
        town: Town,
        settings: DriveSettings,
        environments: int,
        *,
        vehicles: int,
        image_size: int,
        threads: int = 1,
    ) -> None:
        announce_compilation(drive, _COMPILE_SECONDS)
        self.town = town
        self.state: EpisodeState = new_state(town, settings, environments, vehicles, image_size)
        self._everything = np.empty(environments, np.int64)
        self._no_actions = np.zeros((environments, 2), np.float32)
        self._starts = _Starts(town)
        threads = max(1, min(threads, environments // ROWS_PER_THREAD))
        edges = [environments * chunk // threads for chunk in range(threads + 1)]
        self._chunks = list(itertools.pairwise(edges))
        self._pool = ThreadPoolExecutor(threads - 1, "athrl-drive") if threads > 1 else None

    def __len__(self) -> int:
        return self._everything.size

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()

    def begin(self, e: int, generator: np.random.Generator) -> None:
        """Begin an episode in environment `e`; what is drawn comes from `generator` alone.

        The observation is drawn by the next work that has SEE. Raises ValueError where the town has no room
        for the vehicles.
        """
        place = generator.random()
        # Seeds for each part, so that the ego's route does not depend on how much traffic there is.
        route_seed, traffic_seed = generator.integers(2**63, size=2, dtype=np.uint64)
        row, s = self._starts.at(place)
        state = self.state
        parts = state.settings, state.traffic.graph, state.routes, state.metrics, state.progress
        begin(*parts, e, row, s, route_seed, _RANDOM_TURNS, 0.0)
        ego = state.progress.ego[e]
        place_vehicles(
            state.traffic, e, np.random.default_rng(traffic_seed), (ego[X], ego[Y]), CLEARANCE, ego
        )

    def see(self, rows: NDArray[np.int64]) -> None:
        """Draw the observations of some environments."""
        work = self._everything
        work[:] = 0
        work[rows] = SEE
        self.work(self._no_actions, work)

    def work(self, actions: NDArray[np.float32], work: NDArray[np.int64]) -> None:
        """Do what `work` int64 [E] says (see `episode.drive`) with `actions` float32 [E, 2]."""
        if self._pool is None:
            drive(*self.state, actions, work, 0, len(self))
            return
        others = [
            self._pool.submit(drive, *self.state, actions, work, first, last)
            for first, last in self._chunks[1:]
        ]
        drive(*self.state, actions, work, *self._chunks[0])
        wait(others)
        for other in others:
            other.result()

    def info(self, e: int) -> dict[str, Any]:
        """The last decision's reward terms, mean speed (m/s) and ticks, the episode's metres and its end.

        At the end of an episode there are also its `metrics`.
        """
        state = self.state.progress
        metrics = {"metrics": self.summary(e)} if state.terminated[e] or state.truncated[e] else {}
        return {
            "reward_terms": dict(zip(REWARD_TERMS, state.terms[e].tolist(), strict=True)),
            "speed": float(state.speed[e]),
            "distance": float(state.distance[e]),
            "collision": bool(state.collision[e]),
            "off_lane": bool(state.off_lane[e]),
            "ticks": int(state.decision_ticks[e]),
            **metrics,
        }

    def infos(self, rows: NDArray[np.bool_]) -> dict[str, Any]:
        """What `info` tells of the environments of `rows` bool [E], in gymnasium's vector format.

        The others have zeros, and each entry has its own mask, named with an underscore before it.
        """
        state = self.state.progress
        columns = {
            "speed": state.speed,
            "distance": state.distance,
            "collision": state.collision != 0,
            "off_lane": state.off_lane,
            "ticks": state.decision_ticks,
        }
        terms = {name: state.terms[:, place] for place, name in enumerate(REWARD_TERMS)}
        return {**_masked(columns, rows), "reward_terms": _masked(terms, rows), "_reward_terms": rows.copy()}

    def summary(self, e: int) -> dict[str, float]:
        """The metrics of an environment's episode, as docs/metrics.md explains them."""
        return summary(self.state.metrics, e, truncated=bool(self.state.progress.truncated[e]))


def _masked(columns: Mapping[str, NDArray], rows: NDArray[np.bool_]) -> dict[str, NDArray]:
    masked = {}
    for name, column in columns.items():
        masked[name] = column.copy()
        masked[name][~rows] = 0
        masked[f"_{name}"] = rows.copy()
    return masked


class _Starts:
    """Where an ego may start: anywhere on an ordinary lane, a car's length from its ends.

    Not where the lane is about to end: the ego needs room to change to the one beside it.
    """

    def __init__(self, town: Town) -> None:
        graph = town.graph
        before_end = np.minimum(graph.length - EGO_LENGTH, dead_end_distance(graph) - ROOM_BEFORE_DEAD_END)
        room = np.where(graph.junction < 0, np.maximum(before_end - EGO_LENGTH, 0.0), 0.0)
        self._ends = np.cumsum(room)

    def at(self, share: float) -> tuple[int, float]:
        """The row and the metres along it at a share, 0 to 1, of all places."""
        place = share * self._ends[-1]
        row = int(np.searchsorted(self._ends, place, side="right"))
        before = self._ends[row - 1] if row else 0.0
        return row, EGO_LENGTH + float(place - before)
