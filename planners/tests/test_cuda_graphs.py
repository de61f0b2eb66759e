"""An update from fixed buffers, as it is recorded on a GPU, equals the usual update."""

import logging
from collections.abc import Callable

import pytest
import torch
from athrl_planners import Agent
from athrl_planners.factories import make_replay
from athrl_planners.training import cuda_graphs
from athrl_planners.training.cuda_graphs import CapturedUpdate, Recording
from torch import Tensor

UPDATES = 12
PLANNERS = [
    ("athrl", {}),
    ("athrl", {"update_rule": "sac"}),
    ("athrl", {"intention_every": 2, "mirror": True}),
    ("ddpg", {"update_rule": "ddpg", "critic": "scalar"}),
    ("hdqn", {}),
]


def out_of_buffers(agent: Agent) -> CapturedUpdate:
    """Let an agent on a CPU update as one on a GPU does."""
    parameters = [*agent.state.critic_parameters, *agent.state.actor_parameters]
    generator = agent.state.noise.generators[0]
    agent._captured = CapturedUpdate(agent._compute, parameters, generator, agent.device)
    return agent._captured


def all_tensors(state: object) -> list[Tensor]:
    if isinstance(state, dict):
        return [tensor for value in state.values() for tensor in all_tensors(value)]
    return [state] if isinstance(state, Tensor) else []


def train_both(plain: Agent, other: Agent, new_sequence: Callable) -> None:
    """Train both on the same batches; all that they say and all that they become is the same."""
    replays = [make_replay(agent, 100, 5, seed=3) for agent in (plain, other)]
    for replay in replays:
        for seed in range(12):
            replay.insert(new_sequence(plain, seed, length=1 + seed % 5, terminated=seed % 3 == 0))
    said = []
    for update in range(UPDATES):
        decisions = 16 if update < UPDATES - 1 else 8  # the last one is of another shape
        ours, theirs = (
            agent.update(replay.sample(decisions), progress=update / UPDATES)
            for agent, replay in zip((plain, other), replays, strict=True)
        )
        said.append(theirs)
        assert list(ours[0]) == list(theirs[0])
        assert all(torch.equal(ours[0][name], theirs[0][name]) for name in ours[0])
        assert torch.equal(ours[1], theirs[1])
    assert plain.updates == other.updates == UPDATES
    for ours, theirs in zip(*(all_tensors(agent.state_dict()) for agent in (plain, other)), strict=True):
        assert torch.equal(ours, theirs)
    assert len({float(metrics["critic_gradient"]) for metrics, _ in said}) == UPDATES, "results overwritten"


@pytest.mark.parametrize(("kind", "settings"), PLANNERS)
def test_update_out_of_buffers_is_the_plain_one(new_agent, new_sequence, kind, settings):
    plain, other = new_agent(kind, **settings), new_agent(kind, **settings)
    out_of_buffers(other)
    train_both(plain, other, new_sequence)


def played_back(compute: Callable, generator: torch.Generator, stream: object) -> Recording:
    """A recording as a CUDA graph is one: it has run nothing yet, and leaves its results in one place."""
    results: list[tuple[list[str], Tensor, Tensor]] = []
    metrics, errors = torch.zeros(0), torch.zeros(0)

    def replay() -> None:
        said, wrong = compute()
        results.append((list(said), torch.stack(list(said.values())), wrong))
        recording._names = results[-1][0]
        recording._metrics.resize_(len(said)).copy_(results[-1][1])
        recording._errors.resize_(wrong.shape).copy_(wrong)

    recording = Recording(replay, [], metrics, errors)
    return recording


@pytest.mark.parametrize(("kind", "settings"), PLANNERS)
def test_recordings_are_played_with_each_batch_and_step_size(
    new_agent, new_sequence, monkeypatch, kind, settings
):
    recorded = []
    monkeypatch.setattr(cuda_graphs, "record", lambda *given: recorded.append(given) or played_back(*given))
    plain, other = new_agent(kind, **settings), new_agent(kind, **settings)
    out_of_buffers(other)._records = True
    train_both(plain, other, new_sequence)
    delayed = kind == "athrl" and settings.get("update_rule", "td3") == "td3"
    assert len(recorded) == (2 if delayed else 1), "with and without the actors' step"


def test_recording_that_fails_is_told_once_and_updates_run_one_by_one(
    new_agent, new_sequence, monkeypatch, caplog
):
    plain, other = new_agent(), new_agent()

    def fail(compute: Callable, *_: object) -> None:
        other.state.critic_parameters[0].grad = torch.ones_like(other.state.critic_parameters[0])
        raise RuntimeError("operation not permitted\nwhen stream is capturing")

    monkeypatch.setattr(cuda_graphs, "record", fail)
    out_of_buffers(other)._records = True
    with caplog.at_level(logging.WARNING):
        train_both(plain, other, new_sequence)
    (record,) = caplog.records
    assert "run without a CUDA graph" in record.message
    assert "not permitted when stream is capturing" in record.message


WITH_MEMORY = [
    ("athrl", {"update_rule": "ddpg"}),
    ("athrl", {"update_rule": "ddpg", "intention_every": 2, "n_step": 3}),
    ("hdqn", {}),
]


@pytest.mark.parametrize(("kind", "settings"), WITH_MEMORY)
def test_sequences_with_padding_are_trained_like_those_without(new_agent, new_sequence, kind, settings):
    plain, other = (new_agent(kind, memory="lstm", burn_in=2, **settings) for _ in range(2))
    other.prepare._constant_shapes = True
    replays = [make_replay(agent, 100, 5, seed=3) for agent in (plain, other)]
    for replay in replays:
        for seed in range(12):
            replay.insert(new_sequence(plain, seed, length=1 + seed % 5, terminated=seed % 3 == 0))
    for _ in range(UPDATES):
        ours, theirs = (
            agent.update(replay.sample(16)) for agent, replay in zip((plain, other), replays, strict=True)
        )
        for name in ours[0]:
            torch.testing.assert_close(ours[0][name], theirs[0][name], rtol=1e-4, atol=1e-5)
        torch.testing.assert_close(ours[1], theirs[1], rtol=1e-4, atol=1e-5)


def test_sequences_of_all_lengths_are_one_recording(new_agent, new_sequence, monkeypatch):
    recorded = []
    monkeypatch.setattr(cuda_graphs, "record", lambda *given: recorded.append(given) or played_back(*given))
    plain, other = (new_agent("ddpg", memory="lstm", update_rule="ddpg") for _ in range(2))
    for agent in (plain, other):
        agent.prepare._constant_shapes = True
    out_of_buffers(other)._records = True
    train_both(plain, other, new_sequence)
    assert len(recorded) == 1


def test_sequences_without_padding_are_not_recorded(new_agent, new_sequence, stack):
    agent = new_agent(memory="lstm")
    assert not CapturedUpdate.takes(agent.prepare(stack([new_sequence(agent, 1), new_sequence(agent, 2, 3)])))
