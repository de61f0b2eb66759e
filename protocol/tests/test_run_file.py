"""The run file: every default in one place, and every mistake in one line that names it."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from athrl_protocol import RunFile, RunFileError, default_toml, read_run_file, to_toml
from athrl_protocol.run_file import settings


def _error(path: Path | None, *overrides: str) -> str:
    with pytest.raises(RunFileError) as caught:
        read_run_file(path, overrides)
    text = str(caught.value)
    assert "\n" not in text
    return text


def _write(folder: Path, text: str) -> Path:
    path = folder / "run.toml"
    path.write_text(text)
    return path


def test_default_run_file_holds_every_setting_with_its_default(tmp_path: Path) -> None:
    assert read_run_file(_write(tmp_path, default_toml())) == RunFile() == read_run_file(None)
    tables = tomllib.loads(default_toml())
    assert [f"{section}.{key}" for section, table in tables.items() for key in table] == [
        setting.name for setting in settings()
    ]


def test_default_run_file_documents_every_setting() -> None:
    lines = default_toml().splitlines()
    for setting in settings():
        assert setting.description.endswith("."), setting.name
        assert f"# {setting.description} ({setting.expected})" in lines


def test_file_and_overrides_win_over_defaults(tmp_path: Path) -> None:
    path = _write(tmp_path, "[learner]\nbatch = 32\n[run]\nname = 'first'\n")
    run_file = read_run_file(path, ["learner.batch=64", "learner.threads = 2", "learner.batch=8"])
    assert (run_file.run.name, run_file.learner.batch, run_file.learner.threads) == ("first", 8, 2)


@pytest.mark.parametrize("written", ["second", '"second"', "'second'"])
def test_override_of_text_needs_no_quotes(written: str) -> None:
    assert read_run_file(None, [f"run.name={written}"]).run.name == "second"
    assert read_run_file(None, ["network.listen=tcp/0.0.0.0:1234"]).network.listen == "tcp/0.0.0.0:1234"


def test_override_takes_toml_values() -> None:
    run_file = read_run_file(
        None, ["planner.twin_critics=false", "planner.learning_rate=1e-3", "run.seed=1_000"]
    )
    assert run_file.planner.twin_critics is False
    assert run_file.planner.learning_rate == 1e-3
    assert run_file.run.seed == 1000


def test_run_file_survives_json_and_toml() -> None:
    run_file = read_run_file(None, ["run.name=other", "learner.publish_seconds=0.5", 'run.folder=a "b" \\ ü'])
    assert RunFile.from_json(run_file.to_json()) == run_file
    assert RunFile.model_validate(tomllib.loads(to_toml(run_file))) == run_file


def test_served_run_file_of_another_release_is_refused() -> None:
    with pytest.raises(RunFileError, match=r"learner\.bach"):
        RunFile.from_json('{"learner": {"bach": 3}}')


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("[learner]\nbach = 64", ["learner.bach is no setting", "did you mean learner.batch?"]),
        ("[lerner]\nbatch = 64", ["lerner is no section", "did you mean learner?"]),
        ("[tool.other]", ["tool is no section", "one of run, environment, "]),
        ("batch = 64", ["batch is no section", "did you mean learner.batch?"]),
        ("[replay]\nbatch = 64", ["replay.batch is no setting", "did you mean learner.batch?"]),
        ("learner = 3", ["learner = 3", "should be a table"]),
        ("[learner]\nbatch = 0", ["learner.batch = 0", "should be integer, >= 1, <= 4096"]),
        ("[learner]\nbatch = 2.5", ["learner.batch = 2.5", "should be integer"]),
        ('[learner]\nbatch = "64"', ['learner.batch = "64"', "should be integer"]),
        ("[planner]\nlearning_rate = nan", ["planner.learning_rate = nan", "should be number, > 0"]),
        ("[planner]\ntwin_critics = 1", ["planner.twin_critics = 1", "should be true or false"]),
        ("[environment]\nimage_size = 48", ["environment.image_size = 48", "should be 32 or 64"]),
        ('[environment]\ntown = "town05"', ['environment.town = "town05"', "town02, town03, town04, or an"]),
        ('[run]\nname = "Town 03"', ['run.name = "Town 03"', 'should be text like "town03"']),
        ("[run]\nname = 2024-01-01", ["run.name", "should be text"]),
        ('[network]\nlisten = "7447"', ['network.listen = "7447"', "tcp/127.0.0.1:7447"]),
        ("[replay]\nburn_in = 10", ["replay.burn_in = 10", "less than replay.sequence_length = 10"]),
        ("[replay]\ncapacity = 100", ["replay.capacity = 100", "= 160, one batch"]),
        (
            "[run]\nenvironment_steps = 500",
            ["exploration.random_decisions = 2000", "environment_steps = 500"],
        ),
        ("[learner]\nbatch = 0\nthreads = 0", ["learner.batch = 0", "(and 1 more)"]),
        ("[learner\nbatch = 0", ["is not TOML", "line 1"]),
        ("[learner]\nbatch = 1\nbatch = 2", ["is not TOML"]),
    ],
)
def test_mistake_in_the_file_is_one_line_that_names_it(tmp_path: Path, text: str, parts: list[str]) -> None:
    path = _write(tmp_path, text)
    error = _error(path)
    for part in [str(path), *parts]:
        assert part in error, error


@pytest.mark.parametrize(
    ("override", "parts"),
    [
        ("learner.bach=64", ["learner.bach is no setting", "did you mean learner.batch?"]),
        ("batch=64", ["did you mean learner.batch?"]),
        ("learner.batch", ["should look like section.key=value"]),
        ("=3", ["should look like section.key=value"]),
        ("learner=3", ["learner is no setting"]),
        ("learner.batch=many", ["should be integer, >= 1, <= 4096"]),
        ("learner.batch=1\n[run]\nname='x'", ["should be integer"]),
    ],
)
def test_mistake_in_an_override_is_one_line_that_names_it(override: str, parts: list[str]) -> None:
    error = _error(None, override)
    for part in ["--set ", *parts]:
        assert part in error, error


def test_a_file_that_was_cut_off_is_not_taken_for_a_whole_one(tmp_path: Path) -> None:
    whole = to_toml(RunFile())
    (tmp_path / "run.toml").write_text(whole)
    assert read_run_file(tmp_path / "run.toml", complete=True) == RunFile()
    (tmp_path / "run.toml").write_text(whole[: whole.index("discount")])
    with pytest.raises(RunFileError, match=r"run.toml: planner.discount is missing"):
        read_run_file(tmp_path / "run.toml", complete=True)


def test_override_over_a_broken_section_is_refused(tmp_path: Path) -> None:
    assert "should be a table" in _error(_write(tmp_path, "learner = 3"), "learner.batch=64")


def test_missing_or_unreadable_file_is_named(tmp_path: Path) -> None:
    assert "no such file" in _error(tmp_path / "absent.toml")
    assert "is a directory" in _error(tmp_path)
    binary = tmp_path / "run.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    assert "UTF-8" in _error(binary)
