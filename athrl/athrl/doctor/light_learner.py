"""A learner that only receives chunks: log, ledger and intake are the real ones, nothing is trained.

    python -m athrl.doctor.light_learner ADDRESS FOLDER FSYNC

Prints "ready" when it listens, and ends with its standard input.
"""

from __future__ import annotations

import sys
from pathlib import Path

from athrl_learner.files import Files
from athrl_learner.log import Kind, Record, SegmentFacts, SegmentLog, SegmentReader, numbered_segments
from athrl_learner.log.writing import Fsync
from athrl_protocol import Chunk, ChunkIntake, decode_chunk, open_session
from athrl_protocol.delivery.ledger import Ledger

from athrl.doctor.round_trip import RUN

SEGMENT_BYTES = 2**20
_LISTEN_SECONDS = 30.0


class WritingReceiver:
    """Writes every chunk into the log before it is acknowledged, as the learner does."""

    def __init__(self, log: SegmentLog) -> None:
        self._log = log

    def accept(self, chunk: Chunk, message: bytes) -> None:
        """Write the chunk to the log."""
        self._log.append(Kind.CHUNK, message)

    def refuse(self, chunk: Chunk) -> None:
        """Do nothing: no chunk is refused here."""

    def commit(self) -> None:
        """Sync the log to the disk, if so configured."""
        self._log.commit()


def restore_ledger(log: SegmentLog) -> Ledger:
    """Return the ledger of what an earlier process logged, and continue the log after it."""
    ledger, sealed, number = Ledger(), list[SegmentFacts](), 0
    paths = numbered_segments(log.folder)
    for segment, path in paths.items():
        reader = SegmentReader(path, segment, log.next_record)
        for item in reader:
            if isinstance(item, Record):
                ledger.record(decode_chunk(item.body))
                number = item.number + 1
            elif item.torn:
                Files().truncate(item.path, item.start)
        sealed.append(reader.facts())
    log.continue_from(max(paths, default=0) + 1, number, sealed)
    return ledger


def main(address: str, folder: str, fsync: Fsync) -> None:
    """Receive chunks until the input is closed; `fsync` as in the run file."""
    log = SegmentLog(Path(folder), segment_bytes=SEGMENT_BYTES, fsync=fsync)
    ledger = restore_ledger(log)
    with (
        open_session(listen=address, timeout=_LISTEN_SECONDS, run=RUN) as session,
        ChunkIntake(session, RUN, WritingReceiver(log), ledger),
    ):
        print("ready", flush=True)
        sys.stdin.read()
    log.close()


if __name__ == "__main__":
    main(*sys.argv[1:])  # type: ignore[arg-type]
