"""Chunks are pieces of one episode: nothing lost, nothing glued, states from before the first step."""

from typing import Any

import numpy as np
import pytest
from athrl_actor.chunks import ChunkCutter
from athrl_protocol import Chunk, encode_chunk
from hypothesis import given, settings
from hypothesis import strategies as st


def image(episode: int, step: int) -> np.ndarray:
    """What is seen before decision `step` of an episode, unique to it."""
    return np.full((2, 2, 4), (episode * 37 + step * 5 + 1) % 256, np.uint8)


def motion(episode: int, step: int) -> np.ndarray:
    return np.array([episode + 1, step + 1], np.float32)


LEVELS = {"intention": (1, 3), "trajectory": (2, 0)}


def make_cutter(environments: int, time: int) -> ChunkCutter:
    return ChunkCutter(
        "actor", 7, time=time, image_shape=(2, 2, 4), motion_size=2, levels=LEVELS, environments=environments
    )


def decision(where: list[tuple[int, int, str]]) -> dict[str, Any]:
    """What a decision brings in environments, each (episode, step, how it ends)."""
    numbers = np.array([(episode, step) for episode, step, _ in where], np.float32)
    episode, step = numbers[:, :1], numbers[:, 1:]
    return {
        "states": {
            "intention": np.repeat(100 * episode + step, 3, axis=1),
            "trajectory": np.zeros((len(where), 0), np.float32),
        },
        "actions": {"intention": step, "trajectory": np.concatenate([step, -step], axis=1)},
        "rewards": {"intention": step[:, 0], "trajectory": -step[:, 0]},
        "images": np.stack([image(episode, step + 1) for episode, step, _ in where]),
        "motion": np.stack([motion(episode, step + 1) for episode, step, _ in where]),
        "terminated": np.array([ends == "terminated" for _, _, ends in where]),
        "truncated": np.array([ends == "truncated" for _, _, ends in where]),
    }


def drive(lengths: list[int], time: int, ends: list[str]) -> list[tuple[int, Chunk]]:
    """Chunks, with the number of their episode, of episodes of given lengths; the last one is cut off.

    They are driven in environment 1; environment 0 begins its only episode with them and never ends it, so
    its chunks are full at other times.
    """
    cutter = make_cutter(2, time)
    chunks: list[tuple[int, Chunk]] = []
    beside: list[Chunk] = []
    cutter.begin(0, 1, image(99, 0), motion(99, 0))
    steps = 0
    for episode, (length, end) in enumerate(zip(lengths, ends, strict=True)):
        cutter.begin(1, 1000 + episode, image(episode, 0), motion(episode, 0))
        for step in range(length):
            here = (episode, step, end if step == length - 1 else "")
            made = cutter.add(**decision([(99, steps, ""), here]), policy_version=10 * episode + step)
            steps += 1
            chunks += [(episode, chunk) for chunk in made if chunk.environment == 1]
            beside += [chunk for chunk in made if chunk.environment == 0]
    rest = cutter.flush()
    chunks += [(len(lengths) - 1, chunk) for chunk in rest if chunk.environment == 1]
    beside += [chunk for chunk in rest if chunk.environment == 0]
    check_beside(beside, steps)
    return chunks


def check_beside(chunks: list[Chunk], steps: int) -> None:
    """The other environment's chunks are its one episode, whatever happened beside it."""
    assert [chunk.first_step for chunk in chunks] == np.cumsum([0, *(c.length for c in chunks)])[:-1].tolist()
    assert sum(chunk.length for chunk in chunks) == steps
    for chunk in chunks:
        for row in range(chunk.length + 1):
            np.testing.assert_array_equal(chunk.images[row], image(99, chunk.first_step + row))


episodes = st.lists(st.integers(1, 23), min_size=1, max_size=4).flatmap(
    lambda lengths: st.tuples(
        st.just(lengths),
        st.integers(1, 10),
        st.lists(
            st.sampled_from(["terminated", "truncated"]), min_size=len(lengths) - 1, max_size=len(lengths) - 1
        ),
        st.sampled_from(["terminated", "truncated", ""]),
    )
)


@settings(max_examples=60, deadline=None)
@given(episodes)
def test_chunks_are_the_episodes_without_gap_seam_or_overlap(case: tuple):
    lengths, time, ends, last_end = case
    chunks = drive(lengths, time, [*ends, last_end])
    for episode, length in enumerate(lengths):
        own = [chunk for number, chunk in chunks if number == episode]
        assert sum(chunk.length for chunk in own) == length
        step = 0
        for chunk in own:
            assert (chunk.episode_seed, chunk.first_step, chunk.time) == (1000 + episode, step, time)
            for row in range(chunk.length + 1):  # the observation after the last step included
                np.testing.assert_array_equal(chunk.images[row], image(episode, step + row))
                np.testing.assert_array_equal(chunk.motion[row], motion(episode, step + row))
            np.testing.assert_array_equal(
                chunk.policy_version[: chunk.length], 10 * episode + step + np.arange(chunk.length)
            )
            step += chunk.length


