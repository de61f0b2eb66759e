"""After a crash: nothing that was acknowledged is lost, nothing is counted twice, damage is reported."""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from athrl_learner import CannotResume, factories
from athrl_learner.checkpoint import CheckpointContent
from athrl_learner.checkpoint.snapshot import Restored, restore_snapshot, take_snapshot
from athrl_learner.components import make_experience
from athrl_learner.files import Files
from athrl_learner.intake.arrivals import Arrivals
from athrl_learner.log import numbered_segments
from athrl_learner.log.segments import SEGMENT_HEADER_BYTES
from athrl_planners import Agent
from athrl_protocol import Chunk, RunFile, encode_chunk, read_run_file
from athrl_protocol.delivery.ledger import Ledger
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as some

SLOTS = 6
TIME = 5


class SmallLearner:
    """A learner without network and planner's training: takes chunks in, takes snapshots, comes back."""

    def __init__(
        self,
        run_file: RunFile,
        folder: Path,
        content: CheckpointContent | None = None,
        samples_per_insert: float = 0.001,
        agent: Agent | None = None,
    ) -> None:
        """`agent`: another learner's, as making one takes longer than all else and none is trained."""
        replay = run_file.replay.model_copy(update={"capacity": SLOTS * TIME})
        run = run_file.run.model_copy(update={"environment_steps": 10**6})
        learner = run_file.learner.model_copy(update={"samples_per_insert": samples_per_insert})
        self.run_file = run_file.model_copy(update={"replay": replay, "run": run, "learner": learner})
        self.agent = agent or factories.make_agent(self.run_file)
        log = factories.make_log(self.run_file, folder)
        self.store = make_experience(self.run_file, self.agent, Arrivals(), log)
        self.restored: Restored = restore_snapshot(content, self.agent, self.store)
        self._ledger = self.restored.ledger

    def take_in(self, chunk: Chunk) -> None:
        self.store.accept(chunk, encode_chunk(chunk))
        self._ledger.record(chunk)

    def refuse(self, chunk: Chunk) -> None:
        self.store.refuse(chunk)
        self._ledger.refuse(chunk.actor, chunk.incarnation, chunk.sequence)

    def snapshot(self) -> CheckpointContent:
        return take_snapshot(self.run_file, self.agent, self.store, self, 0, self.restored.damaged)

    @contextlib.contextmanager
    def paused(self) -> Iterator[None]:
        yield

    def ledger(self) -> dict[str, dict[str, int]]:
        return self._ledger.to_json()

    def totals(self) -> dict[str, int]:
        return self._ledger.totals_to_json()

    def facts(self) -> dict[str, object]:
        """All that has to survive."""
        return {
            "ledger": self.ledger(),
            "totals": self.totals(),
            "steps": self.store.environment_steps,
            "inserts": self.store.limiter.inserts,
            "marks": self.marks(),
        }

    def marks(self) -> list[int]:
        """What the replay's places hold, place by place: the first reward of each sequence."""
        replay = self.store.replay
        if not len(replay):
            return []
        return replay.columns()["intention.rewards"][:, 0].astype(int).tolist()


def marked(make_chunk, sequence: int, actor: str = "actor-1", **fields: object) -> Chunk:
    chunk = make_chunk(sequence=sequence, actor=actor, **fields)
    chunk.levels["intention"].rewards[0] = 1000 * int(actor[-1]) + sequence
    return chunk


def segment_files(folder: Path) -> list[Path]:
    return list(numbered_segments(folder).values())


@pytest.mark.parametrize("before", [0, 1, 4, 6, 9])
@pytest.mark.parametrize("after", [0, 1, 7, 13])
def test_a_crash_costs_nothing_that_was_taken_in(run_file, make_chunk, tmp_path, before, after):
    learner = SmallLearner(run_file, tmp_path)
    for sequence in range(before):
        learner.take_in(marked(make_chunk, sequence, length=1 + sequence % TIME))
    content = learner.snapshot()
    for sequence in range(before, before + after):
        learner.take_in(marked(make_chunk, sequence, length=1 + sequence % TIME))
    learner.refuse(marked(make_chunk, before + after))
    for start in (content, None):  # from the checkpoint, or from nothing but the log
        back = SmallLearner(run_file, tmp_path, start, agent=learner.agent)
        assert back.facts() == learner.facts()
        assert back.restored.damaged == 0
    assert SmallLearner(run_file, tmp_path, content, agent=learner.agent).restored.recovered == after


