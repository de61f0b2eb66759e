"""A run's own file: whole or refused, older ones included, and overridden by what is given explicitly."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from athrl_protocol import RunFile, RunFileError, read_run_file, to_toml
from athrl_protocol.run_file import saved_toml, settings


def _without(text: str, *keys: str) -> str:
    return "\n".join(line for line in text.splitlines() if line.partition(" = ")[0] not in keys) + "\n"


@pytest.fixture
def run_toml(tmp_path: Path) -> Path:
    return tmp_path / "run.toml"


@pytest.mark.parametrize("to_text", [saved_toml, to_toml])
def test_setting_that_the_saving_release_did_not_have_has_its_default(
    run_toml: Path, to_text: Callable[[RunFile], str]
) -> None:
    run_toml.write_text(_without(to_text(RunFile()), "final_noise_scale", "map_checksums"))
    assert read_run_file(run_toml, complete=True) == RunFile()


def test_saved_file_without_its_last_section_is_whole_if_it_has_its_end(run_toml: Path) -> None:
    lines = saved_toml(RunFile()).splitlines()
    run_toml.write_text("\n".join([*lines[: lines.index("[network]")], lines[-1]]))
    assert read_run_file(run_toml, complete=True) == RunFile()


def test_saved_file_is_refused_wherever_it_is_cut_off(run_toml: Path) -> None:
    whole = saved_toml(RunFile())
    run_toml.write_text(whole)
    assert read_run_file(run_toml, complete=True) == RunFile()
    for setting in list(settings())[1::9]:
        run_toml.write_text(whole[: whole.index(f"\n{setting.key} = ")])
        with pytest.raises(RunFileError, match=r"run\.toml: [a-z_.]+ is missing, the file is damaged"):
            read_run_file(run_toml, complete=True)


def test_given_file_overrides_the_saved_one_and_the_command_line_overrides_both(
    run_toml: Path, tmp_path: Path
) -> None:
    run_toml.write_text(
        saved_toml(read_run_file(None, ["learner.batch=64", "run.seed=5", "learner.threads=7"]))
    )
    given = tmp_path / "given.toml"
    given.write_text("[learner]\nbatch = 128\nthreads = 2\n")
    run_file = read_run_file(run_toml, ["learner.threads=3"], complete=True, changes=given)
    assert (run_file.learner.batch, run_file.learner.threads, run_file.run.seed) == (128, 3, 5)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("learner = 3", r"learner = 3: should be a table"),
        ("[learner]\nbatch = 0", r"given\.toml: learner\.batch = 0: should be integer"),
        ("[learner]\nbach = 1", r"given\.toml: .*did you mean learner\.batch"),
    ],
)
def test_mistake_in_the_given_file_names_that_file(
    run_toml: Path, tmp_path: Path, text: str, told: str
) -> None:
    run_toml.write_text(saved_toml(RunFile()))
    (tmp_path / "given.toml").write_text(text)
    with pytest.raises(RunFileError, match=told) as refused:
        read_run_file(run_toml, complete=True, changes=tmp_path / "given.toml")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("name", ["2024", "true", "nan", "1e5", "0x1f", "2024-01-01", "inf", "00"])
def test_name_is_a_text_whatever_toml_would_make_of_it(name: str) -> None:
    assert read_run_file(None, [f"run.name={name}"]).run.name == name
    assert read_run_file(None, [f'run.name="{name}"']).run.name == name
    assert read_run_file(None, [f"run.folder={name}"]).run.folder == name


@pytest.mark.parametrize("name", ["Town", "a b", "_a", "", "a" * 64])
def test_rule_for_names_is_told_with_one_that_breaks_it(name: str) -> None:
    with pytest.raises(RunFileError, match="a name of at most 63 characters: a-z, 0-9, _ and -"):
        read_run_file(None, [f"run.name={name}"])


def test_number_as_a_name_in_a_file_is_told_to_need_quotes(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text("[run]\nname = 2024\n")
    with pytest.raises(RunFileError, match=r"run\.name = 2024: should be a name .*, in quotes"):
        read_run_file(tmp_path / "run.toml")
