"""Scores policies, records episodes and shows them.

What the package offers is imported when its name is first used: whoever scores or records a policy needs
nothing of the service.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from athrl_spaces.first_use import on_first_use

if TYPE_CHECKING:
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

__getattr__ = on_first_use(
    __name__,
    {
        "EpisodeResult": "scoring.scores",
        "EvaluationSettings": "evaluate",
        "Scores": "scoring.scores",
        "evaluate_driver": "evaluate",
        "run_evaluator": "evaluator",
    },
)
