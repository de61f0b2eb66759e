"""Connections that can be interrupted: a TCP proxy for each service, between it and the learner or a router.

Data in a silent direction is not dropped but delayed, as with TCP when packets are lost.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import struct
import threading
from collections.abc import Callable, Collection, Coroutine
from types import TracebackType
from typing import Any, Self

HOST = "127.0.0.1"
_PIECE = 2**16
_NO_LINGERING = struct.pack("ii", 1, 0)
_PATIENCE_SECONDS = 10.0


class Link:
    """One service's connection towards the learner; every method may be called from any thread."""

    def __init__(self, loop: asyncio.AbstractEventLoop, next_port: int) -> None:
        self.port = 0
        self._loop = loop
        self._next_port = next_port
        self._open = {True: asyncio.Event(), False: asyncio.Event()}  # key: towards the learner
        self._delay = 0.0
        self._severed = False
        self._writers: set[asyncio.StreamWriter] = set()
        for gate in self._open.values():
            gate.set()

    @property
    def address(self) -> str:
        """Address for the service to connect to: the proxy of the learner or of a router."""
        return f"tcp/{HOST}:{self.port}"

    def cut(self) -> None:
        """Reset every connection, and refuse new ones until `heal`."""
        self._call(self._cut)

    def silence(self, *, outward: bool, inward: bool) -> None:
        """Pass no data towards the learner, from it, or both, until `heal`."""
        self._call(lambda: self._silence(outward, inward))

    def slow(self, seconds: float) -> None:
        """Delay all data by this time, until `heal`."""
        self._call(lambda: setattr(self, "_delay", seconds))

    def heal(self) -> None:
        """Pass all data again, delayed data first."""
        self._call(self._heal)

    async def serve(self, reserved: Collection[int]) -> asyncio.Server:
        """Listen at a free port, except ports that are reserved for services.

        A link at the router's port would bypass the router, which would find its port in use forever.
        """
        while True:
            server = await asyncio.start_server(self._connected, HOST, 0)
            self.port = server.sockets[0].getsockname()[1]
            if self.port not in reserved:
                return server
            server.close()

    def _call(self, what: Callable[[], None]) -> None:
        self._loop.call_soon_threadsafe(what)

    def _cut(self) -> None:
        self._severed = True
        for writer in list(self._writers):
            # Without lingering a closed connection is reset, as by a firewall or a restarting host.
            writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _NO_LINGERING)
            writer.transport.abort()

    def _silence(self, outward: bool, inward: bool) -> None:
        for towards, silent in ((True, outward), (False, inward)):
            if silent:
                self._open[towards].clear()

    def _heal(self) -> None:
        self._severed, self._delay = False, 0.0
        for gate in self._open.values():
            gate.set()

    async def _connected(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._writers.add(writer)
        try:
            if self._severed:
                return
            from_learner, to_learner = await asyncio.open_connection(HOST, self._next_port)
        except OSError:
            return
        else:
            self._writers.add(to_learner)
            await self._pump_both(reader, writer, from_learner, to_learner)
            self._writers.discard(to_learner)
        finally:
            self._writers.discard(writer)
            writer.transport.abort()

    async def _pump_both(
        self,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        from_learner: asyncio.StreamReader,
        to_learner: asyncio.StreamWriter,
    ) -> None:
        pumps = [
            asyncio.ensure_future(self._pump(reader, to_learner, True)),
            asyncio.ensure_future(self._pump(from_learner, writer, False)),
        ]
        try:
            await asyncio.wait(pumps, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for pump in pumps:
                pump.cancel()
            await asyncio.gather(*pumps, return_exceptions=True)
            to_learner.transport.abort()

    async def _pump(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, towards: bool) -> None:
        with contextlib.suppress(OSError):
            while piece := await reader.read(_PIECE):
                await self._open[towards].wait()
                if self._delay:
                    await asyncio.sleep(self._delay)
                writer.write(piece)
                await writer.drain()


class LinkProxies:
    """The links of all services, in a separate thread; a context manager.

    `next_ports` gives for each service the port of this machine to which its link connects.
    """

    def __init__(self, next_ports: dict[str, int]) -> None:
        self._loop = asyncio.new_event_loop()
        self.links = {name: Link(self._loop, port) for name, port in next_ports.items()}
        self._reserved = set(next_ports.values())
        self._servers: list[asyncio.Server] = []
        self._thread = threading.Thread(target=self._loop.run_forever, name="proxies", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        self._servers = [self._run(link.serve(self._reserved)) for link in self.links.values()]
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        asyncio.run_coroutine_threadsafe(self._close(), self._loop).result(_PATIENCE_SECONDS)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(_PATIENCE_SECONDS)
        self._loop.close()

    async def _close(self) -> None:
        for server in self._servers:
            server.close()
        others = asyncio.all_tasks() - {asyncio.current_task()}
        for task in others:
            task.cancel()
        await asyncio.gather(*others, return_exceptions=True)

    def _run(self, what: Coroutine[Any, Any, asyncio.Server]) -> asyncio.Server:
        return asyncio.run_coroutine_threadsafe(what, self._loop).result(_PATIENCE_SECONDS)
