"""What an episode came to, and what many of them say about a driver."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

# 97.5 % quantiles of Student's t for 1 to 30 degrees of freedom.
_STUDENT = (
    *(12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228),
    *(2.201, 2.179, 2.160, 2.145, 2.131, 2.120, 2.110, 2.101, 2.093, 2.086),
    *(2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042),
)


@dataclass(frozen=True)
class EpisodeResult:
    """One episode of a driver."""

    seed: int
    episode_return: float
    distance: float  # m
    ticks: int  # of 0.1 s
    speed: float  # m/s, mean over the ticks
    collision: bool
    off_lane: bool
    full: bool  # it lasted until the time limit
    success: bool  # arrived, or without a destination lasted, with neither collision nor lane exit
    driving_score: float  # CARLA leaderboard's, 0 to 1
    comfort: float  # share of the ticks within all of nuPlan's bounds
    time_to_collision_kept: float  # share of the ticks with more than nuPlan's 0.95 s
    red_lights: int  # run


@dataclass(frozen=True)
class Scores:
    """The scores of a driver; `return_ci95` is half the width of the mean return's 95 % interval."""

    episodes: int
    return_mean: float
    return_ci95: float
    speed_mps: float
    distance_m: float
    collision_rate: float
    off_lane_rate: float
    full_episode_rate: float
    success_rate: float
    driving_score: float
    comfort: float
    time_to_collision_kept: float
    red_lights: float

    def as_dict(self) -> dict[str, float]:
        """The scores by name."""
        return asdict(self)


def score(results: Sequence[EpisodeResult]) -> Scores:
    """Sum up at least two episodes; the mean speed weighs every tick alike."""
    if len(results) < 2:
        raise ValueError(f"scores need at least 2 episodes for an interval, not {len(results)}")
    returns = np.array([result.episode_return for result in results])
    ticks = np.array([result.ticks for result in results])
    speeds = np.array([result.speed for result in results])
    return Scores(
        episodes=len(results),
        return_mean=float(returns.mean()),
        return_ci95=float(student_quantile(len(results) - 1) * returns.std(ddof=1) / math.sqrt(len(results))),
        speed_mps=float((speeds * ticks).sum() / max(1, ticks.sum())),
        distance_m=float(np.mean([result.distance for result in results])),
        collision_rate=float(np.mean([result.collision for result in results])),
        off_lane_rate=float(np.mean([result.off_lane for result in results])),
        full_episode_rate=float(np.mean([result.full for result in results])),
        success_rate=float(np.mean([result.success for result in results])),
        driving_score=float(np.mean([result.driving_score for result in results])),
        comfort=float(np.mean([result.comfort for result in results])),
        time_to_collision_kept=float(np.mean([result.time_to_collision_kept for result in results])),
        red_lights=float(np.mean([result.red_lights for result in results])),
    )


def student_quantile(degrees: int) -> float:
    """The 97.5 % quantile of Student's t distribution, to three digits, for 1 or more degrees of freedom."""
    if degrees <= len(_STUDENT):
        return _STUDENT[degrees - 1]
    normal = 1.95996
    first = (normal**3 + normal) / 4
    second = (5 * normal**5 + 16 * normal**3 + 3 * normal) / 96
    return normal + first / degrees + second / degrees**2
