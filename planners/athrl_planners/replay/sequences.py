"""A ring buffer of sequences in preallocated columns; samples sequences or single decisions."""

from __future__ import annotations

import math
import threading
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from athrl_spaces import LevelDescription, Observation

from athrl_planners.replay.batches import Batch, Sequence, SequenceBatch, TransitionBatch
from athrl_planners.replay.random_state import restore_random, to_words
from athrl_planners.replay.sampling import PrioritisedSampler, Sampler, UniformSampler


class SequenceReplay:
    """Holds the newest sequences. One thread may insert while another samples.

    The columns are allocated with the first insertion, so `bytes` is known before. Items are sampled with
    replacement.

    Args:
        capacity: decisions, rounded up to whole sequences.
        sequence_length: decisions in a sequence.
        observation: observation of the planner.
        levels: of the planner, highest first.
        seed: of the sampling.
        horizons: numbers of steps after which the outcome of a transition is observed; none: whole sequences
            are sampled.
        priority: exponents of priority and importance weight; None: uniform sampling.

    Raises:
        ValueError: the capacity is less than a sequence.
    """

    def __init__(
        self,
        capacity: int,
        sequence_length: int,
        observation: Observation,
        levels: Iterable[LevelDescription],
        seed: int,
        horizons: tuple[int, ...] = (),
        priority: tuple[float, float] | None = None,
    ) -> None:
        if capacity < sequence_length:
            raise ValueError(f"a capacity of {capacity} holds no sequence of {sequence_length}")
        self.slots = math.ceil(capacity / sequence_length)
        self.sequence_length = sequence_length
        levels = tuple(levels)
        self._levels = tuple(level.name for level in levels)
        self._horizons = horizons
        self._layout = _layout(sequence_length, observation, levels)
        self._columns: dict[str, np.ndarray] = {}
        self._inserted = 0  # sequences so far; the next one goes to slot inserted % slots
        self._transitions = 0
        self._random = np.random.Generator(np.random.PCG64(seed))
        self._items_per_slot = sequence_length if horizons else 1
        self._priority = priority
        self.prioritised = priority is not None
        self._sampler = self._new_sampler()
        self._lock = threading.Lock()

    @property
    def bytes(self) -> int:
        """Memory of the columns once they are allocated, in bytes."""
        row = sum(math.prod(shape) * np.dtype(dtype).itemsize for shape, dtype in self._layout.values())
        return row * self.slots

    @property
    def sequences(self) -> int:
        """Stored sequences."""
        return min(self._inserted, self.slots)

    def __len__(self) -> int:
        """Stored transitions, without padding."""
        return self._transitions

    def insert(self, sequence: Sequence) -> None:
        """Store a copy; a full buffer replaces its oldest sequence. Raises ValueError if it does not fit."""
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
            self._put(slot, sequence.length)

    def sample(self, decisions: int) -> Batch:
        """Sample a batch, as copies: single decisions, or the number of whole sequences nearest to it.

        Raises:
            ValueError: the replay is empty.
        """
        with self._lock:
            if not self.sequences:
                raise ValueError("the replay is empty; insert a sequence before sampling")
            if self._horizons:
                return self._transition_batch(*self._sampler.draw(decisions, self._random))
            count = max(1, round(decisions / self.sequence_length))
            return self._sequence_batch(*self._sampler.draw(count, self._random))

    def update_priorities(self, batch: Batch, errors: np.ndarray) -> None:
        """Set the priorities of a batch from its absolute errors, float32 [batch].

        Items that have been replaced since it was sampled keep theirs.
        """
        if self._priority is None:
            return
        with self._lock:
            slots = batch.places // self._items_per_slot
            replaced = (slots - batch.inserted) % self.slots < self._inserted - batch.inserted
            self._sampler.update_priorities(batch.places[~replaced], errors[~replaced])

    def columns(self) -> dict[str, np.ndarray]:
        """Stored sequences by column: views [sequences, ...] in order of slots; empty if there are none."""
        return {name: column[: self.sequences] for name, column in self._columns.items()}

    def state(self) -> dict[str, Any]:
        """State of the replay besides its sequences: counts and the generator's state, JSON-able."""
        with self._lock:
            return {
                "inserted": self._inserted,
                "sequences": self.sequences,
                "random": to_words(self._random),
            }

    def priorities(self) -> dict[str, Any]:
        """The priorities, as arrays and plain values; empty for uniform sampling."""
        with self._lock:
            return self._sampler.state()

    def load_priorities(self, state: Mapping[str, Any]) -> None:
        """Restore `priorities()` of a replay with the same sequences in the same slots.

        Raises:
            ValueError: it belongs to a replay of another size.
        """
        if state and self._priority is not None:
            with self._lock:
                self._sampler.load_state(dict(state))

    def load_state(self, state: Mapping[str, Any], sequences: Iterable[Sequence]) -> int:
        """Restore the replay of `state`.

        With all sequences of that replay and the same capacity, every sequence gets its old slot and the next
        samples are the same. With fewer sequences (some were damaged) or another capacity, the newest ones
        fill the replay from the first slot on.

        Args:
            state: what `state()` returned, maybe via JSON.
            sequences: the stored sequences, oldest first.

        Returns:
            Number of given sequences.

        Raises:
            KeyError, TypeError, ValueError: `state` or a sequence does not fit; the replay cannot be used
                then.
        """
        inserted, expected = int(state["inserted"]), int(state["sequences"])
        if not 0 <= expected <= inserted:
            raise ValueError(f"the state has {expected} sequences of {inserted} inserted")
        with self._lock:
            self._columns, self._transitions = {}, 0
            self._sampler = self._new_sampler()
            self._inserted = inserted - expected
            restore_random(self._random, state["random"])
        begin = self._inserted
        for sequence in sequences:
            self.insert(sequence)
        found = self._inserted - begin
        with self._lock:
            if found < self.sequences:
                self._move_to_first_slot(begin, found)
        return found

    def _move_to_first_slot(self, begin: int, found: int) -> None:
        """Move fewer sequences than slots, of which the first is at `begin`, to the first slots."""
        for name, column in self._columns.items():
            self._columns[name] = np.roll(column, -(begin % self.slots), axis=0)
        self._inserted = found
        self._sampler = self._new_sampler()
        for slot in range(found):
            self._put(slot, int(self._columns["length"][slot]))

    def _new_sampler(self) -> Sampler:
        items = self.slots * self._items_per_slot
        return UniformSampler(items) if self._priority is None else PrioritisedSampler(items, *self._priority)

    def _put(self, slot: int, length: int) -> None:
        """Make the items of a slot available for sampling, except padding."""
        items = np.arange(self._items_per_slot)
        present = items < length if self._horizons else np.ones(1, bool)
        self._sampler.put(slot * self._items_per_slot + items, present)

    def _sequence_batch(self, slots: np.ndarray, weights: np.ndarray) -> SequenceBatch:
        rows = {name: column[slots] for name, column in self._columns.items()}
        return SequenceBatch(
            images=rows["images"],
            motion=rows["motion"],
            actions={level: rows[f"{level}.actions"] for level in self._levels},
            rewards={level: rows[f"{level}.rewards"] for level in self._levels},
            initial_state={level: rows[f"{level}.initial_state"] for level in self._levels},
            length=rows["length"],
            terminated=rows["terminated"],
            places=slots,
            weights=weights,
            inserted=self._inserted,
        )

    def _transition_batch(self, places: np.ndarray, weights: np.ndarray) -> TransitionBatch:
        """Look up decisions by their indices: `slot * sequence_length + step`."""
        columns, time = self._columns, self.sequence_length
        slots, step = np.divmod(places, time)
        length = columns["length"][slots]
        steps = np.minimum(np.array(self._horizons)[:, None], length - step)
        ends = columns["terminated"][slots] & (step + steps == length)
        seen = (slots * (time + 1) + step) + np.concatenate([np.zeros_like(step)[None], steps])
        window = step[:, None] + np.arange(max(self._horizons))
        inside = window < length[:, None]
        window = np.minimum(window, time - 1)
        return TransitionBatch(
            images=_rows(columns["images"], seen),
            motion=_rows(columns["motion"], seen),
            actions={level: columns[f"{level}.actions"][slots, step] for level in self._levels},
            last_actions={
                level: columns[f"{level}.actions"][slots, step + steps - 1] for level in self._levels
            },
            rewards={
                level: np.where(inside, columns[f"{level}.rewards"][slots[:, None], window], np.float32(0))
                for level in self._levels
            },
            steps=steps,
            terminated=ends,
            initial_state={level: columns[f"{level}.initial_state"][slots] for level in self._levels},
            step=step,
            places=places,
            weights=weights,
            inserted=self._inserted,
        )

    def _allocate(self) -> None:
        if not self._columns:
            self._columns = {
                name: np.zeros((self.slots, *shape), dtype) for name, (shape, dtype) in self._layout.items()
            }

    def _row(self, sequence: Sequence) -> dict[str, np.ndarray]:
        """The sequence as a row of the columns, after checking it."""
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


