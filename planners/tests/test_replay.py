"""What the replay keeps, returns and announces."""

import json
import threading
import tracemalloc
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from athrl_planners import ObservationSettings, Sequence, SequenceBatch, SequenceReplay

LEVELS = {"intention": (1, 32), "trajectory": (2, 32)}
MakeSequence = Callable[..., Sequence]


def make_replay(capacity: int = 20, seed: int = 1) -> SequenceReplay:
    return SequenceReplay(capacity, 5, ObservationSettings(image_size=16), LEVELS, seed)


def assert_equal(one: SequenceBatch, other: SequenceBatch) -> None:
    np.testing.assert_equal(vars(one), vars(other))


def marked(make_sequence: MakeSequence, mark: int) -> Sequence:
    """A sequence that carries `mark` in every column."""
    sequence = make_sequence(0)
    sequence.images[:] = mark
    sequence.motion[:] = mark
    for column in (*sequence.actions.values(), *sequence.rewards.values(), *sequence.initial_state.values()):
        column[:] = mark
    return sequence


def marks(batch: SequenceBatch) -> np.ndarray:
    """The mark of each row, the same in all its columns."""
    found = batch.images[:, 0, 0, 0, 0].astype(int)
    levels = (*batch.actions.values(), *batch.rewards.values(), *batch.initial_state.values())
    for column in (batch.images, batch.motion, *levels):
        flat = column.reshape(len(found), -1)
        np.testing.assert_array_equal(flat, np.broadcast_to(found[:, None], flat.shape))
    return found


def test_a_sample_is_what_was_inserted(
    make_sequence: MakeSequence, stack: Callable[..., SequenceBatch]
) -> None:
    replay = make_replay()
    sequence = make_sequence(3, length=4, terminated=True)
    replay.insert(sequence)
    assert_equal(replay.sample(2), stack([sequence, sequence]))


def test_a_sample_never_glues_two_sequences(make_sequence: MakeSequence) -> None:
    replay = make_replay()
    for mark in range(1, 10):
        replay.insert(marked(make_sequence, mark))
    assert set(marks(replay.sample(200))) == {6, 7, 8, 9}


def test_the_newest_sequences_replace_the_oldest(make_sequence: MakeSequence) -> None:
    replay = make_replay(capacity=15)
    for mark in range(1, 6):
        replay.insert(marked(make_sequence, mark))
    assert set(marks(replay.sample(100))) == {3, 4, 5}


def test_transitions_are_counted_without_padding(make_sequence: MakeSequence) -> None:
    replay = make_replay(capacity=15)
    for number, length in enumerate((1, 5, 3, 4)):
        replay.insert(make_sequence(number, length=length))
    assert len(replay) == 5 + 3 + 4
    assert replay.sequences == 3


def test_sequences_are_drawn_evenly(make_sequence: MakeSequence) -> None:
    replay = make_replay()
    for mark in range(4):
        replay.insert(marked(make_sequence, mark))
    counts = np.bincount(marks(replay.sample(4000)), minlength=4)
    assert counts.min() > 850


def test_equal_seeds_draw_equal_samples(make_sequence: MakeSequence) -> None:
    one, other, third = make_replay(seed=1), make_replay(seed=1), make_replay(seed=2)
    for replay in (one, other, third):
        for seed in range(4):
            replay.insert(make_sequence(seed))
    first = one.sample(16)
    assert_equal(first, other.sample(16))
    assert not np.array_equal(first.images, third.sample(16).images)


def restored_from(state: object, sequences: list[Sequence], capacity: int = 20) -> SequenceReplay:
    replay = make_replay(capacity, seed=9)
    replay.load_state(json.loads(json.dumps(state)), sequences)
    return replay


@pytest.mark.parametrize("inserted", [0, 2, 4, 7, 8])
def test_a_restored_replay_goes_on_where_it_was(make_sequence: MakeSequence, inserted: int) -> None:
    replay = make_replay()
    sequences = [make_sequence(seed, length=1 + seed % 5) for seed in range(inserted)]
    for sequence in sequences:
        replay.insert(sequence)
    if inserted:
        replay.sample(3)
    restored = restored_from(replay.state(), sequences[-4:])
    assert len(restored) == len(replay)
    for both in (replay, restored):
        both.insert(make_sequence(100))
    for _ in range(3):
        assert_equal(restored.sample(8), replay.sample(8))
    assert restored.state() == replay.state()


