"""Identity and content of a chunk, the same at the actor that made it and in the learner's log."""

from __future__ import annotations

import hashlib
from typing import NamedTuple

from athrl_protocol.messages import athrl_pb2


class Identity(NamedTuple):
    """Identity of a chunk."""

    actor: str
    incarnation: int
    sequence: int


class Content(NamedTuple):
    """Content of a chunk.

    Attributes:
        length: valid steps.
        digest: SHA-256 of everything but its identity.
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
