"""Puts the experience back: the replay from the segments that a checkpoint names, then what came after it.

What is acknowledged is in the log. A checkpoint says which records were in the replay when it was taken; all
records behind it were accepted later, and are taken in once more, in their order, with all counters. A run
that repeats itself bit for bit drives them again instead.
"""

from __future__ import annotations

import dataclasses
import json
import logging
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, Literal

from athrl_planners import Sequence
from athrl_protocol import Chunk, InvalidMessage, decode_chunk
from athrl_protocol.ledger import Known, Ledger

from athrl_learner.errors import CannotResume, SettingsDoNotFit
from athrl_learner.files import Files
from athrl_learner.segments import (
    Damage,
    Kind,
    LogPosition,
    Record,
    SegmentFacts,
    SegmentReader,
    numbered_segments,
)
from athrl_learner.store import ExperienceStore

log = logging.getLogger(__name__)

AfterTheCheckpoint = Literal["taken in", "driven again"]
"""What becomes of experience that came after the checkpoint: the log has it, or it comes again anyway."""


class Recovery:
    """Reads the log of a run that goes on.

    Attributes:
        chunks: accepted after the checkpoint and taken in again.
        damaged: records that were in the log and cannot be read.
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
        self._expected = first  # number of the next record, were none damaged
        self._facts: list[SegmentFacts] = []

    def run(
        self,
        replay_state: dict[str, Any] | None,
        after: AfterTheCheckpoint = "taken in",
        priorities: dict[str, Any] | None = None,
    ) -> None:
        """Fill the replay as it was at the checkpoint (if there is one), take in what followed, go on.

        With "driven again" the log goes on right behind the checkpoint. What it has beyond that is still
        there until `SegmentLog.remove_later`.

        Raises:
            CannotResume: a chunk does not fit the run's settings, or is of another release; a record is
                damaged and what follows was to be driven again, which would then not be the same.
            KeyError, TypeError, ValueError: `replay_state` is wrong.
            OSError: a segment cannot be read.
        """
        if replay_state is not None:
            found = self._store.replay.load_state(replay_state, self._replayed())
            if priorities and found == int(replay_state["sequences"]):
                self._store.replay.load_priorities(priorities)
        if after == "driven again":
            self._go_on_behind_the_checkpoint()
            return
        for record in self._records(self._after_the_checkpoint(), {}):
            self._take_again(record)
        last = max([*self._paths, self._position.next_segment - 1])
        self._store.log.go_on(last + 1, self._expected, self._facts)
        if self.chunks:
            log.info("%d chunks that came after the checkpoint are taken in from the log", self.chunks)
        if self.damaged:
            log.warning("%d records of the log %s are damaged", self.damaged, self._store.log.folder)

    def _replayed(self) -> Iterator[Sequence]:
        """The sequences that were in the replay, oldest first."""
        named = {facts.number: facts for facts in self._position.segments}
        for record in self._records(named, named):
            if record.kind != Kind.CHUNK or record.number < self._position.oldest:
                continue
            sequences = self._sequences(self._chunk(record))
            if record.number == self._position.oldest:
                sequences = sequences[-self._position.oldest_left :]
            for sequence in sequences:
                self._store.remember(record.number)
                yield sequence

    def _go_on_behind_the_checkpoint(self) -> None:
        if self.damaged:
            raise CannotResume(
                f"{self.damaged} records of the log {self._store.log.folder} are damaged or missing: "
                "the run would not be the same; start a new run under another run.name"
            )
        self._store.log.go_on(self._position.next_segment, self._position.next_record, self._facts)

    def _after_the_checkpoint(self) -> list[int]:
        return [number for number in self._paths if number >= self._position.next_segment]

    def _take_again(self, record: Record) -> None:
        if record.kind == Kind.CHUNK:
            chunk = self._chunk(record)
            if isinstance(self._ledger.judge(chunk), Known):
                return
            self._store.take_again(self._sequences(chunk), record.number)
            self._ledger.record(chunk)
            self.chunks += 1
        elif record.kind == Kind.REFUSAL:
            self._ledger.refuse(**json.loads(record.body))
        else:
            raise CannotResume(
                f"{self._store.log.folder} has a record of kind {record.kind}: it is of a newer release"
            )

    def _chunk(self, record: Record) -> Chunk:
        try:
            return decode_chunk(record.body)
        except InvalidMessage as error:
            raise CannotResume(f"record {record.number} of {self._store.log.folder}: {error}") from None

    def _sequences(self, chunk: Chunk) -> list[Sequence]:
        try:
            return self._store.reader.sequences(chunk)
        except InvalidMessage as error:
            raise SettingsDoNotFit("the log", f"was one overridden? {error}") from None

    def _records(self, segments: Iterable[int], named: dict[int, SegmentFacts]) -> Iterator[Record]:
        """All intact records of those segments, in order; what is missing is told and counted."""
        for number in segments:
            path = self._paths.get(number)
            if path is None:
                log.warning("segment %d of %s is missing", number, self._store.log.folder)
            else:
                yield from self._records_of(SegmentReader(path, number, self._expected), number, path)
            if number in named:
                self._count_up_to(named[number].first + named[number].records)
                if path is not None and self._facts[-1].records == named[number].records:
                    _compare(path, self._facts[-1], named[number])

    def _records_of(self, reader: SegmentReader, number: int, path: Path) -> Iterator[Record]:
        self._count_up_to(reader.first)
        cut_at: int | None = None
        for item in reader:
            if isinstance(item, Record):
                self._count_up_to(item.number)
                self._expected = item.number + 1
                yield item
            elif item.torn and number == max(self._paths):
                cut_at = item.start
                _cut_off(item)
            else:
                log.warning("%s; it is left out", item)
                if item.number is not None:
                    self._count_up_to(item.number + 1)
        facts = reader.facts()
        self._facts.append(facts if cut_at is None else dataclasses.replace(facts, bytes=cut_at))

    def _count_up_to(self, number: int) -> None:
        """Records before `number` that have not been seen are damaged."""
        self.damaged += max(0, number - self._expected)
        self._expected = max(self._expected, number)


def _cut_off(torn: Damage) -> None:
    """Remove half a record: the learner died while it wrote it, and so never acknowledged it."""
    log.warning("%s: the learner was ended while it wrote; it was never acknowledged", torn)
    Files().cut(torn.path, torn.start)


def _compare(path: Path, found: SegmentFacts, named: SegmentFacts) -> None:
    if found.checksum != named.checksum:
        log.warning("%s is not the segment that the checkpoint names: its checksum is another", path)
