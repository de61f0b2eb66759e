"""How this package's kernels are compiled: they make no arrays and count no references to any.

Counting references costs several times what the kernels do with the arrays; Python holds all of them.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import numba

from athrl_driving.compilation import cache_folder

Function = TypeVar("Function", bound=Callable[..., Any])

_SETTINGS = {"nogil": True, "error_model": "numpy", "_nrt": False}


def entry(function: Function) -> Function:
    """Compile a function that Python calls; its machine code is kept for later runs."""
    kept, numba.config.CACHE_DIR = numba.config.CACHE_DIR, cache_folder("highway")
    try:
        return numba.njit(cache=True, **_SETTINGS)(function)
    finally:
        numba.config.CACHE_DIR = kept


def whole(function: Function) -> Function:
    """Compile a big function once for all the compiled functions that call it."""
    return numba.njit(no_cpython_wrapper=True, **_SETTINGS)(function)


def part(function: Function) -> Function:
    """Put a small function into the functions that call it, before these are compiled."""
    return numba.njit(inline="always", no_cpython_wrapper=True, **_SETTINGS)(function)
