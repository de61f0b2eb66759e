"""How kernels are compiled and where their machine code is kept.

numba caches a function's machine code as long as its own file stays the same, although the functions that it
calls are compiled into it. So the cache is in a folder named after a hash of the content of all kernels'
files, the processor, the versions of Python and numba, and whether indices are checked (`index_checks`).
"""

import hashlib
import itertools
import logging
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any, TypeVar

import numba
from athrl_spaces import action_kinds, observation, reward_terms
from llvmlite.binding import get_host_cpu_name  # type: ignore[import-untyped]

from athrl_driving.kernels.index_checks import CHECKS_INDICES, compiler_options
from athrl_driving.kernels.machine_code import INDEX, copy_code, temporary_folder

Function = TypeVar("Function", bound=Callable[..., Any])

_COMMON = "kernels/*.py"
_TOWN_KERNELS = (
    "reward.py",
    "control/*.py",
    "episode/*.py",
    "maps/arcs.py",
    "maps/geometry.py",
    "maps/lane_graph.py",
    "maps/levels.py",
    "metrics/*.py",
    "perception/*.py",
    "route/*.py",
    "traffic/*.py",
)
"""This package's files with kernels. In another package that compiles its kernels here, every file counts."""

LONGEST_COMPILATION = 600.0
"""Seconds for which a process waits for another one that compiles the same kernels."""

_NO_REFERENCE_COUNTING = {"error_model": "numpy", "no_cfunc_wrapper": True, "_nrt": False}

_PACKAGE = Path(__file__).resolve().parents[1]
_OWN_PACKAGE = "athrl_driving"
_CONSTANTS = [Path(str(module.__file__)).resolve() for module in (action_kinds, observation, reward_terms)]
"""Files whose constants are compiled into the towns' kernels."""

_LOG = logging.getLogger(__name__)


def compiled(function: Function) -> Function:
    """Compile a function that Python calls; it releases the GIL and is cached for later runs."""
    return _cached(function)


def entry(function: Function) -> Function:
    """Compile a function that Python calls and that calls `part` functions; its state may be pinned.

    Like `part` it counts no references; like `compiled` it is cached and releases the GIL.
    """
    return _cached(function, **_NO_REFERENCE_COUNTING)


def inlined(function: Function) -> Function:
    """Compile a function that only compiled functions call, inlined into its callers."""
    return _njit(function, forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)


def inner(function: Function) -> Function:
    """Compile a large function that several compiled functions call, once for all of them."""
    return _njit(function, no_cpython_wrapper=True, no_cfunc_wrapper=True)


def part(function: Function) -> Function:
    """Compile a function that only compiled functions call, once for all of them, without reference counting.

    Counting references to arrays would cost more than the work on the arrays. So the function must not make
    or return arrays. It takes state of many arrays by reference (`by_reference`).
    """
    return _njit(function, no_cpython_wrapper=True, **_NO_REFERENCE_COUNTING)


def spliced(function: Function) -> Function:
    """Inline a small `part` function into its callers before they are compiled."""
    return _njit(function, inline="always", no_cpython_wrapper=True, **_NO_REFERENCE_COUNTING)


def _cached(function: Function, **options: Any) -> Function:
    previous, numba.config.CACHE_DIR = numba.config.CACHE_DIR, cache_folder(_package_of(function))
    try:
        return _njit(function, cache=True, **options)
    finally:
        numba.config.CACHE_DIR = previous


def _njit(function: Function, **options: Any) -> Function:
    """Compile a function that releases the GIL; in the debug build it checks its indices."""
    if CHECKS_INDICES:
        options.update(compiler_options())
    return numba.njit(nogil=True, **options)(function)


def prepare(kernel: Callable[..., Any], *arguments: Any) -> None:
    """Compile or load a kernel (decorated with `compiled` or `entry`) for such arguments without calling it.

    Kernels that Python first calls in the middle of an episode are prepared where compilation is announced.
    """
    kernel.compile(tuple(numba.typeof(argument) for argument in arguments))  # type: ignore[attr-defined]


