"""H-DDPG: the trajectory planner over PID controllers, without an intention (paper, "Baselines")."""

from __future__ import annotations

from typing import ClassVar

from athrl_spaces import WAYPOINT, Limits

from athrl_planners.planner import LevelPlan, Planner
from athrl_planners.settings import ActorCriticSettings


class HDDPGSettings(ActorCriticSettings):
    """H-DDPG: trajectory planner only."""


class HDDPG(Planner):
    """One level that decides target speed and waypoint; controllers follow them."""

    kind = "hddpg"
    summary = "trajectory planner over PID (the paper's H-DDPG)"
    settings = HDDPGSettings
    action_kind: ClassVar[str] = WAYPOINT

    @classmethod
    def levels(cls, settings: HDDPGSettings, limits: Limits) -> tuple[LevelPlan, ...]:
        """The trajectory planner."""
        return (LevelPlan("trajectory", cls.actions(limits, settings.noise), settings.update_rule),)
