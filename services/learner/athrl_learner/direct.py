"""Intake without a network: chunks of an actor that lives in the learner's process."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator

from athrl_protocol import Chunk, encode_chunk
from athrl_protocol.ledger import Ledger

from athrl_learner.store import ExperienceStore


class DirectIntake:
    """Takes chunks in as they come, and keeps the ledger; all in one thread."""

    def __init__(self, store: ExperienceStore, ledger: Ledger) -> None:
        self._store = store
        self._ledger = ledger

    def take_in(self, chunk: Chunk) -> None:
        """Number a chunk, write it down as the message that it would be, and put it into the replay.

        Raises:
            InvalidMessage, IntakeBusy, IntakeFinished, LogFailed: as `ExperienceStore.accept`; the chunk is
                not taken in, and may be brought again.
        """
        sequence = self._ledger.next_sequence(chunk.actor, chunk.incarnation)
        numbered = dataclasses.replace(chunk, sequence=sequence, oldest_held=sequence)
        self._store.accept(numbered, encode_chunk(numbered))
        self._ledger.record(numbered)

    @contextlib.contextmanager
    def paused(self) -> Iterator[None]:
        """Nothing is taken in within the block: there is no thread that could."""
        yield

    def ledger(self) -> dict[str, dict[str, int]]:
        """The ledger as JSON."""
        return self._ledger.to_json()

    def totals(self) -> dict[str, int]:
        """The totals that go with it."""
        return self._ledger.totals_to_json()
