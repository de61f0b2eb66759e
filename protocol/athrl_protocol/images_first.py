"""Where a chunk's images stand in its message: right behind version and hash, to be found without protobuf.

Any order of fields is the same message, but protobuf copies a bytes field at each of its steps. Here images
are copied once in writing and not at all in reading. A message whose images stand elsewhere is read as well.
"""

from __future__ import annotations

from athrl_protocol import athrl_pb2
from athrl_protocol.schema import encode_message

_STAMP = encode_message(athrl_pb2.Chunk())
_HEAD = _STAMP + bytes([athrl_pb2.Chunk.IMAGES_FIELD_NUMBER << 3 | 2])  # 2: with a length
_LONGEST_LENGTH = 5  # bytes of a varint below 2^35, more than a message may have


def with_images_first(message: athrl_pb2.Chunk, images: bytes | memoryview) -> bytes:
    """Return the bytes of a message, which has no images yet, with these."""
    rest = memoryview(encode_message(message))[len(_STAMP) :]
    return b"".join((_HEAD, _varint(len(images)), images, rest))


def images_taken_out(payload: bytes) -> tuple[bytes | memoryview, bytes]:
    """Return the images of a message, a view, and the message without them.

    Where they are not right behind version and hash, or are cut off, it is no images and all of `payload`:
    protobuf finds what is there, or what is wrong with it.
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
