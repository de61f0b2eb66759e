"""Chunks are pieces of one episode: nothing is lost or joined, states are from before each sequence."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from athrl_actor.chunks import LONGEST_SECONDS, ChunkCutter
from athrl_driving.episode.recording_buffer import new_recording_buffer
from athrl_driving.policy import Recording
from athrl_protocol import Chunk, encode_chunk
from athrl_spaces import REWARD_TERMS, WAYPOINT, Continuous, LevelDescription, Limits, action_kind
from hypothesis import given, settings
from hypothesis import strategies as st


def image(episode: int, step: int) -> np.ndarray:
    """The observation before decision `step` of an episode, unique to it."""
    return np.full((2, 2, 4), (episode * 37 + step * 5 + 1) % 256, np.uint8)


def motion(episode: int, step: int) -> np.ndarray:
    return np.array([episode + 1, step + 1], np.float32)


INTENTION = LevelDescription("intention", (Continuous("intention", "", 0.0, 2.0),), 3)
TRAJECTORY = LevelDescription("trajectory", action_kind(WAYPOINT).describe(Limits()))
LEVELS = (INTENTION, TRAJECTORY)
SHARES = dict(zip(REWARD_TERMS, (8, 4, 2, 1, -1, -2, -11), strict=True))
"""Share of each term in a reward."""


class Batch:
    """Environments that consist only of their recording, filled as the simulation fills it."""

    def __init__(self, environments: int, decisions: int) -> None:
        self._buffer = new_recording_buffer(np.zeros((environments, 2, 2, 4), np.uint8), decisions)
        self.recording = Recording(self._buffer, (2, 2, 4))

    def see(self, env_index: int, episode: int, step: int) -> None:
        """Record the state after `step` decisions of an episode; the last one earned minus its number."""
        if step == 0:
            self._buffer.first[env_index] = 0
        place = step - self._buffer.first[env_index]
        self.recording.images[env_index, place] = image(episode, step)
        self.recording.motion[env_index, place] = motion(episode, step)
        self.recording.rewards[env_index, place] = 1 - step
        self.recording.terms[env_index, place] = (1 - step) * np.array(list(SHARES.values()))


class CutterHarness:
    """A cutter with its environments, and a clock that is advanced by hand."""

    def __init__(
        self,
        environments: int,
        sequence_length: int,
        sequences: int = 1,
        levels: tuple[LevelDescription, ...] = LEVELS,
    ) -> None:
        self.now = 0.0
        self.batch = Batch(environments, sequence_length * sequences)
        self.cutter = ChunkCutter(
            "actor",
            7,
            batch=self.batch,
            environments=environments,
            sequence_length=sequence_length,
            sequences=sequences,
            levels=levels,
            clock=lambda: self.now,
        )

    def begin(self, env_index: int, episode: int) -> None:
        self.batch.see(env_index, episode, 0)
        self.cutter.begin(env_index, 1000 + episode)

    def decide(self, *where: tuple[int, int, str], version: int = 0) -> list[Chunk]:
        """Make a decision in all environments, of each (episode, step, how it ends)."""
        for env_index, (episode, step, _) in enumerate(where):
            self.batch.see(env_index, episode, step + 1)
        ended = {e: how == "terminated" for e, (_, _, how) in enumerate(where) if how}
        return self.cutter.add(**decision(where), policy_version=version, ended=ended)


def decision(where: tuple[tuple[int, int, str], ...]) -> dict[str, Any]:
    """States and actions of a decision in environments, each (episode, step, how it ends)."""
    numbers = np.array([(episode, step) for episode, step, _ in where], np.float32)
    episode, step = numbers[:, :1], numbers[:, 1:]
    return {
        "states": {
            "intention": np.repeat(100 * episode + step, 3, axis=1),
            "trajectory": np.zeros((len(where), 0), np.float32),
        },
        "actions": {"intention": step, "trajectory": np.concatenate([step, -step], axis=1)},
    }


Case = tuple[list[int], tuple[int, int], list[str]]
"""Lengths of episodes, sequence length and maximum sequences of a chunk, how each episode ends."""


def drive(case: Case) -> list[tuple[int, Chunk]]:
    """Chunks, with the number of their episode, of the episodes one after the other; the last one is cut off.

    They are driven in environment 1; environment 0 begins its only episode with them and never ends it, so
    its chunks are full at other times.
    """
    lengths, sizes, ends = case
    harness = CutterHarness(2, *sizes)
    chunks: list[tuple[int, Chunk]] = []
    others: list[Chunk] = []
    harness.begin(0, 99)
    steps = 0
    for episode, (length, end) in enumerate(zip(lengths, ends, strict=True)):
        harness.begin(1, episode)
        for step in range(length):
            here = (episode, step, end if step == length - 1 else "")
            made = harness.decide((99, steps, ""), here, version=10 * episode + step)
            steps += 1
            chunks += [(episode, chunk) for chunk in made if chunk.environment == 1]
            others += [chunk for chunk in made if chunk.environment == 0]
    rest = harness.cutter.flush()
    chunks += [(len(lengths) - 1, chunk) for chunk in rest if chunk.environment == 1]
    others += [chunk for chunk in rest if chunk.environment == 0]
    check_other_environment(others, steps)
    return chunks


def check_other_environment(chunks: list[Chunk], steps: int) -> None:
    """The other environment's chunks are its one episode, independent of the first environment."""
    assert [chunk.first_step for chunk in chunks] == np.cumsum([0, *(c.length for c in chunks)])[:-1].tolist()
    assert sum(chunk.length for chunk in chunks) == steps
    for chunk in chunks:
        for place in range(chunk.length + 1):
            np.testing.assert_array_equal(chunk.images[place], image(99, chunk.first_step + place))


