"""Scores policies, records episodes and shows them."""

from athrl_evaluator.case_studies import CASE_STUDIES
from athrl_evaluator.drivers import REFERENCE_DRIVERS
from athrl_evaluator.evaluate import evaluate_driver
from athrl_evaluator.evaluator import run_evaluator
from athrl_evaluator.scores import EpisodeResult, Scores

__all__ = [
    "CASE_STUDIES",
    "REFERENCE_DRIVERS",
    "EpisodeResult",
    "Scores",
    "evaluate_driver",
    "run_evaluator",
]
