"""Update rules of a level, and the value representations of critics."""

from athrl_planners.updates.deterministic import DeterministicRule
from athrl_planners.updates.q_learning import QLearningRule
from athrl_planners.updates.rule import LevelNetworks, Step, UpdateRule
from athrl_planners.updates.soft import SoftRule
from athrl_planners.updates.values import Values, make_values

__all__ = [
    "DeterministicRule",
    "LevelNetworks",
    "QLearningRule",
    "SoftRule",
    "Step",
    "UpdateRule",
    "Values",
    "make_rule",
    "make_values",
]


def make_rule(name: str) -> type[UpdateRule]:
    """The update rule with this name; raises ValueError if there is none."""
    rules: dict[str, type[UpdateRule]] = {
        "ddpg": DeterministicRule,
        "td3": DeterministicRule,
        "sac": SoftRule,
        "dqn": QLearningRule,
    }
    if name not in rules:
        raise ValueError(f"there is no update rule {name!r}; there are {', '.join(rules)}")
    return rules[name]