def _rows(column: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Observations by their indices over all sequences: a copy [*places, ...]."""
    flat = column.reshape(column.shape[0] * column.shape[1], -1)
    return np.take(flat, places.ravel(), axis=0).reshape(*places.shape, *column.shape[2:])


def _layout(
    time: int, observation: Observation, levels: Iterable[LevelDescription]
) -> dict[str, tuple[tuple[int, ...], str]]:
    """Shape and dtype of one row of each column."""
    layout: dict[str, tuple[tuple[int, ...], str]] = {
        "images": ((time + 1, *observation.image_shape), "uint8"),
        "motion": ((time + 1, observation.motion_size), "float32"),
        "length": ((), "int64"),
        "terminated": ((), "bool"),
    }
    for level in levels:
        layout[f"{level.name}.actions"] = ((time, level.action_size), "float32")
        layout[f"{level.name}.rewards"] = ((time,), "float32")
        layout[f"{level.name}.initial_state"] = ((level.state_size,), "float32")
    return layout


def _check(name: str, value: np.ndarray, shape: tuple[int, ...], dtype: str) -> None:
    if value.shape != shape or value.dtype != np.dtype(dtype):
        raise ValueError(f"{name} is {value.dtype} {list(value.shape)}; it should be {dtype} {list(shape)}")
