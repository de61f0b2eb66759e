"""What a chunk says, however it was sent: the same for the actor that made it and the learner's log."""

from __future__ import annotations

import hashlib
from typing import NamedTuple

from athrl_protocol import athrl_pb2


class Identity(NamedTuple):
    """Which chunk it is."""

    actor: str
    incarnation: int
    sequence: int


class Content(NamedTuple):
    """What is in it.

    Attributes:
        length: valid steps.
        digest: SHA-256 of everything but who sent it as what.
    """

    length: int
    digest: str


def read_chunk(message: bytes) -> tuple[Identity, Content]:
    """Return identity and content of a chunk's message."""
    chunk = athrl_pb2.Chunk.FromString(message)
    identity = Identity(chunk.actor, chunk.incarnation, chunk.sequence)
    for field in ("actor", "incarnation", "sequence", "oldest_held"):
        chunk.ClearField(field)
    digest = hashlib.sha256(chunk.SerializeToString(deterministic=True)).hexdigest()
    return identity, Content(chunk.length, digest)
