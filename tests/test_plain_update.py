"""What the planners' update is measured beside computes the same: equal losses on equal batches."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from athrl_planners import Agent, Sequence, SequenceReplay, make_agent
from athrl_planners.factories import make_replay

ROOT = Path(__file__).parents[1]
UPDATES = 8


@pytest.fixture(scope="module", autouse=True)
def _benchmarks() -> None:
    """Make the package known without its folder's neighbours, which have the names of packages."""
    folder = ROOT / "benchmarks"
    specification = importlib.util.spec_from_file_location(
        "benchmarks", folder / "__init__.py", submodule_search_locations=[str(folder)]
    )
    assert specification is not None
    sys.modules["benchmarks"] = importlib.util.module_from_spec(specification)


def filled(agent: Agent) -> SequenceReplay:
    """A replay with episodes that end in every way, at every length."""
    replay = make_replay(agent, 400, 10, seed=5)
    random = np.random.default_rng(7)
    seen, levels = agent.description.observation, agent.description.levels
    for number in range(replay.slots):
        replay.insert(
            Sequence(
                images=random.integers(0, 256, (11, *seen.image_shape), dtype=np.uint8),
                motion=random.normal(size=(11, 2)).astype(np.float32),
                actions={
                    level.name: random.uniform(level.low, level.high, (10, level.action_size)).astype("f4")
                    for level in levels
                },
                rewards={level.name: random.normal(0, 20, 10).astype(np.float32) for level in levels},
                initial_state={
                    level.name: random.uniform(-0.5, 0.5, level.state_size).astype("f4") for level in levels
                },
                length=1 + number % 10,
                terminated=number % 3 == 0,
            )
        )
    return replay


@pytest.mark.parametrize("memory", ["none", "lstm"])
def test_plain_update_has_the_same_losses(memory: str) -> None:
    from benchmarks.plain_update import PlainUpdate

    torch.set_num_threads(1)
    settings = {"memory": memory, "hidden_features": 24, "head_features": 32, "intention_features": 16}
    settings["recurrent_features"] = 8
    agent = make_agent("athrl", {**settings, "learning_rate": 1e-3}, seed=3)
    plain, replay = PlainUpdate(agent), filled(agent)
    compared = 0
    for number in range(UPDATES):
        batch = replay.sample(60)
        ours, _ = agent.update(batch, progress=number / UPDATES)
        theirs = plain.update(batch, progress=number / UPDATES)
        for name, loss in theirs.items():
            assert float(ours[name]) == pytest.approx(loss, rel=1e-5, abs=1e-5), (number, name)
            compared += 1
        assert set(theirs) == {name for name in ours if name.endswith("loss")}
    assert compared == 2 * UPDATES + 2 * (UPDATES // 2)
    # What training has made of the networks is the same, too, as far as eight steps of Adam can tell.
    for mine, averaged in zip(
        plain.average.trunk.parameters(), agent.state.averaged_trunks.parameters(), strict=True
    ):
        torch.testing.assert_close(mine, averaged, rtol=1e-3, atol=1e-4)
