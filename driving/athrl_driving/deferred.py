"""Imports highway-env without pandas and matplotlib's plots, which nothing that drives in a town ever uses.

highway-env imports both for tables and plots of its own environments. They are most of its start, one
second of a core, and 75 MiB of every process: each is loaded now when something of it is first used. The
module has to be imported before others that import highway-env; one of the two that somebody imported
already stays as it is.
"""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from types import ModuleType

UNUSED = frozenset({"pandas", "matplotlib.pyplot"})


class _Deferring(MetaPathFinder):
    """Finds the modules that are loaded when they are first used."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the module's spec with a loader that waits; None for all other modules."""
        if fullname not in UNUSED:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and spec.loader is not None:
            spec.loader = LazyLoader(spec.loader)
        return spec


@contextmanager
def _deferred() -> Iterator[None]:
    finder = _Deferring()
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)


with _deferred():
    importlib.import_module("highway_env")
