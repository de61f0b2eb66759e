"""The endpoint at which Prometheus fetches the metrics of a service: HTTP, `/metrics`, read only.

Clients need no certificate and may send anything, so nothing that they do may slow down the service: there
are few threads, each request has a deadline and a size, the text is made at most twice a second, and the rate
of requests is bounded. A client that keeps all threads busy delays other clients, not training.
"""

from __future__ import annotations

import contextlib
import errno
import io
import logging
import socket
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from typing import Any

from athrl_spaces.wording import system_reason
from prometheus_client import CollectorRegistry, ProcessCollector
from prometheus_client.exposition import choose_encoder
from prometheus_client.registry import Collector

from athrl_protocol.errors import AddressInUse, ProtocolError
from athrl_protocol.faults.bounded_log import BoundedLog
from athrl_protocol.monitoring.address import MetricsAddress, metrics_address
from athrl_protocol.transport.closeable import Closeable

PATH = "/metrics"
THREADS = 4
"""Connections that are answered at the same time."""
WAITING = 16
"""Connections that may wait to be answered."""
LARGEST_REQUEST = 8 * 1024
"""Bytes of a request with its headers."""
REQUEST_SECONDS = 5.0
"""For a request to arrive, and again for its answer to be taken."""
PAUSE_SECONDS = 0.04
"""Of a thread between two requests: all threads together answer at most a hundred a second."""
FRESH_SECONDS = 0.5
"""For which a text is answered again, before it is made of newer values."""
POLL_SECONDS = 0.5

_OPEN_METRICS = "application/openmetrics-text"

_log = logging.getLogger(__name__)


class MetricsEndpoint(Closeable):
    """Answers scrapes until it is closed, from threads that never keep the process alive.

    Args:
        address: where to listen.
        collectors: of what is shown, besides the memory, processor time and open files of this process.

    Raises:
        AddressInUse: another process listens there.
        ProtocolError: this machine has no such address, or the port may not be used.
    """

    def __init__(self, address: MetricsAddress, collectors: Sequence[Collector]) -> None:
        registry = CollectorRegistry()
        ProcessCollector(registry=registry)
        for collector in collectors:
            registry.register(collector)
        self._texts = _Texts(registry)
        self._closed = threading.Event()
        self._warn = BoundedLog(_log.warning)
        self._socket = _listening(address)
        self._threads = [
            threading.Thread(target=self._serve, name="metrics", daemon=True) for _ in range(THREADS)
        ]
        for thread in self._threads:
            thread.start()
        _log.info("metrics for Prometheus are at http://%s%s", address, PATH)

    def close(self) -> None:
        """Stop answering and give up the port."""
        self._closed.set()
        with contextlib.suppress(OSError):  # it was closed before
            self._socket.shutdown(socket.SHUT_RDWR)  # which wakes the threads that wait for a client
        deadline = time.monotonic() + POLL_SECONDS
        for thread in self._threads:  # one that is busy with a slow client ends later
            thread.join(timeout=max(0.0, deadline - time.monotonic()))
        self._socket.close()

    def _serve(self) -> None:
        while not self._closed.wait(PAUSE_SECONDS):
            try:
                connection, _ = self._socket.accept()
            except TimeoutError:
                continue
            except OSError as error:
                if self._closed.is_set():
                    return
                self._warn(f"a connection for metrics was not accepted: {system_reason(error)}")
                self._closed.wait(POLL_SECONDS)
                continue
            self._answer(connection)

    def _answer(self, connection: socket.socket) -> None:
        try:
            with connection, contextlib.suppress(OSError):  # the client has left, or is too slow
                _Handler(connection, self._texts.of)
        except Exception as error:  # a bug that one request shows must not end the thread
            self._warn(f"a request for metrics failed: {type(error).__name__}: {error}")


def serve_metrics(listen: str, *collectors: Collector) -> AbstractContextManager[object]:
    """Return an endpoint at an address as `metrics.listen` has it; with an empty text, nothing.

    Raises as `metrics_address` and `MetricsEndpoint` do.
    """
    return MetricsEndpoint(metrics_address(listen), collectors) if listen else contextlib.nullcontext()


