"""Which run is meant: names that are taken, runs that are resumed."""

from pathlib import Path

import pytest
from athrl.errors import CommandError
from athrl_protocol.run_file import read_run_file, saved_toml, to_toml, with_whole_maps

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


def test_resumed_run_keeps_what_is_not_asked_for_any_more(tmp_path: Path) -> None:
    """As containers that are made anew, without the settings that the first ones had."""
    write_run(tmp_path / "run", "run.environment_steps=40000", "learner.batch=5")
    asked = [f"run.folder={tmp_path}", "run.name=run", "network.listen=tcp/0.0.0.0:7447"]
    assert runs.folder_asked_for(None, asked) == tmp_path / "run"
    settings, _ = runs.resumed_settings(str(tmp_path / "run"), asked)
    assert (settings.run.environment_steps, settings.learner.batch) == (40_000, 5)
    assert settings.network.listen == "tcp/0.0.0.0:7447"


def test_run_file_of_a_resumed_run_changes_what_it_has_and_nothing_else(tmp_path: Path) -> None:
    write_run(tmp_path / "old", "run.environment_steps=40000", "learner.batch=5", "learner.threads=3")
    run_file = tmp_path / "given.toml"
    run_file.write_text("[learner]\nbatch = 6\nthreads = 4\n[run]\nname = 'other'\n")
    settings, folder = runs.resumed_settings(str(tmp_path / "old"), ["learner.threads=2"], run_file)
    assert (settings.learner.batch, settings.learner.threads) == (6, 2)
    assert (settings.run.name, settings.run.environment_steps) == ("old", 40_000)
    run_file.write_text("[planner]\nkind = 'ddpg'\n")
    with pytest.raises(
        CommandError, match=r"given\.toml: planner\.kind: .*/old is a run of the planner athrl"
    ):
        runs.resumed_settings(str(folder), [], run_file)


def test_folder_that_has_no_name_of_a_run_is_named(tmp_path: Path) -> None:
    write_run(tmp_path / "Copy of old")
    with pytest.raises(
        CommandError, match=r"Copy of old has the name of its run: should be a name of at most"
    ):
        runs.resumed_settings(str(tmp_path / "Copy of old"), [])


def test_run_in_the_working_folder_is_resumed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_run(tmp_path / "2024", "run.name='2024'")
    monkeypatch.chdir(tmp_path / "2024")
    assert runs.resumed_settings(".", [])[0].run.name == "2024"


@pytest.mark.parametrize("name", ["2024", "true", "nan", "a_b-c"])
def test_name_is_a_text(name: str) -> None:
    runs.require_name(name, "--name")


@pytest.mark.parametrize("name", ["Town 3", "", "-a", "a" * 64])
def test_rule_for_names_is_told(name: str) -> None:
    with pytest.raises(CommandError, match="--name: should be a name of at most 63 characters: a-z, 0-9"):
        runs.require_name(name, "--name")


def test_whole_run_file_does_not_make_the_run_forget_its_maps(tmp_path: Path) -> None:
    checksums = {str(tmp_path / "m.xodr"): "0" * 64}
    run_file = read_run_file(None, [f"environment.towns={tmp_path}/m.xodr"])
    began = run_file.model_copy(update={"run": run_file.run.model_copy(update={"map_checksums": checksums})})
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "run.toml").write_text(to_toml(began))
    (tmp_path / "given.toml").write_text(to_toml(run_file))
    settings, _ = runs.resumed_settings(str(tmp_path / "mine"), [], tmp_path / "given.toml")
    assert settings.run.map_checksums == checksums


def test_run_that_goes_on_in_another_town_says_so_in_one_line(tmp_path: Path) -> None:
    (tmp_path / "m.xodr").write_text("<OpenDRIVE/>")
    began = with_whole_maps(read_run_file(None, [f"environment.towns={tmp_path}/m.xodr"]))
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "run.toml").write_text(saved_toml(began))
    for towns, told in (("random-7", f"was {tmp_path}/m.xodr, is random-7"), (f"{tmp_path}/m.xodr", "")):
        settings, folder = runs.resumed_settings(str(tmp_path / "mine"), [f"environment.towns={towns}"])
        said = runs.told_other_towns(folder, settings)
        assert said.endswith(told)
        assert bool(told) == (said != "")
