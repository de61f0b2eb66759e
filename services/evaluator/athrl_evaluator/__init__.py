"""Scores policies, records episodes and shows them."""

from athrl_evaluator.evaluate import EvaluationSettings, evaluate_driver
from athrl_evaluator.evaluator import run_evaluator
from athrl_evaluator.scoring.scores import EpisodeResult, Scores

__all__ = [
    "EpisodeResult",
    "EvaluationSettings",
    "Scores",
    "evaluate_driver",
    "run_evaluator",
]