@settings(max_examples=60, deadline=None)
@given(episodes)
def test_states_are_those_before_the_first_step_and_padding_is_zero(case: tuple):
    lengths, time, ends, last_end = case
    for episode, chunk in drive(lengths, time, [*ends, last_end]):
        level, steps = chunk.levels["intention"], np.arange(chunk.first_step, chunk.first_step + chunk.length)
        np.testing.assert_array_equal(level.initial_state, np.full(3, 100 * episode + chunk.first_step))
        np.testing.assert_array_equal(level.actions[: chunk.length, 0], steps)
        np.testing.assert_array_equal(chunk.levels["trajectory"].rewards[: chunk.length], -steps)
        assert not chunk.images[chunk.length + 1 :].any()
        assert not chunk.motion[chunk.length + 1 :].any()
        assert not chunk.policy_version[chunk.length :].any()
        for columns in chunk.levels.values():
            assert not columns.actions[chunk.length :].any()
            assert not columns.rewards[chunk.length :].any()


@settings(max_examples=60, deadline=None)
@given(episodes)
def test_only_the_last_chunk_of_an_episode_says_that_and_how_it_ended(case: tuple):
    lengths, time, ends, last_end = case
    chunks = drive(lengths, time, [*ends, last_end])
    for episode, end in enumerate([*ends, last_end]):
        own = [chunk for number, chunk in chunks if number == episode]
        assert not any(chunk.terminated or chunk.truncated for chunk in own[:-1])
        assert (own[-1].terminated, own[-1].truncated) == (end == "terminated", end == "truncated")


def test_a_chunk_does_not_change_when_its_sources_or_its_cutter_do():
    cutter = make_cutter(1, 2)
    first = decision([(0, 0, "")])
    seen = (image(0, 0), motion(0, 0))
    cutter.begin(0, 1, *seen)
    cutter.add(**first, policy_version=0)
    for array in (*seen, first["images"], first["motion"], first["states"]["intention"]):
        array[...] = 99
    (chunk,) = cutter.flush()
    for step in range(1, 3):
        cutter.add(**decision([(9, step, "")]), policy_version=9)
    np.testing.assert_array_equal(chunk.images, [image(0, 0), image(0, 1), np.zeros((2, 2, 4))])
    np.testing.assert_array_equal(chunk.motion, [motion(0, 0), motion(0, 1), [0, 0]])
    np.testing.assert_array_equal(chunk.levels["intention"].initial_state, [0, 0, 0])
    assert chunk.policy_version.tolist() == [0, 0]


def test_an_episode_cannot_begin_over_pending_transitions():
    cutter = make_cutter(1, 3)
    cutter.begin(0, 1, image(0, 0), motion(0, 0))
    cutter.add(**decision([(0, 0, "")]), policy_version=0)
    with pytest.raises(RuntimeError, match="pending"):
        cutter.begin(0, 2, image(1, 0), motion(1, 0))


def test_what_is_dropped_is_in_no_chunk_and_counted_where_there_was_something():
    cutter = make_cutter(2, 3)
    for row in range(2):
        cutter.begin(row, row, image(row, 0), motion(row, 0))
    assert cutter.drop([0, 1]) == 0
    cutter.add(**decision([(0, 0, ""), (1, 0, "")]), policy_version=0)
    assert cutter.drop([1]) == 1
    cutter.begin(1, 2, image(2, 0), motion(2, 0))
    chunks = cutter.add(**decision([(0, 1, "truncated"), (2, 0, "terminated")]), policy_version=0)
    assert [(chunk.episode_seed, chunk.length) for chunk in chunks] == [(0, 2), (2, 1)]
    np.testing.assert_array_equal(chunks[1].images[:2], [image(2, 0), image(2, 1)])


def test_cutter_goes_on_from_its_state_in_the_middle_of_episodes():
    first, second = make_cutter(2, 4), make_cutter(2, 4)
    for row in range(2):
        first.begin(row, 70 + row, image(row, 0), motion(row, 0))
    for step in range(6):
        first.add(**decision([(0, step, ""), (1, step, "")]), policy_version=step)
    second.load_state(first.state())
    made = [
        cutter.add(**decision([(0, 6, "terminated"), (1, 6, "")]), policy_version=6) + cutter.flush()
        for cutter in (first, second)
    ]
    for one, other in zip(*made, strict=True):
        assert encode_chunk(one) == encode_chunk(other)
    assert [(chunk.first_step, chunk.length) for chunk in made[1]] == [(4, 3), (4, 3)]
    np.testing.assert_array_equal(made[1][0].images[:4], [image(0, step) for step in range(4, 8)])
