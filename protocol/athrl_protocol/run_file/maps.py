"""The maps of a run: each with its whole path and a checksum of its content.

A path that is relative names another file elsewhere, and a file may be replaced. A run that went on in
another map without a word would be another run.
"""

from __future__ import annotations

import hashlib
import os
from pathlib import Path, PurePath

from athrl_spaces import is_town
from athrl_spaces.wording import system_reason

from athrl_protocol.errors import RunFileError
from athrl_protocol.run_file.root import RunFile
from athrl_protocol.run_file.towns import read_towns

_DIGITS_SHOWN = 12


def with_whole_maps(run_file: RunFile) -> RunFile:
    """Return the run file with absolute paths of its maps and, in `run.map_checksums`, their SHA-256.

    A map that has a checksum already need not be here: the learner does not drive.

    Raises:
        RunFileError: a map without a checksum is not here, or one that is here differs from its checksum.
    """
    towns: dict[str, float] = {}
    for name, share in run_file.environment.towns.items():
        path = _whole_path(name)
        if path in towns:
            raise RunFileError(f"environment.towns: {path} appears twice, should have each town once")
        towns[path] = share
    try:
        towns = read_towns(towns)
    except ValueError as error:  # an absolute path may be too long
        raise RunFileError(f"environment.towns: {error}") from None
    known = run_file.run.map_checksums
    checksums = {path: _checked(path, known.get(path), missing=path in known) for path in _maps(towns)}
    return run_file.model_copy(
        update={
            "environment": run_file.environment.model_copy(update={"towns": towns}),
            "run": run_file.run.model_copy(update={"map_checksums": checksums}),
        }
    )


def require_same_maps(run_file: RunFile) -> None:
    """Refuse to drive in other maps than the run's.

    Raises:
        RunFileError: a map of the run is not on this machine, or is another one.
    """
    for path in map(_whole_path, _maps(run_file.environment.towns)):
        _checked(path, run_file.run.map_checksums.get(path))


def are_other_towns(before: RunFile, now: RunFile) -> bool:
    """Return whether a resumed run is to drive in other towns than before; a moved map is the same town.

    Args:
        before: settings of the run, with whole paths and checksums of its maps.
        now: those with which it is resumed.

    Raises:
        RunFileError: a map has the file name of one that it replaces, and another content, or is not here.
    """
    was, wanted = before.environment.towns, set(map(_whole_path, now.environment.towns))
    gone = {path: before.run.map_checksums.get(path) for path in was if path not in wanted}
    new = {path: _moved_from(path, gone) for path in wanted if path not in was}
    return None in new.values() or set(gone) != set(new.values())


def _moved_from(path: str, gone: dict[str, str | None]) -> str | None:
    """Return the path of which a new map has the content, and maybe the name; None for another town."""
    known = {old: checksum for old, checksum in gone.items() if checksum is not None}
    if not known or is_town(path):
        return None
    found = _checksum(Path(path))
    for old, checksum in known.items():
        if checksum == found:
            return old
    for old, checksum in known.items():
        if PurePath(old).name == PurePath(path).name:
            raise RunFileError(
                f"environment.towns: {path} (SHA-256 {found[:_DIGITS_SHOWN]}...) is another map than {old} "
                f"of the run ({checksum[:_DIGITS_SHOWN]}...): give the same map, or one of another file name"
            )
    return None


def _maps(towns: dict[str, float]) -> list[str]:
    return [town for town in towns if not is_town(town)]


def _whole_path(town: str) -> str:
    return town if is_town(town) else os.path.abspath(os.path.expanduser(town))


def _checked(path: str, known: str | None, *, missing: bool = False) -> str:
    """Return the checksum of a map: what it should be, if there is one. The file may be `missing`."""
    if missing and known is not None and not os.path.lexists(path):
        return known
    found = _checksum(Path(path))
    if known not in (None, found):
        raise RunFileError(
            f"environment.towns: {path} is another map than the run's (SHA-256 {found[:_DIGITS_SHOWN]}..., "
            f"should be {str(known)[:_DIGITS_SHOWN]}...): restore the run's map, or start another run"
        )
    return found


def _checksum(path: Path) -> str:
    try:
        if path.exists() and not path.is_file():
            raise RunFileError(f"environment.towns: {path}: is no file, should be an OpenDRIVE map")
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except FileNotFoundError:
        raise RunFileError(f"environment.towns: {path}: there is no such file on this machine") from None
    except OSError as error:
        raise RunFileError(f"environment.towns: {path}: cannot be read: {system_reason(error)}") from None
