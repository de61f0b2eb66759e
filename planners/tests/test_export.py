"""The artefact says and does what the agent does."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import onnx
import onnxruntime
import pytest
from athrl_planners import AtHRL, PolicyExporter, Sequence, SequenceBatch

MakeAgent = Callable[..., AtHRL]
Arrays = dict[str, np.ndarray]


@pytest.fixture
def trained(
    make_agent: MakeAgent,
    make_sequence: Callable[..., Sequence],
    stack: Callable[[list[Sequence]], SequenceBatch],
) -> AtHRL:
    """An agent whose published actors have left their beginnings, where all actions are in the middle."""
    agent = make_agent(learning_rate=3e-3, average_decay=0.5, actor_delay=1, saturation_penalty=0.5)
    batch = stack([make_sequence(seed) for seed in range(4)])
    for _ in range(40):
        agent.update(batch)
    return agent


def open_policy(artefact: bytes) -> onnxruntime.InferenceSession:
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    return onnxruntime.InferenceSession(artefact, options, providers=["CPUExecutionProvider"])


def observe(agent: AtHRL, batch: int, seed: int) -> Arrays:
    random = np.random.default_rng(seed)
    shape = (batch, *agent.observation.image_shape)
    return {
        "image": random.integers(0, 256, shape, dtype=np.uint8),
        "motion": random.uniform(-2, 2, (batch, 2)).astype(np.float32),
    }


def feed(agent: AtHRL, batch: int, seed: int = 0, noise: float = 0.0, forced: float = np.nan) -> Arrays:
    """Inputs at an episode's start."""
    sizes = agent.level_sizes
    return {
        **observe(agent, batch, seed),
        **{f"{level}_state": np.zeros((batch, size), np.float32) for level, (_, size) in sizes.items()},
        "intention_noise": np.full((batch, 1), noise, np.float32),
        "forced_intention": np.full((batch, 1), forced, np.float32),
    }


def run(session: onnxruntime.InferenceSession, inputs: Arrays) -> Arrays:
    names = [output.name for output in session.get_outputs()]
    return dict(zip(names, session.run(names, inputs), strict=True))


def assert_same_over_a_drive(agent: AtHRL, batch: int, steps: int = 25) -> None:
    session = open_policy(PolicyExporter(agent).artefact())
    random = np.random.default_rng(batch)
    states = {level: np.zeros((batch, size), np.float32) for level, (_, size) in agent.level_sizes.items()}
    carried = dict(states)
    for step in range(steps):
        seen = observe(agent, batch, step)
        noise = random.normal(0, 0.5, (batch, 1)).astype(np.float32)
        forced = random.uniform(0, 2, (batch, 1)).astype(np.float32)
        forced[random.random((batch, 1)) < 0.7] = np.nan
        expected = agent.act(
            seen["image"], seen["motion"], states, {"intention": noise}, {"intention": forced}
        )
        extra = {"intention_noise": noise, "forced_intention": forced}
        outputs = run(session, {**seen, **{f"{level}_state": carried[level] for level in states}, **extra})
        states = expected.states
        carried = {level: outputs[f"next_{level}_state"] for level in states}
        for level in states:
            np.testing.assert_allclose(outputs[level], expected.actions[level], atol=1e-5, rtol=0)
            np.testing.assert_allclose(carried[level], states[level], atol=1e-5, rtol=0)


@pytest.mark.parametrize("batch", [1, 7])
def test_onnx_runtime_and_torch_agree_over_a_drive(trained: AtHRL, batch: int) -> None:
    assert_same_over_a_drive(trained, batch)


@pytest.mark.parametrize("image_size", [32, 64])
def test_they_agree_at_the_sizes_of_a_run(make_agent: MakeAgent, image_size: int) -> None:
    agent = make_agent(image_size=image_size, hidden_features=128, recurrent_features=64)
    assert_same_over_a_drive(agent, batch=2, steps=20)


def test_the_intention_reaches_the_trajectory_planner(trained: AtHRL) -> None:
    session = open_policy(PolicyExporter(trained).artefact())
    free = run(session, feed(trained, 3))
    noisy = run(session, feed(trained, 3, noise=0.3))
    left, right = (run(session, feed(trained, 3, forced=intention)) for intention in (0.0, 2.0))
    for one, other in ((free, noisy), (left, right)):
        assert np.abs(one["trajectory"] - other["trajectory"]).max(axis=1).min() > 1e-4


