"""A chunk: consecutive steps of one environment's episode, in columns; and its validation.

It consists of one or more consecutive sequences of the replay: sending them together costs less.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from athrl_protocol.errors import InvalidMessage, ProtocolError
from athrl_protocol.messages.keys import check_name

# Bounds on the memory that a received message can make the receiver allocate.
MAXIMUM_TIME = 1_024
MAXIMUM_LEVELS = 16
MAXIMUM_IMAGES_BYTES = 64 * 2**20
MAXIMUM_COLUMN_BYTES = 2**20

_FLOAT32, _INT64, _UINT8 = np.dtype(np.float32), np.dtype(np.int64), np.dtype(np.uint8)


@dataclass(frozen=True, eq=False)
class LevelColumns:
    """Columns of one level of the planner.

    Attributes:
        actions: float32 [time, action_size], physical units.
        rewards: float32 [time].
        states: float32 [time / state_interval, state_size], the recurrent states before the steps 0,
            `state_interval`, 2 `state_interval`, ...; may be of size 0.
    """

    actions: npt.NDArray[np.float32]
    rewards: npt.NDArray[np.float32]
    states: npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Chunk:
    """Consecutive steps of one episode; steps from `length` on are padding (zeros).

    Attributes:
        actor: name of the actor.
        incarnation: of the actor's process, see `new_incarnation`.
        sequence: number of the chunk within the incarnation, from 0; the uploader sets it.
        environment: index of the environment within its actor.
        episode_seed: seed with which the episode was reset.
        first_step: decision of the episode at which the chunk starts.
        length: valid steps, at least one of them in the last sequence, at most `time`.
        state_interval: steps between two recurrent states, the length of a sequence; `time` is a multiple
            of it.
        images: uint8 [time + 1, height, width, channels]; `images[length]` is the next observation
            of the last valid step, which is the terminal one if the episode ended.
        motion: float32 [time + 1, motion_size], in the same way.
        levels: columns by the level's name, from the highest level down.
        policy_version: int64 [time], the version that chose each action.
        terminated: the last valid step ended the episode.
        truncated: the last valid step reached the time limit, or the end of the map.
        oldest_held: lowest sequence that the actor can still send; the uploader sets it.
    """

    actor: str
    incarnation: int
    sequence: int
    environment: int
    episode_seed: int
    first_step: int
    length: int
    state_interval: int
    images: npt.NDArray[np.uint8]
    motion: npt.NDArray[np.float32]
    levels: dict[str, LevelColumns]
    policy_version: npt.NDArray[np.int64]
    terminated: bool
    truncated: bool
    oldest_held: int = 0

    @property
    def time(self) -> int:
        """Steps, including padding."""
        return len(self.policy_version)

    @property
    def sequences(self) -> int:
        """Number of sequences."""
        return self.time // self.state_interval


def check_chunk(chunk: Chunk) -> None:
    """Check shapes, types, bounds and values of a chunk.

    Raises:
        InvalidMessage: names the column that is not valid, what it is and what it should be.
    """
    check_form(chunk)
    check_finite(chunk)


def check_form(chunk: Chunk) -> None:
    """Check everything except that all numbers are finite; raises as `check_chunk` does."""
    _check_identity(chunk)
    time = chunk.time
    if not 1 <= time <= MAXIMUM_TIME:
        raise InvalidMessage("shape", f"chunk: time is {time}, should be 1 to {MAXIMUM_TIME}")
    interval = chunk.state_interval
    if interval < 1 or time % interval:
        raise InvalidMessage("shape", f"chunk: state_interval is {interval}, should divide time = {time}")
    if not time - interval < chunk.length <= time:
        raise InvalidMessage(
            "shape", f"chunk: length is {chunk.length}, should be {time - interval + 1} to time = {time}"
        )
    _check_column(("policy_version",), chunk.policy_version, _INT64, 1, time)
    if _any_negative(chunk.policy_version):
        raise InvalidMessage("value", "chunk: policy_version has negative numbers")
    _check_column(("images",), chunk.images, _UINT8, 4, time + 1)
    if not 0 < chunk.images.nbytes <= MAXIMUM_IMAGES_BYTES:
        raise InvalidMessage(
            "size", f"chunk: images of {chunk.images.nbytes} bytes, should be 1 to {MAXIMUM_IMAGES_BYTES}"
        )
    _check_column(("motion",), chunk.motion, _FLOAT32, 2, time + 1)
    if not 1 <= len(chunk.levels) <= MAXIMUM_LEVELS:
        raise InvalidMessage("shape", f"chunk: {len(chunk.levels)} levels, should be 1 to {MAXIMUM_LEVELS}")
    for name, level in chunk.levels.items():
        _check_name("level", name)
        _check_column((name, "actions"), level.actions, _FLOAT32, 2, time)
        _check_column((name, "rewards"), level.rewards, _FLOAT32, 1, time)
        _check_column((name, "states"), level.states, _FLOAT32, 2, time // interval, may_be_empty=True)


def check_finite(chunk: Chunk) -> None:
    """Check that all numbers of a chunk are finite; raises as `check_chunk` does."""
    columns = [chunk.motion]
    for level in chunk.levels.values():
        columns += level.actions, level.rewards, level.states
    # All columns at once: the calls cost more than the numbers. Joining bytes and counting take half the
    # time of `concatenate` and `all`.
    numbers = np.frombuffer(b"".join([column.tobytes() for column in columns]), _FLOAT32)
    if np.count_nonzero(np.isfinite(numbers)) == numbers.size:
        return
    parts = ("actions", "rewards", "states")
    names = ["motion", *(f"{level}.{part}" for level in chunk.levels for part in parts)]
    for name, column in zip(names, columns, strict=True):
        if not np.isfinite(column).all():
            raise InvalidMessage("value", f"chunk: {name} has numbers that are not finite")


def _check_identity(chunk: Chunk) -> None:
    _check_name("actor", chunk.actor)
    for name, value, end in (
        ("incarnation", chunk.incarnation, 1 << 64),
        ("sequence", chunk.sequence, 1 << 63),
        ("oldest_held", chunk.oldest_held, 1 << 63),
        ("episode_seed", chunk.episode_seed, 1 << 64),
        ("environment", chunk.environment, 1 << 32),
        ("first_step", chunk.first_step, 1 << 32),
    ):
        if not 0 <= value < end:
            raise InvalidMessage(
                "value", f"chunk: {name} is {value}, should be 0 to 2^{end.bit_length() - 1} - 1"
            )


def _check_name(kind: str, name: str) -> None:
    try:
        check_name(kind, name)
    except ProtocolError as error:
        raise InvalidMessage("value", f"chunk: {error}") from None


def _any_negative(numbers: npt.NDArray[np.int64]) -> bool:
    """Whether the highest byte of any number is beyond ASCII: the result of `min` in a fifth of its time."""
    return not numbers.astype("<i8", copy=False).tobytes()[7::8].isascii()


def _check_column(
    name: tuple[str, ...],
    column: npt.NDArray[Any],
    dtype: np.dtype[Any],
    dimensions: int,
    length: int,
    may_be_empty: bool = False,
) -> None:
    """Check type and shape of one column, [length, any, ...]; any is at least 1 unless it may be empty."""
    if column.dtype != dtype:
        raise InvalidMessage("shape", f"chunk: {'.'.join(name)} is {column.dtype}, should be {dtype}")
    shape = column.shape
    if len(shape) != dimensions or shape[0] != length or (0 in shape and not may_be_empty):
        wanted = ", ".join([str(length)] + ["any"] * (dimensions - 1))
        raise InvalidMessage(
            "shape", f"chunk: {'.'.join(name)} has shape {list(shape)}, should be [{wanted}]"
        )
