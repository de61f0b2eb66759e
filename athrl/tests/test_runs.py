"""Which run is meant: names that are taken, runs that are resumed."""

from pathlib import Path

import pytest
from athrl.errors import CommandError
from athrl_protocol.run_file import read_run_file, to_toml

from athrl import runs


def write_run(folder: Path, *settings: str) -> None:
    folder.mkdir(parents=True)
    (folder / "run.toml").write_text(to_toml(read_run_file(None, settings)))


def test_taken_name_gets_a_number(tmp_path: Path) -> None:
    settings = runs.new_settings(None, [f"run.folder={tmp_path}", "run.name=a"])
    assert runs.unused_name(settings) == "a"
    write_run(tmp_path / "a")
    assert runs.unused_name(settings) == "a-2"
    write_run(tmp_path / "a-2")
    assert runs.unused_name(settings) == "a-3"


def test_resumed_run_has_its_own_settings_but_for_the_overrides(tmp_path: Path) -> None:
    write_run(tmp_path / "old", "run.name=old", "run.seed=7", "learner.batch=5")
    settings, folder = runs.resumed_settings("old", [f"run.folder={tmp_path}", "learner.batch=6"])
    assert folder == tmp_path / "old"
    assert (settings.run.seed, settings.learner.batch) == (7, 6)


def test_overrides_of_a_resumed_run_are_checked_beside_its_own_settings(tmp_path: Path) -> None:
    write_run(tmp_path / "small", "exploration.random_decisions=50", "run.environment_steps=100")
    settings, _ = runs.resumed_settings(str(tmp_path / "small"), ["run.environment_steps=200"])
    assert settings.run.environment_steps == 200


def test_run_goes_on_where_its_folder_is_found(tmp_path: Path) -> None:
    write_run(tmp_path / "moved", "run.name=old", "run.folder=elsewhere")
    settings, _ = runs.resumed_settings(str(tmp_path / "moved"), [])
    assert runs.run_folder(settings) == tmp_path / "moved"


def test_run_that_is_not_there_is_named_with_those_that_are(tmp_path: Path) -> None:
    write_run(tmp_path / "here")
    with pytest.raises(CommandError, match=r"'gone'.*here"):
        runs.resumed_settings("gone", [f"run.folder={tmp_path}"])