def test_an_intention_is_used_as_it_is_never_rounded(trained: AtHRL) -> None:
    session = open_policy(PolicyExporter(trained).artefact())
    outputs = [run(session, feed(trained, 1, forced=forced)) for forced in (1.6, 1.7, 1.8, 1.9, 2.0)]
    np.testing.assert_allclose([output["intention"][0, 0] for output in outputs], [1.6, 1.7, 1.8, 1.9, 2.0])
    trajectories = {tuple(output["trajectory"][0]) for output in outputs}
    assert len(trajectories) == 5


def test_noise_is_added_within_the_range_and_a_forced_intention_has_none(trained: AtHRL) -> None:
    session = open_policy(PolicyExporter(trained).artefact())
    greedy = run(session, feed(trained, 2))["intention"]
    noisy = run(session, feed(trained, 2, noise=0.05))["intention"]
    np.testing.assert_allclose(noisy, np.minimum(greedy + 0.05, 2), atol=1e-6)
    np.testing.assert_array_equal(run(session, feed(trained, 2, noise=9))["intention"], 2)
    np.testing.assert_array_equal(run(session, feed(trained, 2, noise=-9))["intention"], 0)
    np.testing.assert_allclose(run(session, feed(trained, 2, noise=9, forced=0.7))["intention"], 0.7)


def test_each_level_carries_a_state_of_its_own(trained: AtHRL) -> None:
    session = open_policy(PolicyExporter(trained).artefact())
    fresh = feed(trained, 2)
    before = run(session, fresh)
    for level, other in (("intention", "trajectory"), ("trajectory", "intention")):
        carried = {**fresh, f"{level}_state": before[f"next_{level}_state"]}
        after = run(session, carried)
        assert np.abs(after[f"next_{level}_state"] - before[f"next_{level}_state"]).max() > 1e-4
        assert np.abs(after[level] - before[level]).max() > 1e-6
        np.testing.assert_array_equal(after[f"next_{other}_state"], before[f"next_{other}_state"])


def test_a_publication_has_the_newest_weights_in_the_same_graph(
    trained: AtHRL, make_sequence: Callable[..., Sequence], stack: Callable[..., SequenceBatch]
) -> None:
    exporter = PolicyExporter(trained)
    before = exporter.artefact()
    assert exporter.artefact() == before
    trained.update(stack([make_sequence(9)]))
    after = exporter.artefact()
    assert after == PolicyExporter(trained).artefact()
    old, new = onnx.load_from_string(before), onnx.load_from_string(after)
    assert [node.name for node in old.graph.node] == [node.name for node in new.graph.node]
    seen = feed(trained, 2)
    assert (
        np.abs(
            run(open_policy(before), seen)["trajectory"] - run(open_policy(after), seen)["trajectory"]
        ).max()
        > 0
    )


def test_publishing_for_a_week_takes_no_more_memory(make_agent: MakeAgent) -> None:
    exporter = PolicyExporter(make_agent())
    size = len(exporter.artefact())
    for _ in range(20):  # until freed memory is used again
        exporter.artefact()
    before = resident_bytes()
    for _ in range(200):
        exporter.artefact()
    assert resident_bytes() - before < 20 * size


def resident_bytes() -> int:
    """Memory that this process has."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


def test_the_metadata_describes_observation_states_actions_and_noise(make_agent: MakeAgent) -> None:
    model = onnx.load_from_string(PolicyExporter(make_agent()).artefact())
    metadata = json.loads({entry.key: entry.value for entry in model.metadata_props}["athrl"])
    assert metadata == {
        "schema_version": 1,
        "planner": "athrl",
        "observation": {"image": [16, 16, 4], "motion": ["speed_over_8", "steering_over_0.3"]},
        "levels": [
            {
                "name": "intention",
                "state_size": 32,
                "actions": [
                    {
                        "name": "intention",
                        "unit": "",
                        "low": 0.0,
                        "high": 2.0,
                        "noise": "ornstein-uhlenbeck",
                        "noise_scale": 0.2,
                        "damping": 0.15,
                    }
                ],
            },
            {
                "name": "trajectory",
                "state_size": 32,
                "actions": [
                    {
                        "name": "target_speed",
                        "unit": "m/s",
                        "low": 0.0,
                        "high": 7.95,
                        "noise": "ornstein-uhlenbeck",
                        "noise_scale": 0.2,
                        "damping": 0.15,
                    },
                    {
                        "name": "waypoint_angle",
                        "unit": "rad",
                        "low": -0.52,
                        "high": 0.52,
                        "noise": "gaussian",
                        "noise_scale": 0.1,
                        "damping": 0.0,
                    },
                ],
            },
        ],
    }
