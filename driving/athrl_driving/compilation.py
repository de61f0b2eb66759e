"""How kernels are compiled and where their machine code is kept.

numba keeps a function's machine code as long as its own file stays the same, although the functions that
it calls are compiled into it. So it is kept in a folder named after the content of all kernels' files, and
after the processor and the versions of Python and numba, without whose like it cannot be used.
"""

import hashlib
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
from athrl_spaces import action_kinds
from llvmlite.binding import get_host_cpu_name  # type: ignore[import-untyped]

Function = TypeVar("Function", bound=Callable[..., Any])

_COMMON = ("compilation.py", "by_reference.py")
_KERNEL_FILES = {
    "town": (
        "reward.py",
        "control/*.py",
        "episode/*.py",
        "maps/geometry.py",
        "maps/lane_graph.py",
        "metrics/*.py",
        "perception/*.py",
        "route/*.py",
        "traffic/*.py",
    ),
    "highway": ("highway/**/*.py",),
}
"""The files of the two families of kernels, which are compiled into each other."""

LONGEST_COMPILATION = 600.0
"""Seconds for which a process waits for another one that compiles the same kernels."""

_FEW_FRILLS = {"error_model": "numpy", "no_cfunc_wrapper": True, "_nrt": False}

_PACKAGE = Path(__file__).resolve().parent
_CONSTANTS = Path(action_kinds.__file__).resolve()
"""Whose constants are compiled into the towns' kernels."""

_LOG = logging.getLogger(__name__)


def compiled(function: Function) -> Function:
    """Compile a function that Python calls; it frees the interpreter's lock and is kept for later runs."""
    return _kept(function)


def entry(function: Function) -> Function:
    """Compile a function of `part` functions that Python calls; its state may be pinned (`episode.pinned`).

    Like `part` it counts no references; like `compiled` it is kept, and frees the interpreter's lock.
    """
    return _kept(function, **_FEW_FRILLS)


def inlined(function: Function) -> Function:
    """Compile a function that only compiled functions call, into its callers."""
    return numba.njit(nogil=True, forceinline=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)(function)


def inner(function: Function) -> Function:
    """Compile a big function that several compiled functions call, once for all of them."""
    return numba.njit(nogil=True, no_cpython_wrapper=True, no_cfunc_wrapper=True)(function)


def part(function: Function) -> Function:
    """Compile a function that only compiled functions call, once for all of them, with few frills.

    References to arrays are not counted, which costs more than what is done with the arrays, so it makes no
    arrays and returns none. State of many arrays it takes by reference (`by_reference`).
    """
    return numba.njit(nogil=True, no_cpython_wrapper=True, **_FEW_FRILLS)(function)


def spliced(function: Function) -> Function:
    """Put a small function, a `part` otherwise, into the functions that call it before these are compiled."""
    return numba.njit(nogil=True, inline="always", no_cpython_wrapper=True, **_FEW_FRILLS)(function)


def _kept(function: Function, **options: Any) -> Function:
    kept, numba.config.CACHE_DIR = numba.config.CACHE_DIR, cache_folder(_family(function))
    try:
        return numba.njit(cache=True, nogil=True, **options)(function)
    finally:
        numba.config.CACHE_DIR = kept


def prepare(kernel: Callable[..., Any], *arguments: Any) -> None:
    """Compile a kernel (decorated with `compiled` or `entry`) for such arguments, or load it; do not call it.

    What Python calls only later, in the middle of an episode, is prepared where compilation is announced.
    """
    kernel.compile(tuple(numba.typeof(argument) for argument in arguments))  # type: ignore[attr-defined]


@contextmanager
def compiled_once(kernel: Callable[..., Any], what: str, seconds: int) -> Iterator[None]:
    """Announce that `what` is compiled in this block, unless its machine code is there already.

    The block must compile `kernel`, and after everything else, as its machine code tells that all is there.
    `seconds` is about how long it takes. Processes that start together would all compile the same and be slow
    at it: the others wait for the first one and take its machine code.
    """
    if _is_compiled(kernel):
        yield
        return
    from filelock import FileLock, Timeout  # here, because it brings asyncio: 50 ms of every start

    lock = FileLock(Path(cache_folder(_family(kernel))) / "compiling.lock")
    try:
        lock.acquire(timeout=LONGEST_COMPILATION)
    except Timeout:
        _LOG.warning("another process compiles for more than %g s; not waiting longer", LONGEST_COMPILATION)
    try:
        if not _is_compiled(kernel):
            _announce(_family(kernel), what, seconds)
        yield
    finally:
        lock.release()


def _announce(family: str, what: str, seconds: int) -> None:
    """Say that a family of kernels is about to be compiled."""
    how_often = "once per installation"
    if _lasting_folder(family) is None:
        how_often = "at every start, as no folder to keep it in can be written: set NUMBA_CACHE_DIR to one"
    # A warning, because that is what Python shows where no logging has been configured.
    _LOG.warning("compiling %s: about %d s, %s", what, seconds, how_often)


def _is_compiled(kernel: Callable[..., Any]) -> bool:
    """Tell whether machine code of a kernel, of any signature, is kept."""
    module, name = kernel.__module__.rpartition(".")[2], kernel.__name__
    return any(Path(cache_folder(_family(kernel))).rglob(f"{module}.{name}-*.nbi"))


def _family(function: Callable[..., Any]) -> str:
    return "highway" if ".highway" in function.__module__ else "town"


@cache
def cache_folder(family: str = "town") -> str:
    """Return the folder for machine code: in $NUMBA_CACHE_DIR, beside the package, or in the user's cache.

    Where none of them can be written it is a temporary folder of this process alone. `family` is "town" or
    "highway": changes to one of them leave the other's machine code alone.
    """
    return _lasting_folder(family) or tempfile.mkdtemp(prefix="athrl-compiled-")


def _lasting_folder(family: str) -> str | None:
    """Return the folder whose machine code the next process finds; None where none can be written."""
    name = f"athrl_driving-{family}-{_fingerprint(family)}"
    user_cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    places = [os.environ.get("NUMBA_CACHE_DIR"), str(_PACKAGE / "__pycache__"), user_cache]
    for place in places:
        if place and _is_writable(Path(place) / name):
            return str(Path(place) / name)
    return None


def _fingerprint(family: str) -> str:
    machine = (get_host_cpu_name(), sys.implementation.cache_tag, numba.__version__)
    digest = hashlib.sha256(repr(machine).encode())
    for pattern in _COMMON + _KERNEL_FILES[family]:
        _add_files(digest, _PACKAGE.glob(pattern))
    if family == "town":
        _add_files(digest, [_CONSTANTS])
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
