"""The result of an episode, and a driver's scores over many episodes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np


@dataclass(frozen=True)
class EpisodeResult:
    """One episode of a driver."""

    seed: int
    episode_return: float
    distance: float  # m
    ticks: int
    seconds: float
    speed: float  # m/s, mean over the ticks
    collision: bool
    off_lane: bool
    full: bool  # it lasted until the time limit, or until the map ended
    success: bool  # arrived, or without a destination drove on to the end, without collision or lane exit
    driving_score: float  # CARLA leaderboard's, 0 to 1
    comfort: float  # share of the ticks within all of nuPlan's bounds
    time_to_collision_kept: float  # share of the ticks with more than nuPlan's 0.95 s
    red_lights: int  # run


@dataclass(frozen=True)
class Scores:
    """The scores of a driver; `return_ci95` is half the width of the mean return's 95 % interval.

    `success_seconds` is the mean duration of the successful episodes; None if there is none.
    """

    episodes: int
    return_mean: float
    return_ci95: float
    speed_mps: float
    distance_m: float
    collision_rate: float
    off_lane_rate: float
    full_episode_rate: float
    success_rate: float
    success_seconds: float | None
    driving_score: float
    comfort: float
    time_to_collision_kept: float
    red_lights: float

    def as_dict(self) -> dict[str, float]:
        """The scores by name, without one that is None."""
        return {name: value for name, value in asdict(self).items() if value is not None}


def score(results: Sequence[EpisodeResult]) -> Scores:
    """Average over at least two episodes; every tick has the same weight in the mean speed."""
    if len(results) < 2:
        raise ValueError(f"scores need at least 2 episodes for an interval, not {len(results)}")
    returns = np.array([result.episode_return for result in results])
    ticks = np.array([result.ticks for result in results])
    speeds = np.array([result.speed for result in results])
    seconds = np.array([result.seconds for result in results])
    success = np.array([result.success for result in results])
    return Scores(
        episodes=len(results),
        return_mean=float(returns.mean()),
        return_ci95=float(student_quantile(len(results) - 1) * returns.std(ddof=1) / math.sqrt(len(results))),
        speed_mps=float((speeds * ticks).sum() / max(1, ticks.sum())),
        distance_m=float(np.mean([result.distance for result in results])),
        collision_rate=float(np.mean([result.collision for result in results])),
        off_lane_rate=float(np.mean([result.off_lane for result in results])),
        full_episode_rate=float(np.mean([result.full for result in results])),
        success_rate=float(success.mean()),
        success_seconds=round(float(seconds[success].mean()), 3) if success.any() else None,
        driving_score=float(np.mean([result.driving_score for result in results])),
        comfort=float(np.mean([result.comfort for result in results])),
        time_to_collision_kept=float(np.mean([result.time_to_collision_kept for result in results])),
        red_lights=float(np.mean([result.red_lights for result in results])),
    )


def student_quantile(degrees: int) -> float:
    """The 97.5 % quantile of Student's t distribution for 1 or more degrees of freedom."""
    from scipy.special import stdtrit  # here, because it takes a quarter of a second that most do not need

    return float(stdtrit(degrees, 0.975))
