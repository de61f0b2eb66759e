"""What only a GPU can show: recorded updates there are those of the CPU, for every kind of planner."""

import copy
import logging

import pytest
import torch
from athrl_planners import make_agent
from athrl_planners.factories import make_replay
from athrl_spaces import Observation

pytestmark = pytest.mark.skipif(not torch.cuda.is_available(), reason="there is no GPU")

PLANNERS = [
    ("athrl", {"update_rule": "ddpg"}),
    ("athrl", {"update_rule": "ddpg", "memory": "lstm"}),
    ("athrl", {"update_rule": "ddpg", "memory": "lstm", "shared_trunk": False, "intention_every": 2}),
    ("hddpg", {"update_rule": "ddpg", "memory": "lstm"}),
    ("ddpg", {"update_rule": "ddpg", "critic": "scalar"}),
    ("hdqn", {}),
    ("hdqn", {"memory": "lstm"}),
]
RANDOM = [("athrl", {}), ("athrl", {"memory": "lstm"}), ("athrl", {"update_rule": "sac"}), ("hddpg", {})]
UPDATES = 12
SMALL_STEPS = {"learning_rate": 1e-5}
"""So that what is rounded otherwise does not grow from update to update."""


def agents_and_replays(kind, settings, new_sequence, precision=torch.float32):
    made = []
    for device in ("cpu", "cuda"):
        agent = make_agent(
            kind, settings, observation=Observation(16), seed=1, device=device, precision=precision
        )
        replay = make_replay(agent, 200, 5, seed=3)
        for seed in range(20):
            replay.insert(new_sequence(agent, seed, length=1 + seed % 5, terminated=seed % 3 == 0))
        made.append((agent, replay))
    return made


@pytest.fixture(autouse=True)
def _exact_products(monkeypatch):
    monkeypatch.setattr(torch.backends.cuda.matmul, "allow_tf32", False)
    monkeypatch.setattr(torch.backends.cudnn, "allow_tf32", False)


@pytest.mark.parametrize(("kind", "settings"), PLANNERS)
def test_update_on_a_gpu_is_that_on_a_cpu(new_sequence, caplog, kind, settings):
    (plain, first), (other, second) = agents_and_replays(kind, settings | SMALL_STEPS, new_sequence)
    with caplog.at_level(logging.WARNING):
        for _ in range(UPDATES):
            ours, theirs = plain.update(first.sample(20)), other.update(second.sample(20))
            for name in ours[0]:
                torch.testing.assert_close(ours[0][name], theirs[0][name].cpu(), rtol=5e-3, atol=5e-4)
            torch.testing.assert_close(ours[1], theirs[1].cpu(), rtol=5e-3, atol=5e-4)
    assert not caplog.records, "recorded without a warning"
    assert other._captured._recordings


@pytest.mark.parametrize("precision", [torch.float32, torch.bfloat16])
@pytest.mark.parametrize(("kind", "settings"), RANDOM)
def test_recorded_updates_with_noise_stay_finite_and_differ(new_sequence, caplog, kind, settings, precision):
    _, (agent, replay) = agents_and_replays(kind, settings, new_sequence, precision)
    with caplog.at_level(logging.WARNING):
        norms = [float(agent.update(replay.sample(20))[0]["critic_gradient"]) for _ in range(UPDATES)]
    assert not caplog.records
    assert agent._captured._recordings
    assert len(set(norms)) == UPDATES
    assert all(0 < norm < 1e6 for norm in norms)


@pytest.mark.parametrize("memory", ["none", "lstm"])
def test_saved_training_state_resumes_on_a_gpu(new_sequence, memory):
    settings = {"update_rule": "ddpg", "memory": memory}
    _, (agent, replay) = agents_and_replays("athrl", settings, new_sequence)
    for _ in range(UPDATES):
        agent.update(replay.sample(20))
    saved = copy.deepcopy(agent.state_dict())
    batch = replay.sample(20)
    fresh = make_agent("athrl", settings, observation=Observation(16), seed=9, device="cuda")
    fresh.load_state_dict(saved)
    metrics, errors = fresh.update(batch)
    expected, expected_errors = agent.update(batch)
    for name in expected:
        torch.testing.assert_close(expected[name], metrics[name], rtol=1e-3, atol=1e-4)
    torch.testing.assert_close(expected_errors, errors, rtol=1e-3, atol=1e-4)
