"""Record episodes as MCAP files with self-describing protobuf channels.

A file opens in Foxglove and in rerun: beside our own Frame it has Foxglove's well-known messages for what
those programs can show. It is written beside its name and renamed when it is whole.
"""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path

from athrl_protocol import Frame, encode_frame
from mcap.writer import CompressionType
from mcap_protobuf.writer import Writer

from athrl_evaluator.errors import writing
from athrl_evaluator.foxglove_messages import foxglove_messages

FRAME_TOPIC = "/frame"
CHUNK_BYTES = 256 * 1024  # keeps the longest write short, and a kill loses no more than this


class EpisodeRecording:
    """One episode's file; all but `abandon` raise EvaluatorError where the disk does not take it."""

    def __init__(self, path: Path) -> None:
        """Begin the file `path`; until `finish` it is called `path` with `.part` behind it."""
        self.path = path
        self._part = path.with_name(path.name + ".part")
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._stream = self._part.open("wb")
        self._writer = Writer(self._stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._began = time.time_ns()

    def write(self, frame: Frame) -> None:
        """Add one frame; its time in the file is the recording's begin plus the simulated time."""
        encode_frame(frame)  # stamps the schema into it, so that readers can tell
        log_time = self._began + round(frame.time * 1e9)
        with writing(self.path):
            self._write(FRAME_TOPIC, frame, log_time)
            for topic, message in foxglove_messages(frame, log_time):
                self._write(topic, message, log_time)

    def finish(self) -> None:
        """Complete the file and give it its name."""
        with writing(self.path):
            self._writer.finish()
            self._stream.close()
            self._part.replace(self.path)

    def abandon(self) -> None:
        """Remove what has been written."""
        with suppress(OSError):  # a full disk does not take what is still buffered either
            self._stream.close()
        self._part.unlink(missing_ok=True)

    def _write(self, topic: str, message: object, log_time: int) -> None:
        self._writer.write_message(topic=topic, message=message, log_time=log_time, publish_time=log_time)


def prune_recordings(folder: Path, kept: int) -> None:
    """Remove all but the newest `kept` recordings of a folder."""
    files = sorted(folder.glob("*.mcap"), key=lambda path: (path.stat().st_mtime_ns, path.name))
    for path in files[: max(0, len(files) - kept)]:
        path.unlink(missing_ok=True)