cases = st.lists(st.integers(1, 23), min_size=1, max_size=4).flatmap(
    lambda lengths: st.tuples(
        st.just(lengths),
        st.tuples(st.integers(1, 7), st.integers(1, 3)),
        st.tuples(
            *[st.sampled_from(["terminated", "truncated"])] * (len(lengths) - 1),
            st.sampled_from(["terminated", "truncated", ""]),
        ).map(list),
    )
)


@settings(max_examples=60, deadline=None)
@given(cases)
def test_chunks_are_the_episodes_without_gap_or_overlap(case: Case):
    lengths, (sequence_length, sequences), _ = case
    chunks = drive(case)
    for episode, length in enumerate(lengths):
        own = [chunk for number, chunk in chunks if number == episode]
        assert sum(chunk.length for chunk in own) == length
        assert all(chunk.length == sequence_length * sequences for chunk in own[:-1])
        step = 0
        for chunk in own:
            assert (chunk.episode_seed, chunk.first_step) == (1000 + episode, step)
            assert (chunk.state_interval, chunk.sequences) == (
                sequence_length,
                -(-chunk.length // sequence_length),
            )
            for place in range(chunk.length + 1):  # the observation after the last step included
                np.testing.assert_array_equal(chunk.images[place], image(episode, step + place))
                np.testing.assert_array_equal(chunk.motion[place], motion(episode, step + place))
            np.testing.assert_array_equal(
                chunk.policy_version[: chunk.length], 10 * episode + step + np.arange(chunk.length)
            )
            step += chunk.length


@settings(max_examples=60, deadline=None)
@given(cases)
def test_states_are_those_before_each_sequence_and_padding_is_zero(case: Case):
    for episode, chunk in drive(case):
        level, steps = chunk.levels["intention"], np.arange(chunk.first_step, chunk.first_step + chunk.length)
        before = 100 * episode + steps[:: chunk.state_interval]
        np.testing.assert_array_equal(level.states, np.repeat(before[:, None], 3, axis=1))
        np.testing.assert_array_equal(level.actions[: chunk.length, 0], steps)
        for columns in chunk.levels.values():
            np.testing.assert_array_equal(columns.rewards[: chunk.length], -steps)
            assert not columns.actions[chunk.length :].any()
            assert not columns.rewards[chunk.length :].any()
        assert not chunk.images[chunk.length + 1 :].any()
        assert not chunk.motion[chunk.length + 1 :].any()
        assert not chunk.policy_version[chunk.length :].any()
        encode_chunk(chunk)  # it is valid


@settings(max_examples=60, deadline=None)
@given(cases)
def test_only_the_last_chunk_of_an_episode_says_that_and_how_it_ended(case: Case):
    chunks = drive(case)
    for episode, end in enumerate(case[2]):
        own = [chunk for number, chunk in chunks if number == episode]
        assert not any(chunk.terminated or chunk.truncated for chunk in own[:-1])
        assert (own[-1].terminated, own[-1].truncated) == (end == "terminated", end == "truncated")


def test_a_slow_actors_chunk_goes_with_the_sequences_that_it_has():
    harness = CutterHarness(1, 2, sequences=5)
    harness.begin(0, 0)
    lengths = []
    for step in range(9):
        harness.now += 0.3 * LONGEST_SECONDS
        lengths += [chunk.length for chunk in harness.decide((0, step, ""))]
    assert lengths == [4, 4]  # after four decisions it is old, and a sequence is complete


def test_a_chunk_does_not_change_when_its_sources_or_its_cutter_do():
    harness = CutterHarness(1, 2)
    harness.begin(0, 0)
    sources = decision(((0, 0, ""),))
    harness.batch.see(0, 0, 1)
    harness.cutter.add(**sources, policy_version=0, ended={})
    sources["states"]["intention"][...] = sources["actions"]["intention"][...] = 99
    (chunk,) = harness.cutter.flush()
    for step in range(1, 5):
        harness.decide((0, step, ""), version=9)
    np.testing.assert_array_equal(chunk.images, [image(0, 0), image(0, 1), np.zeros((2, 2, 4))])
    np.testing.assert_array_equal(chunk.motion, [motion(0, 0), motion(0, 1), [0, 0]])
    np.testing.assert_array_equal(chunk.levels["intention"].states, [[0, 0, 0]])
    np.testing.assert_array_equal(chunk.levels["intention"].actions, [[0], [0]])
    assert chunk.policy_version.tolist() == [0, 0]


@pytest.mark.parametrize(
    ("paid", "share"),
    [
        (("collision", "speed", "fast", "out", "constant"), 4),
        (("lateral",), -2),
        (("constant", "collision"), -3),
        (REWARD_TERMS[::-1], 1),
    ],
)
def test_levels_receive_the_terms_that_they_name(paid: tuple[str, ...], share: int):
    harness = CutterHarness(2, 3, sequences=2, levels=(replace(INTENTION, rewarded=paid), TRAJECTORY))
    for env_index in range(2):
        harness.begin(env_index, env_index)
    chunks = [
        chunk
        for step in range(8)
        for chunk in harness.decide((0, step, ""), (1, step, "terminated" if step == 7 else ""))
    ]
    chunks += harness.cutter.flush()
    assert [(chunk.environment, chunk.length) for chunk in chunks] == [(0, 6), (1, 6), (1, 2), (0, 2)]
    for chunk in chunks:
        earned = np.zeros(chunk.time, np.float32)
        earned[: chunk.length] = -np.arange(chunk.first_step, chunk.first_step + chunk.length)
        np.testing.assert_array_equal(chunk.levels["trajectory"].rewards, earned)
        np.testing.assert_array_equal(chunk.levels["intention"].rewards, share * earned)
        encode_chunk(chunk)  # it is valid


def test_an_episode_cannot_begin_over_pending_transitions():
    harness = CutterHarness(1, 3)
    harness.begin(0, 0)
    harness.decide((0, 0, ""))
    with pytest.raises(RuntimeError, match="pending"):
        harness.begin(0, 1)


def test_what_is_dropped_is_in_no_chunk_and_counted_where_there_was_something():
    harness = CutterHarness(2, 3)
    for env_index in range(2):
        harness.begin(env_index, env_index)
    assert harness.cutter.drop([0, 1]) == 0
    harness.decide((0, 0, ""), (1, 0, ""))
    assert harness.cutter.drop([1]) == 1
    harness.begin(1, 2)
    chunks = harness.decide((0, 1, "truncated"), (2, 0, "terminated"))
    assert [(chunk.episode_seed, chunk.length) for chunk in chunks] == [(1000, 2), (1002, 1)]
    np.testing.assert_array_equal(chunks[1].images[:2], [image(2, 0), image(2, 1)])


@pytest.mark.parametrize("sequences", [1, 2])
def test_cutter_continues_from_its_state_in_the_middle_of_episodes(sequences: int):
    first, second = CutterHarness(2, 4, sequences), CutterHarness(2, 4, sequences)
    for env_index in range(2):
        first.begin(env_index, env_index)
    for step in range(6):
        first.decide((0, step, ""), (1, step, ""), version=step)
    second.cutter.load_state(first.cutter.state())
    made = [
        harness.decide((0, 6, "terminated"), (1, 6, ""), version=6) + harness.cutter.flush()
        for harness in (first, second)
    ]
    for one, other in zip(*made, strict=True):
        assert encode_chunk(one) == encode_chunk(other)
    begun = 4 if sequences == 1 else 0
    assert [(chunk.first_step, chunk.length) for chunk in made[1]] == [(begun, 7 - begun)] * 2
    seen = [image(0, step) for step in range(begun, 8)]
    np.testing.assert_array_equal(made[1][0].images[: len(seen)], seen)
