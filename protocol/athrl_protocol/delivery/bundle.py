"""Several chunks in one query: concatenated, with their sizes in an attached message.

A query costs actor, network and learner ten times as much as a chunk of ten decisions, so an actor collects
chunks for a moment. A single chunk is the content of the query without an attachment.
"""

from __future__ import annotations

from collections.abc import Sequence

from athrl_protocol.errors import InvalidMessage
from athrl_protocol.messages import athrl_pb2
from athrl_protocol.messages.schema import decode_message, encode_message

MOST_CHUNKS = 16
"""Most chunks in one query."""
MOST_BYTES = 2**20
"""Most bytes of several chunks in one query; a larger chunk is sent alone."""
_LARGEST_ATTACHMENT = 4 * 2**10


def join_messages(messages: Sequence[bytes]) -> tuple[bytes, bytes | None]:
    """Return content and attachment of a query with these chunks."""
    if len(messages) == 1:
        return messages[0], None
    sizes = athrl_pb2.Delivery(sizes=[len(message) for message in messages])
    return b"".join(messages), encode_message(sizes)


def split_messages(content: bytes, attachment: bytes | None) -> list[bytes]:
    """Return the messages of the chunks in a query, at least one.

    Raises:
        InvalidMessage: the attachment is not valid, or does not fit the content.
    """
    if attachment is None:
        return [content]
    sizes = decode_message(athrl_pb2.Delivery, attachment, largest=_LARGEST_ATTACHMENT).sizes
    if not 1 <= len(sizes) <= MOST_CHUNKS or sum(sizes) != len(content):
        raise InvalidMessage(
            "shape",
            f"delivery: {len(sizes)} chunks of {sum(sizes)} bytes in {len(content)}, should be 1 to "
            f"{MOST_CHUNKS} and as many bytes",
        )
    messages, start = [], 0
    for size in sizes:
        messages.append(content[start : start + size])
        start += size
    return messages
