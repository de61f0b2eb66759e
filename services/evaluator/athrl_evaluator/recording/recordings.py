"""Records episodes as MCAP files with self-describing protobuf channels.

A file opens in Foxglove and in rerun: besides `Frame` it contains Foxglove's well-known messages for what
those programs can show, and the actions and the origin with which `athrl replay` drives it again. It is
written under a temporary name and renamed when it is complete.
"""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path

import numpy as np
from athrl_protocol import Frame, encode_frame
from athrl_spaces.wording import system_reason
from foxglove_schemas_protobuf.Vector2_pb2 import Vector2
from mcap.writer import CompressionType
from mcap_protobuf.writer import Writer
from numpy.typing import NDArray

from athrl_evaluator.errors import EvaluatorError, writing
from athrl_evaluator.recording.foxglove_messages import foxglove_messages
from athrl_evaluator.recording.origin import METADATA, Origin

FRAME_TOPIC = "/frame"
ACTION_TOPIC = "/action"
CHUNK_BYTES = 256 * 1024  # limits the longest write, and what a kill loses


class EpisodeRecording:
    """One episode's file; all methods but `abandon` raise EvaluatorError if writing fails."""

    def __init__(self, path: Path, origin: Origin | None = None) -> None:
        """Open the file; until `finish` its name is `path` with `.part` appended.

        Without an origin the episode can be shown and not driven again.
        """
        self.path = path
        self._part = path.with_name(path.name + ".part")
        self._began = time.time_ns()
        with writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._stream = self._part.open("wb")
            try:
                self._writer = Writer(self._stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
                if origin is not None:
                    self._writer.add_metadata(METADATA, origin.metadata())
            except OSError:
                self.abandon()
                raise

    def write(self, frame: Frame, action: NDArray[np.float32] | None = None) -> None:
        """Add one frame and the action, float32 [2], that led to it.

        The time in the file is the start of the recording plus the simulated time.
        """
        encode_frame(frame)  # writes the schema version into it for readers
        log_time = self._began + round(frame.time * 1e9)
        with writing(self.path):
            self._write(FRAME_TOPIC, frame, log_time)
            if action is not None:
                self._write(ACTION_TOPIC, Vector2(x=float(action[0]), y=float(action[1])), log_time)
            for topic, message in foxglove_messages(frame, log_time):
                self._write(topic, message, log_time)

    def finish(self) -> None:
        """Complete the file and give it its name."""
        with writing(self.path):
            self._writer.finish()
            self._stream.close()
            self._part.replace(self.path)

    def abandon(self) -> None:
        """Remove the unfinished file, as far as the disk lets it."""
        with suppress(OSError):  # buffered data does not fit on a full disk either
            self._stream.close()
        with suppress(OSError):  # a disk with errors can often only be read any more
            self._part.unlink(missing_ok=True)

    def _write(self, topic: str, message: object, log_time: int) -> None:
        self._writer.write_message(topic=topic, message=message, log_time=log_time, publish_time=log_time)


def newest_recordings(folder: Path) -> list[Path]:
    """The recordings of a folder, the newest first; one that cannot be looked at is passed over."""
    ages = []
    for path in folder.glob("*.mcap"):
        with suppress(OSError):  # such as one that somebody else has cleared away
            ages.append((path.stat().st_mtime_ns, path.name, path))
    return [path for _, _, path in sorted(ages, reverse=True)]


def prune_recordings(folder: Path, kept: int) -> None:
    """Remove all but the newest `kept` recordings of a folder; raises EvaluatorError if one stays."""
    for path in newest_recordings(folder)[kept:]:
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise EvaluatorError(f"cannot remove {path}: {system_reason(error)}") from None
