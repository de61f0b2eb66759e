"""Restores the experience: the replay from the segments that a checkpoint names, then later records.

Every acknowledged chunk is in the log. A checkpoint names the records that were in the replay when it was
taken. All later records were accepted after it and are inserted again, in order, with all counters. A serial
run, which repeats itself bit for bit, drives these decisions again instead.
"""

from __future__ import annotations

import dataclasses
import json
import logging
from collections.abc import Iterable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, Literal

from athrl_planners import Sequence
from athrl_protocol import Chunk, InvalidMessage, decode_chunk
from athrl_protocol.delivery.ledger import END_OF_SEQUENCES, Gap, Known, Ledger, New
from athrl_protocol.faults.bounded_log import BoundedLog
from athrl_spaces.untrusted import parser_errors
from athrl_spaces.wording import counted

from athrl_learner.errors import CannotResume, SettingsDoNotFit
from athrl_learner.files import Files
from athrl_learner.intake.store import ExperienceStore
from athrl_learner.log import (
    Damage,
    Kind,
    LogPosition,
    Record,
    SegmentFacts,
    SegmentReader,
    numbered_segments,
)

log = logging.getLogger(__name__)

LaterExperience = Literal["restored", "repeated"]
"""Experience after the checkpoint is restored from the log, or repeated by a serial run."""


