"""Drive episodes on given seeds, as many at a time as the batch has environments."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from athrl_driving.envs import EnvView
from athrl_driving.policy import AnyBatch

from athrl_evaluator.scoring.drivers import BatchDriver, Decisions
from athrl_evaluator.scoring.scores import EpisodeResult


class Stopped(Exception):  # noqa: N818  (not an error: a stop was requested)
    """The episodes were abandoned because the service stops."""


@dataclass(frozen=True)
class EpisodeStep:
    """One decision of one episode, for observers."""

    index: int  # of the episode
    seed: int
    step: int  # decisions so far, this one included
    environment: EnvView
    image: np.ndarray  # uint8 [H, W, C] after the step
    town: str
    action: np.ndarray  # float32 [2] as the environment took it
    decision: Mapping[str, float]  # all decided values, by name; empty if no policy decides
    reward: float
    episode_return: float
    info: Mapping[str, Any]


class EpisodeObserver:
    """Base class of observers of episodes; its methods do nothing."""

    def on_step(self, step: EpisodeStep) -> None:
        """Called after each decision."""

    def on_end(self, index: int, result: EpisodeResult) -> None:
        """Called at the end of each episode."""


@dataclass
class _Running:
    """A running episode."""

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
            seconds=float(metrics["duration"]),
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
    observers: Sequence[EpisodeObserver] = (),
    stop: threading.Event | None = None,
) -> list[EpisodeResult]:
    """Drive one episode for each seed; results are in the order of the seeds for any batch size.

    Raises Stopped when `stop` is set before the last episode is over, and EnvironmentFailure as `batch` does.
    """
    results: dict[int, EpisodeResult] = {}
    waiting = iter(enumerate(seeds))
    episodes: list[_Running | None] = [_begin(driver, batch, e, waiting) for e in range(len(batch))]
    while len(results) < len(seeds):
        if stop is not None and stop.is_set():
            raise Stopped
        active = np.array([running is not None for running in episodes])
        decisions = driver.decide(batch, active)
        outcome = batch.step(decisions.actions, active)
        ended = outcome.terminated | outcome.truncated
        for env_index, running in enumerate(episodes):
            if running is None:
                continue
            reward = float(outcome.rewards[env_index])
            running.add(reward, batch.info(env_index))
            step = _episode_step(running, batch, env_index, decisions, reward)
            for observer in observers:
                observer.on_step(step)
            if ended[env_index]:
                results[running.index] = running.result(full=bool(outcome.truncated[env_index]))
                for observer in observers:
                    observer.on_end(running.index, results[running.index])
                episodes[env_index] = _begin(driver, batch, env_index, waiting)
    return [results[index] for index in range(len(seeds))]


def _begin(
    driver: BatchDriver, batch: AnyBatch, env_index: int, waiting: enumerate[int] | Any
) -> _Running | None:
    """Begin the next waiting episode in an environment; None when there is none."""
    following = next(waiting, None)
    if following is None:
        return None
    index, seed = following
    batch.reset(env_index, seed)
    driver.begin(env_index, batch.environments[env_index], seed)
    return _Running(index=index, seed=seed)


def _episode_step(
    running: _Running, batch: AnyBatch, env_index: int, decisions: Decisions, reward: float
) -> EpisodeStep:
    return EpisodeStep(
        index=running.index,
        seed=running.seed,
        step=running.steps,
        environment=batch.environments[env_index],
        image=batch.images[env_index],
        town=batch.towns[env_index],
        action=decisions.actions[env_index],
        decision=decisions.named_values(env_index),
        reward=reward,
        episode_return=running.episode_return,
        info=running.last_info,
    )
