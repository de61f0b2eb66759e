"""Every planner learns a task that needs its eyes, and with a memory one that needs that; within seconds."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from athrl_planners import Agent, Sequence, SequenceReplay, make_agent
from athrl_planners.factories import make_replay
from athrl_spaces import WAYPOINT_SET, Continuous, Discrete, LevelDescription, Observation, Sampled

ROWS, EPISODE = 16, 6
FAR = 0.6
"""The wanted numbers, normalised, lie this far to either side of the middle."""
CHOICES = {"behaviour": (0, 2), "waypoint": (2, 13)}

Arrays = dict[str, np.ndarray]
Explore = Callable[[np.random.Generator], tuple[Arrays, Arrays]]

SETTINGS = {
    "hidden_features": 16,
    "head_features": 32,
    "recurrent_features": 16,
    "discount": 0.5,
    "n_step": 1,
    "reward_scale": 1.0,
    "value_min": -1.0,
    "value_max": 3.0,
    "atoms": 21,
    "learning_rate": 5e-3,
    "average_decay": 0.95,
}


class Signs:
    """Two signs, up or down and left or right, say what is wanted of the two entries that are decided.

    They are shown in every image, or only in an episode's first one. A decision earns 1 at most: without
    looking 0.4 (numbers) or 0.5 (choices), as each entry is wanted on either side equally often.
    """

    def __init__(self, agent: Agent, once: bool, seed: int) -> None:
        self._description, self._once = agent.description, once
        self._random = np.random.default_rng(seed)

    def start(self) -> np.ndarray:
        """New episodes in all rows; returns their first images."""
        self._wanted = self._random.integers(0, 2, (ROWS, 2))
        images = np.zeros((ROWS, 8, 8, 4), np.uint8)
        first, second = self._wanted.astype(bool).T
        images[first, 1:3, :, 0] = 255
        images[~first, 5:7, :, 0] = 255
        images[second, :, 1:3, 2] = 255
        images[~second, :, 5:7, 2] = 255
        self._images = images
        return images

    def step(self, actions: Arrays) -> tuple[np.ndarray, np.ndarray]:
        """What decisions earn, float32 [rows], and the next images."""
        decided = self._description.environment_action(actions)
        if self._description.kind.name == WAYPOINT_SET:
            places = np.array([CHOICES[entry] for entry in self._description.kind.entries])
            right = decided == np.take_along_axis(places, self._wanted.T, axis=1).T
            reward = right.mean(axis=1)
        else:
            reward = 1 - np.abs(decided - FAR * (2 * self._wanted - 1)).mean(axis=1)
        images = np.zeros_like(self._images) if self._once else self._images
        return reward.astype(np.float32), images


def explored(level: LevelDescription, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Noise and forced decisions of one level, float32 [rows, n]."""
    noise = random.standard_normal((ROWS, level.action_size))
    forced = np.full(noise.shape, np.nan)
    for column, action in enumerate(level.actions):
        if isinstance(action, Discrete):
            chosen = random.random(ROWS) < 0.2
            forced[chosen, column] = random.integers(len(action.choices), size=int(chosen.sum()))
        elif not isinstance(action.exploration, Sampled):
            noise[:, column] *= 0.5 * action.half_range
    return noise.astype(np.float32), forced.astype(np.float32)


