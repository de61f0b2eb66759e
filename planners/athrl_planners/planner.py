"""What a planner says of itself. Everything else in the project follows from it.

A planner is a class derived from `Planner`, in a folder or file of its own, and one line in
`athrl_planners.registry` (or an entry point of the group `athrl.planners` in a package of yours). No torch
here, nor in the modules that define planners: the command lists and checks planners without it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Literal

from athrl_spaces import Action, Epsilon, Limits, Noise, Sampled, refuse_wrong_terms
from athrl_spaces.action_kinds import action_kind

from athrl_planners.settings import PlannerSettings

View = Literal["everything", "near route", "far route"]
"""What a level sees: all of it; the route only close to the car; or road and route alone."""


@dataclass(frozen=True)
class LevelPlan:
    """One level of a planner.

    Attributes:
        name: of the level.
        actions: what it decides, with its exploration; it sees what the levels above have decided.
        update_rule: `ddpg`, `td3` or `sac` for numbers, `dqn` for a choice.
        every: it decides every so many decisions, and holds in between.
        view: what it sees.
        gradient_from_below: weight of the next level's value in this level's actor's objective (paper,
            "Hierarchical Off-Policy Actor-Critic").
        head_features: width of the hidden layers of its actor and critics; 0: what the settings say.
        rewarded: names of the terms of the reward that it is paid (`athrl_spaces.REWARD_TERMS`); empty: all
            of them, the task's reward.
        value_from: what its critics learn; experience: its rewards and its own next value; below: what the
            next level's critics say of that level's decision, in which that level's noise does not count.
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
        settings: its table of settings.
        action_kind: what an environment takes of it, one of `athrl_spaces.ACTION_KINDS`.
    """

    kind: ClassVar[str]
    summary: ClassVar[str]
    settings: ClassVar[type[PlannerSettings]]
    action_kind: ClassVar[str]

    @classmethod
    def levels(cls, settings: Any, limits: Limits) -> tuple[LevelPlan, ...]:
        """The levels, highest first, under these settings and in environments with these limits."""
        raise NotImplementedError

    @classmethod
    def read_settings(cls, values: Mapping[str, Any]) -> PlannerSettings:
        """The settings with these values and defaults for the others; raises pydantic's ValidationError."""
        return cls.settings.model_validate(dict(values))

    @classmethod
    def actions(cls, limits: Limits, exploration: Noise | Sampled | Epsilon) -> tuple[Action, ...]:
        """The entries that an environment takes, each explored like this."""
        change: Any = {"exploration": exploration}
        return tuple(replace(action, **change) for action in action_kind(cls.action_kind).describe(limits))
