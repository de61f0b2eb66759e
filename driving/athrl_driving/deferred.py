"""Imports highway-env and numba without what nothing that drives in a town ever uses of other libraries.

highway-env imports pandas and matplotlib's plots for tables and plots of its own environments: most of its
start, one second of a core, and 75 MiB of every process. numba imports scipy's linear algebra with its first
kernel, to learn whether there is any: a quarter of a second. Each is loaded now when something of it is first
used. A lazy module of importlib's loads at any look at it, and importing a part of a package is one, so
packages are kept back in another way. This module has to be imported before others that import highway-env or
use numba; what somebody imported already stays as it is.
"""

from __future__ import annotations

import importlib
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from importlib.util import LazyLoader
from types import ModuleType
from typing import Any

UNUSED = frozenset({"pandas", "matplotlib.pyplot"})
PACKAGES = frozenset({"matplotlib", "scipy.linalg"})
"""Packages of which a part is imported, and the package with it, without being used."""


class _Unloaded(ModuleType):
    """A package that has its place and is loaded when something of it is used that is not there yet."""

    def __getattr__(self, name: str) -> Any:
        with _loading:
            if type(self) is _Unloaded:
                self.__class__ = ModuleType  # type: ignore[assignment]  # as it was
                assert self.__spec__ is not None
                assert self.__spec__.loader is not None
                self.__spec__.loader.exec_module(self)
        return getattr(self, name)


_loading = threading.RLock()


class _LaterPackage(Loader):
    """Puts a package in its place and leaves loading it to the loader that it has."""

    def __init__(self, loader: Loader) -> None:
        self._loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        """Leave that to Python."""
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        """Give the package back its loader, for later."""
        assert module.__spec__ is not None
        module.__loader__ = module.__spec__.loader = self._loader
        module.__class__ = _Unloaded


class _Deferring(MetaPathFinder):
    """Finds the modules that are loaded when they are first used."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the module's spec with a loader that waits; None for all other modules."""
        if fullname not in UNUSED | PACKAGES:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and spec.loader is not None:
            spec.loader = _LaterPackage(spec.loader) if fullname in PACKAGES else LazyLoader(spec.loader)
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
    importlib.import_module("numba.np.arraymath")
