"""Converts a recorded episode to a rerun file that looks like `athrl watch`."""

from __future__ import annotations

from pathlib import Path

import rerun as rr

from athrl_evaluator.drawing import APPLICATION, SceneDrawing, make_blueprint
from athrl_evaluator.recording.reading import read_frames


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
