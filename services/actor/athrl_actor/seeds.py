"""The actor's branch of the run's tree of seeds: run, role, actor and incarnation, environment, episode."""

from __future__ import annotations

import hashlib

import numpy as np

ACTOR_ROLE = 2  # the branch of all actors under the run's seed
EXPLORATION, EPISODES = 0, 1  # the branches of one actor

EPISODE_SEED_BIT = 1 << 62
"""Set in every training episode's seed, so that none equals an evaluator's seed, which fits in 32 bits."""


class ActorSeeds:
    """Seeds that no other actor and no earlier incarnation of this one has."""

    def __init__(self, run_seed: int, actor: str, incarnation: int) -> None:
        name = int.from_bytes(hashlib.blake2b(actor.encode(), digest_size=8).digest(), "little")
        self._root = (run_seed, (ACTOR_ROLE, name, incarnation))

    def exploration(self) -> np.random.Generator:
        """The generator of the actor's exploration noise."""
        return np.random.default_rng(self._sequence(EXPLORATION))

    def episode(self, environment: int, episode: int) -> int:
        """The seed of an environment's episode, an integer of 63 bits."""
        state = self._sequence(EPISODES, environment, episode).generate_state(1, np.uint64)
        return int(state[0]) & (EPISODE_SEED_BIT - 1) | EPISODE_SEED_BIT

    def _sequence(self, *branch: int) -> np.random.SeedSequence:
        entropy, path = self._root
        return np.random.SeedSequence(entropy, spawn_key=(*path, *branch))