def anything(level: LevelDescription, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Decisions drawn evenly from all that are possible."""
    columns = [
        random.uniform(*action.bounds, ROWS)
        if isinstance(action, Continuous)
        else random.integers(len(action.choices), size=ROWS)
        for action in level.actions
    ]
    forced = np.stack(columns, axis=1).astype(np.float32)
    return np.zeros_like(forced), forced


class Drive:
    """Drives episodes in all rows as an actor would, and stores each as two sequences."""

    def __init__(self, agent: Agent, task: Signs, seed: int) -> None:
        self._agent, self._task = agent, task
        self._random = np.random.default_rng(seed)
        self._motion = np.zeros((ROWS, 2), np.float32)

    def episode(self, explore: Any = None, replay: SequenceReplay | None = None) -> float:
        """Drive greedily, or as `explore` says; returns what a decision earns."""
        levels = self._agent.description.levels
        states = {level.name: np.zeros((ROWS, level.state_size), np.float32) for level in levels}
        images, earned = self._task.start(), []
        for _ in range(2):
            before, frames, decisions, rewards = states, [images], [], []
            for _ in range(EPISODE // 2):
                noise, forced = {}, {}
                if explore is not None:
                    for level in levels:
                        noise[level.name], forced[level.name] = explore(level, self._random)
                output = self._agent.act(images, self._motion, states, noise, forced)
                states = {**states, **output.states}
                reward, images = self._task.step(output.actions)
                frames.append(images)
                decisions.append(output.actions)
                rewards.append(reward)
            earned += rewards
            if replay is not None:
                self._store(replay, before, frames, decisions, rewards)
        return float(np.mean(earned))

    def _store(
        self,
        replay: SequenceReplay,
        states: Arrays,
        frames: list[np.ndarray],
        decisions: list[Arrays],
        rewards: list[np.ndarray],
    ) -> None:
        time = len(decisions)
        for row in range(ROWS):
            earned = np.stack([reward[row] for reward in rewards])
            replay.insert(
                Sequence(
                    images=np.stack([frame[row] for frame in frames]),
                    motion=np.zeros((time + 1, 2), np.float32),
                    actions={name: np.stack([each[name][row] for each in decisions]) for name in states},
                    rewards=dict.fromkeys(states, earned),
                    initial_state={name: state[row] for name, state in states.items()},
                    length=time,
                    terminated=False,
                )
            )


def learn(kind: str, settings: dict[str, Any], once: bool, enough: float, seed: int = 1) -> tuple[float, int]:
    """Train until a greedy decision earns enough, or for long; returns what it earns, and the rounds."""
    agent = make_agent(kind, {**SETTINGS, **settings}, observation=Observation(8), seed=seed)
    replay = make_replay(agent, 6000, EPISODE // 2, seed)
    drive = Drive(agent, Signs(agent, once, seed), seed)
    for _ in range(10):
        drive.episode(anything, replay)
    mean_return = 0.0
    for number in range(1, 101):
        drive.episode(explored, replay)
        for _ in range(8):
            agent.update(replay.sample(144))
        if number % 5 == 0:
            mean_return = float(np.mean([drive.episode() for _ in range(8)]))
            if mean_return > enough:
                return mean_return, number
    return mean_return, 101


LOOKING: list[tuple[str, dict[str, Any]]] = [
    ("athrl", {}),
    ("athrl", {"update_rule": "sac", "sac_temperature": 0.02}),
    ("hddpg", {}),
    ("ddpg", {"update_rule": "td3"}),
    ("ddpg", {"update_rule": "ddpg", "critic": "scalar", "critics": 1}),
    ("ddpg", {"update_rule": "sac", "sac_temperature": 0.02}),
    ("hdqn", {}),
    ("hdqn", {"double": False, "dueling": False, "critic": "scalar", "critics": 1}),
]


@pytest.mark.parametrize(("kind", "settings"), LOOKING)
def test_planner_learns_to_do_what_it_sees(kind: str, settings: dict[str, Any]) -> None:
    enough = 0.8
    assert learn(kind, settings, once=False, enough=enough)[0] > enough


@pytest.mark.parametrize(
    ("kind", "settings"),
    [
        ("athrl", {}),
        ("athrl", {"shared_trunk": False, "update_rule": "ddpg"}),
        ("hddpg", {}),
        ("ddpg", {"update_rule": "sac", "sac_temperature": 0.02}),
        ("hdqn", {}),
    ],
)
def test_planner_with_a_memory_learns_to_remember_what_it_saw(kind: str, settings: dict[str, Any]) -> None:
    """The first decision alone can be right without one: 1 + 5 * 0.5 of 6 for choices."""
    enough = 0.72
    assert learn(kind, {**settings, "memory": "lstm"}, once=True, enough=enough)[0] > enough
