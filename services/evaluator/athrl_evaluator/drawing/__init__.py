"""Draw frames of an episode with rerun; the same for a live episode and for a recorded one."""

from athrl_evaluator.drawing.blueprint import make_blueprint
from athrl_evaluator.drawing.scene import APPLICATION, SceneDrawing

__all__ = ["APPLICATION", "SceneDrawing", "make_blueprint"]
