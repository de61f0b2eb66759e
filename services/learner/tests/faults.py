"""Disks that fail, fill up, lose power, or see the process die at any operation."""

from __future__ import annotations

import errno
from pathlib import Path

from athrl_learner.files import Files, WritableFile


class Died(BaseException):
    """The process was killed: nothing that would tidy up may catch this, and nothing is done after it."""


class FaultyFile(WritableFile):
    """A file whose operations go through its disk's `turn`."""

    def __init__(self, path: Path, disk: FaultyFiles) -> None:
        super().__init__(path)
        self._disk = disk

    def write(self, content: bytes | memoryview) -> None:
        """Write all, or as much as the fault lets through."""
        try:
            self._disk.turn(len(content))
        except (OSError, Died) as fault:
            super().write(content[: getattr(fault, "written", len(content) // 2)])
            raise
        super().write(content)

    def truncate(self, size: int) -> None:
        """Shorten the file."""
        self._disk.turn()
        super().truncate(size)

    def sync(self) -> None:
        """Nothing but a turn: the tests' disks lose no power."""
        self._disk.turn()


class FaultyFiles(Files):
    """A disk on which one operation is the last.

    Args:
        dies_at: the operation, counted from 0, at which the process dies; half of what it was to write is
            written.
        fails_at: the operation that fails with an input/output error.
        free_space: bytes that can be written in all, before the disk is full.
    """

    def __init__(
        self, dies_at: int | None = None, fails_at: int | None = None, free_space: int | None = None
    ) -> None:
        self.operations = 0
        self.dies_at = dies_at
        self.fails_at = fails_at
        self.free_space = free_space

    def turn(self, size: int = 0) -> None:
        """Called before each operation, with the bytes that it writes."""
        operation, self.operations = self.operations, self.operations + 1
        if self.dies_at is not None and operation >= self.dies_at:
            if operation > self.dies_at:
                dead = Died()
                dead.written = 0  # type: ignore[attr-defined]
                raise dead
            raise Died
        if operation == self.fails_at:
            raise OSError(errno.EIO, "Input/output error")
        if self.free_space is not None:
            if size > self.free_space:
                full = OSError(errno.ENOSPC, "No space left on device")
                full.written = self.free_space  # type: ignore[attr-defined]
                raise full
            self.free_space -= size

    def create(self, path: Path) -> WritableFile:
        """Create a file that belongs to this disk."""
        self.turn()
        return FaultyFile(path, self)

    def make_folder(self, path: Path) -> None:
        """As the real one, after a turn."""
        self.turn()
        super().make_folder(path)

    def rename(self, old: Path, new: Path) -> None:
        """As the real one, after a turn."""
        self.turn()
        super().rename(old, new)

    def remove(self, path: Path) -> None:
        """As the real one, after a turn."""
        self.turn()
        super().remove(path)

    def remove_folder(self, path: Path) -> None:
        """Removes one file after the other, so that one may be the last."""
        self.turn()
        for inside in sorted(path.rglob("*"), reverse=True):
            self.turn()
            inside.unlink()
        if path.is_dir():
            self.turn()
            path.rmdir()

    def sync_folder(self, path: Path) -> None:
        """A turn."""
        self.turn()

    def free_bytes(self, path: Path) -> int:
        """The free space that is left."""
        return self.free_space if self.free_space is not None else 2**40


class PowerCutFile(WritableFile):
    """A file whose content is lost unless it was synced."""

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._pending = b""

    def write(self, content: bytes | memoryview) -> None:
        """Keep the content where a power cut takes it."""
        self._pending += bytes(content)

    def sync(self) -> None:
        """Bring it to the disk."""
        super().write(self._pending)
        self._pending = b""


class PowerCutFiles(Files):
    """A disk of which only what was synced is left when the test looks at it."""

    def create(self, path: Path) -> WritableFile:
        """Create a file that forgets."""
        return PowerCutFile(path)
