"""Turn a recorded episode into a rerun file that looks as `athrl watch` does."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import rerun as rr
from athrl_protocol import Frame, ProtocolError, decode_frame
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader

from athrl_evaluator.drawing import APPLICATION, SceneDrawing, make_blueprint
from athrl_evaluator.recordings import FRAME_TOPIC


class InvalidRecording(ProtocolError):  # noqa: N818  (the name says what is wrong)
    """A file is not a recorded episode."""


def read_frames(path: Path) -> Iterator[Frame]:
    """The frames of a recording in their order; of a file that was cut off, all that is whole.

    Raises InvalidRecording for a file that is no recorded episode, InvalidMessage for another release's.
    """
    count = 0
    with _opened(path) as stream:
        reader = NonSeekingReader(stream, validate_crcs=True)
        try:
            for _, channel, message in reader.iter_messages(log_time_order=False):
                if channel.topic == FRAME_TOPIC:
                    count += 1
                    yield decode_frame(message.data)
        except (McapError, struct.error):  # the latter where a file ends within a number
            if count == 0:  # what the reader says is of bytes and often nothing at all
                raise InvalidRecording(
                    f"{path} is not a recorded episode: it is cut short before the first frame, "
                    "damaged, or no MCAP file"
                ) from None
    if count == 0:
        raise InvalidRecording(f"{path} is not a recorded episode: it has no {FRAME_TOPIC}")


def _opened(path: Path) -> BinaryIO:
    try:
        if path.is_file():  # a named pipe, say, would be waited for
            return path.open("rb")
    except OSError as error:
        raise InvalidRecording(f"cannot read {path}: {(error.strerror or str(error)).lower()}") from None
    wrong = "it is a folder" if path.is_dir() else "there is no such file"
    raise InvalidRecording(f"{path} is not a recorded episode: {wrong}")


def draw_recording(recording: Path, rerun_file: Path) -> None:
    """Draw the episode of an MCAP file into a rerun file."""
    stream = rr.RecordingStream(APPLICATION)
    stream.save(rerun_file, default_blueprint=make_blueprint())
    try:
        drawing = SceneDrawing(stream)
        for frame in read_frames(recording):
            drawing.draw(frame)
        stream.flush()
    finally:
        stream.disconnect()
