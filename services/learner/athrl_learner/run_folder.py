"""The folder of a run: its layout and its lock."""

from __future__ import annotations

import contextlib
import fcntl
import os
from pathlib import Path
from types import TracebackType
from typing import IO

from athrl_spaces.wording import system_reason

from athrl_learner.errors import LearnerError, RunFolderInUse, RunFolderTaken
from athrl_learner.files import Files, write_whole


def _made_folders(path: Path) -> list[Path]:
    """Make a folder and those above it; return those that were missing, the innermost first."""
    missing = [folder for folder in (path, *path.parents) if not folder.exists()]
    path.mkdir(parents=True, exist_ok=True)
    return missing


def _holds_something(folder: Path) -> bool:
    return folder.is_dir() and any(folder.iterdir())


class RunFolder:
    """`<folder>/<run>/`; as a context manager it is locked for this process.

    It is a lock of the kernel on an open file, so it ends with the process in any case. A folder that still
    holds no run is left as it was found, so that a run which is refused leaves nothing behind.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.run_toml = path / "run.toml"
        self.checkpoints = path / "checkpoints"
        self.experience = path / "experience"
        self.latest_policy = path / "policies" / "latest.onnx"
        self.latest_policy_facts = path / "policies" / "latest.json"
        self._lock_path = path / "learner.lock"
        self._lock: IO[bytes] | None = None
        self._made: list[Path] = []  # folders that were missing, the innermost first

    def __enter__(self) -> RunFolder:
        """Make the folder if it is missing and lock it.

        Raises:
            RunFolderInUse: another learner holds it.
            LearnerError: the folder cannot be written.
        """
        while True:
            lock = self._locked()
            if self._is_current(lock):
                self._lock = lock
                return self
            lock.close()

    def _locked(self) -> IO[bytes]:
        """Make the folder, and lock its file."""
        try:
            self._made = _made_folders(self.path)
            lock = self._lock_path.open("ab")
        except OSError as error:
            raise LearnerError(f"cannot write the run folder {self.path}: {system_reason(error)}") from None
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
            raise RunFolderInUse(
                f"another learner is writing {self.path}: stop it first, or choose another run.name"
            ) from None
        except OSError as error:  # for instance of a network file system that is mounted without locks
            lock.close()
            raise LearnerError(
                f"cannot lock {self._lock_path}: {system_reason(error)}; mount its file system with locks, "
                "or choose another run.folder"
            ) from None
        return lock

    def _is_current(self, lock: IO[bytes]) -> bool:
        """Whether another process has not removed the file between our opening and locking it."""
        try:
            return os.path.samestat(os.fstat(lock.fileno()), self._lock_path.stat())
        except FileNotFoundError:
            return False

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._lock is None:
            return
        if not self._holds_run():
            with contextlib.suppress(OSError):  # of a folder that holds something else, or is on a full disk
                self._lock_path.unlink()
                for folder in self._made:
                    folder.rmdir()
        self._lock.close()
        self._lock = None

    def _holds_run(self) -> bool:
        return self.run_toml.exists() or any(map(_holds_something, (self.checkpoints, self.experience)))

    def require_unused(self) -> None:
        """Refuse a folder that holds a run; log files that were put there before do not count.

        Raises:
            RunFolderTaken: it holds a run file or checkpoints.
        """
        if self._holds_run():
            raise RunFolderTaken(
                f"{self.path} already holds a run: resume it with --resume {self.path}, "
                "or choose another run.name"
            )

    def lay_out(self, run_toml: str) -> None:
        """Make the subfolders and write `run.toml`, the run file as it is used."""
        try:
            self.checkpoints.mkdir(exist_ok=True)
            self.experience.mkdir(exist_ok=True)
            self.latest_policy.parent.mkdir(exist_ok=True)
            if not self._holds(run_toml.encode()):  # a run that is resumed unchanged needs no disk space
                write_whole(Files(), self.run_toml, run_toml.encode())
        except OSError as error:
            raise LearnerError(f"cannot write the run folder {self.path}: {system_reason(error)}") from None

    def _holds(self, run_toml: bytes) -> bool:
        return self.run_toml.is_file() and self.run_toml.read_bytes() == run_toml
