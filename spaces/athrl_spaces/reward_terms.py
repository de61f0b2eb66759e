"""The terms of the reward by name, and which of them a level of a planner gets."""

from __future__ import annotations

from collections.abc import Sequence

REWARD_TERMS = ("collision", "speed", "fast", "out", "steer", "lateral", "constant")
"""Names of the terms whose weighted sum is the task's reward, in the order of the sum."""


def refuse_wrong_terms(level: str, rewarded: Sequence[str]) -> None:
    """Raise ValueError, in one line, if a level has an unknown term, or one twice."""
    for term in rewarded:
        if term not in REWARD_TERMS:
            terms = ", ".join(REWARD_TERMS)
            raise ValueError(f"level {level} has the reward term {term!r:.60}; there are {terms}")
        if list(rewarded).count(term) > 1:
            raise ValueError(f"level {level} has the reward term {term!r} twice; once is enough")


def indices_of_terms(rewarded: Sequence[str]) -> tuple[int, ...]:
    """Indices in `REWARD_TERMS` of a level's terms; empty for all of them, the task's reward."""
    if set(rewarded) == set(REWARD_TERMS):
        return ()
    return tuple(place for place, term in enumerate(REWARD_TERMS) if term in rewarded)
