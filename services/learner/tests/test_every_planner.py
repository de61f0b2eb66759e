"""Every planner trains in the same learner: on single decisions or sequences, drawn evenly or by priority."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import onnx
import pytest
from athrl_learner import Summary, factories, run_learner
from athrl_learner.checkpoint import fingerprint, read_checkpoint, write_checkpoint
from athrl_learner.checkpoint.snapshot import restore_snapshot, take_snapshot
from athrl_learner.components import make_experience
from athrl_learner.intake.arrivals import Arrivals
from athrl_learner.intake.local_intake import LocalIntake
from athrl_learner.intake.store import ExperienceStore
from athrl_planners import Agent
from athrl_protocol import Chunk, LevelColumns, RunFile
from athrl_protocol.delivery.ledger import Ledger
from athrl_protocol.run_file import PlannerSection

TIME = 5
SMALL = {"hidden_features": 16, "head_features": 16, "atoms": 11, "recurrent_features": 8}


def of(run_file: RunFile, kind: str, *, prioritised: bool = False, **settings: object) -> RunFile:
    """The small run of another planner."""
    planner = PlannerSection.model_validate({"kind": kind, **SMALL, **settings})
    replay = run_file.replay.model_copy(update={"prioritised": prioritised})
    return run_file.model_copy(update={"planner": planner, "replay": replay})


def chunks_of(run_file: RunFile, make_chunk: Callable[..., Chunk]) -> Callable[..., Chunk]:
    """Make chunks that fit any planner."""
    random = np.random.default_rng(0)
    levels = factories.make_agent(run_file).description.levels

    def make(**fields: object) -> Chunk:
        columns = {
            level.name: LevelColumns(
                actions=np.floor(random.uniform(level.low, level.high + 1, (TIME, level.action_size)))
                .clip(level.low, level.high)
                .astype(np.float32),
                rewards=random.normal(0, 20, TIME).astype(np.float32),
                states=random.normal(size=(1, level.state_size)).astype(np.float32),
            )
            for level in levels
        }
        return make_chunk(levels=columns, **fields)

    return make


@pytest.mark.parametrize(
    ("kind", "settings"),
    [
        ("athrl", {}),
        ("athrl", {"memory": "lstm", "prioritised": True}),
        ("hddpg", {"update_rule": "sac", "prioritised": True}),
        ("ddpg", {"memory": "lstm"}),
        ("hdqn", {}),
    ],
)
def test_planner_trains_to_its_end_and_publishes_what_it_is(run_file, make_chunk, make_actor, kind, settings):
    run_file = of(run_file, kind, **settings)
    actor = make_actor(chunks_of(run_file, make_chunk), "actor-1")
    with ThreadPoolExecutor(1) as pool, actor:
        running = pool.submit(run_learner, run_file, stop=threading.Event())
        summary: Summary = running.result(timeout=120)
    assert summary.finished
    assert summary.samples_per_insert == pytest.approx(4, rel=0.05)
    assert 67 <= summary.updates <= 69
    model = onnx.load_from_string(actor.policies[-1].artefact)
    (description,) = [entry.value for entry in model.metadata_props if entry.key == "athrl"]
    assert json.loads(description)["planner"] == kind
    names = {name for report in actor.metrics for name in report.values}
    levels = [level["name"] for level in json.loads(description)["levels"]]
    assert {f"loss/{level}/critic_loss" for level in levels} <= names
    assert {"loss/critic_gradient", "trained_per_second", "update_seconds"} <= names
    assert ("loss/actor_gradient" in names) == (kind != "hdqn")


@pytest.mark.parametrize("memory", ["none", "lstm"])
def test_priorities_come_back_with_the_checkpoint(run_file, make_chunk, tmp_path, memory):
    run_file = of(run_file, "athrl", prioritised=True, memory=memory)
    make = chunks_of(run_file, make_chunk)
    agent = factories.make_agent(run_file)
    log = factories.make_log(run_file, tmp_path / "experience")
    store = make_experience(run_file, agent, Arrivals(), log)
    intake = LocalIntake(store, Ledger())
    for number in range(14):
        intake.take_in(make(length=1 + number % TIME))
    for _ in range(5):
        train(agent, store)
    content = take_snapshot(run_file, agent, store, intake, policy_version=0)
    content = read_checkpoint(write_checkpoint(tmp_path / "checkpoints", content))
    other = factories.make_agent(run_file)
    again = make_experience(
        run_file, other, Arrivals(), factories.make_log(run_file, tmp_path / "experience")
    )
    restore_snapshot(content, other, again)
    assert fingerprint.replay_content(again.replay) == fingerprint.replay_content(store.replay)
    for _ in range(3):
        assert train(agent, store) == train(other, again)


def train(agent: Agent, store: ExperienceStore) -> list[int]:
    """One update; return the items of its batch."""
    batch = store.replay.sample(20)
    _, errors = agent.update(batch)
    store.replay.update_priorities(batch, errors.numpy())
    return batch.places.tolist()
