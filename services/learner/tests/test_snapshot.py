"""A snapshot put into a fresh learner goes on exactly where the old one was."""

import dataclasses

import numpy as np
import pytest
from athrl_learner import CannotResume, translation
from athrl_learner.arrivals import Arrivals
from athrl_learner.checkpoint import CheckpointContent, read_checkpoint, write_checkpoint
from athrl_learner.parts import make_experience
from athrl_learner.snapshot import restore_snapshot, saved_ledger, saved_version, take_snapshot
from athrl_planners import AtHRL
from athrl_protocol import ChunkIntake, RunFile, open_session


def trained(run_file: RunFile, make_chunk, agent: AtHRL):
    store = make_experience(run_file, agent, Arrivals())
    while store.limiter.permits_insert(5):
        store.accept(make_chunk(length=5 if len(store.replay) % 2 else 3))
    for _ in range(3):
        agent.update(store.sample(4, timeout=0))
    return store


@pytest.fixture
def content(run_file, make_chunk, tmp_path) -> tuple[CheckpointContent, AtHRL, object]:
    agent = translation.make_agent(run_file)
    store = trained(run_file, make_chunk, agent)
    with open_session(listen=run_file.network.listen, timeout=10) as session:
        ledger = {"actor-1": {"12": 34}}
        with ChunkIntake(session, "small", store.accept, ledger) as intake:
            snapshot = take_snapshot(run_file, agent, store, intake, policy_version=9)
    return read_checkpoint(write_checkpoint(tmp_path, snapshot, kept=1)), agent, store


def test_training_goes_on_bit_for_bit(content, run_file):
    read, agent, store = content
    other = translation.make_agent(run_file)
    restored = make_experience(run_file, other, Arrivals())
    restore_snapshot(read, other, restored)
    assert restored.environment_steps == store.environment_steps
    assert restored.limiter.state() == store.limiter.state()
    assert len(restored.replay) == len(store.replay)
    assert (saved_ledger(read), saved_version(read)) == ({"actor-1": {"12": 34}}, 9)
    for _ in range(4):
        ours, theirs = store.replay.sample(4), restored.replay.sample(4)
        np.testing.assert_array_equal(ours.images, theirs.images)
        assert agent.update(ours) == other.update(theirs)


def test_a_snapshot_is_not_changed_by_later_training(run_file, make_chunk):
    agent = translation.make_agent(run_file)
    store = trained(run_file, make_chunk, agent)
    with (
        open_session(listen=run_file.network.listen, timeout=10) as session,
        ChunkIntake(session, "small", store.accept) as intake,
    ):
        snapshot = take_snapshot(run_file, agent, store, intake, policy_version=0)
    images, updates = snapshot.replay["images"].copy(), agent.updates
    while store.limiter.permits_sample(20):
        agent.update(store.sample(4, timeout=0))
    store.accept(make_chunk())
    fresh = translation.make_agent(run_file)
    fresh.load_state_dict(snapshot.agent)
    assert fresh.updates == updates < agent.updates
    np.testing.assert_array_equal(snapshot.replay["images"], images)


def test_a_checkpoint_of_another_planner_is_refused_in_one_line(content, run_file):
    read, _, _ = content
    planner = run_file.planner.model_copy(update={"recurrent_features": 12})
    larger = run_file.model_copy(update={"planner": planner})
    agent = translation.make_agent(larger)
    with pytest.raises(CannotResume, match="does not fit the run's settings") as refusal:
        restore_snapshot(read, agent, make_experience(larger, agent, Arrivals()))
    assert "\n" not in str(refusal.value)


def test_a_limiter_never_comes_back_without_its_replay(content, run_file):
    read, agent, _ = content
    store = make_experience(run_file, agent, Arrivals())
    empty = store.replay.state()
    arrays = {name: value for name, value in empty.items() if isinstance(value, np.ndarray)}
    emptied = dataclasses.replace(read, replay=arrays, state={**read.state, "replay": {"inserted": 0}})
    with pytest.raises(CannotResume, match="its replay does not hold"):
        restore_snapshot(emptied, agent, store)
