"""What a checkpoint keeps of a planner: training continues bit for bit; what does not fit changes nothing."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
import torch
from athrl_planners import Agent, PolicyExporter, Sequence, SequenceReplay

NewAgent = Callable[..., Agent]
PLANNERS: list[tuple[str, dict[str, Any]]] = [
    ("athrl", {}),
    ("athrl", {"memory": "lstm", "shared_trunk": False, "intention_every": 2}),
    ("athrl", {"update_rule": "sac", "mirror": True}),
    ("hddpg", {"memory": "lstm", "update_rule": "ddpg", "critic": "scalar", "critics": 1}),
    ("ddpg", {"mirror": True}),
    ("hdqn", {"mirror": True}),
    ("hdqn", {"memory": "lstm", "dueling": False}),
]


def tensors(state: Any) -> list[torch.Tensor]:
    if isinstance(state, torch.Tensor):
        return [state]
    parts = state.values() if isinstance(state, Mapping) else state if isinstance(state, list) else ()
    return [tensor for part in parts for tensor in tensors(part)]


def equal(one: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    plain = [{key: one[key] for key in ("kind", "updates", "mirroring")} for one in (one, other)]
    ours, theirs = tensors(one), tensors(other)
    return plain[0] == plain[1] and len(ours) == len(theirs) and all(map(torch.equal, ours, theirs))


def saved(agent: Agent) -> dict[str, Any]:
    """The state by way of a file that may hold nothing but tensors and plain values."""
    file = io.BytesIO()
    torch.save(agent.state_dict(), file)
    file.seek(0)
    return torch.load(file, weights_only=True)


@pytest.fixture
def experience(
    new_sequence: Callable[..., Sequence], replay_of: Callable[..., SequenceReplay]
) -> Callable[[Agent], SequenceReplay]:
    return lambda agent: replay_of(agent, [new_sequence(agent, seed, terminated=True) for seed in range(3)])


@pytest.mark.parametrize(("kind", "settings"), PLANNERS)
def test_resumed_training_is_the_same_bit_for_bit(
    new_agent: NewAgent,
    experience: Callable[[Agent], SequenceReplay],
    kind: str,
    settings: dict[str, Any],
) -> None:
    straight, first, second = (new_agent(kind, seed=seed, **settings) for seed in (1, 1, 2))
    replays = {id(agent): experience(agent) for agent in (straight, first)}

    def train(agent: Agent, replay: SequenceReplay) -> None:
        for progress in (0.1, 0.2, 0.3):
            agent.update(replay.sample(15), progress)

    for agent in (straight, first):
        train(agent, replays[id(agent)])
    second.load_state_dict(saved(first))
    assert equal(second.state_dict(), first.state_dict())
    train(straight, replays[id(straight)])
    train(second, replays[id(first)])
    assert second.updates == straight.updates == 6
    assert equal(second.state_dict(), straight.state_dict())
    assert PolicyExporter(second).artefact() == PolicyExporter(straight).artefact()


def test_state_that_was_loaded_is_not_shared(
    new_agent: NewAgent, experience: Callable[[Agent], SequenceReplay]
) -> None:
    agent, other = new_agent(), new_agent(seed=2)
    other.load_state_dict(agent.state_dict())
    before = saved(agent)
    other.update(experience(other).sample(15))
    assert equal(agent.state_dict(), before)


@pytest.mark.parametrize(
    ("kind", "settings", "message"),
    [
        ("hddpg", {}, "the state is of a planner of kind 'hddpg'; this one is 'athrl'"),
        ("athrl", {"hidden_features": 24}, r"has shape \[24, \d+\]; it should be \[16, \d+\]"),
        ("athrl", {"atoms": 21}, r"has shape \[21, 64\]; it should be \[11, 64\]"),
        ("athrl", {"critics": 1}, "the planner's state lacks levels.intention.online.critics.1"),
        ("athrl", {"memory": "lstm"}, r"has [\w.]*trunks.intention.memory[\w.]*, which this planner"),
        ("athrl", {"shared_trunk": False}, r"has [\w.]*trunks.trajectory[\w.]*, which this planner"),
        ("athrl", {"update_rule": "sac"}, r"has levels.intention.rule.log_temperature, which this"),
        ("athrl", {"image_size": 16}, r"has shape \[\d+(, \d+)*\]; it should be \["),
    ],
)
def test_state_that_does_not_fit_changes_nothing(
    new_agent: NewAgent,
    experience: Callable[[Agent], SequenceReplay],
    kind: str,
    settings: dict[str, Any],
    message: str,
) -> None:
    agent, other = new_agent(), new_agent(kind, **settings)
    other.update(experience(other).sample(15))
    before = saved(agent)
    with pytest.raises(ValueError, match=message) as refused:
        agent.load_state_dict(other.state_dict())
    assert "\n" not in str(refused.value)
    assert equal(agent.state_dict(), before)


def test_state_of_an_earlier_release_changes_nothing(new_agent: NewAgent) -> None:
    agent = new_agent()
    before = saved(agent)
    old = {"kind": "athrl", "updates": 7, "noise": torch.zeros(3), "levels": {}}
    with pytest.raises(ValueError, match="the planner's state lacks 'actor_optimiser'; it is of another"):
        agent.load_state_dict(old)
    assert equal(agent.state_dict(), before)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("mirroring", [1, 2]),
        ("critic_optimiser", {"state": {0: {}}}),
        ("actor_optimiser", {"state": {0: {}}}),
    ],
)
def test_damaged_part_of_a_state_changes_nothing(
    new_agent: NewAgent, experience: Callable[[Agent], SequenceReplay], key: str, value: Any
) -> None:
    agent, other = new_agent(), new_agent(seed=2)
    other.update(experience(other).sample(15))
    before = saved(agent)
    with pytest.raises(ValueError, match=r"generator's state|optimiser's"):
        agent.load_state_dict({**other.state_dict(), key: value})
    assert equal(agent.state_dict(), before)


def test_state_of_another_kind_of_device_continues_with_noise_of_its_own(
    new_agent: NewAgent, experience: Callable[[Agent], SequenceReplay]
) -> None:
    agent = new_agent()
    agent.update(experience(agent).sample(15))
    state = {
        **agent.state_dict(),
        "noise": [torch.zeros(16, dtype=torch.uint8)],
    }  # as a GPU's generator has it
    first, second = new_agent(), new_agent()
    for successor in (first, second):
        successor.load_state_dict(state)
        successor.update(experience(successor).sample(15))
    assert first.updates == 2
    assert equal(first.state_dict(), second.state_dict())
    assert not np.array_equal(first.state_dict()["noise"][0], new_agent().state_dict()["noise"][0])
