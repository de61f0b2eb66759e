"""DDPG: no hierarchy; the actor decides acceleration and steering (paper, "Baselines")."""

from __future__ import annotations

from typing import ClassVar

from athrl_spaces import DIRECT, Limits

from athrl_planners.planner import LevelPlan, Planner
from athrl_planners.settings import ActorCriticSettings


class DDPGSettings(ActorCriticSettings):
    """DDPG: acceleration and steering."""


class DDPG(Planner):
    """One level that decides acceleration and steering."""

    kind = "ddpg"
    summary = "acceleration and steering directly (the paper's DDPG)"
    settings = DDPGSettings
    action_kind: ClassVar[str] = DIRECT

    @classmethod
    def levels(cls, settings: DDPGSettings, limits: Limits) -> tuple[LevelPlan, ...]:
        """The only level."""
        return (LevelPlan("control", cls.actions(limits, settings.noise), settings.update_rule),)
