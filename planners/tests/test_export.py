"""The artefact says and does what the agent does."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import onnxruntime
import pytest
from athrl_planners import Agent, PolicyExporter, Sequence, SequenceReplay
from athrl_spaces import Continuous, PolicyDescription, Sampled

Arrays = dict[str, np.ndarray]
NewAgent = Callable[..., Agent]

PLANNERS: dict[str, dict[str, Any]] = {
    "athrl": {},
    "athrl, ddpg, as in the paper": {
        "update_rule": "ddpg",
        "memory": "lstm",
        "shared_trunk": False,
        "critic": "scalar",
        "critics": 1,
        "encoder": "paper",
    },
    "athrl, sac": {"update_rule": "sac"},
    "athrl, sac, one memory": {"update_rule": "sac", "memory": "lstm"},
    "athrl, td3, two memories": {"memory": "lstm", "shared_trunk": False},
    "athrl, held": {"intention_every": 3},
    "athrl, held, one memory": {"intention_every": 3, "memory": "lstm"},
    "athrl, held, two memories": {"intention_every": 2, "memory": "lstm", "shared_trunk": False},
    "athrl, views": {"intention_view": "far route", "trajectory_view": "near route"},
    "athrl, views, memory": {"trajectory_view": "near route", "memory": "lstm"},
    "hddpg": {},
    "hddpg, ddpg, memory": {"update_rule": "ddpg", "memory": "lstm"},
    "hddpg, sac": {"update_rule": "sac"},
    "ddpg": {},
    "ddpg, sac, memory": {"update_rule": "sac", "memory": "lstm"},
    "hdqn": {},
    "hdqn, scalar, not dueling": {"critic": "scalar", "dueling": False, "double": False},
    "hdqn, one memory": {"memory": "lstm"},
    "hdqn, two memories": {"memory": "lstm", "shared_trunk": False},
}


class Published:
    """An agent, its exporter, which was made before training, and the artefact of the moment."""

    def __init__(self, agent: Agent, replay: SequenceReplay) -> None:
        self.agent, self.replay = agent, replay
        self.exporter = PolicyExporter(agent)
        for _ in range(12):
            self.train()

    def train(self) -> None:
        self.agent.update(self.replay.sample(20))

    def session(self) -> onnxruntime.InferenceSession:
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        return onnxruntime.InferenceSession(
            self.exporter.artefact(), options, providers=["CPUExecutionProvider"]
        )


@pytest.fixture
def publish(
    new_agent: NewAgent, new_sequence: Callable[..., Sequence], replay_of: Callable[..., SequenceReplay]
) -> Callable[[str], Published]:
    """A planner of the table that has left its beginnings, where all actions are in the middle."""

    def make(name: str) -> Published:
        settings = {"learning_rate": 1e-2, "average_decay": 0.2, **PLANNERS[name]}
        agent = new_agent(name.split(",")[0], **settings)
        return Published(agent, replay_of(agent, [new_sequence(agent, seed) for seed in range(4)]))

    return make


def run(session: onnxruntime.InferenceSession, inputs: Arrays) -> Arrays:
    names = [output.name for output in session.get_outputs()]
    return dict(zip(names, session.run(names, inputs), strict=True))


def explore(agent: Agent, batch: int, random: np.random.Generator) -> tuple[Arrays, Arrays]:
    """Noise of each level that takes it, and decisions that a third of the rows is forced to."""
    noise, forced = {}, {}
    for level in agent.description.levels:
        shape = (batch, level.action_size)
        if all(isinstance(action, Continuous) for action in level.actions):
            scale = (level.high - level.low) / 4
            noise[level.name] = random.normal(0, scale, shape).astype(np.float32)
            values = random.uniform(level.low, level.high, shape)
        else:
            values = random.integers(level.high + 1, size=shape)
        free = random.random(shape) > 1 / 3
        forced[level.name] = np.where(free, np.nan, values).astype(np.float32)
    return noise, forced


def observe(agent: Agent, batch: int, random: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    shape = (batch, *agent.description.observation.image_shape)
    images = random.integers(0, 256, shape, dtype=np.uint8)
    return images, random.uniform(-2, 2, (batch, 2)).astype(np.float32)


def initial_states(agent: Agent, batch: int) -> Arrays:
    levels = agent.description.levels
    return {level.name: np.zeros((batch, level.state_size), np.float32) for level in levels}


def assert_same_over_a_drive(published: Published, batch: int, steps: int = 12) -> None:
    session, agent = published.session(), published.agent
    random = np.random.default_rng(batch)
    states = initial_states(agent, batch)
    carried = dict(states)
    for _ in range(steps):
        images, motion = observe(agent, batch, random)
        noise, forced = explore(agent, batch, random)
        expected = agent.act(images, motion, states, noise, forced)
        outputs = run(
            session,
            {
                "image": images,
                "motion": motion,
                **{f"{name}_state": state for name, state in carried.items() if state.shape[1]},
                **{f"{name}_noise": values for name, values in noise.items()},
                **{f"forced_{name}": values for name, values in forced.items()},
            },
        )
        for level in agent.description.levels:
            np.testing.assert_allclose(outputs[level.name], expected.actions[level.name], atol=2e-5, rtol=0)
            assert (level.name in expected.states) == (level.state_size > 0)
        states = expected.states
        carried = {name: outputs[f"next_{name}_state"] for name in states}
        for name, state in states.items():
            np.testing.assert_allclose(carried[name], state, atol=2e-5, rtol=0)


@pytest.mark.parametrize("name", PLANNERS)
def test_onnx_runtime_and_torch_agree_over_a_drive(publish: Callable[[str], Published], name: str) -> None:
    published = publish(name)
    for batch in (1, 7):
        assert_same_over_a_drive(published, batch)


@pytest.mark.parametrize("image_size", [32, 64])
@pytest.mark.parametrize("encoder", ["small", "paper"])
def test_they_agree_at_the_sizes_of_a_run(
    new_agent: NewAgent,
    new_sequence: Callable[..., Sequence],
    replay_of: Callable[..., SequenceReplay],
    image_size: int,
    encoder: str,
) -> None:
    agent = new_agent(image_size=image_size, encoder=encoder, memory="lstm", average_decay=0.2)
    published = Published(agent, replay_of(agent, [new_sequence(agent, 1)]))
    assert_same_over_a_drive(published, batch=2, steps=3)


@pytest.mark.parametrize("name", ["athrl", "athrl, td3, two memories", "hdqn"])
def test_every_weight_can_be_replaced(publish: Callable[[str], Published], name: str) -> None:
    """Fresh networks have many equal weights, which an exporter takes for one if it is allowed to."""
    published = publish(name)
    model = onnx.load_from_string(published.exporter.artefact())
    weights = {initializer.name: initializer for initializer in model.graph.initializer}
    for key, tensor in published.agent.policy.state_dict().items():
        stored = onnx.numpy_helper.to_array(weights[f"policy.{key}"])
        np.testing.assert_array_equal(stored, tensor.numpy(), err_msg=key)


@pytest.mark.parametrize("name", ["athrl, held, two memories", "athrl, sac", "hdqn"])
def test_noise_and_forcing_are_taken_at_every_level(publish: Callable[[str], Published], name: str) -> None:
    published = publish(name)
    session, agent = published.session(), published.agent
    images, motion = observe(agent, 3, np.random.default_rng(1))
    levels = agent.description.levels
    inputs: Arrays = {
        "image": images,
        "motion": motion,
        **{
            f"{level.name}_state": np.zeros((3, level.state_size), np.float32)
            for level in levels
            if level.state_size
        },
    }
    for level in levels:
        nothing = np.full((3, level.action_size), np.nan, np.float32)
        inputs[f"forced_{level.name}"] = nothing
        if isinstance(level.actions[0], Continuous):
            inputs[f"{level.name}_noise"] = np.zeros_like(nothing)
    free = run(session, inputs)
    for level in levels:
        column = level.actions[-1]
        last = np.full((3, level.action_size), column.bounds[1], np.float32)
        last[:, :-1] = level.high[:-1]
        forced = run(session, {**inputs, f"forced_{level.name}": last})
        np.testing.assert_allclose(forced[level.name], last, rtol=1e-6)
        if not isinstance(column, Continuous):
            continue
        if isinstance(column.exploration, Sampled):
            up, down = (
                run(session, {**inputs, f"{level.name}_noise": np.full_like(last, sign)}) for sign in (1, -1)
            )
            assert (up[level.name] > free[level.name]).all()
            assert (down[level.name] < free[level.name]).all()
            continue
        small = 0.01 * (level.high - level.low)
        noisy = run(session, {**inputs, f"{level.name}_noise": np.tile(small, (3, 1))})
        expected = np.minimum(free[level.name] + small, level.high)
        np.testing.assert_allclose(noisy[level.name], expected, atol=1e-5)
        much = run(session, {**inputs, f"{level.name}_noise": np.full_like(last, -99)})
        np.testing.assert_allclose(much[level.name], np.tile(level.low, (3, 1)), atol=1e-6)
        both = {f"{level.name}_noise": np.full_like(last, -99), f"forced_{level.name}": last}
        np.testing.assert_allclose(run(session, {**inputs, **both})[level.name], last, rtol=1e-6)


def test_held_decision_stays_as_long_as_it_should(publish: Callable[[str], Published]) -> None:
    agent = publish("athrl, held").agent
    random = np.random.default_rng(1)
    states, decided = initial_states(agent, 4), []
    for _ in range(9):
        noise = {"intention": random.uniform(-1.5, -0.1, (4, 1)).astype(np.float32)}
        output = agent.act(*observe(agent, 4, random), states, noise)
        states = {**states, **output.states}
        decided.append(output.actions["intention"])
    blocks = np.stack(decided).reshape(3, 3, 4)
    np.testing.assert_array_equal(blocks, np.broadcast_to(blocks[:, :1], blocks.shape))
    assert (blocks[0, 0] != blocks[1, 0]).all()


def test_publication_has_the_newest_weights_in_the_same_graph(publish: Callable[[str], Published]) -> None:
    published = publish("athrl")
    before = published.exporter.artefact()
    assert published.exporter.artefact() == before
    published.train()
    after = published.exporter.artefact()
    assert after == PolicyExporter(published.agent).artefact() != before
    old, new = onnx.load_from_string(before), onnx.load_from_string(after)
    assert [node.name for node in old.graph.node] == [node.name for node in new.graph.node]


@pytest.mark.parametrize("name", ["athrl, held, two memories", "ddpg, sac, memory", "hdqn"])
def test_metadata_is_the_agents_description(publish: Callable[[str], Published], name: str) -> None:
    published = publish(name)
    model = onnx.load_from_string(published.exporter.artefact())
    metadata = {entry.key: entry.value for entry in model.metadata_props}
    assert PolicyDescription.from_json(metadata["athrl"]) == published.agent.description


@pytest.mark.parametrize(
    ("reward", "paid"), [("task", ()), ("progress", ("collision", "speed", "fast", "out", "constant"))]
)
def test_intention_is_paid_what_its_setting_says(new_agent: NewAgent, reward: str, paid: tuple[str]) -> None:
    agent = new_agent("athrl", image_size=32, intention_reward=reward, intention_target="experience")
    model = onnx.load_from_string(PolicyExporter(agent).artefact())
    metadata = {entry.key: entry.value for entry in model.metadata_props}
    levels = PolicyDescription.from_json(metadata["athrl"]).levels
    assert {level.name: level.rewarded for level in levels} == {"intention": paid, "trajectory": ()}


def test_publishing_for_a_week_takes_no_more_memory(new_agent: NewAgent) -> None:
    exporter = PolicyExporter(new_agent(image_size=32, hidden_features=128))
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
