"""A task that only a planner with a memory can do, learned within seconds on one thread."""

from collections.abc import Callable

import numpy as np
from athrl_planners import AtHRL, Sequence, SequenceReplay

EPISODE, CHUNK, ROWS = 8, 4, 16
LOW = {"intention": np.float32([0]), "trajectory": np.float32([0, -0.52])}
HIGH = {"intention": np.float32([2]), "trajectory": np.float32([7.95, 0.52])}
WANTED_SPEED, WANTED_ANGLE = 6.0, 0.3

Exploration = Callable[[dict[str, np.ndarray]], dict[str, np.ndarray]]


class CueTask:
    """The first image shows a bar to the left or right, later ones nothing; the waypoint shall stay there.

    A decision earns at most 100: half for the waypoint's angle, half for the target speed.
    """

    def __init__(self, seed: int) -> None:
        self._random = np.random.default_rng(seed)

    def start(self) -> np.ndarray:
        """New episodes in all rows; returns their first images."""
        self._side = self._random.choice([-1.0, 1.0], ROWS)
        images = np.zeros((ROWS, 16, 16, 4), np.uint8)
        images[self._side < 0, :, 2:6, 2] = 255
        images[self._side > 0, :, 10:14, 2] = 255
        return images

    def reward(self, trajectory: np.ndarray) -> np.ndarray:
        angle_error = np.abs(trajectory[:, 1] - WANTED_ANGLE * self._side) / 0.52
        speed_error = np.abs(trajectory[:, 0] - WANTED_SPEED) / 3.975
        return (100 - 50 * angle_error - 50 * speed_error).astype(np.float32)


class Driver:
    """Drives episodes in all rows as an actor would: in chunks, with the recurrent state at each start."""

    def __init__(self, agent: AtHRL, task: CueTask) -> None:
        self._agent = agent
        self._task = task
        self._motion = np.zeros((ROWS, 2), np.float32)

    def episode(self, explore: Exploration, replay: SequenceReplay | None) -> float:
        """Drive; returns the mean reward of a decision."""
        images = self._task.start()
        states = {
            level: np.zeros((ROWS, size), np.float32) for level, (_, size) in self._agent.level_sizes.items()
        }
        total = 0.0
        for _ in range(EPISODE // CHUNK):
            before, frames, decisions, rewards = states, [images], [], []
            for _ in range(CHUNK):
                greedy = self._agent.act(images, self._motion, states)
                actions, states = explore(greedy.actions), greedy.states
                images = np.zeros_like(images)
                frames.append(images)
                decisions.append(actions)
                rewards.append(self._task.reward(actions["trajectory"]))
            total += float(np.mean(rewards)) * CHUNK / EPISODE
            if replay is not None:
                self._store(replay, before, frames, decisions, rewards)
        return total

    def _store(
        self,
        replay: SequenceReplay,
        states: dict[str, np.ndarray],
        frames: list[np.ndarray],
        decisions: list[dict[str, np.ndarray]],
        rewards: list[np.ndarray],
    ) -> None:
        for row in range(ROWS):
            earned = np.stack([reward[row] for reward in rewards])
            sequence = Sequence(
                images=np.stack([frame[row] for frame in frames]),
                motion=np.zeros((CHUNK + 1, 2), np.float32),
                actions={level: np.stack([step[level][row] for step in decisions]) for level in LOW},
                rewards=dict.fromkeys(LOW, earned),
                initial_state={level: state[row] for level, state in states.items()},
                length=CHUNK,
                terminated=False,
            )
            replay.insert(sequence)


def test_agent_learns_to_remember_a_cue(make_agent: Callable[..., AtHRL]) -> None:
    agent = make_agent(discount=0.8, learning_rate=3e-3, average_decay=0.98, soft_target=0.02, burn_in=1)
    replay = SequenceReplay(4000, CHUNK, agent.observation, agent.level_sizes, seed=2)
    random = np.random.default_rng(3)

    def uniform(actions: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        return {
            level: random.uniform(LOW[level], HIGH[level], value.shape).astype(np.float32)
            for level, value in actions.items()
        }

    def noisy(actions: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
        noise = {level: random.normal(0, 0.1, value.shape) for level, value in actions.items()}
        return {
            level: np.clip(value + noise[level] * (HIGH[level] - LOW[level]), LOW[level], HIGH[level]).astype(
                np.float32
            )
            for level, value in actions.items()
        }

    driver = Driver(agent, CueTask(seed=4))
    by_chance = mean_reward(driver, uniform, replay)
    for round_number in range(1, 81):
        driver.episode(noisy, replay)
        for _ in range(8):
            agent.update(replay.sample(16))
        if round_number % 10 == 0:
            learned = mean_reward(driver, lambda actions: actions, None)
            if learned > 90:
                break

    # Without a memory the waypoint stays in the middle, which costs 29: at most 71 are left.
    assert learned > 90, f"a decision earns {learned:.1f}, by chance {by_chance:.1f}"
    assert by_chance < 50


def mean_reward(driver: Driver, explore: Exploration, replay: SequenceReplay | None) -> float:
    return float(np.mean([driver.episode(explore, replay) for _ in range(8)]))
