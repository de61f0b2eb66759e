"""How a run's settings were changed when it was resumed: told in the log and kept in `changes.jsonl`."""

from __future__ import annotations

import json
import logging
import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from athrl_protocol import RunFile, read_run_file
from athrl_protocol.faults.bounded_log import BoundedLog, shortened
from athrl_protocol.run_file import saved_toml
from athrl_protocol.run_file.document import read_document
from athrl_protocol.run_file.toml_values import to_toml_value
from athrl_spaces.untrusted import UntrustedFile, parser_errors, read_untrusted
from athrl_spaces.wording import system_reason

from athrl_learner.errors import LearnerError
from athrl_learner.files import Files, write_whole
from athrl_learner.run_folder import RunFolder

log = logging.getLogger(__name__)

MOST_BYTES = 16 * 2**20
"""Of `changes.jsonl`: some hundred thousand changes."""

#: Where the run was found, and what follows from its maps: nobody changes these by themselves.
FOLLOWING = ("run.folder", "run.map_checksums")


@dataclass(frozen=True)
class Change:
    """One setting that was changed.

    Attributes:
        setting: its dotted name.
        was: the old value.
        now: the new value.
        environment_steps: how far the run was.
    """

    setting: str
    was: Any
    now: Any
    environment_steps: int

    def __str__(self) -> str:
        was, now = to_toml_value(self.was), to_toml_value(self.now)
        return f"{self.setting} was {was} and is {now}, from step {self.environment_steps}"


def replace_settings(folder: RunFolder, run_file: RunFile, environment_steps: int) -> list[str]:
    """Write the settings of a run into its locked folder; return all changes of the run, oldest first.

    Each setting that differs from those of the folder is one line of the log. Those that the release which
    wrote the folder did not have yet are one line together.

    Raises:
        LearnerError: the folder cannot be written, or its changes cannot be read.
        RunFileError: the folder's run file is not valid.
    """
    path = folder.path / "changes.jsonl"
    history = list(_read(path))
    if folder.run_toml.exists():
        _tell_additions(folder.run_toml, run_file)
        changes = list(_changes(read_run_file(folder.run_toml, complete=True), run_file, environment_steps))
        for change in changes:
            log.info("setting %s", change)
        if changes:
            history += changes
            _write(path, history)
    folder.lay_out(saved_toml(run_file))
    return [str(change) for change in history]


def _changes(before: RunFile, now: RunFile, environment_steps: int) -> Iterator[Change]:
    earlier, values = _by_name(before), _by_name(now)
    for name in dict.fromkeys([*values, *earlier]):
        was, value = earlier.get(name), values.get(name)
        if was != value and name not in FOLLOWING:
            yield Change(name, was, value, environment_steps)


def _by_name(run_file: RunFile) -> dict[str, Any]:
    return {
        f"{section}.{key}": value
        for section, table in run_file.model_dump().items()
        for key, value in table.items()
    }


def _tell_additions(run_toml: Path, now: RunFile) -> None:
    """Say which settings the folder's run file does not have."""
    saved = read_document(run_toml)
    added = [
        f"{name} = {to_toml_value(value)}"
        for name, value in _by_name(now).items()
        if name.partition(".")[2] not in saved.get(name.partition(".")[0], {})
    ]
    if added:
        log.info("%s was saved by an earlier release; settings that are new: %s", run_toml, ", ".join(added))


def _read(path: Path) -> Iterator[Change]:
    """The changes in a file, without lines that were damaged."""
    if not os.path.lexists(path):
        return
    with parser_errors(lambda reason: LearnerError(f"{path} {reason}; move it away to resume without it")):
        lines = read_untrusted(path, MOST_BYTES).decode(errors="replace").splitlines()
    warn = BoundedLog(log.warning)
    for line in lines:
        try:
            yield _change(line)
        except UntrustedFile:
            warn(f"{path} has a line that is no change: {shortened(line)}")


def _change(line: str) -> Change:
    """Read a line; raises UntrustedFile unless it is a change that can be told in one line."""
    with parser_errors(UntrustedFile):
        change = Change(**json.loads(line))
        if not isinstance(change.setting, str) or not isinstance(change.environment_steps, int):
            raise TypeError("a setting is a text, steps are an integer")
        if not str(change).isprintable():
            raise ValueError("it has a control character")
        return change


def _write(path: Path, changes: list[Change]) -> None:
    text = "".join(f"{json.dumps(asdict(change))}\n" for change in changes)
    try:
        write_whole(Files(), path, text.encode())
    except OSError as error:
        raise LearnerError(f"cannot write {path}: {system_reason(error)}") from None
