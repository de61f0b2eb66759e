"""What the levels of a hierarchy see: all of it, or each its own part."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from athrl_planners import Agent, Sequence, SequenceReplay

SIZE = 32
FAR_ROW, NEAR_ROW = 4, 18  # the ego is 12 m above the lower edge of 32 m, so in row 20


@pytest.fixture
def changed_by(
    new_agent: Callable[..., Agent],
    new_sequence: Callable[..., Sequence],
    replay_of: Callable[..., SequenceReplay],
) -> Callable[..., dict[str, bool]]:
    """Whether each level decides something else when a row of one channel of the image lights up."""

    def find(channel: str, row: int, **settings: Any) -> dict[str, bool]:
        agent = new_agent(image_size=SIZE, learning_rate=1e-2, average_decay=0.2, **settings)
        replay = replay_of(agent, [new_sequence(agent, seed) for seed in range(2)])
        for _ in range(6):
            agent.update(replay.sample(10))
        dark = np.zeros((1, *agent.description.observation.image_shape), np.uint8)
        lit = dark.copy()
        lit[:, row, :, agent.description.observation.channels.index(channel)] = 255
        # The intention is forced for the trajectory, which would change with it.
        decided = {}
        for level, forced in (("intention", {}), ("trajectory", {"intention": np.ones((1, 1), np.float32)})):
            one, other = (
                agent.act(images, np.zeros((1, 2), np.float32), {}, None, forced).actions[level]
                for images in (dark, lit)
            )
            decided[level] = not np.array_equal(one, other)
        return decided

    return find


@pytest.mark.parametrize(
    ("channel", "row", "high", "low"),
    [
        ("route", FAR_ROW, True, False),
        ("route", NEAR_ROW, True, True),
        ("vehicles", FAR_ROW, False, True),
        ("lidar", NEAR_ROW, False, True),
        ("drivable", FAR_ROW, True, True),
    ],
)
def test_levels_see_what_their_views_leave(
    changed_by: Callable[..., dict[str, bool]], channel: str, row: int, high: bool, low: bool
) -> None:
    seen = changed_by(channel, row, intention_view="far route", trajectory_view="near route")
    assert seen == {"intention": high, "trajectory": low}


def test_levels_see_everything_unless_they_are_told_otherwise(
    changed_by: Callable[..., dict[str, bool]],
) -> None:
    for channel in ("route", "vehicles"):
        assert changed_by(channel, FAR_ROW) == {"intention": True, "trajectory": True}


def test_levels_of_different_views_have_trunks_of_their_own(new_agent: Callable[..., Agent]) -> None:
    trunks = [
        len(list(agent.state.online_trunks))
        for agent in (
            new_agent(),
            new_agent(shared_trunk=False),
            new_agent(trajectory_view="near route"),
            new_agent("hddpg", shared_trunk=False),
        )
    ]
    assert trunks == [1, 2, 2, 1]
