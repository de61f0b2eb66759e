"""No two actors, incarnations of an actor, environments or episodes share a seed."""

from itertools import product

import numpy as np
from athrl_actor.seeds import ActorSeeds


def test_every_episode_of_every_actor_and_incarnation_has_a_seed_of_its_own():
    seeds = [
        ActorSeeds(run_seed, actor, incarnation).episode(environment, episode)
        for run_seed, actor, incarnation, environment, episode in product(
            (1, 2), ("a", "b"), (10, 2**63), range(4), range(25)
        )
    ]
    assert len(set(seeds)) == len(seeds)


def test_seeds_are_the_same_for_the_same_branch_of_the_tree():
    first, second = (ActorSeeds(1, "actor", 5) for _ in range(2))
    assert first.episode(3, 4) == second.episode(3, 4)
    np.testing.assert_array_equal(first.exploration().random(8), second.exploration().random(8))


def test_a_training_episode_is_never_one_of_an_evaluators():
    seeds = ActorSeeds(1, "actor", 5)
    assert all(2**32 <= seeds.episode(0, episode) < 2**63 for episode in range(100))


def test_exploration_differs_between_actors():
    first, second = (ActorSeeds(1, actor, 5).exploration().random(8) for actor in ("a", "b"))
    assert not np.array_equal(first, second)
