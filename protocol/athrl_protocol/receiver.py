"""Who takes in what the intake has received, and what it may say to that."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol, runtime_checkable

from athrl_protocol.chunk import Chunk


class IntakeBusy(Exception):  # noqa: N818 - says what is so, not what went wrong
    """Raised by `accept`: there is no room now, the actor shall send the chunk again."""


class IntakeFinished(Exception):  # noqa: N818
    """Raised by `accept`: the run has all the chunks it needs."""


@runtime_checkable
class Receiver(Protocol):
    """Takes chunks in so that they survive the process; all in the intake's thread."""

    def accept(self, chunk: Chunk, message: bytes) -> None:
        """Take a chunk in, which arrived as `message`; raises what `ChunkIntake` lets `accept` raise."""

    def refuse(self, chunk: Chunk) -> None:
        """Remember that a chunk is settled for which `accept` raised InvalidMessage; may raise IntakeBusy."""

    def commit(self) -> None:
        """Called before answers go out: what was accepted or refused so far is safe when this returns."""


class PlainReceiver:
    """A receiver around a function: nothing outlives the process."""

    def __init__(self, accept: Callable[[Chunk], None]) -> None:
        self._accept = accept

    def accept(self, chunk: Chunk, message: bytes) -> None:
        """Call the function."""
        self._accept(chunk)

    def refuse(self, chunk: Chunk) -> None:
        """Remember nothing."""

    def commit(self) -> None:
        """Promise nothing."""
