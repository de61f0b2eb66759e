"""atHRL: an intention planner over a trajectory planner over PID controllers (the paper).

The intention planner decides I in [0, 2]: left, straight on, right, and values between them. The trajectory
planner sees I and decides target speed and waypoint. Both learn off-policy from the same experience. With s
the observation and memory of a level, r its reward, Q' and pi' its target networks:

    critics      Q_h(s, I)     ->  Q_l(s, I, pi_l(s, I)), or r_h + discount * Q_h'(s', pi_h'(s'))  (the paper)
                 Q_l(s, I, a)  ->  r_l + discount * Q_l'(s', I', pi_l'(s', I')),   I' = pi_h'(s')
    trajectory   maximise  Q_l(s, I, pi_l(s, I))
    intention    maximise  Q_h(s, pi_h(s)) + intention_gradient * Q_l(s, pi_h(s), pi_l(s, pi_h(s)))

The last line is how the high level back-propagates both levels' errors (paper, "Hierarchical Off-Policy
Actor-Critic"). `training/losses.py` computes these for any planner with levels; this module defines the
levels. README.md in this folder lists the deviations from the paper and the settings that undo them.
"""

from __future__ import annotations

from typing import ClassVar, Literal, Self

from athrl_spaces import WAYPOINT, Continuous, Limits, Noise
from pydantic import Field, model_validator

from athrl_planners.planner import LevelPlan, Planner
from athrl_planners.settings import ActorCriticSettings

PROGRESS = ("collision", "speed", "fast", "out", "constant")
"""Terms of the reward without the costs of steering, `steer` and `lateral`."""


class AtHRLSettings(ActorCriticSettings):
    """atHRL: intention planner over trajectory planner."""

    kept_by_a_run = ActorCriticSettings.kept_by_a_run | {"intention_every"}

    intention_gradient: float = Field(
        default=1.0,
        ge=0,
        le=100,
        description="Weight of the trajectory critic's gradient through the intention.",
    )
    intention_features: int = Field(
        default=64,
        ge=8,
        le=2048,
        description="Width of the hidden layers of the intention planner's actor and critics.",
    )
    intention_noise: float = Field(
        default=0.2,
        ge=0,
        le=2,
        description="With ddpg and td3: as noise_low, for the intention, in every environment.",
    )
    intention_reward: Literal["task", "progress"] = Field(
        default="task",
        description="Reward of the intention planner, r_h; task: the same as the trajectory planner's; "
        "progress: without the costs of steering (the terms steer and lateral), as it does not steer.",
    )
    intention_target: Literal["trajectory", "experience"] = Field(
        default="trajectory",
        description="Target of the intention's critics; experience: rewards and their own next value (the "
        "paper), with the trajectory planner's noise; trajectory: the trajectory critics' value of its own "
        "decision.",
    )
    intention_every: int = Field(
        default=1,
        ge=1,
        le=100,
        description="Decisions for which the intention planner holds its intention.",
    )
    intention_view: Literal["everything", "far route"] = Field(
        default="everything",
        description="View of the intention planner; far route: only the drivable map and the route.",
    )
    trajectory_view: Literal["everything", "near route"] = Field(
        default="everything",
        description="View of the trajectory planner; near route: the route only a few metres ahead, so that "
        "the choice of a branch must come from the intention.",
    )

    @model_validator(mode="after")
    def _check_what_the_intention_is_worth(self) -> Self:
        if self.intention_reward != "task" and self.intention_target == "trajectory":
            raise ValueError(
                f'planner.intention_reward = "{self.intention_reward}": should go with '
                'planner.intention_target = "experience", as trajectory critics know the task\'s reward alone'
            )
        return self


class AtHRL(Planner):
    """The paper's hierarchy."""

    kind = "athrl"
    summary = "intention planner over trajectory planner over PID (the paper)"
    settings = AtHRLSettings
    action_kind: ClassVar[str] = WAYPOINT

    @classmethod
    def levels(cls, settings: AtHRLSettings, limits: Limits) -> tuple[LevelPlan, ...]:
        """The intention planner over the trajectory planner."""
        noise = settings.noise
        if isinstance(noise, Noise):
            noise = Noise(settings.intention_noise, settings.intention_noise, settings.noise_damping)
        intention = Continuous("intention", "", 0.0, 2.0, noise, sideways=True)
        trajectory = cls.actions(limits, settings.noise)
        return (
            LevelPlan(
                "intention",
                (intention,),
                settings.update_rule,
                every=settings.intention_every,
                view=settings.intention_view,
                gradient_from_below=settings.intention_gradient,
                head_features=settings.intention_features,
                rewarded=PROGRESS if settings.intention_reward == "progress" else (),
                value_from="below" if settings.intention_target == "trajectory" else "experience",
            ),
            LevelPlan("trajectory", trajectory, settings.update_rule, view=settings.trajectory_view),
        )
