"""Position of a chunk's images in its message: directly after version and hash, found without protobuf.

The order of fields does not matter to protobuf, but protobuf copies a bytes field several times. Here images
are copied once when writing and never when reading. A message with images at another position is read as
well.
"""

from __future__ import annotations

from athrl_protocol.messages import athrl_pb2
from athrl_protocol.messages.schema import encode_message

_STAMP = encode_message(athrl_pb2.Chunk())
_HEAD = _STAMP + bytes([athrl_pb2.Chunk.IMAGES_FIELD_NUMBER << 3 | 2])  # 2: with a length
_LONGEST_LENGTH = 5  # bytes of a varint below 2^35, more than a message may have


def with_images_first(message: athrl_pb2.Chunk, images: bytes | memoryview) -> bytes:
    """Return the bytes of a message, which has no images yet, with these images."""
    rest = memoryview(encode_message(message))[len(_STAMP) :]
    return b"".join((_HEAD, _varint(len(images)), images, rest))


def split_images(payload: bytes) -> tuple[bytes | memoryview, bytes]:
    """Return the images of a message, as a view, and the message without them.

    If they are not directly after version and hash, or are cut off, returns no images and all of `payload`:
    protobuf then finds them, or the error.
    """
    if not payload.startswith(_HEAD):
        return b"", payload
    length, start = 0, len(_HEAD)
    for position, byte in enumerate(payload[start : start + _LONGEST_LENGTH]):
        length |= (byte & 0x7F) << 7 * position
        if byte <= 0x7F:
            start += position + 1
            break
    else:
        return b"", payload
    end = start + length
    if end > len(payload):
        return b"", payload
    content = memoryview(payload)
    return content[start:end], b"".join((_STAMP, content[end:]))


def _varint(number: int) -> bytes:
    content = bytearray()
    while number > 0x7F:
        content.append(number & 0x7F | 0x80)
        number >>= 7
    content.append(number)
    return bytes(content)
