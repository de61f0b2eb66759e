"""Chunks that come without a network are numbered, written down and counted as those that come by one."""

import pytest
from athrl_learner import factories
from athrl_learner.checkpoint.snapshot import restore_snapshot, take_snapshot
from athrl_learner.components import make_experience
from athrl_learner.intake.arrivals import Arrivals
from athrl_learner.intake.local_intake import LocalIntake
from athrl_learner.log import SegmentReader, numbered_segments
from athrl_protocol import IntakeFinished
from athrl_protocol.codec.images import number_of
from athrl_protocol.delivery.ledger import Ledger
from athrl_protocol.messages import athrl_pb2


@pytest.fixture
def store(run_file, experience):
    return make_experience(run_file, factories.make_agent(run_file), Arrivals(), experience)


def test_chunks_are_numbered_in_their_order(store, make_chunk, experience):
    intake = LocalIntake(store, Ledger())
    for _ in range(3):
        intake.take_in(make_chunk(actor="serial", incarnation=0, sequence=77))
    assert intake.ledger() == {"serial": {"0": 3}}
    assert intake.totals() == {"stored": 3, "transitions": 15, "refused": 0, "lost": 0}
    assert experience.next_record == 3


@pytest.mark.parametrize("compression", ["lz4", "zstd", "none"])
def test_images_are_written_down_as_the_run_compresses_them(store, make_chunk, experience, compression):
    LocalIntake(store, Ledger(), compression).take_in(make_chunk())
    (path,) = numbered_segments(experience.folder).values()
    (record,) = SegmentReader(path, 1, 0)
    message = athrl_pb2.Chunk.FromString(record.body)
    assert message.image_compression == number_of(compression)


def test_chunk_that_is_not_taken_in_may_be_brought_again(store, make_chunk):
    intake = LocalIntake(store, Ledger())
    store.environment_steps = store.environment_steps_target
    with pytest.raises(IntakeFinished):
        intake.take_in(make_chunk())
    store.environment_steps = 0
    intake.take_in(make_chunk())
    assert intake.totals()["stored"] == 1


def test_owed_samples_are_always_permitted_and_leave_room_for_the_next_chunk(run_file, store, make_chunk):
    intake, largest = LocalIntake(store, Ledger()), run_file.learner.batch
    for _ in range(40):
        intake.take_in(make_chunk())
        while store.limiter.owes(largest):
            assert store.sample(timeout=0) is not None
        assert store.limiter.permits_insert(5)
        assert store.limiter.surplus < largest
    assert store.limiter.realised_ratio == pytest.approx(run_file.learner.samples_per_insert, rel=0.05)


def test_what_followed_the_checkpoint_is_driven_again(run_file, store, make_chunk, experience, tmp_path):
    agent = factories.make_agent(run_file)
    intake = LocalIntake(store, Ledger())
    intake.take_in(make_chunk())
    content = take_snapshot(run_file, agent, store, intake, policy_version=0)
    for _ in range(30):  # several segments
        intake.take_in(make_chunk())
        while store.limiter.owes(20):
            store.sample(timeout=0)
    later = len(numbered_segments(experience.folder)) - 1
    assert later > 1
    again = make_experience(
        run_file, agent, Arrivals(), factories.make_log(run_file, tmp_path / "experience")
    )
    restored = restore_snapshot(content, agent, again, "repeated")
    assert (restored.recovered, restored.ledger.next_sequence("actor-1", 1)) == (0, 1)
    assert again.environment_steps == 5
    assert again.log.remove_later_segments() == later
    assert list(numbered_segments(experience.folder)) == [1]
    LocalIntake(again, restored.ledger).take_in(make_chunk())
    assert list(numbered_segments(experience.folder)) == [1, 2]
    assert again.log.next_record == 2
