"""Drive episodes on given seeds, as many at a time as the batch has environments."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from athrl_driving.envs import TownRow
from athrl_driving.policy import AnyBatch

from athrl_evaluator.drivers import BatchDriver, Decisions
from athrl_evaluator.scores import EpisodeResult


class Stopped(Exception):  # noqa: N818  (no error: somebody asked for it)
    """The episodes were given up because the service stops."""


@dataclass(frozen=True)
class EpisodeStep:
    """One decision of one episode, for those who look on."""

    index: int  # of the episode
    seed: int
    step: int  # decisions so far, this one included
    environment: TownRow
    image: np.ndarray  # uint8 [H, W, C] after the step
    town: str
    decision: Mapping[str, float]  # everything that was decided, by name; empty where no policy decides
    reward: float
    episode_return: float
    info: Mapping[str, Any]


class Onlooker:
    """Is told what happens in the episodes; does nothing by itself."""

    def on_step(self, step: EpisodeStep) -> None:
        """A decision was carried out."""

    def on_end(self, index: int, result: EpisodeResult) -> None:
        """An episode is over."""


@dataclass
class _Running:
    """An episode under way."""

    index: int
    seed: int
    steps: int = 0
    episode_return: float = 0.0
    ticks: int = 0
    speed_ticks: float = 0.0
    last_info: Mapping[str, Any] = field(default_factory=dict)

    def add(self, reward: float, info: Mapping[str, Any]) -> None:
        ticks = int(info["ticks"])
        self.steps += 1
        self.episode_return += reward
        self.ticks += ticks
        self.speed_ticks += float(info["speed"]) * ticks
        self.last_info = info

    def result(self, full: bool) -> EpisodeResult:
        metrics = self.last_info["metrics"]
        return EpisodeResult(
            seed=self.seed,
            episode_return=self.episode_return,
            distance=float(self.last_info["distance"]),
            ticks=self.ticks,
            speed=self.speed_ticks / max(1, self.ticks),
            collision=bool(self.last_info["collision"]),
            off_lane=bool(self.last_info["off_lane"]),
            full=full,
            success=bool(metrics["success"]),
            driving_score=metrics["driving_score"],
            comfort=metrics["comfort_all"],
            time_to_collision_kept=metrics["time_to_collision_kept"],
            red_lights=int(metrics["red_lights"]),
        )


def drive_episodes(
    driver: BatchDriver,
    batch: AnyBatch,
    seeds: Sequence[int],
    onlookers: Sequence[Onlooker] = (),
    stop: threading.Event | None = None,
) -> list[EpisodeResult]:
    """Drive one episode on each seed; results are in the seeds' order whatever the batch's size is.

    Raises Stopped when `stop` is set before the last episode is over, and EnvironmentFailure as `batch` does.
    """
    results: dict[int, EpisodeResult] = {}
    waiting = iter(enumerate(seeds))
    rows: list[_Running | None] = [_begin(driver, batch, row, waiting) for row in range(len(batch))]
    while len(results) < len(seeds):
        if stop is not None and stop.is_set():
            raise Stopped
        active = np.array([running is not None for running in rows])
        decisions = driver.decide(batch, active)
        outcome = batch.step(decisions.actions, active)
        ended = outcome.terminated | outcome.truncated
        for row, running in enumerate(rows):
            if running is None:
                continue
            running.add(float(outcome.rewards[row]), batch.info(row))
            step = _look(running, batch, row, decisions, float(outcome.rewards[row]))
            for onlooker in onlookers:
                onlooker.on_step(step)
            if ended[row]:
                results[running.index] = running.result(full=bool(outcome.truncated[row]))
                for onlooker in onlookers:
                    onlooker.on_end(running.index, results[running.index])
                rows[row] = _begin(driver, batch, row, waiting)
    return [results[index] for index in range(len(seeds))]


def _begin(driver: BatchDriver, batch: AnyBatch, row: int, waiting: enumerate[int] | Any) -> _Running | None:
    """Begin the next waiting episode in a row; None when there is none."""
    following = next(waiting, None)
    if following is None:
        return None
    index, seed = following
    batch.reset(row, seed)
    driver.begin(row, batch.environments[row], seed)
    return _Running(index=index, seed=seed)


def _look(running: _Running, batch: AnyBatch, row: int, decisions: Decisions, reward: float) -> EpisodeStep:
    return EpisodeStep(
        index=running.index,
        seed=running.seed,
        step=running.steps,
        environment=batch.environments[row],
        image=batch.images[row],
        town=batch.towns[row],
        decision=decisions.named_values(row),
        reward=reward,
        episode_return=running.episode_return,
        info=running.last_info,
    )
