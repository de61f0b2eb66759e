"""The folder of a study: whose it is, who works in it, and what its runs came to."""

from __future__ import annotations

import fcntl
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from athrl_spaces.untrusted import UntrustedFile, parser_errors, read_untrusted
from athrl_spaces.whole_files import write_whole
from athrl_spaces.wording import system_reason

from athrl.errors import CommandError
from athrl.study.file import StudyFile
from athrl.study.identity import identity, joined
from athrl.study.plan import PlannedRun

_MOST_BYTES = 64 * 2**20
"""Of one of its JSON files; that of a study of thousands of runs has a few."""


class StudyFolder:
    """`<out>/`: the runs' folders in `runs`, what they said in `logs`, what they came to in `results`.

    Attributes:
        path: the folder.
        runs: the folder of the runs' folders.
    """

    def __init__(self, path: Path) -> None:
        self.path = path.resolve()
        self.runs = self.path / "runs"
        self._results = self.path / "results"
        self._begun = self.path / "begun.json"

    @contextmanager
    def locked(self, *, shared: bool = False) -> Iterator[None]:
        """Hold the folder for this process, or for the workers of one search together.

        Raises:
            CommandError: another process holds it, or it cannot be made, written or locked.
        """
        with self._writing(self.path):
            self.path.mkdir(parents=True, exist_ok=True)
            others = (each.name for each in self.path.iterdir() if each.name != "study.lock")
            # begun.json.N.part is being written by another worker, or was by one that was killed.
            if not self._begun.exists() and not all(name.startswith(self._begun.name) for name in others):
                raise CommandError(
                    f"--out {self.path}: holds other files and no study, should be a new folder "
                    "or that of this study"
                )
            lock = (self.path / "study.lock").open("ab")
        with lock:
            try:
                fcntl.flock(lock, (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB)
            except BlockingIOError:
                raise CommandError(
                    f"--out {self.path}: another athrl study works in it, wait for its end or stop it"
                ) from None
            except OSError as error:  # for instance of a network file system that is mounted without locks
                cause = system_reason(error)
                raise CommandError(
                    f"--out {self.path}: cannot be locked: {cause}; mount its file system with locks, or "
                    "name another folder"
                ) from None
            yield

    def claim(self, study: StudyFile, runs: Sequence[PlannedRun]) -> None:
        """Note what the study is, or check that the folder was begun with the same.

        Raises:
            CommandError: the folder is another study's; names the first difference.
        """
        wanted = identity(study, runs)
        begun = read_object(self._begun) if self._begun.exists() else wanted
        with parser_errors(lambda reason: CommandError(f"{self._begun}: {reason}")):
            self.write_json(self._begun.name, joined(f"--out {self.path}", begun, wanted))

    def result(self, run: str) -> dict[str, Any] | None:
        """Return what a run came to, finished or failed; None if it has not ended yet."""
        path = self._results / f"{run}.json"
        return read_object(path) if path.exists() else None

    def note(self, run: str, result: Mapping[str, Any]) -> None:
        """Write down what a run came to."""
        self.write_json(f"results/{run}.json", result)

    def log(self, name: str) -> Path:
        """Return the file for what a process says."""
        return self.path / "logs" / f"{name}.log"

    def write_json(self, name: str, document: Mapping[str, Any]) -> None:
        """Write one of its files as `write` does."""
        self.write(name, json.dumps(document, indent=1) + "\n")

    def write(self, name: str, content: str | bytes) -> None:
        """Write one of its files whole or not at all."""
        path = self.path / name
        with self._writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            write_whole(path, content.encode() if isinstance(content, str) else content)

    @contextmanager
    def _writing(self, path: Path) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            cause = system_reason(error)
            raise CommandError(f"cannot write {path}: {cause}, --out should be a folder to write") from None


def read_object(path: Path) -> dict[str, Any]:
    """Return the JSON object in a file of a study; raises CommandError if it cannot be read or is none."""
    with parser_errors(lambda reason: CommandError(f"{path}: {reason}"), UntrustedFile):
        found = json.loads(read_untrusted(path, _MOST_BYTES))
        if not isinstance(found, dict):
            raise CommandError(f"{path}: should be one JSON object")
        return found
