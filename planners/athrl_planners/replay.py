"""Replay of sequences: preallocated columns, a ring, uniform sampling with a generator of its own."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from athrl_planners.sequence import Sequence, SequenceBatch
from athrl_planners.settings import ObservationSettings

_WORD = 2**64


class SequenceReplay:
    """Holds the newest sequences. One thread may insert while another samples.

    The columns are allocated with the first insertion, so `bytes` can be announced before. Sequences are
    drawn evenly and with replacement, so every stored decision is equally likely.
    """

    def __init__(
        self,
        capacity_transitions: int,
        sequence_length: int,
        observation: ObservationSettings,
        levels: Mapping[str, tuple[int, int]],
        seed: int,
    ) -> None:
        """Lay out the columns; `levels` has the action size and the state size of each level."""
        if capacity_transitions < sequence_length:
            raise ValueError(f"a capacity of {capacity_transitions} holds no sequence of {sequence_length}")
        self.slots = math.ceil(capacity_transitions / sequence_length)
        self.sequence_length = sequence_length
        self._levels = tuple(levels)
        self._layout = _layout(sequence_length, observation, levels)
        self._columns: dict[str, np.ndarray] = {}
        self._inserted = 0  # sequences ever; the next one goes to slot inserted % slots
        self._transitions = 0
        self._random = np.random.Generator(np.random.PCG64(seed))
        self._lock = threading.Lock()

    @property
    def bytes(self) -> int:
        """Memory of the columns once they are allocated, in bytes."""
        row = sum(math.prod(shape) * np.dtype(dtype).itemsize for shape, dtype in self._layout.values())
        return row * self.slots

    @property
    def sequences(self) -> int:
        """Sequences that are stored."""
        return min(self._inserted, self.slots)

    def __len__(self) -> int:
        """Transitions that are stored, padding not counted."""
        return self._transitions

    def insert(self, sequence: Sequence) -> None:
        """Store a copy, in a full ring over the oldest sequence; raises ValueError if it does not fit."""
        row = self._row(sequence)
        with self._lock:
            self._allocate()
            slot = self._inserted % self.slots
            if self._inserted >= self.slots:
                self._transitions -= int(self._columns["length"][slot])
            for name, value in row.items():
                self._columns[name][slot] = value
            self._transitions += sequence.length
            self._inserted += 1

    def sample(self, batch: int) -> SequenceBatch:
        """Draw a batch of sequences, as copies; raises ValueError while the replay is empty."""
        with self._lock:
            if not self.sequences:
                raise ValueError("the replay is empty; insert a sequence before sampling")
            slots = self._random.integers(self.sequences, size=batch)
            rows = {name: column[slots] for name, column in self._columns.items()}
        return SequenceBatch(
            images=rows["images"],
            motion=rows["motion"],
            actions={level: rows[f"{level}.actions"] for level in self._levels},
            rewards={level: rows[f"{level}.rewards"] for level in self._levels},
            initial_state={level: rows[f"{level}.initial_state"] for level in self._levels},
            length=rows["length"],
            terminated=rows["terminated"],
        )

    def columns(self) -> dict[str, np.ndarray]:
        """What is stored, by column: views [sequences, ...] in the order of the slots; none while empty."""
        return {name: column[: self.sequences] for name, column in self._columns.items()}

    def state(self) -> dict[str, Any]:
        """What a restored replay needs beside its sequences, JSON-able: counts and the generator's state."""
        with self._lock:
            return {
                "inserted": self._inserted,
                "sequences": self.sequences,
                "random": self._random_words(),
            }

    def load_state(self, state: Mapping[str, Any], sequences: Iterable[Sequence]) -> int:
        """Become what `state` was taken from.

        With all the sequences that were stored then, and the same capacity, every one comes to its old slot
        and the next samples are the same. With fewer of them (some were damaged), or another capacity, the
        newest that there are fill the replay from its first slot on.

        Args:
            state: what `state()` returned, perhaps by way of JSON.
            sequences: what was stored, oldest first.

        Returns:
            How many sequences there were.

        Raises:
            KeyError, TypeError, ValueError: `state` or a sequence does not fit; the replay is not usable.
        """
        inserted, expected = int(state["inserted"]), int(state["sequences"])
        if not 0 <= expected <= inserted:
            raise ValueError(f"the state has {expected} sequences of {inserted} inserted")
        with self._lock:
            self._columns, self._transitions = {}, 0
            self._inserted = inserted - expected
            self._restore_random(state["random"])
        begin = self._inserted
        for sequence in sequences:
            self.insert(sequence)
        found = self._inserted - begin
        with self._lock:
            if found < self.sequences:
                self._begin_at_the_first_slot(begin, found)
        return found

    def _begin_at_the_first_slot(self, begin: int, found: int) -> None:
        """Move fewer sequences than slots, the first of them at `begin`, so that none before is empty."""
        for name, column in self._columns.items():
            self._columns[name] = np.roll(column, -(begin % self.slots), axis=0)
        self._inserted = found

    def _allocate(self) -> None:
        if not self._columns:
            self._columns = {
                name: np.zeros((self.slots, *shape), dtype) for name, (shape, dtype) in self._layout.items()
            }

    def _row(self, sequence: Sequence) -> dict[str, np.ndarray]:
        """The sequence as a row of the columns, checked."""
        if not 1 <= sequence.length <= self.sequence_length:
            raise ValueError(f"the length is {sequence.length}; it should be 1..{self.sequence_length}")
        row: dict[str, np.ndarray] = {
            "images": sequence.images,
            "motion": sequence.motion,
            "length": np.array(sequence.length, np.int64),
            "terminated": np.array(sequence.terminated, np.bool_),
        }
        for level in self._levels:
            row[f"{level}.actions"] = sequence.actions[level]
            row[f"{level}.rewards"] = sequence.rewards[level]
            row[f"{level}.initial_state"] = sequence.initial_state[level]
        for name, value in row.items():
            _check(name, value, *self._layout[name])
        return row

    def _random_words(self) -> list[int]:
        """The generator's state as integers below 2^64, since not every JSON reader takes 128 bits."""
        state = self._random.bit_generator.state
        value, increment = state["state"]["state"], state["state"]["inc"]
        words = [*divmod(value, _WORD), *divmod(increment, _WORD), state["has_uint32"], state["uinteger"]]
        return [int(word) for word in words]

    def _restore_random(self, words: list[int]) -> None:
        numbers = [int(word) for word in words]
        if len(numbers) != 6:
            raise ValueError(f"the generator's state has {len(numbers)} numbers; it should have 6")
        self._random.bit_generator.state = {
            "bit_generator": "PCG64",
            "state": {"state": numbers[0] * _WORD + numbers[1], "inc": numbers[2] * _WORD + numbers[3]},
            "has_uint32": numbers[4],
            "uinteger": numbers[5],
        }


def _layout(
    time: int, observation: ObservationSettings, levels: Mapping[str, tuple[int, int]]
) -> dict[str, tuple[tuple[int, ...], str]]:
    """Shape and dtype of one row of each column."""
    layout: dict[str, tuple[tuple[int, ...], str]] = {
        "images": ((time + 1, *observation.image_shape), "uint8"),
        "motion": ((time + 1, observation.motion_size), "float32"),
        "length": ((), "int64"),
        "terminated": ((), "bool"),
    }
    for level, (action_size, state_size) in levels.items():
        layout[f"{level}.actions"] = ((time, action_size), "float32")
        layout[f"{level}.rewards"] = ((time,), "float32")
        layout[f"{level}.initial_state"] = ((state_size,), "float32")
    return layout


def _check(name: str, value: np.ndarray, shape: tuple[int, ...], dtype: str) -> None:
    if value.shape != shape or value.dtype != np.dtype(dtype):
        raise ValueError(f"{name} is {value.dtype} {list(value.shape)}; it should be {dtype} {list(shape)}")
