"""The definition of a planner, from which everything else in the project follows.

A planner is a class derived from `Planner`, in its own folder or file, and one line in
`athrl_planners.registry` (or an entry point of the group `athrl.planners` in another package). This module
and the modules that define planners do not import torch: the command lists and checks planners without it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

from athrl_spaces import Action, Epsilon, Limits, Noise, Sampled, refuse_wrong_terms
from athrl_spaces.action_kinds import action_kind

from athrl_planners.settings import PlannerSettings

View = Literal["everything", "near route", "far route"]
"""What a level sees: everything; the route only near the ego; or only road and route."""


@dataclass(frozen=True)
class LevelPlan:
    """One level of a planner.

    Attributes:
        name: of the level.
        actions: what it decides, with its exploration; it sees the decisions of the levels above.
        update_rule: `ddpg`, `td3` or `sac` for numbers, `dqn` for a choice.
        every: number of decisions for which it holds its own decision.
        view: what it sees.
        gradient_from_below: weight of the next level's value in this level's actor's objective (paper,
            "Hierarchical Off-Policy Actor-Critic").
        head_features: width of the hidden layers of its actor and critics; 0: as in the settings.
        rewarded: names of its reward terms (`athrl_spaces.REWARD_TERMS`); empty: all of them, the task's
            reward.
        value_from: target of its critics; experience: its rewards and its own next value; below: the value
            of the next level's critics for that level's own decision, without exploration (td3's target
            policy smoothing is on it).
    """

    name: str
    actions: tuple[Action, ...]
    update_rule: Literal["ddpg", "td3", "sac", "dqn"]
    every: int = 1
    view: View = "everything"
    gradient_from_below: float = 0.0
    head_features: int = 0
    rewarded: tuple[str, ...] = ()
    value_from: Literal["experience", "below"] = "experience"

    def __post_init__(self) -> None:
        if not self.actions:
            raise ValueError(f"level {self.name} decides nothing")
        if self.every < 1:
            raise ValueError(f"level {self.name} decides every {self.every} decisions; should be 1 or more")
        if self.gradient_from_below and self.update_rule == "dqn":
            raise ValueError(f"level {self.name} learns by dqn: it has no actor that a gradient could climb")
        refuse_wrong_terms(self.name, self.rewarded)


class Planner:
    """A kind of planner.

    Attributes:
        kind: its name in run files, artefacts and checkpoints.
        summary: one line for lists and for the run file's comment.
        settings: class of its settings.
        action_kind: kind of its actions in an environment, one of `athrl_spaces.ACTION_KINDS`.
    """

    kind: ClassVar[str]
    summary: ClassVar[str]
    settings: ClassVar[type[PlannerSettings]]
    action_kind: ClassVar[str]

    @classmethod
    def levels(cls, settings: Any, limits: Limits) -> tuple[LevelPlan, ...]:
        """The levels, highest first, for these settings and limits of environments."""
        raise NotImplementedError

    @classmethod
    def read_settings(cls, values: Mapping[str, Any]) -> PlannerSettings:
        """The settings with these values, else defaults; raises pydantic's ValidationError."""
        return cls.settings.model_validate(dict(values))

    @classmethod
    def actions(cls, limits: Limits, exploration: Noise | Sampled | Epsilon) -> tuple[Action, ...]:
        """The entries that an environment takes, each with this exploration."""
        change: Any = {"exploration": exploration}
        return tuple(replace(action, **change) for action in action_kind(cls.action_kind).describe(limits))
