"""Chunks survive the wire unchanged, and nothing that is wrong gets through."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable
from typing import Any

import lz4.block
import numpy as np
import pytest
import zstandard
from athrl_protocol import (
    Chunk,
    InvalidMessage,
    LevelColumns,
    decode_chunk,
    encode_chunk,
)
from athrl_protocol.codec import images as image_codec
from athrl_protocol.codec.chunks import MAXIMUM_IMAGES_BYTES, with_oldest_held
from athrl_protocol.codec.images import Compression
from athrl_protocol.messages import athrl_pb2
from google.protobuf.message import DecodeError
from hypothesis import given, settings
from hypothesis import strategies as some

COMPRESSIONS: tuple[Compression, ...] = ("zstd", "lz4", "none")
_finite = some.floats(-1e6, 1e6, width=32)
_quick = settings(max_examples=40, deadline=None)
_LENGTH_OF_1280 = b"\x80\x0a"
"""How protobuf writes how many bytes the images of a small chunk have."""


@some.composite
def chunks(draw: some.DrawFn) -> Chunk:
    interval, sequences = draw(some.integers(1, 6)), draw(some.integers(1, 3))
    time = interval * sequences
    height, width, channels, motion = (draw(some.integers(1, 6)) for _ in range(4))

    random = np.random.default_rng(draw(some.integers(0, 2**32 - 1)))
    same = draw(some.booleans())  # as most images and many numbers are, which compresses well

    def floats(*shape: int) -> np.ndarray:
        values = random.integers(2**32, size=shape, dtype=np.uint32).view(np.float32)
        return np.full(shape, draw(_finite), np.float32) if same else np.where(np.isfinite(values), values, 0)

    names = draw(
        some.lists(some.sampled_from(["intention", "trajectory", "single"]), min_size=1, unique=True)
    )
    levels = {
        name: LevelColumns(
            floats(time, draw(some.integers(1, 3))),
            floats(time),
            floats(sequences, draw(some.integers(0, 5))),
        )
        for name in names
    }
    return Chunk(
        actor=draw(some.from_regex(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,20}", fullmatch=True)),
        incarnation=draw(some.integers(0, 2**64 - 1)),
        sequence=draw(some.integers(0, 2**63 - 1)),
        environment=draw(some.integers(0, 2**32 - 1)),
        episode_seed=draw(some.integers(0, 2**64 - 1)),
        first_step=draw(some.integers(0, 2**32 - 1)),
        length=draw(some.integers(time - interval + 1, time)),
        state_interval=interval,
        images=random.integers(1 if same else 256, size=(time + 1, height, width, channels), dtype=np.uint8),
        motion=floats(time + 1, motion),
        levels=levels,
        policy_version=random.integers(2**63 - 1, size=time, endpoint=True),
        terminated=draw(some.booleans()),
        truncated=draw(some.booleans()),
    )


def _plain(chunk: Chunk) -> dict[str, Any]:
    """Return the chunk with arrays as (type, shape, bytes), which can be compared."""

    def plain(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return str(value.dtype), value.shape, value.tobytes()
        if isinstance(value, dict):
            return [(key, plain(item)) for key, item in value.items()]
        return value

    return {name: plain(value) for name, value in dataclasses.asdict(chunk).items()}


@_quick
@given(chunks(), some.sampled_from(COMPRESSIONS))
def test_decoded_chunk_equals_the_encoded_one(chunk: Chunk, compression: Compression) -> None:
    assert _plain(decode_chunk(encode_chunk(chunk, compression))) == _plain(chunk)


def test_message_is_the_one_that_protobuf_writes(make_chunk: Callable[..., Chunk]) -> None:
    payload = encode_chunk(dataclasses.replace(make_chunk(time=200), actor="a"), "none")
    message = athrl_pb2.Chunk.FromString(payload)
    assert len(message.images) == 201 * 8 * 8 * 4
    assert len(message.SerializeToString()) == len(payload)


@_quick
@given(chunks(), some.integers(0, 2**63 - 1))
def test_oldest_held_is_added_without_encoding_again(chunk: Chunk, oldest_held: int) -> None:
    decoded = decode_chunk(with_oldest_held(encode_chunk(chunk), oldest_held))
    assert _plain(decoded) == _plain(dataclasses.replace(chunk, oldest_held=oldest_held))


@_quick
@given(some.binary(max_size=300))
def test_random_bytes_are_refused(payload: bytes) -> None:
    with pytest.raises(InvalidMessage):
        decode_chunk(payload)


@_quick
@given(some.data(), some.sampled_from(COMPRESSIONS))
def test_damaged_message_is_refused_or_still_a_valid_chunk(
    data: some.DataObject, compression: Compression
) -> None:
    payload = bytearray(encode_chunk(data.draw(chunks()), compression))
    for _ in range(data.draw(some.integers(1, 4))):
        payload[data.draw(some.integers(0, len(payload) - 1))] = data.draw(some.integers(0, 255))
    cut = data.draw(some.integers(1, len(payload)))
    with contextlib.suppress(InvalidMessage):
        encode_chunk(decode_chunk(bytes(payload[:cut])))


def _outcome(payload: bytes) -> object:
    """The chunk in a message, plain, or what it is refused for."""
    try:
        return _plain(decode_chunk(payload))
    except InvalidMessage as error:
        return error.reason


@_quick
@given(chunks(), some.sampled_from(COMPRESSIONS))
def test_images_are_read_wherever_they_stand_in_the_message(chunk: Chunk, compression: Compression) -> None:
    encoded = encode_chunk(chunk, compression)
    by_number = athrl_pb2.Chunk.FromString(encoded).SerializeToString()
    message = athrl_pb2.Chunk.FromString(encoded)
    message.ClearField("images")
    images = athrl_pb2.Chunk(images=athrl_pb2.Chunk.FromString(encoded).images).SerializeToString()
    assert sorted(by_number) == sorted(encoded)
    assert _plain(chunk) == _outcome(by_number) == _outcome(message.SerializeToString() + images)


@_quick
@given(some.data(), some.sampled_from(COMPRESSIONS))
def test_damaged_message_is_read_as_protobuf_reads_it(
    data: some.DataObject, compression: Compression
) -> None:
    payload = bytearray(encode_chunk(data.draw(chunks()), compression))
    for _ in range(data.draw(some.integers(0, 3))):
        payload[data.draw(some.integers(0, min(40, len(payload) - 1)))] = data.draw(some.integers(0, 255))
    damaged = bytes(payload[: data.draw(some.integers(1, len(payload)) | some.just(len(payload)))])
    try:
        by_protobuf = athrl_pb2.Chunk.FromString(damaged)
    except DecodeError:
        assert _outcome(damaged) == "malformed"
    else:
        assert _outcome(damaged) == _outcome(by_protobuf.SerializeToString())


@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_of_images_that_come_twice_the_last_count(
    make_chunk: Callable[..., Chunk], compression: Compression
) -> None:
    chunk = dataclasses.replace(make_chunk(), actor="a")
    other = dataclasses.replace(chunk, images=chunk.images[::-1])
    images = athrl_pb2.Chunk.FromString(encode_chunk(other, compression)).images
    payload = encode_chunk(chunk, compression) + athrl_pb2.Chunk(images=images).SerializeToString()
    assert _outcome(payload) == _plain(other)


@pytest.mark.parametrize("length", [b"", b"\x80", b"\xff" * 5 + b"\x01", b"\xff" * 9 + b"\x01", b"\xff" * 11])
def test_images_of_impossible_length_are_malformed(make_chunk: Callable[..., Chunk], length: bytes) -> None:
    payload = encode_chunk(dataclasses.replace(make_chunk(), actor="a"), "none")
    head, rest = payload.split(_LENGTH_OF_1280, 1)
    assert _outcome(head + length) == "malformed"
    if len(length) > 1:
        assert _outcome(head + length + rest) == "malformed"


def test_length_may_be_written_in_more_bytes_than_it_needs(make_chunk: Callable[..., Chunk]) -> None:
    chunk = dataclasses.replace(make_chunk(), actor="a")
    payload = encode_chunk(chunk, "none")
    padded = payload.replace(_LENGTH_OF_1280, b"\x80\x8a\x00", 1)
    assert _outcome(padded) == _plain(chunk)


def test_images_that_are_not_compressed_are_not_copied(make_chunk: Callable[..., Chunk]) -> None:
    payload = encode_chunk(dataclasses.replace(make_chunk(), actor="a"), "none")
    images = decode_chunk(payload).images
    assert np.shares_memory(images, np.frombuffer(payload, np.uint8))
    assert not images.flags.writeable


def test_columns_that_are_not_contiguous_are_encoded(make_chunk: Callable[..., Chunk]) -> None:
    chunk = dataclasses.replace(make_chunk(), actor="a")

    def spread(column: np.ndarray) -> np.ndarray:
        return np.repeat(column, 2, axis=0)[::2]

    level = chunk.levels["trajectory"]
    scattered = dataclasses.replace(
        chunk,
        images=spread(chunk.images),
        motion=spread(chunk.motion),
        policy_version=spread(chunk.policy_version),
        levels=chunk.levels | {"trajectory": LevelColumns(*map(spread, vars(level).values()))},
    )
    assert encode_chunk(scattered, "none") == encode_chunk(chunk, "none")


def test_decoded_columns_are_read_only(make_chunk: Callable[..., Chunk]) -> None:
    chunk = decode_chunk(encode_chunk(dataclasses.replace(make_chunk(), actor="a")))
    columns = [chunk.images, chunk.motion, chunk.policy_version, chunk.levels["intention"].rewards]
    assert not any(column.flags.writeable for column in columns)


@pytest.mark.parametrize("column", ["motion", "actions", "rewards", "states"])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_number_that_is_not_finite_is_refused(
    make_chunk: Callable[..., Chunk], column: str, value: float
) -> None:
    chunk = dataclasses.replace(make_chunk(), actor="a")
    array = chunk.motion if column == "motion" else getattr(chunk.levels["trajectory"], column)
    payload = encode_chunk(chunk)
    place = payload.index(array.tobytes())
    damaged = payload[:place] + np.float32(value).tobytes() + payload[place + 4 :]
    with pytest.raises(InvalidMessage, match=f"{column} has numbers that are not finite") as caught:
        decode_chunk(damaged)
    assert caught.value.reason == "value"


def _changed(make_chunk: Callable[..., Chunk], **fields: Any) -> bytes:
    payload = encode_chunk(dataclasses.replace(make_chunk(), actor="a"))
    message = athrl_pb2.Chunk.FromString(payload)
    for name, value in fields.items():
        setattr(message, name, value)
    return message.SerializeToString()


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"time": 0}, "time 0"),
        ({"time": 2**31}, "out of bounds"),
        ({"time": 5}, "images unpack to 1280 bytes, should be 1536"),
        ({"length": 0}, "length is 0, should be 1 to time = 4"),
        ({"length": 5}, "length is 5, should be 1 to time = 4"),
        ({"image_height": 9}, "images unpack to 1280 bytes"),
        ({"image_height": 2**20}, f"should be 1 to {MAXIMUM_IMAGES_BYTES}"),
        ({"image_channels": 0}, "images of 0 bytes"),
        ({"motion_size": 3}, "motion has 40 bytes"),
        ({"motion": b""}, "motion has 0 bytes"),
        ({"policy_version": b"1234567"}, "policy_version has 7 bytes"),
        ({"policy_version": (b"\xff" * 8) * 4}, "negative"),
        ({"images": b"no zstd"}, "zstd"),
        ({"images": b""}, "zstd"),
        ({"images": b"", "image_compression": 1}, "cannot unpack to 1280"),
        ({"images": b"no block", "image_compression": 1}, "no LZ4 block"),
        ({"image_compression": 1, "image_height": 2**9}, "cannot unpack to|no LZ4 block"),
        ({"image_compression": 2}, "images unpack to"),
        ({"images": bytes(1279), "image_compression": 2}, "images unpack to 1279 bytes, should be 1280"),
        ({"image_compression": 3}, "image_compression 3 is not known"),
        ({"actor": "a/b"}, "actor 'a/b' cannot be used"),
        ({"actor": ""}, "cannot be used"),
    ],
)
def test_wrong_shape_or_length_is_named(
    make_chunk: Callable[..., Chunk], fields: dict[str, Any], text: str
) -> None:
    with pytest.raises(InvalidMessage, match=text):
        decode_chunk(_changed(make_chunk, **fields))


def test_level_that_comes_twice_is_refused(make_chunk: Callable[..., Chunk]) -> None:
    message = athrl_pb2.Chunk.FromString(_changed(make_chunk))
    message.levels.append(message.levels[0])
    with pytest.raises(InvalidMessage, match="level 'intention' comes twice"):
        decode_chunk(message.SerializeToString())


def test_chunk_without_levels_is_refused(make_chunk: Callable[..., Chunk]) -> None:
    message = athrl_pb2.Chunk.FromString(_changed(make_chunk))
    del message.levels[:]
    with pytest.raises(InvalidMessage, match="0 levels"):
        decode_chunk(message.SerializeToString())


def test_bomb_is_refused_before_it_is_unpacked(
    make_chunk: Callable[..., Chunk], monkeypatch: pytest.MonkeyPatch
) -> None:
    def unpack(*_: object, **__: object) -> bytes:
        raise AssertionError("a bomb was unpacked")

    monkeypatch.setattr(image_codec._zstd, "decompressor", type("", (), {"decompress": unpack}))
    monkeypatch.setattr(image_codec.lz4.block, "decompress", unpack)
    bomb = zstandard.ZstdCompressor(level=19).compress(bytes(MAXIMUM_IMAGES_BYTES))
    assert len(bomb) < 10_000
    for payload in (
        _changed(make_chunk, images=bomb),
        _changed(make_chunk, images=bomb, image_height=2**12, image_width=2**12),
        # an LZ4 block is never that much smaller than its content
        _changed(make_chunk, images=bomb, image_compression=1, image_height=2**11, image_width=2**11),
        # a frame that does not say how large its content is
        _changed(make_chunk, images=zstandard.ZstdCompressor(write_content_size=False).compress(bytes(1280))),
    ):
        with pytest.raises(InvalidMessage) as caught:
            decode_chunk(payload)
        assert caught.value.reason == "size"


def test_images_beyond_what_the_run_has_are_not_unpacked(
    make_chunk: Callable[..., Chunk], monkeypatch: pytest.MonkeyPatch
) -> None:
    payload = encode_chunk(make_chunk())
    size = decode_chunk(payload).images.nbytes
    assert decode_chunk(payload, size).images.nbytes == size
    monkeypatch.setattr("athrl_protocol.codec.chunks.unpack_images", lambda *_: pytest.fail("was unpacked"))
    with pytest.raises(InvalidMessage, match=f"images of {size} bytes, should be 1 to {size - 1}"):
        decode_chunk(payload, size - 1)


def test_frame_that_lies_about_its_size_is_refused(make_chunk: Callable[..., Chunk]) -> None:
    honest = zstandard.ZstdCompressor(level=1).compress(bytes(1280))
    liar = bytearray(zstandard.ZstdCompressor(level=1).compress(bytes(100_000)))
    assert (
        honest[4] & 0xC0 == 0x40
    )  # a content size of two bytes, the honest frame's goes into the liar's header
    assert liar[4] & 0xC0 == 0x80  # of four bytes
    liar[5:9] = (1280).to_bytes(4, "little")
    assert zstandard.frame_content_size(bytes(liar)) == 1280
    with pytest.raises(InvalidMessage):
        decode_chunk(_changed(make_chunk, images=bytes(liar)))
    with pytest.raises(InvalidMessage):
        decode_chunk(_changed(make_chunk, images=honest + honest))


@pytest.mark.parametrize("content", [1279, 1281, 100_000])
def test_lz4_block_of_another_size_is_refused(make_chunk: Callable[..., Chunk], content: int) -> None:
    block = lz4.block.compress(np.random.default_rng(1).bytes(content), store_size=False)
    with pytest.raises(InvalidMessage) as caught:
        decode_chunk(_changed(make_chunk, images=block, image_compression=1))
    assert caught.value.reason in ("size", "images")


def test_too_long_message_is_refused() -> None:
    with pytest.raises(InvalidMessage, match="at most") as caught:
        decode_chunk(bytes(2 * MAXIMUM_IMAGES_BYTES))
    assert caught.value.reason == "size"


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"motion": np.zeros((5, 2))}, "motion is float64, should be float32"),
        ({"motion": np.zeros((4, 2), np.float32)}, r"motion has shape \[4, 2\], should be \[5, any\]"),
        ({"images": np.zeros((5, 8, 8), np.uint8)}, "images has shape"),
        ({"sequence": -1}, "sequence is -1"),
    ],
)
def test_wrong_chunk_is_not_encoded(
    make_chunk: Callable[..., Chunk], change: dict[str, Any], text: str
) -> None:
    with pytest.raises(InvalidMessage, match=text):
        encode_chunk(dataclasses.replace(make_chunk(), actor="a", **change))
