"""What actors send is checked against the run before it reaches the replay."""

import dataclasses

import numpy as np
import pytest
from athrl_learner import factories
from athrl_learner.intake.chunk_validation import ChunkReader
from athrl_protocol import Chunk, InvalidMessage, LevelColumns, decode_chunk, encode_chunk


@pytest.fixture
def reader(run_file) -> ChunkReader:
    return factories.make_reader(run_file, factories.make_agent(run_file))


def with_level(chunk: Chunk, level: str, **columns: np.ndarray) -> Chunk:
    changed = dataclasses.replace(chunk.levels[level], **columns)
    return dataclasses.replace(chunk, levels={**chunk.levels, level: changed})


def test_a_chunk_becomes_the_sequence_it_describes(reader, make_chunk):
    chunk = decode_chunk(encode_chunk(make_chunk(length=3, terminated=True)))
    (sequence,) = reader.sequences(chunk)
    assert (sequence.length, sequence.terminated) == (3, True)
    np.testing.assert_array_equal(sequence.images, chunk.images)
    np.testing.assert_array_equal(sequence.motion, chunk.motion)
    for level in ("intention", "trajectory"):
        np.testing.assert_array_equal(sequence.actions[level], chunk.levels[level].actions)
        np.testing.assert_array_equal(sequence.rewards[level], chunk.levels[level].rewards)
        np.testing.assert_array_equal(sequence.initial_state[level], chunk.levels[level].states[0])


def test_a_long_chunk_becomes_its_sequences_with_the_image_between_two_in_both(reader, make_chunk):
    chunk = decode_chunk(encode_chunk(make_chunk(sequences=3, length=12, terminated=True)))
    sequences = reader.sequences(chunk)
    assert [(sequence.length, sequence.terminated) for sequence in sequences] == [
        (5, False),
        (5, False),
        (2, True),
    ]
    for number, sequence in enumerate(sequences):
        steps, seen = slice(5 * number, 5 * number + 5), slice(5 * number, 5 * number + 6)
        np.testing.assert_array_equal(sequence.images, chunk.images[seen])
        np.testing.assert_array_equal(sequence.motion, chunk.motion[seen])
        for level, columns in chunk.levels.items():
            np.testing.assert_array_equal(sequence.actions[level], columns.actions[steps])
            np.testing.assert_array_equal(sequence.rewards[level], columns.rewards[steps])
            np.testing.assert_array_equal(sequence.initial_state[level], columns.states[number])


def test_a_chunk_with_other_sequences_than_the_runs_is_refused(reader, make_chunk):
    with pytest.raises(InvalidMessage, match=r"state_interval is 3; it should be 5"):
        reader.sequences(make_chunk(state_interval=3))
    reader.sequences(make_chunk(sequences=8))
    with pytest.raises(InvalidMessage, match=r"time is 45; it should be at most 40"):
        reader.sequences(make_chunk(sequences=9))


@pytest.mark.parametrize(
    ("shape", "columns"),
    [
        ("time", {"images": np.zeros((7, 32, 32, 4), np.uint8), "motion": np.zeros((7, 2), np.float32)}),
        ("size", {"images": np.zeros((6, 64, 64, 4), np.uint8)}),
        ("channels", {"images": np.zeros((6, 32, 32, 3), np.uint8)}),
        ("motion", {"motion": np.zeros((6, 3), np.float32)}),
    ],
)
def test_wrong_sizes_are_refused_with_what_they_should_be(reader, make_chunk, shape, columns):
    with pytest.raises(InvalidMessage, match="should be") as refusal:
        reader.sequences(make_chunk(**columns))
    assert refusal.value.reason == "shape"


@pytest.mark.parametrize("names", [("intention",), ("intention", "trajectory", "third"), ("a", "b")])
def test_wrong_levels_are_refused(reader, make_chunk, names):
    columns = next(iter(make_chunk().levels.values()))
    with pytest.raises(InvalidMessage, match=r"should be \['intention', 'trajectory'\]"):
        reader.sequences(make_chunk(levels=dict.fromkeys(names, columns)))


@pytest.mark.parametrize(
    "columns", [{"actions": np.zeros((5, 3), np.float32)}, {"states": np.zeros((1, 15), np.float32)}]
)
def test_wrong_level_columns_are_refused(reader, make_chunk, columns):
    with pytest.raises(InvalidMessage, match="trajectory"):
        reader.sequences(with_level(make_chunk(), "trajectory", **columns))


@pytest.mark.parametrize(
    ("level", "index", "value", "name"),
    [
        ("intention", 0, 2.1, "intention"),
        ("intention", 0, -0.1, "intention"),
        ("intention", 0, float("nan"), "intention"),
        ("trajectory", 0, 8.5, "target_speed"),
        ("trajectory", 1, -0.6, "waypoint_angle"),
        ("trajectory", 1, float("inf"), "waypoint_angle"),
    ],
)
def test_actions_outside_their_range_are_refused_by_name(reader, make_chunk, level, index, value, name):
    chunk = make_chunk()
    actions = chunk.levels[level].actions.copy()
    actions[2, index] = value
    with pytest.raises(InvalidMessage, match=name) as refusal:
        reader.sequences(with_level(chunk, level, actions=actions))
    assert refusal.value.reason == "value"


def test_the_ends_of_the_ranges_are_inside_them(reader, make_chunk):
    chunk = make_chunk()
    ends = np.array([[0.0, -np.pi / 6], [7.95, np.pi / 6]] * 3, np.float32)[:5]
    reader.sequences(with_level(chunk, "trajectory", actions=ends))


def test_motion_outside_its_range_is_refused(reader, make_chunk):
    motion = np.zeros((6, 2), np.float32)
    motion[3, 1] = -2.5
    with pytest.raises(InvalidMessage, match=r"motion is -2\.5"):
        reader.sequences(make_chunk(motion=motion))


def test_padding_may_hold_anything_finite(reader, make_chunk):
    chunk = make_chunk(length=2)
    actions = chunk.levels["intention"].actions.copy()
    actions[2:] = 99
    assert reader.sequences(with_level(chunk, "intention", actions=actions))[0].length == 2


@pytest.mark.parametrize("column", ["actions", "rewards", "states"])
def test_numbers_that_are_none_never_leave_the_wire(make_chunk, column):
    chunk = make_chunk()
    columns: LevelColumns = chunk.levels["trajectory"]
    poisoned = getattr(columns, column).copy()
    poisoned.flat[0] = np.nan
    with pytest.raises(InvalidMessage, match="finite"):
        encode_chunk(with_level(chunk, "trajectory", **{column: poisoned}))
