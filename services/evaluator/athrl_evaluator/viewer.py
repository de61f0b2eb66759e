"""The rerun viewer, or a rerun server that viewers connect to, as a child process.

It is a process of its own because a viewer that hangs may block whoever logs to it. It is in a process
group of its own, too: Ctrl-C in the terminal would end it together with this process, which then could not
hand over its last frames and would tell of errors. It does not outlive this process, however that ends.
"""

from __future__ import annotations

import ctypes
import os
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import rerun_cli  # type: ignore[import-untyped]
from athrl_protocol import AddressInUse, ProtocolError

START_SECONDS = 30.0
END_SECONDS = 5.0
MEMORY_LIMIT = "512MiB"  # of frames that are kept for scrolling back

_LIBC = ctypes.CDLL(None)
_PR_SET_PDEATHSIG = 1


@contextmanager
def server_process(bind: str, port: int) -> Iterator[subprocess.Popen]:
    """A rerun server without a window that listens at `bind` and `port`; raises AddressInUse."""
    options = ["--serve-grpc", "--bind", bind, "--port", str(port), "--server-memory-limit", MEMORY_LIMIT]
    with _process(bind, port, options) as process:
        yield process


@contextmanager
def viewer_process(port: int) -> Iterator[subprocess.Popen]:
    """A viewer with a window, which listens at loopback; raises ProtocolError where there is no screen."""
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
    with _process("127.0.0.1", port, options) as process:
        yield process


def require_screen() -> None:
    """Raise ProtocolError where there is no screen to show a viewer's window on."""
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ProtocolError("this machine has no screen for a viewer: use --serve PORT and open it elsewhere")


def proxy_address(bind: str, port: int) -> str:
    """What a viewer on this machine connects to, where a server listens at `bind`."""
    return f"rerun+http://{_near_host(bind)}:{port}/proxy"


def free_port() -> int:
    """A port of loopback that nobody listens at just now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


@contextmanager
def _process(bind: str, port: int, options: list[str]) -> Iterator[subprocess.Popen]:
    _check_free(bind, port)
    program = Path(rerun_cli.__file__).with_name("rerun")
    process = subprocess.Popen(
        [str(program), *options],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        process_group=0,
        preexec_fn=_end_with_parent,
    )
    try:
        _wait_until_it_listens(process, _near_host(bind), port)
        yield process
    finally:
        process.terminate()
        try:
            process.wait(timeout=END_SECONDS)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _end_with_parent() -> None:
    """In the child before it becomes rerun: let the system end it when the thread that started it is gone."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)


def _near_host(bind: str) -> str:
    """Where this machine reaches a server that listens at `bind`."""
    return "127.0.0.1" if bind == "0.0.0.0" else bind


def _check_free(bind: str, port: int) -> None:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((bind, port))
        except OSError as error:
            raise AddressInUse(
                f"cannot serve rerun at {bind}:{port}: {error.strerror}; use another port"
            ) from None


def _wait_until_it_listens(process: subprocess.Popen, host: str, port: int) -> None:
    deadline = time.monotonic() + START_SECONDS
    while time.monotonic() < deadline:
        if process.poll() is not None:
            raise ProtocolError(f"rerun ended at once with exit code {process.returncode}")
        try:
            socket.create_connection((host, port), timeout=1).close()
        except OSError:
            time.sleep(0.05)
        else:
            return
    raise ProtocolError(f"rerun did not listen at port {port} within {START_SECONDS:.0f} s")