@pytest.mark.parametrize("capacity", [10, 20, 40])
@pytest.mark.parametrize("found", [0, 1, 2, 3, 4])
@pytest.mark.parametrize("inserted", [4, 6, 9])
def test_a_replay_that_gets_back_fewer_sequences_never_draws_an_empty_place(
    make_sequence: MakeSequence, inserted: int, found: int, capacity: int
) -> None:
    replay = make_replay()
    sequences = [marked(make_sequence, mark) for mark in range(1, inserted + 1)]
    for sequence in sequences:
        replay.insert(sequence)
    left = sequences[-4:][4 - found :]
    restored = restored_from(replay.state(), left, capacity)
    expected = list(range(inserted + 1 - found, inserted + 1))[-capacity // 5 :]
    for mark in range(50, 50 + capacity // 5 + 2):
        assert restored.sequences == len(expected)
        assert len(restored) == 5 * len(expected)
        if expected:
            assert set(marks(restored.sample(100))) == set(expected)
        restored.insert(marked(make_sequence, mark))
        expected = [*expected, mark][-capacity // 5 :]


def test_a_sequence_of_another_run_is_refused(make_sequence: MakeSequence) -> None:
    replay = make_replay()
    replay.insert(make_sequence(1))
    other = replace(make_sequence(1), images=make_sequence(1).images[:-1])
    with pytest.raises(ValueError, match="images is uint8"):
        restored_from(replay.state(), [other])


def test_a_wrong_state_is_refused() -> None:
    state = make_replay().state()
    for wrong in ({**state, "sequences": 3}, {**state, "sequences": -1}, {**state, "random": [1]}):
        with pytest.raises(ValueError, match=r"the state has|the generator's state has"):
            restored_from(wrong, [])


def test_memory_is_known_before_it_is_taken(make_sequence: MakeSequence) -> None:
    replay = make_replay(capacity=2000)
    announced = replay.bytes
    tracemalloc.start()
    replay.insert(make_sequence(1))
    taken, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert taken == pytest.approx(announced, rel=0.05)


def test_a_hundred_thousand_transitions_fit_into_600_mebibytes() -> None:
    levels = {"intention": (1, 128), "trajectory": (2, 128)}
    replay = SequenceReplay(100_000, 10, ObservationSettings(image_size=32), levels, seed=1)
    assert replay.bytes <= 0.6 * 2**30


def test_an_empty_replay_says_so() -> None:
    with pytest.raises(ValueError, match="empty"):
        make_replay().sample(1)


def test_a_sequence_that_does_not_fit_is_refused(make_sequence: MakeSequence) -> None:
    replay, good = make_replay(), make_sequence(1)
    wrong = [
        (replace(good, images=good.images[:-1]), "images"),
        (replace(good, motion=good.motion.astype(np.float64)), "motion"),
        (replace(good, length=6), "length"),
        (replace(good, length=0), "length"),
        (
            replace(good, rewards={**good.rewards, "trajectory": np.zeros(4, np.float32)}),
            "trajectory.rewards",
        ),
    ]
    for sequence, name in wrong:
        with pytest.raises(ValueError, match=name):
            replay.insert(sequence)
    assert len(replay) == 0


def test_one_thread_inserts_while_another_samples(make_sequence: MakeSequence) -> None:
    replay = make_replay(capacity=15)
    sequences = [marked(make_sequence, mark) for mark in range(1, 200)]
    replay.insert(sequences[0])

    def insert() -> None:
        for sequence in sequences:
            replay.insert(sequence)

    thread = threading.Thread(target=insert)
    thread.start()
    for _ in range(100):
        marks(replay.sample(8))  # checks that no row is half old, half new
    thread.join(timeout=30)
    assert not thread.is_alive()
    assert set(marks(replay.sample(100))) == {197, 198, 199}
