"""Scores are what their names mean."""

from dataclasses import fields

import numpy as np
import pytest
from athrl_evaluator import EpisodeResult
from athrl_evaluator.scoring.scores import Scores, score, student_quantile
from athrl_protocol.monitoring.table import SCORES


def episode(episode_return: float, **changes: object) -> EpisodeResult:
    values = {
        "distance": 100.0,
        "ticks": 500,
        "seconds": 50.0,
        "speed": 2.0,
        "collision": False,
        "off_lane": False,
        "full": True,
        "success": True,
        "driving_score": 0.8,
        "comfort": 1.0,
        "time_to_collision_kept": 1.0,
        "red_lights": 0,
    }
    return EpisodeResult(seed=1, episode_return=episode_return, **(values | changes))  # type: ignore[arg-type]


def test_rates_and_means_are_over_episodes():
    scores = score(
        [
            episode(10.0),
            episode(20.0, collision=True, full=False, success=False),
            episode(30.0, off_lane=True, full=False),
            episode(40.0, distance=300.0, driving_score=0.4, comfort=0.6, red_lights=2),
        ]
    )
    assert scores.episodes == 4
    assert scores.return_mean == 25.0
    assert scores.distance_m == 150.0
    assert (scores.collision_rate, scores.off_lane_rate, scores.full_episode_rate) == (0.25, 0.25, 0.5)
    assert scores.success_rate == 0.75
    assert (scores.driving_score, scores.comfort, scores.red_lights) == pytest.approx((0.7, 0.9, 0.5))


def test_seconds_to_success_are_those_of_the_successful_episodes():
    arrived = [episode(0.0, seconds=40.0), episode(0.0, seconds=60.0)]
    crashed = episode(0.0, seconds=2.0, success=False, collision=True)
    assert score([*arrived, crashed]).success_seconds == pytest.approx(50.0)
    assert "success_seconds" not in score([crashed, crashed]).as_dict()


def test_the_mean_speed_weighs_every_tick_alike():
    assert score([episode(0.0, speed=8.0, ticks=100), episode(0.0, speed=2.0, ticks=500)]).speed_mps == 3.0


def test_the_interval_holds_the_true_mean_in_95_of_100_cases():
    rng = np.random.default_rng(1)
    inside = 0
    for _ in range(2000):
        scores = score([episode(value) for value in rng.normal(7.0, 3.0, 5)])
        inside += abs(scores.return_mean - 7.0) <= scores.return_ci95
    assert inside / 2000 == pytest.approx(0.95, abs=0.02)


@pytest.mark.parametrize(
    ("degrees", "value"), [(1, 12.706), (7, 2.365), (30, 2.042), (39, 2.023), (1000, 1.962)]
)
def test_students_quantiles_are_those_of_the_tables(degrees: int, value: float):
    assert student_quantile(degrees) == pytest.approx(value, abs=1e-3)


def test_every_score_is_in_the_table_of_metrics():
    names = [metric.name for group in SCORES for metric in group.metrics]
    assert names == [field.name for field in fields(Scores)]


def test_one_episode_has_no_interval():
    with pytest.raises(ValueError, match="at least 2 episodes"):
        score([episode(1.0)])