def require_free_endpoints(listens: Mapping[str, str]) -> None:
    """Raise what `serve_metrics` would for one of these addresses, or for two that are the same.

    Args:
        listens: addresses by what gives them, which an error names; an empty address is none.

    Raises:
        ProtocolError: an address is none, or cannot be listened at.
        AddressInUse: another process listens there, or an address before it is the same.
    """
    with contextlib.ExitStack() as taken:
        for origin, listen in listens.items():
            try:
                if listen:
                    taken.enter_context(_listening(metrics_address(listen)))
            except ProtocolError as error:
                raise type(error)(f"{origin}: {error}") from None


class _Texts:
    """The text of all metrics in each of Prometheus' two formats, made again when it is old."""

    def __init__(self, registry: CollectorRegistry) -> None:
        self._registry = registry
        self._made: dict[str, tuple[float, bytes]] = {}
        self._lock = threading.Lock()

    def of(self, accepted: str) -> tuple[str, bytes]:
        """Return content type and text for what a client accepts."""
        # The client's own words would be one format more for each version that it makes up.
        wanted = f"{_OPEN_METRICS}; version=1.0.0" if _OPEN_METRICS in accepted else "text/plain"
        encode, kind = choose_encoder(wanted)
        with self._lock:  # so that many clients at once cost one text
            made_at, text = self._made.get(kind, (-float("inf"), b""))
            if time.monotonic() - made_at > FRESH_SECONDS:
                text = encode(self._registry)
                self._made[kind] = time.monotonic(), text
            return kind, text


class _Handler(BaseHTTPRequestHandler):
    """Answers one request on a connection: the standard library reads headers, within our bounds."""

    server_version = "athrl"
    sys_version = ""

    def __init__(self, connection: socket.socket, text_of: Callable[[str], tuple[str, bytes]]) -> None:
        self._text_of = text_of
        super().__init__(connection, ("", 0), None)  # type: ignore[arg-type]  # there is no server object

    def setup(self) -> None:
        """Read the request as a whole, within its deadline and size."""
        self.connection = self.request
        self.rfile = io.BytesIO(_request(self.request))
        self.wfile = io.BytesIO()

    def finish(self) -> None:
        """Send the answer as a whole, within its deadline."""
        self.request.settimeout(REQUEST_SECONDS)
        self.request.sendall(self.wfile.getvalue())  # type: ignore[attr-defined]
        self.request.shutdown(socket.SHUT_WR)

    def do_GET(self) -> None:
        """Answer with all metrics, in the format that the client accepts."""
        if self.path.partition("?")[0] != PATH:
            self.send_error(HTTPStatus.NOT_FOUND, f"metrics are at {PATH}")
            return
        kind, text = self._text_of(self.headers.get("Accept", ""))
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(text)))
        self.end_headers()
        self.wfile.write(text)

    def log_message(self, format: str, *arguments: Any) -> None:
        """Log nothing: what clients ask for would fill the log."""


def _listening(address: MetricsAddress) -> socket.socket:
    both = not address.host and socket.has_dualstack_ipv6()
    family = socket.AF_INET6 if both or ":" in address.host else socket.AF_INET
    try:
        listening = socket.create_server(
            (address.host, address.port), family=family, backlog=WAITING, dualstack_ipv6=both
        )
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise AddressInUse(
                f"cannot serve metrics at {address}: another process listens there; give each service of "
                "this machine a port of its own"
            ) from None
        reason = system_reason(error).partition(" (while")[0]
        raise ProtocolError(f"cannot serve metrics at {address}: {reason}") from None
    except (TypeError, ValueError):  # so Python says that it cannot be encoded, or has a NUL character
        raise ProtocolError(f"cannot serve metrics at {str(address)!r}: that is no host's name") from None
    listening.settimeout(POLL_SECONDS)
    return listening


def _request(connection: socket.socket) -> bytes:
    """Read until the end of the headers.

    Raises:
        OSError: it did not arrive within `REQUEST_SECONDS`, or is larger than `LARGEST_REQUEST`.
    """
    deadline = time.monotonic() + REQUEST_SECONDS
    request = b""
    while b"\r\n\r\n" not in request and b"\n\n" not in request:
        left = deadline - time.monotonic()
        if left <= 0 or len(request) > LARGEST_REQUEST:
            raise OSError("the request is too slow or too large")
        connection.settimeout(left)
        received = connection.recv(LARGEST_REQUEST)
        if not received:
            raise OSError("the client has left")
        request += received
    return request
