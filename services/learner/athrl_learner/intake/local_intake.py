"""Intake without a network: chunks of an actor in the learner's process."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator

from athrl_protocol import Chunk, encode_chunk
from athrl_protocol.codec.images import Compression
from athrl_protocol.delivery.ledger import Ledger

from athrl_learner.intake.store import ExperienceStore


class LocalIntake:
    """Takes chunks in and keeps the ledger, all in one thread.

    Args:
        store: takes the chunks.
        ledger: to continue with.
        compression: of the chunks' images in the log.
    """

    def __init__(self, store: ExperienceStore, ledger: Ledger, compression: Compression = "lz4") -> None:
        self._store = store
        self._ledger = ledger
        self._compression: Compression = compression

    def take_in(self, chunk: Chunk) -> None:
        """Number a chunk, log it as the message that it would be, and insert it into the replay.

        Raises:
            InvalidMessage, IntakeBusy, IntakeFinished, LogFailed: as `ExperienceStore.accept`; the chunk is
                not taken in, and may be submitted again.
        """
        sequence = self._ledger.next_sequence(chunk.actor, chunk.incarnation)
        numbered = dataclasses.replace(chunk, sequence=sequence, oldest_held=sequence)
        self._store.accept(numbered, encode_chunk(numbered, self._compression))
        self._ledger.record(numbered)

    @contextlib.contextmanager
    def paused(self) -> Iterator[None]:
        """Within the block no chunk is taken in: there is no other thread."""
        yield

    def ledger(self) -> dict[str, dict[str, int]]:
        """The ledger as JSON."""
        return self._ledger.to_json()

    def totals(self) -> dict[str, int]:
        """The totals that belong to the ledger."""
        return self._ledger.totals_to_json()
