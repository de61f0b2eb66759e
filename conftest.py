"""Loaded before every test.

The folder of the command has the name of its package: imported here, the package is known before pytest meets
the tests in `athrl/tests` and takes the folder for it.

pygame gets no screen. With one it loads the graphics driver, which brings an LLVM of its own that does not
get along with triton's: importing torch's compiler in the same process afterwards crashes. `putenv` tells SDL
alone; highway-env, which looks into `os.environ`, would stop drawing altogether.

MKL reads MKL_CBWR when it first computes. Serial runs set it in time in a process of their own; here some
other test may have computed before one, and its last bits would be those of sums in another order.

Some tests import ONNX Runtime themselves, maybe before the package that turns its telemetry off.

Ports are below the range out of which the system gives ports to outgoing connections, and no process gives
one twice: nobody else gets a port between the moment when it is found free and the moment when the test's
process listens at it, which may be a minute later.

A test's collection of garbage need not look at the millions of objects that came with the packages and tests.

Workers that reach the same kernel at the same time would all compile it: one does, the others load its code.
"""

import gc
import itertools
import os
import random
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

os.putenv("SDL_VIDEODRIVER", "dummy")
os.environ.setdefault("MKL_CBWR", "AUTO")
os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")

from athrl.ports import is_free

_FIRST_PORT, _LAST_PORT = 12_000, 32_000
_PORTS_A_PROCESS = 1_000

_LONGEST_COMPILATION = 280.0
"""Seconds; less than a test may take."""


def pytest_collection_finish() -> None:
    """Leave all that is there before the first test out of collections of garbage."""
    gc.freeze()


@pytest.fixture(scope="session")
def free_port(worker_id: str) -> Callable[[], int]:
    """Gives a port that is free at the loopback interface, another one each time."""
    ports = _ports_of(worker_id)

    def free() -> int:
        return next(port for port in ports if is_free(port))

    return free


@pytest.fixture(scope="session")
def free_address(free_port: Callable[[], int]) -> Callable[[], str]:
    """Gives an address of the loopback interface for a learner or router, another one each time."""
    return lambda: f"tcp/127.0.0.1:{free_port()}"


@pytest.fixture
def port(free_port: Callable[[], int]) -> int:
    """A port that is free at the loopback interface."""
    return free_port()


@pytest.fixture
def address(free_address: Callable[[], str]) -> str:
    """An address of the loopback interface for a learner or router."""
    return free_address()


@pytest.fixture(scope="session", autouse=True)
def _each_kernel_is_compiled_once() -> Iterator[None]:
    """Let one worker compile a kernel that is cached, and the others wait for its machine code."""
    from filelock import FileLock
    from numba.core.dispatcher import Dispatcher

    compile_at_once = Dispatcher.compile

    def compile_once(self: Any, signature: Any) -> Any:
        folder = self._cache.cache_path
        if folder is None:
            return compile_at_once(self, signature)
        Path(folder).mkdir(parents=True, exist_ok=True)
        with FileLock(Path(folder) / f"{self.py_func.__qualname__}.lock", timeout=_LONGEST_COMPILATION):
            return compile_at_once(self, signature)

    Dispatcher.compile = compile_once
    yield
    Dispatcher.compile = compile_at_once


def _ports_of(worker: str) -> Iterator[int]:
    """The ports of one of the processes that run tests side by side, beginning anywhere among them."""
    number = int(worker.removeprefix("gw")) if worker.startswith("gw") else 0
    first = _FIRST_PORT + number * _PORTS_A_PROCESS % (_LAST_PORT - _FIRST_PORT)
    start = random.SystemRandom().randrange(_PORTS_A_PROCESS)
    return (first + (start + step) % _PORTS_A_PROCESS for step in itertools.count())
