"""Turns received chunks into sequences for the replay; everything that an actor sends is checked here.

The protocol has checked that a chunk is well formed: types, columns of equal length, finite numbers. Only the
learner knows whether it fits *this* run (sizes, levels, ranges), and training relies on the content of the
replay for hours.
"""

from __future__ import annotations

import numpy as np
from athrl_planners import Sequence
from athrl_protocol import Chunk, InvalidMessage, LevelColumns
from athrl_spaces import Action, Continuous, LevelDescription, PolicyDescription

#: Physical values were rounded to float32 and scaled by the graph: this much beyond a range is rounding.
_ROUNDING = 1e-4
_MOTION_LIMIT = 2.0
#: Far beyond every reward and every cell of an LSTM; larger values would spoil the critics.
_LARGEST = 1e5


class ChunkReader:
    """Turns chunks into sequences, and refuses those that do not fit the run."""

    def __init__(self, policy: PolicyDescription, sequence_length: int, longest_chunk: int) -> None:
        """`policy` describes the policy of this run."""
        self._observation = policy.observation
        self._length = sequence_length
        self._longest = longest_chunk
        self._levels = {level.name: level for level in policy.levels}

    def sequences(self, chunk: Chunk) -> list[Sequence]:
        """The chunk as sequences, oldest first; their arrays are the chunk's.

        The image between two sequences belongs to both.

        Raises:
            InvalidMessage: a size, a level or a value does not fit the run; says what it is and what it
                should be.
        """
        self._check_sizes(chunk)
        _check_motion(chunk.motion)
        for name, expected in self._levels.items():
            _check_level(name, chunk.levels[name], expected, chunk)
        return [self._sequence(chunk, number) for number in range(chunk.sequences)]

    def _sequence(self, chunk: Chunk, number: int) -> Sequence:
        """The chunk's sequence `number`."""
        first, last = number * self._length, (number + 1) * self._length
        return Sequence(
            images=chunk.images[first : last + 1],
            motion=chunk.motion[first : last + 1],
            actions={name: chunk.levels[name].actions[first:last] for name in self._levels},
            rewards={name: chunk.levels[name].rewards[first:last] for name in self._levels},
            initial_state={name: chunk.levels[name].states[number] for name in self._levels},
            length=min(self._length, chunk.length - first),
            terminated=chunk.terminated and last == chunk.time,
        )

    def _check_sizes(self, chunk: Chunk) -> None:
        if chunk.state_interval != self._length:
            raise InvalidMessage(
                "shape", f"state_interval is {chunk.state_interval}; it should be {self._length}"
            )
        if chunk.time > self._longest:
            raise InvalidMessage("shape", f"time is {chunk.time}; it should be at most {self._longest}")
        _check_shape("images", chunk.images, (chunk.time + 1, *self._observation.image_shape))
        _check_shape("motion", chunk.motion, (chunk.time + 1, self._observation.motion_size))
        if set(chunk.levels) != set(self._levels):
            raise InvalidMessage(
                "shape", f"levels are {sorted(chunk.levels)}; they should be {sorted(self._levels)}"
            )


def _check_level(name: str, columns: LevelColumns, expected: LevelDescription, chunk: Chunk) -> None:
    _check_shape(f"{name}.actions", columns.actions, (chunk.time, len(expected.actions)))
    _check_shape(f"{name}.states", columns.states, (chunk.sequences, expected.state_size))
    for column, action in zip(columns.actions[: chunk.length].T, expected.actions, strict=True):
        _check_action(name, action, column)
    _check_size(f"{name}.rewards", columns.rewards)
    _check_size(f"{name}.actions", columns.actions)  # padding goes through the networks, too
    _check_size(f"{name}.states", columns.states)


def _check_action(level: str, action: Action, column: np.ndarray) -> None:
    """A number must lie in its range, a choice must be one of the existing ones."""
    low, high = action.bounds
    margin = _ROUNDING * action.half_range if isinstance(action, Continuous) else 0.0
    fits = (column >= low - margin) & (column <= high + margin)
    unit = f" {action.unit}" if isinstance(action, Continuous) and action.unit else ""
    if not isinstance(action, Continuous):
        fits &= column == np.floor(column)
        unit = ", a whole number"
    if not fits.all():
        raise InvalidMessage(
            "value",
            f"{level}.actions: {action.name} is {column.min()}..{column.max()}; "
            f"it should be {low:g}..{high:g}{unit}",
        )


def _check_motion(motion: np.ndarray) -> None:
    if not (np.abs(motion) <= _MOTION_LIMIT * (1 + _ROUNDING)).all():
        raise InvalidMessage(
            "value",
            f"motion is {motion.min()}..{motion.max()}; it should be -{_MOTION_LIMIT:g}..{_MOTION_LIMIT:g}",
        )


def _check_size(name: str, numbers: np.ndarray) -> None:
    if not (np.abs(numbers) <= _LARGEST).all():
        raise InvalidMessage(
            "value", f"{name} is {numbers.min()}..{numbers.max()}; it should be -{_LARGEST:g}..{_LARGEST:g}"
        )


def _check_shape(name: str, array: np.ndarray, shape: tuple[int, ...]) -> None:
    if array.shape != shape:
        raise InvalidMessage("shape", f"{name} has shape {list(array.shape)}; it should be {list(shape)}")
