"""The receiver, to which the intake passes chunks, and its answers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

from athrl_protocol.messages.chunk import Chunk


class IntakeBusy(Exception):  # noqa: N818 - a state, not an error
    """Raised by `accept`: there is no room now, the actor should send the chunk again."""


class IntakeFinished(Exception):  # noqa: N818
    """Raised by `accept`: the run has all the chunks it needs."""


@runtime_checkable
class Receiver(Protocol):
    """Takes chunks in so that they survive the process; all in the intake's thread."""

    def accept(self, chunk: Chunk, message: bytes) -> None:
        """Take in a chunk, which arrived as `message`; raises as the `accept` of `ChunkIntake`."""

    def refuse(self, chunk: Chunk) -> None:
        """Record that a chunk is settled for which `accept` raised InvalidMessage; may raise IntakeBusy."""

    def commit(self) -> None:
        """Called before answers are sent: everything accepted or refused so far must be safe afterwards."""


class PlainReceiver:
    """A receiver around a function: nothing survives the process."""

    def __init__(self, accept: Callable[[Chunk], None]) -> None:
        self._accept = accept

    def accept(self, chunk: Chunk, message: bytes) -> None:
        """Call the function."""
        self._accept(chunk)

    def refuse(self, chunk: Chunk) -> None:
        """Do nothing."""

    def commit(self) -> None:
        """Do nothing."""
