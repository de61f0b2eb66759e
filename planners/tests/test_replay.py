"""What the replay keeps, returns and announces."""

from __future__ import annotations

import json
import threading
import tracemalloc
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from athrl_planners import Agent, Sequence, SequenceBatch, SequenceReplay, TransitionBatch
from athrl_planners.replay import Batch
from athrl_spaces import Continuous, LevelDescription, Observation

MakeSequence = Callable[..., Sequence]
MakeReplay = Callable[..., SequenceReplay]


@pytest.fixture(params=["none", "lstm"])
def agent(request: pytest.FixtureRequest, new_agent: Callable[..., Agent]) -> Agent:
    """Without a memory single decisions are drawn, with one whole sequences."""
    return new_agent(memory=request.param, n_step=2)


@pytest.fixture
def make_sequence(agent: Agent, new_sequence: MakeSequence) -> MakeSequence:
    return lambda *arguments, **keywords: new_sequence(agent, *arguments, **keywords)


@pytest.fixture
def make_replay(agent: Agent) -> MakeReplay:
    def make(capacity: int = 20, seed: int = 1) -> SequenceReplay:
        description = agent.description
        horizons = () if agent.has_memory else agent.prepare.horizons
        return SequenceReplay(capacity, 5, description.observation, description.levels, seed, horizons)

    return make


def assert_equal(one: Batch, other: Batch) -> None:
    np.testing.assert_equal({**vars(one), "inserted": 0}, {**vars(other), "inserted": 0})


def marked(make_sequence: MakeSequence, mark: int) -> Sequence:
    """A full sequence that carries `mark` in every column."""
    sequence = make_sequence(0)
    sequence.images[:] = mark
    sequence.motion[:] = mark
    for column in (*sequence.actions.values(), *sequence.rewards.values(), *sequence.initial_state.values()):
        column[:] = mark
    return sequence


def marks(batch: Batch) -> np.ndarray:
    """The mark of each row, the same in all its columns."""
    levels = [*batch.actions.values(), *batch.initial_state.values()]
    if isinstance(batch, TransitionBatch):
        found = batch.images[0, :, 0, 0, 0].astype(int)
        columns = [batch.images.swapaxes(0, 1), batch.motion.swapaxes(0, 1), *levels]
        columns += [column.swapaxes(0, 1) for column in batch.last_actions.values()]
        for rewards in batch.rewards.values():
            assert (rewards[:, 0] == found).all()
            assert ((rewards[:, 1] == found) | (rewards[:, 1] == 0)).all()
    else:
        found = batch.images[:, 0, 0, 0, 0].astype(int)
        columns = [batch.images, batch.motion, *levels, *batch.rewards.values()]
    for column in columns:
        flat = column.reshape(len(found), -1)
        np.testing.assert_array_equal(flat, np.broadcast_to(found[:, None], flat.shape))
    return found


def test_sequence_that_is_sampled_is_what_was_inserted(
    new_agent: Callable[..., Agent],
    new_sequence: MakeSequence,
    replay_of: Callable[..., SequenceReplay],
    stack: Callable[..., SequenceBatch],
) -> None:
    agent = new_agent(memory="lstm")
    sequence = new_sequence(agent, 3, length=4, terminated=True)
    batch = replay_of(agent, [sequence]).sample(10)
    assert_equal(batch, replace(stack([sequence, sequence]), places=np.zeros(2, int)))


