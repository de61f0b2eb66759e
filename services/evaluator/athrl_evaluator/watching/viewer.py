"""The rerun viewer, or a rerun server that viewers or browsers connect to, as a child process.

It is a separate process because a viewer that hangs may block the process that logs to it. It also has its
own process group: Ctrl-C in the terminal would otherwise end it together with this process, which then could
not send its last frames and would report errors. It never outlives this process.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import ipaddress
import os
import signal
import socket
import subprocess
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import rerun_cli  # type: ignore[import-untyped]
from athrl_protocol import AddressInUse, ProtocolError
from athrl_spaces.wording import system_reason

START_SECONDS = 30.0
END_SECONDS = 5.0
PUBLISHED_VARIABLE = "ATHRL_VIEWER_ADDRESS"
"""Variable with the host and port at which viewers reach a server behind a container's port or a proxy; with
`https://` before it where a proxy adds TLS."""
PAGE_VARIABLE = "ATHRL_VIEWER_PAGE"
"""Variable with the address, `http://...`, at which browsers reach the page behind the same."""

PAGE_PORT = 9890
"""Port of the page, unless another one is given."""
FRAMES_PORT = PAGE_PORT + 1
"""Port of the page's frames, unless others are given: the one after the page's."""

MEMORY_LIMIT = "512MiB"  # of frames kept for scrolling back

_LIBC = ctypes.CDLL(None)
_PR_SET_PDEATHSIG = 1


class Server(NamedTuple):
    """Where a server for viewers listens."""

    port: int
    """For viewers, and for the frames of those in browsers."""
    bind: str = "127.0.0.1"
    """IP address of this machine at which both ports are."""
    page_port: int | None = None
    """For a page with rerun's viewer, which is opened in browsers; None: there is none."""

    @property
    def address(self) -> str:
        """The address to which a viewer on this machine connects."""
        return f"rerun+http://{_in_url(self.bind)}:{self.port}/proxy"

    @property
    def shown_address(self) -> str:
        """The address to tell people: of the page if there is one, else of the server for viewers.

        Neither a container nor a server behind a proxy knows how it is reached, so its environment says it.
        """
        published = os.environ.get(PUBLISHED_VARIABLE)
        scheme = "" if published and "://" in published else "http://"
        frames = f"rerun+{scheme}{published}/proxy" if published else self.address
        if self.page_port is None:
            return frames
        page = os.environ.get(PAGE_VARIABLE) or f"http://{_in_url(self.bind)}:{self.page_port}"
        return f"{page.rstrip('/')}/?url={quote(frames, safe=':/')}"


@contextlib.contextmanager
def server_process(server: Server) -> Iterator[subprocess.Popen]:
    """A rerun server without a window.

    Raises:
        AddressInUse: one of its ports is taken.
        ProtocolError: this machine has no such address; or the page would be open to other machines, and
            nothing says that a container or a proxy stands before it.
    """
    options = ["--bind", server.bind, "--port", str(server.port), "--server-memory-limit", MEMORY_LIMIT]
    if server.page_port is None:
        with _process(server.bind, [server.port], [*options, "--serve-grpc"]) as process:
            yield process
        return
    _require_guarded(server.bind)
    options += ["--serve-web", "--web-viewer-port", str(server.page_port)]
    with _process(server.bind, [server.port, server.page_port], options) as process:
        yield process


@contextlib.contextmanager
def viewer_process(port: int) -> Iterator[subprocess.Popen]:
    """A viewer with a window, which listens at loopback; raises ProtocolError without a screen."""
    require_screen()
    options = [
        "--bind",
        "127.0.0.1",
        "--port",
        str(port),
        "--memory-limit",
        MEMORY_LIMIT,
        "--hide-welcome-screen",
    ]
    with _process("127.0.0.1", [port], options) as process:
        yield process


def has_screen() -> bool:
    """Whether a window can be opened."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def require_screen() -> None:
    """Raise ProtocolError if there is no screen for a viewer's window."""
    if not has_screen():
        raise ProtocolError(
            "this machine has no screen for a viewer: use --browser, or --serve PORT and a viewer elsewhere"
        )


def free_port() -> int:
    """A free port of the loopback interface."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _require_guarded(bind: str) -> None:
    """Raise ProtocolError for a page that other machines could open, unless that is wanted."""
    if not _ip_address(bind).is_loopback and not os.environ.get(PAGE_VARIABLE):
        raise ProtocolError(
            f"--bind {bind}: the page has neither encryption nor a password, it should be at 127.0.0.1 and "
            f"reached through ssh; a container or proxy before it tells its address in {PAGE_VARIABLE}"
        )


@contextlib.contextmanager
def _process(bind: str, ports: Sequence[int], options: list[str]) -> Iterator[subprocess.Popen]:
    for port in ports:
        _check_free(bind, port)
    program = Path(rerun_cli.__file__).with_name("rerun")
    process = subprocess.Popen(
        [str(program), *options],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={"CI": "true", **os.environ},  # there rerun sends no usage data, by its own rule
        process_group=0,
        preexec_fn=_end_with_parent,
    )
    try:
        for port in ports:
            _wait_until_it_listens(process, _near_host(bind), port)
        yield process
    finally:
        process.terminate()
        try:
            process.wait(timeout=END_SECONDS)
        except subprocess.TimeoutExpired:
            process.kill()
            with contextlib.suppress(subprocess.TimeoutExpired):  # the kernel waits for a device in its place
                process.wait(timeout=END_SECONDS)


def _end_with_parent() -> None:
    """Let the system end this child process when the thread that started it ends; called before exec."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _ip_address(bind: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address:
    """The address in a text; raises ProtocolError for any other text: rerun looks no names up."""
    try:
        return ipaddress.ip_address(bind)
    except ValueError:
        raise ProtocolError(
            f"--bind {bind}: should be an IP address of this machine, such as 127.0.0.1"
        ) from None


def _near_host(bind: str) -> str:
    """The host at which this machine reaches a server that listens at `bind`."""
    return {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(bind, bind)


def _in_url(bind: str) -> str:
    """The same as an address of a page has it."""
    host = _near_host(bind)
    return f"[{host}]" if ":" in host else host


def _check_free(bind: str, port: int) -> None:
    family = socket.AF_INET if _ip_address(bind).version == 4 else socket.AF_INET6
    with socket.socket(family) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((bind, port))
        except OSError as error:
            if error.errno == errno.EADDRNOTAVAIL:
                raise ProtocolError(f"--bind {bind}: this machine has no such address") from None
            raise AddressInUse(
                f"cannot serve rerun at {bind}:{port}: {system_reason(error)}; use another port"
            ) from None


def _wait_until_it_listens(process: subprocess.Popen, host: str, port: int) -> None:
    deadline = time.monotonic() + START_SECONDS
    while time.monotonic() < deadline:
        if process.poll() is not None:
            raise ProtocolError(f"rerun ended at once with exit code {process.returncode}")
        if _listens(host, port):
            return
        time.sleep(0.05)
    raise ProtocolError(f"rerun did not listen at port {port} within {START_SECONDS:.0f} s")


def _listens(host: str, port: int) -> bool:
    """Tell whether a server answers at this port.

    Where nobody listens, a connection may get the very port that it asks for as its own, and then connects
    to itself.
    """
    try:
        with socket.create_connection((host, port), timeout=1) as connection:
            return connection.getsockname() != connection.getpeername()
    except OSError:
        return False
