"""A frame: one decision of an episode as it is shown live and recorded; see `Frame` in the schema."""

from __future__ import annotations

from athrl_protocol.athrl_pb2 import Frame, Point, Vehicle
from athrl_protocol.errors import InvalidMessage
from athrl_protocol.schema import decode_message, encode_message

__all__ = ["Frame", "Point", "Vehicle", "decode_frame", "encode_frame"]


def encode_frame(frame: Frame) -> bytes:
    """Return a frame as bytes, live or for a recording."""
    return encode_message(frame)


def decode_frame(payload: bytes) -> Frame:
    """Return the frame in a message.

    Raises:
        InvalidMessage: it is no frame of this schema, or its images do not have the size it says.
    """
    frame = decode_message(Frame, payload)
    pixels = frame.image_height * frame.image_width
    for name, image, channels in (("birdeye", frame.birdeye, 3), ("lidar", frame.lidar, 1)):
        if len(image) not in (0, pixels * channels):
            raise InvalidMessage(
                "size", f"frame: {name} has {len(image)} bytes, should have {pixels * channels}"
            )
    return frame
