"""Draws frames of an episode with rerun, in the same way for live and recorded episodes."""

from athrl_evaluator.drawing.blueprint import make_blueprint
from athrl_evaluator.drawing.scene import APPLICATION, SceneDrawing

__all__ = ["APPLICATION", "SceneDrawing", "make_blueprint"]
