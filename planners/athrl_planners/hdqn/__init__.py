"""H-DQN: one network chooses a behaviour, another one a waypoint; controllers follow them.

Behaviours are target speeds (stop, slow, drive), waypoints lie in 8 directions at 2 distances (paper,
"Baselines"). Each level is a DQN on the task's reward; the waypoint level sees the behaviour.
"""

from __future__ import annotations

from typing import ClassVar

from athrl_spaces import WAYPOINT_SET, Epsilon, Limits

from athrl_planners.planner import LevelPlan, Planner
from athrl_planners.settings import QLearningSettings


class HDQNSettings(QLearningSettings):
    """H-DQN: behaviour over waypoint."""


class HDQN(Planner):
    """One of three behaviours over one of sixteen waypoints."""

    kind = "hdqn"
    summary = "behaviour of three over waypoint of sixteen over PID (the paper's H-DQN)"
    settings = HDQNSettings
    action_kind: ClassVar[str] = WAYPOINT_SET

    @classmethod
    def levels(cls, settings: HDQNSettings, limits: Limits) -> tuple[LevelPlan, ...]:
        """The behaviour's level over the waypoint's."""
        exploration = Epsilon(settings.epsilon_low, settings.epsilon_high)
        behaviour, waypoint = cls.actions(limits, exploration)
        return (LevelPlan("behaviour", (behaviour,), "dqn"), LevelPlan("waypoint", (waypoint,), "dqn"))
