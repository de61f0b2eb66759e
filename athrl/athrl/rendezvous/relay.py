"""A port of this machine that leads to a learner wherever it is now.

Zenoh connects again and again to the one address with which a session was opened. A learner that a scheduler
started on another machine has another address; this relay looks it up for each new connection. So a service
keeps its session, its environments and its unacknowledged chunks while its learner moves.

Data passes unchanged: with certificates, service and learner still authenticate each other, and the relay
sees what anybody on the network would see. The service knows the relay as 127.0.0.1, a name that every
certificate of a learner includes.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
import time
from collections.abc import Callable, Coroutine
from types import TracebackType
from typing import Self

from athrl_protocol.errors import ProtocolError
from athrl_protocol.transport.address import split_address

HOST = "127.0.0.1"
CONNECT_SECONDS = 3.0
"""Limit for a connection to the learner."""
CLOSE_SECONDS = 5.0
PIECE = 2**16

log = logging.getLogger(__name__)


class Relay:
    """Listens at a free port of loopback and connects each client to the learner; a context manager.

    Runs in a thread of its own. `find` returns the learner's address, None while there is none, and is called
    for each connection.
    """

    def __init__(self, find: Callable[[], str | None]) -> None:
        self._find = find
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name="relay", daemon=True)
        self._heard_at = time.monotonic()
        self._learner: str | None = None

    def __enter__(self) -> Self:
        self._thread.start()
        started = asyncio.run_coroutine_threadsafe(asyncio.start_server(self._serve, HOST, 0), self._loop)
        self._server = started.result(CLOSE_SECONDS)
        self.address = f"{HOST}:{self._server.sockets[0].getsockname()[1]}"
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        closing = asyncio.run_coroutine_threadsafe(self._close(), self._loop)
        try:
            closing.result(CLOSE_SECONDS)
        except TimeoutError:  # the file system of the learner's address hangs, and holds the loop
            return
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(CLOSE_SECONDS)
        self._loop.close()

    @property
    def silent_seconds(self) -> float:
        """Seconds since anything came from the learner, or since the start."""
        return time.monotonic() - self._heard_at

    async def _close(self) -> None:
        self._server.close()
        connections = asyncio.all_tasks() - {asyncio.current_task()}
        for connection in connections:
            connection.cancel()
        await asyncio.gather(*connections, return_exceptions=True)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Connect a client to the learner; without one, or once either side is gone, close its connection."""
        with contextlib.closing(writer.transport), contextlib.suppress(OSError, TimeoutError, ProtocolError):
            address = self._find()
            if address is None:
                return
            connecting = asyncio.open_connection(*split_address(address))
            from_learner, to_learner = await asyncio.wait_for(connecting, CONNECT_SECONDS)
            self._note(address)
            with contextlib.closing(to_learner.transport):
                await _first_of(self._pass(reader, to_learner), self._hear(from_learner, writer))

    def _note(self, address: str) -> None:
        if self._learner not in (None, address):
            log.info("the learner is at %s now", address)
        self._learner = address

    async def _hear(self, from_learner: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while piece := await from_learner.read(PIECE):
            self._heard_at = time.monotonic()
            writer.write(piece)
            await writer.drain()

    async def _pass(self, reader: asyncio.StreamReader, to_learner: asyncio.StreamWriter) -> None:
        while piece := await reader.read(PIECE):
            to_learner.write(piece)
            await to_learner.drain()


async def _first_of(*directions: Coroutine[None, None, None]) -> None:
    """Run both directions of a connection until one of them ends."""
    tasks = [asyncio.ensure_future(direction) for direction in directions]
    try:
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
