"""The command in processes forked off one that has loaded it: as `athrl`, without loading it each time.

Loading takes most of the time of a command that refuses what it was given. Whatever depends on how a command
is loaded is tested with `Command.run` instead, which starts a new interpreter.
"""

from __future__ import annotations

import gc
import json
import os
import subprocess
import sys
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any


class ForkingServer:
    """A process that has loaded modules and forks off one that runs the command, for one call at a time."""

    def __init__(self, process: subprocess.Popen[str], folder: Path) -> None:
        self._process = process
        self._folder = folder

    def run(
        self, *arguments: str, folder: Path, environment: dict[str, str], seconds: float
    ) -> subprocess.CompletedProcess[str]:
        """Run the command to its end, which must come within so many seconds."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        outputs = [self._folder / name for name in ("stdout", "stderr")]
        call = {
            "arguments": arguments,
            "folder": str(folder),
            "environment": environment,
            "outputs": [str(path) for path in outputs],
        }
        self._process.stdin.write(json.dumps(call) + "\n")
        self._process.stdin.flush()
        child = int(self._process.stdout.readline())
        limit = threading.Timer(seconds, _kill, (child,))
        limit.start()
        code = int(self._process.stdout.readline())
        limit.cancel()
        out, err = (path.read_text() for path in outputs)
        return subprocess.CompletedProcess(["athrl", *arguments], code, out, err)


@dataclass
class ForkedCommand:
    """Runs `athrl` in the folder and with the environment of a `Command`, forked off by a server."""

    command: Any
    server: ForkingServer

    @property
    def folder(self) -> Path:
        """Where it runs."""
        return self.command.folder  # type: ignore[no-any-return]

    def run(self, *arguments: str, seconds: float) -> subprocess.CompletedProcess[str]:
        """Run the command to its end, which must come within so many seconds."""
        return self.server.run(
            *arguments, folder=self.folder, environment=self.command.environment(), seconds=seconds
        )


@contextmanager
def forking_server(modules: Iterable[str], environment: dict[str, str]) -> Iterator[ForkingServer]:
    """Start a server that has loaded these modules, and end it."""
    with TemporaryDirectory() as folder:
        process = subprocess.Popen(
            [sys.executable, __file__, *modules],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            yield ForkingServer(process, Path(folder))
            process.communicate(timeout=30)  # its input ends, and so does it
        finally:
            process.kill()
            process.wait()


def _kill(process: int) -> None:
    with suppress(ProcessLookupError):
        os.kill(process, 9)


def _become(call: dict[str, object]) -> None:
    """Make this process what a new one would be: its folder, environment, arguments and files."""
    os.chdir(str(call["folder"]))
    os.environ.clear()
    os.environ.update(call["environment"])  # type: ignore[call-overload]
    sys.argv[1:] = call["arguments"]  # type: ignore[assignment]
    flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC
    for number, path in enumerate((os.devnull, *call["outputs"])):  # type: ignore[misc]
        opened = os.open(path, flags if number else os.O_RDONLY, 0o600)
        os.dup2(opened, number)
        os.close(opened)


def _tell(number: int) -> None:
    os.write(1, f"{number}\n".encode())


def _serve(modules: list[str]) -> None:
    """Run the calls that are lines of standard input; tell of each its process, and its exit code."""
    from athrl.__main__ import main

    for module in modules:
        import_module(module)
    threads = os.listdir("/proc/self/task")
    if len(threads) > 1:  # they would be missing in what is forked off
        raise SystemExit(f"{len(threads)} threads run after {', '.join(modules)} have been loaded")
    gc.freeze()
    while line := sys.stdin.readline():
        child = os.fork()
        if child == 0:
            _become(json.loads(line))
            main()
        _tell(child)
        _, status = os.waitpid(child, 0)
        _tell(os.waitstatus_to_exitcode(status))


if __name__ == "__main__":
    loaded = sys.argv[1:]
    sys.path.pop(0)  # this folder
    _serve(loaded)
