"""A run's settings, checked before torch is loaded, which takes seconds, and before anything is written."""

from __future__ import annotations

from pathlib import Path

from athrl_protocol import RunFile, complete_address, read_run_file
from athrl_protocol.run_file import with_whole_maps
from athrl_protocol.security.certificates import find_certificates
from athrl_protocol.transport.address import is_loopback, split_address

from athrl_learner.errors import CannotResume
from athrl_learner.planner_tables import declare_installed_planners, with_planner_settings

NAME = "learner"
"""The learner's role and name: a run has one learner."""


def checked_settings(run_file: RunFile | None, resume: Path | None) -> tuple[RunFile, Path, str]:
    """Return the settings, the folder and the complete address of a run, new or resumed.

    Raises:
        LearnerError: there is no run to resume, it is a serial one, or no planner matches the run file.
        ProtocolError: `run.toml` is not valid, no client would accept the certificate, or a run that had
            certificates is resumed without them.
    """
    run_file, path = _settings_and_folder(run_file, resume)
    if run_file.serial.enabled:
        raise CannotResume(f"{path} is a serial run, which has no separate learner: athrl train --serial")
    shown = find_certificates(run_file.network.certificates, NAME)
    if shown is not None:
        shown.check_may_serve(NAME)
    elif resume is not None:
        _require_encryption_as_before(resume, run_file)
    return run_file, path, complete_address(run_file.network.listen, secure=shown is not None)


def _require_encryption_as_before(folder: Path, run_file: RunFile) -> None:
    """Refuse to resume a run that had certificates without them, where others than this machine reach it."""
    host, _ = split_address(complete_address(run_file.network.listen))
    if not is_loopback(host):
        complete_address(read_run_file(folder / "run.toml", complete=True).network.listen)


def _settings_and_folder(run_file: RunFile | None, resume: Path | None) -> tuple[RunFile, Path]:
    """The settings and the folder of the run."""
    declare_installed_planners()
    if resume is not None:
        if not (resume / "run.toml").is_file():
            raise CannotResume(f"{resume} holds no run to resume: it has no run.toml")
        if run_file is None:
            return with_whole_maps(read_run_file(resume / "run.toml", complete=True)), resume
        return with_whole_maps(with_planner_settings(run_file)), resume
    if run_file is None:
        raise ValueError("run_learner needs a run file, or a run to resume")
    folder = Path(run_file.run.folder) / run_file.run.name
    return with_whole_maps(with_planner_settings(run_file)), folder