def test_transition_that_is_sampled_is_what_was_inserted(
    new_agent: Callable[..., Agent], new_sequence: MakeSequence, replay_of: Callable[..., SequenceReplay]
) -> None:
    """At each decision, and after 2 and 3 steps or at the end."""
    agent = new_agent(n_step=2, intention_every=3)
    sequences = [new_sequence(agent, 1, length=4, terminated=True), new_sequence(agent, 2, length=5)]
    batch = replay_of(agent, sequences).sample(200)
    assert isinstance(batch, TransitionBatch)
    assert set(batch.places) == {0, 1, 2, 3, 5, 6, 7, 8, 9}
    for row, place in enumerate(batch.places):
        sequence, step = sequences[place // 5], place % 5
        assert batch.step[row] == step
        after = [min(horizon, sequence.length - step) for horizon in (2, 3)]
        assert batch.steps[:, row].tolist() == after
        for number, frame in enumerate([step, step + after[0], step + after[1]]):
            np.testing.assert_array_equal(batch.images[number, row], sequence.images[frame])
            np.testing.assert_array_equal(batch.motion[number, row], sequence.motion[frame])
        ends = [sequence.terminated and step + steps == sequence.length for steps in after]
        assert batch.terminated[:, row].tolist() == ends
        for level, actions in sequence.actions.items():
            np.testing.assert_array_equal(batch.actions[level][row], actions[step])
            for number, steps in enumerate(after):
                np.testing.assert_array_equal(
                    batch.last_actions[level][number, row], actions[step + steps - 1]
                )
            earned = np.zeros(3, np.float32)
            earned[: after[1]] = sequence.rewards[level][step : step + after[1]]
            np.testing.assert_array_equal(batch.rewards[level][row], earned)
            np.testing.assert_array_equal(batch.initial_state[level][row], sequence.initial_state[level])


def test_sample_never_glues_two_sequences(make_replay: MakeReplay, make_sequence: MakeSequence) -> None:
    replay = make_replay()
    for mark in range(1, 10):
        replay.insert(marked(make_sequence, mark))
    assert set(marks(replay.sample(1000))) == {6, 7, 8, 9}


def test_newest_sequences_replace_the_oldest(make_replay: MakeReplay, make_sequence: MakeSequence) -> None:
    replay = make_replay(capacity=15)
    for mark in range(1, 6):
        replay.insert(marked(make_sequence, mark))
    assert set(marks(replay.sample(500))) == {3, 4, 5}


def test_transitions_are_counted_without_padding(
    make_replay: MakeReplay, make_sequence: MakeSequence
) -> None:
    replay = make_replay(capacity=15)
    for number, length in enumerate((1, 5, 3, 4)):
        replay.insert(make_sequence(number, length=length))
    assert len(replay) == 5 + 3 + 4
    assert replay.sequences == 3


def test_items_are_sampled_evenly(make_replay: MakeReplay, make_sequence: MakeSequence) -> None:
    replay = make_replay()
    for seed in range(4):
        replay.insert(make_sequence(seed, length=1 + seed))
    places = replay.sample(40_000).places
    items = len(replay) if len(places) == 40_000 else 4
    _, counts = np.unique(places, return_counts=True)
    assert len(counts) == items
    assert counts.min() > 0.85 * counts.mean()


def test_batch_has_as_many_decisions_as_it_should(
    make_replay: MakeReplay, make_sequence: MakeSequence
) -> None:
    replay = make_replay()
    replay.insert(make_sequence(1))
    assert [replay.sample(decisions).transitions for decisions in (5, 10, 200)] == [5, 10, 200]


def test_equal_seeds_draw_equal_samples(make_replay: MakeReplay, make_sequence: MakeSequence) -> None:
    one, other, third = make_replay(seed=1), make_replay(seed=1), make_replay(seed=2)
    for replay in (one, other, third):
        for seed in range(4):
            replay.insert(make_sequence(seed))
    first = one.sample(80)
    assert_equal(first, other.sample(80))
    assert not np.array_equal(first.images, third.sample(80).images)


@pytest.fixture
def restored_from(make_replay: MakeReplay) -> Callable[..., SequenceReplay]:
    def restore(state: object, sequences: list[Sequence], capacity: int = 20) -> SequenceReplay:
        replay = make_replay(capacity, seed=9)
        replay.load_state(json.loads(json.dumps(state)), sequences)
        return replay

    return restore


@pytest.mark.parametrize("inserted", [0, 2, 4, 7, 8])
def test_restored_replay_continues_where_it_was(
    make_replay: MakeReplay, make_sequence: MakeSequence, restored_from: MakeReplay, inserted: int
) -> None:
    replay = make_replay()
    sequences = [make_sequence(seed, length=1 + seed % 5) for seed in range(inserted)]
    for sequence in sequences:
        replay.insert(sequence)
    if inserted:
        replay.sample(15)
    restored = restored_from(replay.state(), sequences[-4:])
    assert len(restored) == len(replay)
    for both in (replay, restored):
        both.insert(make_sequence(100))
    for _ in range(3):
        assert_equal(restored.sample(40), replay.sample(40))
    assert restored.state() == replay.state()


@pytest.mark.parametrize("capacity", [10, 20, 40])
@pytest.mark.parametrize("found", [0, 1, 2, 3, 4])
@pytest.mark.parametrize("inserted", [4, 6, 9])
def test_replay_that_gets_back_fewer_sequences_never_draws_an_empty_place(
    make_replay: MakeReplay,
    make_sequence: MakeSequence,
    restored_from: MakeReplay,
    inserted: int,
    found: int,
    capacity: int,
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
            assert set(marks(restored.sample(500))) == set(expected)
        restored.insert(marked(make_sequence, mark))
        expected = [*expected, mark][-capacity // 5 :]


def test_sequence_of_another_run_is_refused(
    make_replay: MakeReplay, make_sequence: MakeSequence, restored_from: MakeReplay
) -> None:
    replay = make_replay()
    replay.insert(make_sequence(1))
    other = replace(make_sequence(1), images=make_sequence(1).images[:-1])
    with pytest.raises(ValueError, match="images is uint8"):
        restored_from(replay.state(), [other])


def test_wrong_state_is_refused(make_replay: MakeReplay, restored_from: MakeReplay) -> None:
    state = make_replay().state()
    for wrong in ({**state, "sequences": 3}, {**state, "sequences": -1}, {**state, "random": [1]}):
        with pytest.raises(ValueError, match=r"the state has|the generator's state has"):
            restored_from(wrong, [])


def test_memory_is_known_before_it_is_taken(make_replay: MakeReplay, make_sequence: MakeSequence) -> None:
    replay = make_replay(capacity=20_000)
    announced = replay.bytes
    tracemalloc.start()
    replay.insert(make_sequence(1))
    taken, _ = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert taken == pytest.approx(announced, rel=0.05)


def test_hundred_thousand_transitions_fit_into_600_mebibytes() -> None:
    action = Continuous("intention", "", 0.0, 2.0)
    levels = [LevelDescription(name, (action,), 128) for name in ("intention", "trajectory")]
    replay = SequenceReplay(100_000, 10, Observation(32), levels, seed=1)
    assert replay.bytes <= 0.6 * 2**30


def test_empty_replay_says_so(make_replay: MakeReplay) -> None:
    with pytest.raises(ValueError, match="empty"):
        make_replay().sample(1)


def test_capacity_of_less_than_a_sequence_is_refused(make_replay: MakeReplay) -> None:
    with pytest.raises(ValueError, match="a capacity of 4 holds no sequence of 5"):
        make_replay(capacity=4)


def test_sequence_that_does_not_fit_is_refused(make_replay: MakeReplay, make_sequence: MakeSequence) -> None:
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


def test_one_thread_inserts_while_another_samples(
    make_replay: MakeReplay, make_sequence: MakeSequence
) -> None:
    replay = make_replay(capacity=15)
    sequences = [marked(make_sequence, mark) for mark in range(1, 200)]
    replay.insert(sequences[0])

    def insert() -> None:
        for sequence in sequences:
            replay.insert(sequence)

    thread = threading.Thread(target=insert)
    thread.start()
    for _ in range(100):
        marks(replay.sample(40))  # checks that no row is half old, half new
    thread.join(timeout=30)
    assert not thread.is_alive()
    assert set(marks(replay.sample(500))) == {197, 198, 199}