class Recovery:
    """Reads the log of a run that is resumed.

    Attributes:
        chunks: accepted after the checkpoint and restored from the log.
        damaged: records of the log that cannot be read.
    """

    def __init__(self, store: ExperienceStore, ledger: Ledger, position: LogPosition | None) -> None:
        """Prepare for the log of `store`, from `position`, or from its beginning without a checkpoint."""
        self.chunks = 0
        self.damaged = 0
        self._store = store
        self._ledger = ledger
        self._position = position or LogPosition(1, 0, 0, 0, ())
        self._paths = numbered_segments(store.log.folder)
        first = self._position.segments[0].first if self._position.segments else self._position.next_record
        self._expected = first  # number of the next record if none is damaged
        self._facts: list[SegmentFacts] = []
        self._warn = BoundedLog(log.warning)  # a segment may be damaged in a thousand places

    def run(
        self,
        replay_state: dict[str, Any] | None,
        after: LaterExperience = "restored",
        priorities: dict[str, Any] | None = None,
    ) -> None:
        """Fill the replay as it was at the checkpoint (if there is one), then restore later records.

        With "repeated" the log continues directly after the checkpoint. Its later segments stay on the disk
        until `SegmentLog.remove_later_segments`.

        Raises:
            CannotResume: a segment cannot be read; a record does not fit the run's settings, or is of another
                release; one is damaged and later experience was to be repeated, which would then differ.
            KeyError, TypeError, ValueError: `replay_state` is wrong.
            OSError: a torn record at the end cannot be removed.
        """
        if replay_state is not None:
            found = self._store.replay.load_state(replay_state, self._checkpointed_sequences())
            if priorities and found == int(replay_state["sequences"]):
                self._store.replay.load_priorities(priorities)
        if after == "repeated":
            self._continue_from_checkpoint()
            return
        for record in self._records(self._later_segments(), {}):
            self._restore_record(record)
        last = max([*self._paths, self._position.next_segment - 1])
        self._store.log.continue_from(last + 1, self._expected, self._facts)
        if self.chunks:
            log.info("restored %s after the checkpoint from the log", counted(self.chunks, "chunk"))
        if self.damaged:
            log.warning("the log %s has %s", self._store.log.folder, counted(self.damaged, "damaged record"))

    def _checkpointed_sequences(self) -> Iterator[Sequence]:
        """The sequences that were in the replay, oldest first."""
        named = {facts.number: facts for facts in self._position.segments}
        for record in self._records(named, named):
            if record.kind != Kind.CHUNK or record.number < self._position.oldest:
                continue
            sequences = self._sequences(self._chunk(record))
            if record.number == self._position.oldest:
                sequences = sequences[-self._position.oldest_left :]
            for sequence in sequences:
                self._store.add_restored(record.number)
                yield sequence

    def _continue_from_checkpoint(self) -> None:
        if self.damaged:
            raise CannotResume(
                f"the log {self._store.log.folder} has {counted(self.damaged, 'damaged or missing record')}: "
                "the run would not be the same; start a new run under another run.name"
            )
        self._store.log.continue_from(self._position.next_segment, self._position.next_record, self._facts)

    def _later_segments(self) -> list[int]:
        return [number for number in self._paths if number >= self._position.next_segment]

    def _restore_record(self, record: Record) -> None:
        if record.kind == Kind.CHUNK:
            chunk = self._chunk(record)
            if isinstance(self._classified(chunk, record), Known):
                return
            self._store.restore_chunk(self._sequences(chunk), record.number)
            self._ledger.record(chunk)
            self.chunks += 1
        elif record.kind == Kind.REFUSAL:
            actor, incarnation, sequence = self._refusal(record)
            # A log that was put together by hand may repeat one, by which the ledger would go back.
            if sequence >= self._ledger.next_sequence(actor, incarnation):
                self._ledger.refuse(actor, incarnation, sequence)
        else:
            raise CannotResume(
                f"{self._store.log.folder} has a record of kind {record.kind}: it is of a newer release"
            )

    def _chunk(self, record: Record) -> Chunk:
        with self._errors_of(record, InvalidMessage):
            return decode_chunk(record.body)

    def _classified(self, chunk: Chunk, record: Record) -> Known | Gap | New:
        with self._errors_of(record, InvalidMessage):
            return self._ledger.classify(chunk)

    def _refusal(self, record: Record) -> tuple[str, int, int]:
        """Actor, incarnation and sequence of the chunk that was refused."""
        with self._errors_of(record):
            values = json.loads(record.body)
            actor, incarnation, sequence = values["actor"], values["incarnation"], values["sequence"]
            numbers_fit = all(
                isinstance(number, int) and 0 <= number < end
                for number, end in ((incarnation, 2**64), (sequence, END_OF_SEQUENCES))
            )
            if not isinstance(actor, str) or not numbers_fit:
                raise ValueError("it is no refusal: it should have actor, incarnation and sequence")
            return actor, incarnation, sequence

    def _errors_of(self, record: Record, *ours: type[Exception]) -> AbstractContextManager[None]:
        """Makes every error of a parser inside the block a `CannotResume` that names the record."""
        place = f"record {record.number} of {self._store.log.folder}"
        return parser_errors(lambda reason: CannotResume(f"{place}: {reason}"), *ours)

    def _sequences(self, chunk: Chunk) -> list[Sequence]:
        try:
            return self._store.reader.sequences(chunk)
        except InvalidMessage as error:
            raise SettingsDoNotFit("the log", f"was one overridden? {error}") from None

    def _records(self, segments: Iterable[int], named: dict[int, SegmentFacts]) -> Iterator[Record]:
        """All intact records of those segments, in order; missing ones are logged and counted."""
        for number in segments:
            path = self._paths.get(number)
            if path is None:
                self._warn(f"segment {number} of {self._store.log.folder} is missing")
            else:
                yield from self._records_of(SegmentReader(path, number, self._expected), number)
            if number in named:
                self._count_missing_before(named[number].first + named[number].records)
                if path is not None and self._facts[-1].records == named[number].records:
                    _compare(path, self._facts[-1], named[number])

    def _records_of(self, reader: SegmentReader, number: int) -> Iterator[Record]:
        self._count_missing_before(reader.first)
        truncated_at: int | None = None
        for item in reader:
            if isinstance(item, Record):
                self._count_missing_before(item.number)
                self._expected = item.number + 1
                yield item
            elif item.torn and number == max(self._paths):
                truncated_at = item.start
                _truncate(item)
            else:
                self._warn(f"{item}; it is skipped")
                if item.number is not None:
                    self._count_missing_before(item.number + 1)
        facts = reader.facts()
        self._facts.append(facts if truncated_at is None else dataclasses.replace(facts, bytes=truncated_at))

    def _count_missing_before(self, number: int) -> None:
        """Count records before `number` that have not been seen as damaged."""
        self.damaged += max(0, number - self._expected)
        self._expected = max(self._expected, number)


def _truncate(torn: Damage) -> None:
    """Remove a partial record: the learner died while writing it, so it was never acknowledged."""
    log.warning("%s: the learner ended while writing it; it was never acknowledged", torn)
    Files().truncate(torn.path, torn.start)


def _compare(path: Path, found: SegmentFacts, named: SegmentFacts) -> None:
    if found.checksum != named.checksum:
        log.warning("%s is not the segment that the checkpoint names: its checksum differs", path)
