"""Imports highway-env and numba, and defers those of their imports that driving in a town never uses.

highway-env imports pandas and matplotlib's plots for the tables and plots of its own environments: most of
its import time, one second of a core, and 75 MiB of every process. numba imports scipy's linear algebra with
its first kernel, to find out whether it is installed: a quarter of a second. Here each of them is loaded when
an attribute of it is first used, and need not be installed until then: images for actors leave pandas and
matplotlib out. importlib's lazy modules load at any attribute access. Importing a submodule of a package is
one, and so is a look at a module's file, which `inspect` takes at every module while torch is imported: so
modules are deferred in another way. This module has to be imported before others that import highway-env or
use numba; modules that are already imported stay as they are.
"""

from __future__ import annotations

import importlib
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from types import ModuleType
from typing import Any

UNUSED = frozenset({"pandas", "matplotlib.pyplot"})
PACKAGES = frozenset({"matplotlib", "scipy.linalg"})
"""Packages of which a submodule is imported, and with it the package, without being used."""

NOT_NEEDED = frozenset({"pandas", "matplotlib", "matplotlib.pyplot"})
"""Modules whose import succeeds where they are not installed."""


class _Unloaded(ModuleType):
    """A module in `sys.modules` that is loaded when an attribute is used that it does not have yet."""

    def __getattr__(self, name: str) -> Any:
        with _loading:
            if type(self) is _Unloaded:
                self.__class__ = ModuleType  # type: ignore[assignment]  # as before
                assert self.__spec__ is not None
                assert self.__spec__.loader is not None
                self.__spec__.loader.exec_module(self)
        return getattr(self, name)


_loading = threading.RLock()


class _Later(Loader):
    """Creates a module without executing it; its own loader executes it later."""

    def __init__(self, loader: Loader) -> None:
        self._loader = loader

    def create_module(self, spec: ModuleSpec) -> ModuleType | None:
        """Create the module as its own loader does."""
        return self._loader.create_module(spec)

    def exec_module(self, module: ModuleType) -> None:
        """Restore the module's own loader, which executes it later."""
        assert module.__spec__ is not None
        module.__loader__ = module.__spec__.loader = self._loader
        module.__class__ = _Unloaded


class _Missing(Loader):
    """Creates a module that is not installed; it says so when an attribute of it is used."""

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        """Create a module that holds nothing but its name."""
        return _NotInstalled(spec.name)

    def exec_module(self, module: ModuleType) -> None:
        """There is nothing to execute."""


class _NotInstalled(ModuleType):
    """Stands for a module that is not installed, as long as nobody uses it."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # by which the import system looks at every module
            raise AttributeError(name)
        raise ModuleNotFoundError(f"{self.__name__}.{name} is used and {self.__name__} is not installed")


class _Deferring(MetaPathFinder):
    """Finds the modules whose loading is deferred."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """Return the module's spec with a deferring loader; None for all other modules."""
        if fullname not in UNUSED | PACKAGES:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is None and fullname in NOT_NEEDED:
            return ModuleSpec(fullname, _Missing(), is_package=fullname in PACKAGES)
        if spec is not None and spec.loader is not None:
            spec.loader = _Later(spec.loader)
        return spec


@contextmanager
def _deferred() -> Iterator[None]:
    finder = _Deferring()
    sys.meta_path.insert(0, finder)
    try:
        yield
    finally:
        sys.meta_path.remove(finder)
        for name in NOT_NEEDED:  # whoever else asks for them is told that they are not installed
            if type(sys.modules.get(name)) is _NotInstalled:  # isinstance would load a deferred module
                del sys.modules[name]


with _deferred():
    importlib.import_module("highway_env")
    importlib.import_module("numba.np.arraymath")
