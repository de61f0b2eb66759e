"""The images of a chunk as bytes: raw, or compressed by LZ4 or zstd; unpacked within bounds."""

from __future__ import annotations

import threading
from typing import Literal

import lz4.block
import numpy as np
import numpy.typing as npt
import zstandard

from athrl_protocol.errors import InvalidMessage
from athrl_protocol.messages import athrl_pb2

Compression = Literal["lz4", "zstd", "none"]

# Level 1 shrinks bird's eye views as much as level 3 does, in less time.
_ZSTD_LEVEL = 1
# LZ4 searches less thoroughly: a quarter less time for 3 % more bytes; higher values gain no more.
_LZ4_ACCELERATION = 4
# A byte of an LZ4 block represents 255 bytes at most (its specification: a run's length grows by 255 a byte).
_LZ4_HIGHEST_RATIO = 255

_NUMBERS: dict[Compression, athrl_pb2.Chunk.Compression] = {
    "zstd": athrl_pb2.Chunk.ZSTD,
    "lz4": athrl_pb2.Chunk.LZ4,
    "none": athrl_pb2.Chunk.NONE,
}


class _Zstd(threading.local):
    """zstd contexts are costly to make and must not be shared between threads."""

    def __init__(self) -> None:
        self.compressor = zstandard.ZstdCompressor(level=_ZSTD_LEVEL)
        self.decompressor = zstandard.ZstdDecompressor()


_zstd = _Zstd()


def number_of(compression: Compression) -> athrl_pb2.Chunk.Compression:
    """Return the number of a compression in the message."""
    return _NUMBERS[compression]


def pack_images(images: npt.NDArray[np.uint8], compression: Compression) -> bytes | memoryview:
    """Return the compressed bytes of images; without compression those of the array itself."""
    content: memoryview = np.ascontiguousarray(images).reshape(-1).data
    if compression == "lz4":
        return lz4.block.compress(content, mode="fast", acceleration=_LZ4_ACCELERATION, store_size=False)
    if compression == "zstd":
        return _zstd.compressor.compress(content)
    return content


def unpack_images(content: bytes | memoryview, compression: int, expected: int) -> bytes | memoryview:
    """Return the `expected` bytes that were packed; the caller has checked that number.

    Uncompressed content is returned without a copy.

    Raises:
        InvalidMessage: the content unpacks to another size or not at all, or its compression is not known.
            Content with a wrong announced size is not unpacked.
    """
    if compression == athrl_pb2.Chunk.LZ4:
        return _checked(_unpacked_lz4(content, expected), expected)
    if compression == athrl_pb2.Chunk.ZSTD:
        return _checked(_unpacked_zstd(content, expected), expected)
    if compression == athrl_pb2.Chunk.NONE:
        return _checked(content, expected)
    raise InvalidMessage("images", f"chunk: image_compression {compression} is not known")


def _checked(content: bytes | memoryview, expected: int) -> bytes | memoryview:
    if len(content) != expected:
        raise InvalidMessage("size", f"chunk: images unpack to {len(content)} bytes, should be {expected}")
    return content


def _unpacked_lz4(content: bytes | memoryview, expected: int) -> bytes:
    if expected > _LZ4_HIGHEST_RATIO * len(content):
        raise InvalidMessage(
            "size", f"chunk: images of {len(content)} bytes cannot unpack to {expected}, as they should"
        )
    try:
        return lz4.block.decompress(content, uncompressed_size=expected)
    except lz4.block.LZ4BlockError as error:
        raise InvalidMessage("images", f"chunk: images are no LZ4 block ({error})") from None


def _unpacked_zstd(content: bytes | memoryview, expected: int) -> bytes:
    try:
        announced = zstandard.frame_content_size(content)
        if announced != expected:
            raise InvalidMessage("size", f"chunk: images unpack to {announced} bytes, should be {expected}")
        return _zstd.decompressor.decompress(content, allow_extra_data=False)
    except zstandard.ZstdError as error:
        raise InvalidMessage("images", f"chunk: images are no zstd frame ({error})") from None