steps = some.lists(
    some.one_of(
        some.tuples(some.just("take in"), some.integers(1, 3), some.integers(1, TIME)),
        some.tuples(some.just("refuse"), some.integers(1, 3), some.just(1)),
        some.tuples(some.sampled_from(["snapshot", "crash", "torn crash"]), some.just(0), some.just(0)),
    ),
    max_size=40,
)


@given(steps=steps)
@settings(deadline=None, max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_life_of_crashes_and_snapshots_comes_to_the_same(
    run_file_for, make_chunk, tmp_path_factory, steps
):
    folder = tmp_path_factory.mktemp("life")
    learner, content = SmallLearner(run_file_for, folder), None
    unbroken = SmallLearner(run_file_for, tmp_path_factory.mktemp("unbroken"), agent=learner.agent)
    following = {1: 0, 2: 0, 3: 0}
    for what, actor, length in steps:
        if what == "snapshot":
            content = learner.snapshot()
        elif "crash" in what:
            learner.store.log.close()
            if what == "torn crash" and segment_files(folder):
                with segment_files(folder)[-1].open("ab") as file:
                    file.write(b"\x93ath and not much more")
            learner = SmallLearner(run_file_for, folder, content, agent=learner.agent)
        else:
            chunk = marked(make_chunk, following[actor], f"actor-{actor}", length=length)
            following[actor] += 1
            for one in (learner, unbroken):
                (one.take_in if what == "take in" else one.refuse)(chunk)
        assert learner.facts() == unbroken.facts()
    assert learner.restored.damaged == 0


@pytest.fixture(scope="module")
def run_file_for(tmp_path_factory) -> RunFile:
    """The small run for a test of which hypothesis runs many examples."""
    return read_run_file(
        None,
        [
            "planner.hidden_features=8",
            "planner.head_features=8",
            "planner.atoms=11",
            "planner.memory=lstm",
            "planner.recurrent_features=8",
            "planner.shared_trunk=false",
            "exploration.random_decisions=60",
            f"replay.sequence_length={TIME}",
            "replay.burn_in=1",
            "learner.batch=20",
            "learner.precision=float32",
            "durability.segment_mebibytes=0.01",
            f"run.folder={tmp_path_factory.mktemp('runs')}",
        ],
    )


def damaged_life(run_file, make_chunk, folder) -> tuple[SmallLearner, CheckpointContent]:
    """Eleven chunks, of which the checkpoint knows eight, and six segments."""
    small = run_file.model_copy(
        update={"durability": run_file.durability.model_copy(update={"segment_mebibytes": 0.005})}
    )
    learner = SmallLearner(small, folder)
    for sequence in range(8):
        learner.take_in(marked(make_chunk, sequence))
    content = learner.snapshot()
    for sequence in range(8, 11):
        learner.take_in(marked(make_chunk, sequence))
    learner.store.log.close()
    return learner, content


def flip(path: Path, place: int = -20) -> None:
    content = bytearray(path.read_bytes())
    content[place] ^= 0xFF
    path.write_bytes(content)


def test_a_damaged_record_behind_the_checkpoint_is_named_and_counted(run_file, make_chunk, tmp_path, caplog):
    learner, content = damaged_life(run_file, make_chunk, tmp_path)
    path = segment_files(tmp_path)[-2]
    flip(path)
    back = SmallLearner(learner.run_file, tmp_path, content)
    assert back.restored.damaged == 1
    assert back.restored.recovered == 2
    assert back.store.environment_steps == learner.store.environment_steps - TIME
    assert f"{path}: a record is damaged" in caplog.text
    # It is in the ledger as lost, so its sender is asked for the next one.
    assert back.totals() == {"stored": 10, "transitions": 50, "refused": 0, "lost": 1}
    assert back.ledger() == learner.ledger()
    assert back.snapshot().state["damaged"] == 1


def test_a_damaged_record_of_the_replay_is_left_out_and_no_empty_place_is_drawn(
    run_file, make_chunk, tmp_path, caplog
):
    learner, content = damaged_life(run_file, make_chunk, tmp_path)
    flip(segment_files(tmp_path)[4])
    back = SmallLearner(learner.run_file, tmp_path, content)
    assert back.restored.damaged == 1
    assert set(back.marks()) < set(learner.marks()) | {1002, 1003, 1004}
    assert 0 not in back.marks()
    assert back.totals() == learner.totals()
    assert back.store.environment_steps == learner.store.environment_steps
    assert "a record is damaged" in caplog.text


@pytest.mark.parametrize("place", ["in the replay", "behind the checkpoint"])
def test_no_flipped_bit_of_a_segments_header_stops_a_run_or_costs_a_record(
    run_file, make_chunk, tmp_path, caplog, place
):
    """One bit of each byte, another one each time; the log's own tests flip all of them."""
    learner, content = damaged_life(run_file, make_chunk, tmp_path)
    following = content.log.next_segment
    number = following if place == "behind the checkpoint" else following - 1
    path = numbered_segments(tmp_path)[number]
    intact = path.read_bytes()
    random = np.random.default_rng()
    for bit in 8 * np.arange(SEGMENT_HEADER_BYTES) + random.integers(8, size=SEGMENT_HEADER_BYTES):
        damaged = bytearray(intact)
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        caplog.clear()
        back = SmallLearner(learner.run_file, tmp_path, content, agent=learner.agent)
        assert back.facts() == learner.facts(), bit
        assert back.restored.damaged == 0, bit
        assert str(path) in caplog.text, bit


def test_a_segment_of_another_format_is_refused(run_file, make_chunk, tmp_path):
    learner, content = damaged_life(run_file, make_chunk, tmp_path)
    path = segment_files(tmp_path)[-1]
    changed = bytearray(path.read_bytes())
    fields = changed[: SEGMENT_HEADER_BYTES - 4]
    fields[8] += 1  # the format's lowest byte
    changed[:SEGMENT_HEADER_BYTES] = fields + zlib.crc32(fields).to_bytes(4, "little")
    path.write_bytes(changed)
    with pytest.raises(CannotResume, match="segment format 2"):
        SmallLearner(learner.run_file, tmp_path, content)


def test_actors_need_not_wait_until_what_came_after_the_checkpoint_is_trained_on(
    run_file, make_chunk, tmp_path
):
    learner = SmallLearner(run_file, tmp_path)
    content = learner.snapshot()
    for sequence in range(60):
        learner.take_in(marked(make_chunk, sequence))
    back = SmallLearner(run_file, tmp_path, content, samples_per_insert=32.0)
    assert back.store.limiter.surplus > 5 * back.store.limiter.error_bound
    for _ in range(16):  # updates; they are owed three hundred
        assert back.store.sample(timeout=0) is not None
    back.take_in(marked(make_chunk, 60))


def test_a_missing_segment_is_named_and_counted(run_file, make_chunk, tmp_path, caplog):
    learner, content = damaged_life(run_file, make_chunk, tmp_path)
    numbers = numbered_segments(tmp_path)
    missing = content.log.segments[1]
    numbers[missing.number].unlink()
    back = SmallLearner(learner.run_file, tmp_path, content)
    assert back.restored.damaged == missing.records
    assert f"segment {missing.number} of {tmp_path} is missing" in caplog.text


def test_a_segment_of_another_run_is_named(run_file, make_chunk, tmp_path, caplog):
    learner, content = damaged_life(run_file, make_chunk, tmp_path)
    facts = dataclasses.replace(content.log.segments[0], checksum="another")
    log = dataclasses.replace(content.log, segments=(facts, *content.log.segments[1:]))
    with caplog.at_level(logging.WARNING):
        SmallLearner(learner.run_file, tmp_path, dataclasses.replace(content, log=log))
    assert "its checksum differs" in caplog.text


def test_a_log_of_other_settings_is_refused_in_one_line(run_file, make_chunk, tmp_path):
    learner, _ = damaged_life(run_file, make_chunk, tmp_path)
    planner = learner.run_file.planner.model_copy(update={"recurrent_features": 12})
    with pytest.raises(CannotResume, match="does not fit the run's settings") as refusal:
        SmallLearner(learner.run_file.model_copy(update={"planner": planner}), tmp_path)
    assert "\n" not in str(refusal.value)


def test_half_a_record_is_cut_off_so_that_it_is_not_found_again(run_file, make_chunk, tmp_path, caplog):
    learner, content = damaged_life(run_file, make_chunk, tmp_path)
    path = segment_files(tmp_path)[-1]
    Files().truncate(path, path.stat().st_size - 7)
    back = SmallLearner(learner.run_file, tmp_path, content)
    assert f"{path}: a record was cut off" in caplog.text
    assert (back.restored.damaged, back.restored.recovered) == (0, 2)
    back.take_in(marked(make_chunk, 10))
    caplog.clear()
    again = SmallLearner(learner.run_file, tmp_path, content)
    assert not caplog.text
    assert again.facts() == learner.facts()


def test_the_ledger_refuses_what_the_log_gave_back(run_file, make_chunk, tmp_path):
    learner, content = damaged_life(run_file, make_chunk, tmp_path)
    ledger: Ledger = SmallLearner(learner.run_file, tmp_path, content).restored.ledger
    assert ledger.next_sequence("actor-1", 1) == 11
