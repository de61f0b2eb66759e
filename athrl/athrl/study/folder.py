"""The folder of a study: whose it is, who works in it, and what its runs came to."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from athrl_spaces.untrusted import UntrustedFile, parser_errors, read_untrusted
from athrl_spaces.wording import system_reason

from athrl.errors import CommandError
from athrl.study.file import StudyFile
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

        Rows, seeds and places may be added to a study and taken from it. What a run was begun with, the
        scored episodes and the search must not change, else the table would compare different things.

        Raises:
            CommandError: the folder is another study's; names the first difference.
        """
        fixed: dict[str, Any] = {
            "study": study.study.name,
            "scoring": study.scoring.model_dump(),
            "search": study.search.model_dump(exclude={"trials"}) if study.search is not None else None,
        }
        recipes = {run.name: run.recipe for run in runs}
        places = {place.name: place.model_dump() for place in study.elsewhere}
        begun: dict[str, Any] = self._read(self._begun) if self._begun.exists() else {**fixed, "runs": {}}
        begun_places = begun.get("elsewhere", {})
        for key, wanted in fixed.items():
            self._require_same(key, begun.get(key), json.loads(json.dumps(wanted)))
        for name, recipe in recipes.items():
            self._require_same(f"run {name}", begun["runs"].get(name, recipe), recipe)
        for name, place in places.items():
            self._require_same(f"elsewhere {name}", begun_places.get(name, place), place)
        now = {**fixed, "runs": {**begun["runs"], **recipes}, "elsewhere": {**begun_places, **places}}
        self.write_json(self._begun.name, now)

    def _require_same(self, what: str, begun: Any, wanted: Any) -> None:
        if begun != wanted:
            what, begun, wanted = _first_difference(what, begun, wanted)
            raise CommandError(
                f"--out {self.path}: holds another study: {what} was begun as {begun}, should be {wanted}; "
                "name another folder"
            )

    def result(self, run: str) -> dict[str, Any] | None:
        """Return what a run came to, finished or failed; None if it has not ended yet."""
        path = self._results / f"{run}.json"
        return self._read(path) if path.exists() else None

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
        part = path.with_name(f"{path.name}.{os.getpid()}.part")
        with self._writing(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            try:
                part.write_bytes(content.encode() if isinstance(content, str) else content)
                os.replace(part, path)
            except OSError:
                with contextlib.suppress(OSError):
                    part.unlink()
                raise

    @staticmethod
    def _read(path: Path) -> dict[str, Any]:
        with parser_errors(lambda reason: CommandError(f"{path}: {reason}"), UntrustedFile):
            found = json.loads(read_untrusted(path, _MOST_BYTES))
            if not isinstance(found, dict):
                raise CommandError(f"{path}: should be one JSON object")
            return found

    @contextmanager
    def _writing(self, path: Path) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            cause = system_reason(error)
            raise CommandError(f"cannot write {path}: {cause}, --out should be a folder to write") from None


def _first_difference(what: str, begun: Any, wanted: Any) -> tuple[str, Any, Any]:
    """Return where two documents differ, and what is there in each; of lists what the other lacks."""
    if isinstance(begun, dict) and isinstance(wanted, dict):
        for key in [*begun, *wanted]:
            if begun.get(key) != wanted.get(key):
                return _first_difference(f"{what}, {key}", begun.get(key), wanted.get(key))
    if isinstance(begun, list) and isinstance(wanted, list):
        only = [each for each in begun if each not in wanted], [each for each in wanted if each not in begun]
        if any(only):
            return what, *only
    return what, begun, wanted
