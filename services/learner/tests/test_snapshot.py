"""A snapshot restored into a new learner continues exactly where the old one stopped."""

import dataclasses

import numpy as np
import pytest
from athrl_learner import CannotResume, factories
from athrl_learner.checkpoint import CheckpointContent, fingerprint, read_checkpoint, write_checkpoint
from athrl_learner.checkpoint.snapshot import restore_snapshot, saved_version, take_snapshot
from athrl_learner.components import make_experience
from athrl_learner.intake.arrivals import Arrivals
from athrl_learner.intake.store import ExperienceStore
from athrl_learner.log import LogPosition, SegmentLog
from athrl_planners import Agent
from athrl_protocol import ChunkIntake, RunFile, encode_chunk, open_session


def trained(run_file: RunFile, make_chunk, agent: Agent, experience: SegmentLog) -> ExperienceStore:
    store = make_experience(run_file, agent, Arrivals(), experience)
    sequence = 0
    while store.limiter.permits_insert(store.limiter.largest_insert):
        chunk = make_chunk(length=5 if len(store.replay) % 2 else 3, sequence=sequence)
        store.accept(chunk, encode_chunk(chunk))
        sequence += 1
    for _ in range(3):
        agent.update(store.sample(timeout=0))
    return store


def restored_store(run_file: RunFile, agent: Agent, folder) -> ExperienceStore:
    return make_experience(run_file, agent, Arrivals(), factories.make_log(run_file, folder))


@pytest.fixture
def content(run_file, make_chunk, tmp_path, experience) -> tuple[CheckpointContent, Agent, ExperienceStore]:
    agent = factories.make_agent(run_file)
    store = trained(run_file, make_chunk, agent, experience)
    with open_session(listen=run_file.network.listen, timeout=10) as session:
        ledger = {"actor-1": {"12": 34}}
        with ChunkIntake(session, "small", store, ledger) as intake:
            snapshot = take_snapshot(run_file, agent, store, intake, policy_version=9)
    return read_checkpoint(write_checkpoint(tmp_path, snapshot)), agent, store


def test_training_goes_on_bit_for_bit(content, run_file):
    read, agent, store = content
    other = factories.make_agent(run_file)
    restored = restored_store(run_file, other, store.log.folder)
    found = restore_snapshot(read, other, restored)
    assert restored.environment_steps == store.environment_steps
    assert restored.limiter.state() == store.limiter.state()
    assert len(restored.replay) == len(store.replay)
    assert (found.ledger.to_json(), saved_version(read)) == ({"actor-1": {"12": 34}}, 9)
    assert (found.recovered, found.damaged) == (0, 0)
    for _ in range(4):
        ours, theirs = store.replay.sample(20), restored.replay.sample(20)
        np.testing.assert_array_equal(ours.images, theirs.images)
        metrics, errors = agent.update(ours)
        assert fingerprint.fingerprint((metrics, errors)) == fingerprint.fingerprint(other.update(theirs))
        assert fingerprint.parameters(agent) == fingerprint.parameters(other)
        assert fingerprint.optimisers(agent) == fingerprint.optimisers(other)


def test_what_came_after_the_snapshot_is_taken_in_from_the_log(content, run_file, make_chunk):
    read, agent, store = content
    while store.limiter.permits_sample(20):
        agent.update(store.sample(timeout=0))
    for sequence in range(3):
        chunk = make_chunk(actor="actor-2", sequence=sequence, length=4)
        store.accept(chunk, encode_chunk(chunk))
    store.refuse(make_chunk(actor="actor-2", sequence=3))
    other = factories.make_agent(run_file)
    restored = restored_store(run_file, other, store.log.folder)
    found = restore_snapshot(read, other, restored)
    assert found.recovered == 3
    assert found.ledger.to_json() == {"actor-1": {"12": 34}, "actor-2": {"1": 4}}
    assert found.ledger.totals.refused == 1
    assert restored.environment_steps == store.environment_steps
    assert restored.limiter.inserts == store.limiter.inserts
    assert len(restored.replay) == len(store.replay)


def test_a_snapshot_is_not_changed_by_later_training(run_file, make_chunk, experience):
    agent = factories.make_agent(run_file)
    store = trained(run_file, make_chunk, agent, experience)
    with (
        open_session(listen=run_file.network.listen, timeout=10) as session,
        ChunkIntake(session, "small", store) as intake,
    ):
        snapshot = take_snapshot(run_file, agent, store, intake, policy_version=0)
    replay, updates = dict(snapshot.state["replay"]), agent.updates
    while store.limiter.permits_sample(20):
        agent.update(store.sample(timeout=0))
    chunk = make_chunk(sequence=999)
    store.accept(chunk, encode_chunk(chunk))
    fresh = factories.make_agent(run_file)
    fresh.load_state_dict(snapshot.agent["planner"])
    assert fresh.updates == updates < agent.updates
    assert snapshot.state["replay"] == replay


def test_a_checkpoint_of_another_planner_is_refused_in_one_line(content, run_file):
    read, _, store = content
    planner = run_file.planner.model_copy(update={"recurrent_features": 12})
    larger = run_file.model_copy(update={"planner": planner})
    agent = factories.make_agent(larger)
    with pytest.raises(CannotResume, match="does not fit the run's settings") as refusal:
        restore_snapshot(read, agent, restored_store(larger, agent, store.log.folder))
    assert "\n" not in str(refusal.value)


def test_a_limiter_never_comes_back_without_its_replay(content, run_file, tmp_path):
    read, agent, _ = content
    emptied = dataclasses.replace(read, log=LogPosition(1, 0, 0, 0, ()))
    with pytest.raises(CannotResume, match="is not in its replay"):
        restore_snapshot(emptied, agent, restored_store(run_file, agent, tmp_path / "nothing"))


@pytest.mark.parametrize("chunks", [7, 8, 9, 10])
def test_a_chunk_that_has_half_left_the_replay_comes_back_by_half(run_file, make_chunk, experience, chunks):
    replay = run_file.replay.model_copy(update={"capacity": 100})  # 20 sequences, chunks have three
    learner = run_file.learner.model_copy(update={"samples_per_insert": 0.1})
    small = run_file.model_copy(update={"replay": replay, "learner": learner})
    agent = factories.make_agent(small)
    store = make_experience(small, agent, Arrivals(), experience)
    for sequence in range(chunks):
        chunk = make_chunk(sequences=3, sequence=sequence)
        store.accept(chunk, encode_chunk(chunk))
    with (
        open_session(listen=small.network.listen, timeout=10) as session,
        ChunkIntake(session, "small", store) as intake,
    ):
        snapshot = take_snapshot(small, agent, store, intake, policy_version=0)
    assert snapshot.log.oldest == (3 * chunks - 20) // 3
    assert snapshot.log.oldest_left == 3 - (3 * chunks - 20) % 3
    restored = restored_store(small, agent, experience.folder)
    restore_snapshot(snapshot, agent, restored)
    for name, column in store.replay.columns().items():
        np.testing.assert_array_equal(restored.replay.columns()[name], column)
    assert restored.environment_steps == store.environment_steps == 15 * chunks
    np.testing.assert_array_equal(store.replay.sample(40).images, restored.replay.sample(40).images)
