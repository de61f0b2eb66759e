"""Scores policies, records episodes and shows them.

What the package offers is imported when its name is first used: whoever scores or records a policy needs
nothing of the service.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

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

_MODULE_OF_NAME = {
    "EpisodeResult": "scoring.scores",
    "EvaluationSettings": "evaluate",
    "Scores": "scoring.scores",
    "evaluate_driver": "evaluate",
    "run_evaluator": "evaluator",
}


def __getattr__(name: str) -> Any:
    """Import the module of a public name when the name is first used."""
    if name not in _MODULE_OF_NAME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULE_OF_NAME[name]}"), name)
