"""The episodes of a batch of environments: begins them, drives them on several threads, reports on them."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from functools import cache
from importlib.metadata import version
from typing import Any

import numpy as np
from athrl_spaces.untrusted import one_line
from numpy.typing import NDArray

from athrl_driving.control import angle_in_frame
from athrl_driving.episode.drive import drive
from athrl_driving.episode.observation_arrays import ObservationArrays, new_observation_arrays
from athrl_driving.episode.own_arrays import fill_own_arrays, own_arrays
from athrl_driving.episode.starts import Journeys
from athrl_driving.episode.state import DriveSettings, EpisodeState, new_state
from athrl_driving.episode.work_flags import FIND_LEADER, OBSERVE, START, new_orders
from athrl_driving.episode.workers import BatchSlice, Workers
from athrl_driving.errors import DrivingError
from athrl_driving.kernels.compilation import compiled_once
from athrl_driving.kernels.pinned_arrays import Pinned
from athrl_driving.maps import Town
from athrl_driving.metrics import prepare_summary, summary
from athrl_driving.perception import Perception, new_perception
from athrl_driving.reward import REWARD_TERMS
from athrl_driving.route import Route
from athrl_driving.scenarios import places_near

ENVIRONMENTS_PER_THREAD = 4
"""Environments per thread below which another thread costs more than it gains."""

_COMPILE_SECONDS = 40

_STARTS = 20
"""Starts that are drawn until all vehicles have room beside the ego."""


class Episodes:
    """E episodes of one town, one for each environment of `observations`; `state` holds their arrays.

    What happens in an environment depends only on its seed and its actions, not on the other environments,
    their number or the number of threads.

    `traffic_near` (x, y, radius, m) is where vehicles may start; None: anywhere. `workers` drives the
    environments in slices of at least `ENVIRONMENTS_PER_THREAD`; their number is `len(self.slice_bounds)`.
    """

    def __init__(
        self,
        town: Town,
        settings: DriveSettings,
        perception: Perception,
        observations: ObservationArrays,
        journeys: Journeys,
        *,
        vehicles: int,
        traffic_near: tuple[float, float, float] | None = None,
        workers: Workers | None = None,
    ) -> None:
        self.town = town
        environments = observations.env_index.size
        self.state: EpisodeState = new_state(town, settings, perception, observations, vehicles)
        if traffic_near is not None:
            self.state = self.state._replace(traffic=places_near(self.state.traffic, *traffic_near))
        self._orders = new_orders(environments, self.state.traffic.lane_links.start_link.size)
        self._pinned: tuple[Any, Any] = Pinned(self.state), Pinned(self._orders)
        self._journeys = journeys
        self._traffic_near = traffic_near
        self._workers = Workers(1) if workers is None else workers
        count = max(1, min(self._workers.threads, environments // ENVIRONMENTS_PER_THREAD))
        edges = [environments * number // count for number in range(count + 1)]
        self.slice_bounds = list(itertools.pairwise(edges))
        """The environments of each slice: the first, and the first of the next."""
        with compiled_once(drive, "the towns", _COMPILE_SECONDS):
            prepare_summary(self.state.metrics)
            Route.prepare(town.graph, self.state.routes)
            angle_in_frame(0.0, 0.0, 0.0, (0.0, 0.0))
            self.work(0)

    def __len__(self) -> int:
        return self._orders.flags.size

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy is made from: the town, settings, and the episodes' arrays by name.

        A copy is independent: it has observations and threads of its own, also where these are shared.
        Raises DrivingError while another thread drives the episodes.
        """
        if self._workers.are_driving:
            raise DrivingError("the episodes cannot be copied while a thread drives them: wait for its step")
        perception, observations = self.state.perception, self.state.observations
        return {
            "version": _version(),
            "town": self.town,
            "settings": self.state.settings._asdict(),
            "perception": {
                "window_side": perception.window_side,
                "ego_above_lower_edge": perception.ego_above_lower_edge,
                "lidar_range": perception.lidar_range,
                "lidar_rays": perception.ray_cosine.size,
            },
            "observations": {
                "environments": len(observations.images),
                "image_size": observations.images.shape[1],
                "decisions": max(observations.recording_buffer.images.shape[1] - 1, 0),
            },
            "journeys": self._journeys,
            "vehicles": self.state.traffic.background.lane.shape[1],
            "traffic_near": self._traffic_near,
            "workers": self._workers,
            "arrays": own_arrays(self.state),
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Make the episodes again; raises DrivingError in one line for a state that does not fit."""
        try:
            observations = new_observation_arrays(**state["observations"])
            env_index = np.array(state["arrays"]["observations.env_index"], np.int64)
            Episodes.__init__(
                self,
                state["town"],
                DriveSettings(**state["settings"]),
                new_perception(state["town"], **state["perception"]),
                observations._replace(env_index=env_index),
                state["journeys"],
                vehicles=state["vehicles"],
                traffic_near=state["traffic_near"],
                workers=state["workers"],
            )
            fill_own_arrays(self.state, state["arrays"])
        except (LookupError, TypeError, ValueError) as error:
            made = state.get("version") if isinstance(state, dict) else None
            raise DrivingError(
                f"the episodes, copied by athrl-driving {made}, cannot be made by {_version()}: "
                f"{_reason(error)}"
            ) from None

    def close(self) -> None:
        """End the workers' threads."""
        self._workers.close()

    def begin(self, env_indices: NDArray[np.int64], generators: Sequence[np.random.Generator]) -> None:
        """Begin episodes in some environments and observe them; each draws from its own generator alone.

        Raises ValueError where the town has no room for the vehicles, or no route leads to the destination.
        """
        vehicles, placed = self.state.traffic.background.lane.shape[1], self._orders.placed
        to_begin = dict(zip(env_indices.tolist(), generators, strict=True))
        for _ in range(1 if self._journeys.have_start else _STARTS):
            self._begin(to_begin)
            # A map that is nearly full has room for all vehicles only where the ego takes little of it.
            to_begin = {e: generator for e, generator in to_begin.items() if placed[e] < vehicles}
            if not to_begin:
                return
        where = "in the town"
        if self._traffic_near is not None:
            x, y, radius = self._traffic_near
            where = f"within {radius:g} m of ({x:g}, {y:g}) (traffic_near)"
        room = placed[list(to_begin)].min()
        raise DrivingError(f"vehicles_count is {vehicles}, but {where} there is room for {room} at most")

    def _begin(self, generators: Mapping[int, np.random.Generator]) -> None:
        """Draw a journey in each environment that has a generator here, place the vehicles, and observe."""
        orders = self._orders
        orders.flags[:] = 0
        for e, generator in generators.items():
            orders.flags[e] = START + OBSERVE
            journey = self._journeys.draw(generator)
            orders.starts[e] = journey.start
            orders.plan_lanes[e] = journey.plan.size
            orders.plans[e, : journey.plan.size] = journey.plan
            # One seed each, so that the ego's route does not depend on how much traffic there is.
            orders.seeds[e] = generator.integers(2**63, size=2, dtype=np.uint64)
        self.drive()

    @property
    def slices(self) -> list[BatchSlice]:
        """All environments, as workers drive them."""
        return [(*self._pinned, first, last) for first, last in self.slice_bounds]

    def order(self, work: int | NDArray[np.int64], actions: NDArray[np.float32] | None = None) -> None:
        """Set the `work` to do, int64 [E] or the same in all environments (see `episode.work_flags`).

        `actions` is float32 [E, 2] and needed where there is SET_ACTION. Workers that drive `slices` do it.
        """
        self._orders.flags[:] = work
        if actions is not None:
            self._orders.actions[:] = actions

    def work(self, work: int | NDArray[np.int64], actions: NDArray[np.float32] | None = None) -> None:
        """Do `work`; arguments as for `order`."""
        self.order(work, actions)
        self.drive()

    def drive(self) -> None:
        """Do the work that has been ordered."""
        self._workers.drive(self.slices)

    def find_leader(self, e: int) -> None:
        """Find the present leader and next junction of environment `e`'s ego."""
        self._orders.flags[:] = 0
        self._orders.flags[e] = FIND_LEADER
        drive(*self._pinned, e, e + 1)

    def info(self, e: int) -> dict[str, Any]:
        """Reward terms, mean speed (m/s) and ticks of the last decision; distance (m) and end of the episode.

        `arrived` is whether the ego has reached its destination or the end of its route, where no lane
        follows, as at the map's edge; `route_end` is whether it was the latter, which truncates the episode.
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
            "arrived": bool(state.arrived[e] or state.route_end[e]),
            "route_end": bool(state.route_end[e]),
            "ticks": int(state.decision_ticks[e]),
            **metrics,
        }

    def infos(self, chosen: NDArray[np.bool_]) -> dict[str, Any]:
        """The `info` of the environments of `chosen` bool [E], in gymnasium's vector format.

        The others have zeros, and each entry has its own mask, whose name begins with an underscore.
        """
        state = self.state.progress
        columns = {
            "speed": state.speed,
            "distance": state.distance,
            "collision": state.collision != 0,
            "off_lane": state.off_lane,
            "arrived": state.arrived | state.route_end,
            "route_end": state.route_end,
            "ticks": state.decision_ticks,
        }
        terms = {name: state.terms[:, place] for place, name in enumerate(REWARD_TERMS)}
        return {
            **_masked(columns, chosen),
            "reward_terms": _masked(terms, chosen),
            "_reward_terms": chosen.copy(),
        }

    def summary(self, e: int) -> dict[str, float]:
        """The metrics of an environment's episode; docs/reference/metrics.md explains them."""
        lasted = bool(self.state.progress.truncated[e]) and not self._journeys.have_destination
        return summary(self.state.metrics, e, lasted=lasted)


@cache
def _version() -> str:
    return version("athrl-driving")


def _reason(error: Exception) -> str:
    """The error in one line; a missing entry's name alone would say nothing."""
    return f"they have no entry {error}" if isinstance(error, KeyError) else one_line(str(error))


def _masked(columns: Mapping[str, NDArray], chosen: NDArray[np.bool_]) -> dict[str, NDArray]:
    masked, are_all = {}, chosen.all()
    for name, column in columns.items():
        masked[name] = column.copy()
        if not are_all:
            masked[name][~chosen] = 0
        masked[f"_{name}"] = chosen.copy()
    return masked