@contextmanager
def compiled_once(kernel: Callable[..., Any], what: str, seconds: int) -> Iterator[None]:
    """Announce that `what` is compiled in this block, unless its machine code is cached already.

    The block must compile `kernel` last, as its cached machine code means that everything is cached.
    `seconds` is about how long it takes. Processes that start together would all compile the same code
    slowly: the others wait for the first one and load its machine code.
    """
    if _is_compiled(kernel):
        yield
        return
    from filelock import FileLock, Timeout  # here, because it imports asyncio: 50 ms of every start

    lock = FileLock(Path(cache_folder(_package_of(kernel))) / "compiling.lock")
    try:
        lock.acquire(timeout=LONGEST_COMPILATION)
    except Timeout:
        _LOG.warning("another process compiles for more than %g s; not waiting longer", LONGEST_COMPILATION)
    try:
        if not _is_compiled(kernel):
            _announce(_package_of(kernel), what, seconds)
        yield
    finally:
        lock.release()


def _announce(package: str, what: str, seconds: int) -> None:
    """Log that a package's kernels are about to be compiled."""
    how_often = "once per installation"
    if _persistent_folder(package) is None:
        how_often = "at every start, as no folder to keep it in can be written: set NUMBA_CACHE_DIR to one"
    # A warning, because Python shows warnings where no logging has been configured.
    _LOG.warning("compiling %s: about %d s, %s", what, seconds, how_often)


def _is_compiled(kernel: Callable[..., Any]) -> bool:
    """Tell whether machine code of a kernel, of any signature, is cached."""
    module, name = kernel.__module__.rpartition(".")[2], kernel.__name__
    return any(Path(cache_folder(_package_of(kernel))).rglob(f"{module}.{name}-*{INDEX}"))


def _package_of(function: Callable[..., Any]) -> str:
    """Return the package of a kernel; a function outside packages is cached with this package's kernels."""
    package = function.__module__.partition(".")[0]
    return package if hasattr(sys.modules.get(package), "__path__") else _OWN_PACKAGE


@cache
def cache_folder(package: str = "athrl_driving") -> str:
    """Return the folder for machine code: in $NUMBA_CACHE_DIR, beside the package, or in the user's cache.

    It is the first of them that can be written, else a temporary folder of this process. Machine code in
    those before it, which can only be read, is used from there. `package` is the package of the kernels: a
    change to one package does not invalidate another's machine code.
    """
    folder = Path(_persistent_folder(package) or temporary_folder(package))
    for readable in itertools.takewhile(lambda place: place != folder, _folders(package)):
        copy_code(readable, folder)
    return str(folder)


def _persistent_folder(package: str) -> str | None:
    """Return the folder whose machine code the next process can load; None if none can be written."""
    return next((str(folder) for folder in _folders(package) if _is_writable(folder)), None)


def _folders(package: str) -> list[Path]:
    """Where machine code may be kept; the first one that can be written is used."""
    name = f"{package}-{fingerprint(package)}"
    user_cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    places = [os.environ.get("NUMBA_CACHE_DIR"), _package_folder(package) / "__pycache__", user_cache]
    return [Path(place) / name for place in places if place]


def _package_folder(package: str) -> Path:
    if package == _OWN_PACKAGE:
        return _PACKAGE
    return Path(str(sys.modules[package].__file__)).resolve().parent


def fingerprint(package: str = _OWN_PACKAGE) -> str:
    """Return a hash of a package's kernels, the compiler and the processor: of all that machine code is of.

    Where it is equal, kernels compute the same numbers to the last bit.
    """
    # Code with checks of indices, ours or numba's own, is never taken for code without.
    checks = (CHECKS_INDICES, numba.config.BOUNDSCHECK)
    machine = (get_host_cpu_name(), sys.implementation.cache_tag, numba.__version__, checks)
    digest = hashlib.sha256(repr(machine).encode())
    _add_files(digest, _PACKAGE.glob(_COMMON))
    if package == _OWN_PACKAGE:
        for pattern in _TOWN_KERNELS:
            _add_files(digest, _PACKAGE.glob(pattern))
        _add_files(digest, _CONSTANTS)
    else:
        _add_files(digest, _package_folder(package).rglob("*.py"))
    return digest.hexdigest()[:16]


def _add_files(digest: "hashlib._Hash", paths: Iterable[Path]) -> None:
    for path in sorted(paths):
        digest.update(path.name.encode())
        digest.update(path.read_bytes())


def _is_writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False
