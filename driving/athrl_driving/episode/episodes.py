"""The episodes of a batch of environments: begins them, drives them on several threads, tells about them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from athrl_driving.compilation import compiled_once
from athrl_driving.control import angle_in_frame
from athrl_driving.episode.crew import Crew, Piece
from athrl_driving.episode.drive import drive
from athrl_driving.episode.orders import LOOK, SEE, START, new_orders
from athrl_driving.episode.pinned import Pinned
from athrl_driving.episode.sight import Sight
from athrl_driving.episode.starts import Journeys
from athrl_driving.episode.state import DriveSettings, EpisodeState, new_state
from athrl_driving.errors import DrivingError
from athrl_driving.maps import Town
from athrl_driving.metrics import prepare_summary, summary
from athrl_driving.perception import Perception
from athrl_driving.reward import REWARD_TERMS
from athrl_driving.route import Route
from athrl_driving.scenarios import places_near

ROWS_PER_THREAD = 4
"""Environments below which another thread costs more than it brings."""

_COMPILE_SECONDS = 40


class Episodes:
    """E episodes of one town, one for each row of `sight`; `state` holds their arrays.

    What happens in an environment depends on its seed and its actions alone: not on the others, on how many
    there are or on the number of threads.

    `traffic_near` (x, y, radius, m) is where vehicles may start, anywhere without it. `crew` drives
    them, in pieces of `ROWS_PER_THREAD` environments at least; how many there are is `len(self.chunks)`.
    """

    def __init__(
        self,
        town: Town,
        settings: DriveSettings,
        perception: Perception,
        sight: Sight,
        journeys: Journeys,
        *,
        vehicles: int,
        traffic_near: tuple[float, float, float] | None = None,
        crew: Crew | None = None,
    ) -> None:
        self.town = town
        environments = sight.rows.size
        self.state: EpisodeState = new_state(town, settings, perception, sight, vehicles)
        if traffic_near is not None:
            self.state = self.state._replace(traffic=places_near(self.state.traffic, *traffic_near))
        self._orders = new_orders(environments, self.state.traffic.rails.start_link.size)
        self._pinned: tuple[Any, Any] = Pinned(self.state), Pinned(self._orders)
        self._journeys = journeys
        self._traffic_near = traffic_near
        self._crew = Crew(1) if crew is None else crew
        pieces = max(1, min(self._crew.threads, environments // ROWS_PER_THREAD))
        edges = [environments * piece // pieces for piece in range(pieces + 1)]
        self.chunks = list(itertools.pairwise(edges))
        """The environments of each piece: the first, and the first of the next."""
        with compiled_once(drive, "the towns", _COMPILE_SECONDS):
            prepare_summary(self.state.metrics)
            Route.prepare(town.graph, self.state.routes)
            angle_in_frame(0.0, 0.0, 0.0, (0.0, 0.0))
            self.work(0)

    def __len__(self) -> int:
        return self._orders.work.size

    def close(self) -> None:
        """End the crew's threads."""
        self._crew.close()

    def begin(self, rows: NDArray[np.int64], generators: Sequence[np.random.Generator]) -> None:
        """Begin episodes in the environments `rows` and see them; each draws from its own generator alone.

        Raises ValueError where the town has no room for the vehicles, or no way leads to the destination.
        """
        orders = self._orders
        orders.work[:] = 0
        orders.work[rows] = START + SEE
        for e, generator in zip(rows.tolist(), generators, strict=True):
            journey = self._journeys.draw(generator)
            orders.starts[e] = journey.start
            orders.plan_rows[e] = journey.plan.size
            orders.plans[e, : journey.plan.size] = journey.plan
            # One seed each, so that the ego's route does not depend on how much traffic there is.
            orders.seeds[e] = generator.integers(2**63, size=2, dtype=np.uint64)
        self.drive()
        vehicles, placed = self.state.traffic.background.lane.shape[1], orders.placed[rows].min(initial=10**9)
        if placed < vehicles:
            where = "in the town"
            if self._traffic_near is not None:
                x, y, radius = self._traffic_near
                where = f"within {radius:g} m of ({x:g}, {y:g}) (traffic_near)"
            raise DrivingError(
                f"vehicles_count is {vehicles}, but {where} there is room for {placed} at most"
            )

    @property
    def pieces(self) -> list[Piece]:
        """All environments, as a crew drives them."""
        return [(*self._pinned, first, last) for first, last in self.chunks]

    def order(self, work: int | NDArray[np.int64], actions: NDArray[np.float32] | None = None) -> None:
        """Leave `work` to be done, int64 [E] or the same in all environments (see `episode.orders`).

        `actions` is float32 [E, 2]; without one there is nothing to TAKE. A crew drives `pieces` to do it.
        """
        self._orders.work[:] = work
        if actions is not None:
            self._orders.actions[:] = actions

    def work(self, work: int | NDArray[np.int64], actions: NDArray[np.float32] | None = None) -> None:
        """Do `work`, as `order` has it."""
        self.order(work, actions)
        self.drive()

    def drive(self) -> None:
        """Do the work that is ordered."""
        self._crew.drive(self.pieces)

    def look(self, e: int) -> None:
        """Find the leader of environment `e`'s ego and its next junction as they are now."""
        self._orders.work[:] = 0
        self._orders.work[e] = LOOK
        drive(*self._pinned, e, e + 1)

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
        lasted = bool(self.state.progress.truncated[e]) and not self._journeys.have_destination
        return summary(self.state.metrics, e, lasted=lasted)


def _masked(columns: Mapping[str, NDArray], rows: NDArray[np.bool_]) -> dict[str, NDArray]:
    masked, are_all = {}, rows.all()
    for name, column in columns.items():
        masked[name] = column.copy()
        if not are_all:
            masked[name][~rows] = 0
        masked[f"_{name}"] = rows.copy()
    return masked
