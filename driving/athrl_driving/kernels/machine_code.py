"""Folders of machine code: one for a process alone, and one that can only be read."""

import atexit
import os
import shutil
import tempfile
from contextlib import suppress
from functools import cache
from glob import escape
from pathlib import Path

INDEX = ".nbi"
"""Ending of the file in which numba lists the machine code of a function."""
_DATA = ".nbc"
_TEMPORARY = "athrl-compiled-"


@cache
def temporary_folder(package: str) -> str:
    """Make a folder for a package's kernels that is removed when this process ends, not when a fork does."""
    folder = tempfile.mkdtemp(prefix=_TEMPORARY)
    atexit.register(_remove, folder, os.getpid())
    return folder


def is_temporary(folder: Path) -> bool:
    """Whether `temporary_folder` made it."""
    return folder.name.startswith(_TEMPORARY)


def copy_code(source: Path, folder: Path) -> None:
    """Copy the machine code of `source`, where nothing can be written, into `folder`, where it can.

    numba uses no folder that it cannot write. Copies and not links: numba adds to the index of a function,
    and its data must stay what they were then. A function that is there already is left as it is.
    """
    for index in source.rglob(f"*{INDEX}"):
        target = folder / index.relative_to(source)
        if target.exists():
            continue
        with suppress(OSError):  # what cannot be read or copied is compiled
            target.parent.mkdir(parents=True, exist_ok=True)
            for data in index.parent.glob(f"{escape(index.stem)}.*{_DATA}"):
                _copy(data, target.with_name(data.name))
            _copy(index, target)  # last, so that another process finds whole code or none


def _copy(file: Path, target: Path) -> None:
    """Copy a file such that nobody sees half of it."""
    part = target.with_name(f"{target.name}.{os.getpid()}")
    try:
        shutil.copyfile(file, part)
        part.replace(target)
    finally:
        part.unlink(missing_ok=True)


def _remove(folder: str, process: int) -> None:
    if os.getpid() == process:
        shutil.rmtree(folder, ignore_errors=True)
