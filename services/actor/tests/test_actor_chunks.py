"""Chunks are pieces of one episode: nothing lost, nothing glued, states from before the first step."""

import numpy as np
import pytest
from athrl_actor.chunks import ChunkBuilder, Transition
from athrl_protocol import Chunk
from hypothesis import given, settings
from hypothesis import strategies as st


def image(episode: int, step: int) -> np.ndarray:
    """What is seen before decision `step` of an episode, unique to it."""
    return np.full((2, 2, 4), (episode * 37 + step * 5 + 1) % 256, np.uint8)


def motion(episode: int, step: int) -> np.ndarray:
    return np.array([episode + 1, step + 1], np.float32)


def transition(episode: int, step: int, ends: str = "") -> Transition:
    return Transition(
        image=image(episode, step),
        motion=motion(episode, step),
        states={
            "intention": np.full(3, 100 * episode + step, np.float32),
            "trajectory": np.zeros(0, np.float32),
        },
        actions={
            "intention": np.array([step], np.float32),
            "trajectory": np.array([step, -step], np.float32),
        },
        rewards={"intention": float(step), "trajectory": float(-step)},
        policy_version=10 * episode + step,
        next_image=image(episode, step + 1),
        next_motion=motion(episode, step + 1),
        terminated=ends == "terminated",
        truncated=ends == "truncated",
    )


def drive(lengths: list[int], time: int, ends: list[str]) -> list[tuple[int, Chunk]]:
    """Chunks, with the number of their episode, of episodes of given lengths; the last one is cut off."""
    builder = ChunkBuilder("actor", 7, 3, time)
    chunks: list[tuple[int, Chunk]] = []
    for episode, (length, end) in enumerate(zip(lengths, ends, strict=True)):
        builder.begin(1000 + episode)
        for step in range(length):
            chunk = builder.add(transition(episode, step, end if step == length - 1 else ""))
            if chunk is not None:
                chunks.append((episode, chunk))
    rest = builder.flush()
    if rest is not None:
        chunks.append((len(lengths) - 1, rest))
    return chunks


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


def test_a_chunk_does_not_change_when_its_sources_do():
    builder = ChunkBuilder("actor", 7, 0, 2)
    first = transition(0, 0)
    builder.begin(1)
    builder.add(first)
    for array in (first.image, first.motion, first.states["intention"], first.next_image):
        array[...] = 99
    chunk = builder.flush()
    assert chunk is not None
    assert not (chunk.images == 99).any()
    assert not (chunk.levels["intention"].initial_state == 99).any()


def test_an_episode_cannot_begin_over_pending_transitions():
    builder = ChunkBuilder("actor", 7, 0, 3)
    builder.begin(1)
    builder.add(transition(0, 0))
    with pytest.raises(RuntimeError, match="pending"):
        builder.begin(2)
