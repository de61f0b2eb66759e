"""The run file: every default in one place, and every mistake in one line that names it."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from athrl_protocol import RunFile, RunFileError, default_toml, read_run_file, to_toml
from athrl_protocol.messages.chunk import MAXIMUM_IMAGES_BYTES
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


def test_mark_of_the_encoding_at_the_beginning_is_no_error(tmp_path: Path) -> None:
    path = tmp_path / "run.toml"
    path.write_text("[run]\nname = 'marked'\n", encoding="utf-8-sig")
    assert read_run_file(path).run.name == "marked"


def test_override_takes_toml_values() -> None:
    run_file = read_run_file(
        None, ["replay.prioritised=true", "exploration.final_noise_scale=1e-3", "run.seed=1_000"]
    )
    assert run_file.replay.prioritised is True
    assert run_file.exploration.final_noise_scale == 1e-3
    assert run_file.run.seed == 1000


def test_run_file_survives_json_and_toml() -> None:
    run_file = read_run_file(None, ["run.name=other", "learner.publish_seconds=0.5", 'run.folder=a "b" \\ ü'])
    assert RunFile.from_json(run_file.to_json()) == run_file
    assert RunFile.model_validate(tomllib.loads(to_toml(run_file))) == run_file


@pytest.mark.parametrize(
    ("decisions", "asked_for", "warm_up"), [(600_000, 10_000, 10_000), (3000, 10_000, 1000), (2, 0, 0)]
)
def test_warm_up_leaves_two_thirds_of_a_short_run_for_training(
    decisions: int, asked_for: int, warm_up: int
) -> None:
    settings = [f"run.environment_steps={decisions}", f"exploration.random_decisions={asked_for}"]
    assert read_run_file(None, settings).warm_up == warm_up


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
        ("[learner]\nbatch = 0", ["learner.batch = 0", "should be integer, >= 1, <= 65536"]),
        ("[learner]\nbatch = 2.5", ["learner.batch = 2.5", "should be integer"]),
        ('[learner]\nbatch = "64"', ['learner.batch = "64"', "should be integer"]),
        ("[network]\npatience = nan", ["network.patience = nan", "should be number, > 0"]),
        ("[replay]\nprioritised = 1", ["replay.prioritised = 1", "should be true or false"]),
        ('[learner]\nprecision = "half"', ['learner.precision = "half"', '"auto", "float32" or "bfloat16"']),
        ("[environment]\nimage_size = 4", ["environment.image_size = 4", "should be integer, >= 8, <= 512"]),
        ("[environment]\nvehicles = -1", ["environment.vehicles = -1", "should be integer, >= 0, <= 10000"]),
        (
            '[run]\nname = "Town 03"',
            ['run.name = "Town 03"', "should be a name of at most 63 characters: a-z, 0-9, _ and -"],
        ),
        ("[run]\nname = 2024-01-01", ["run.name", "should be a name"]),
        (
            '[network]\nlisten = "7447"',
            ['network.listen = "7447"', "should be tcp/HOST:PORT or tls/HOST:PORT"],
        ),
        (
            '[network]\nlisten = "tcp/127.0.0.1:99999"',
            ['network.listen = "tcp/127.0.0.1:99999"', "its port should be 1 to 65535"],
        ),
        ("[replay]\nburn_in = 16", ["replay.burn_in = 16", "less than replay.sequence_length = 16"]),
        ("[replay]\ncapacity = 500", ["replay.capacity = 500", "at least 512", "learner.batch = 512"]),
        (
            "[learner]\nbatch = 8\n[replay]\nsequence_length = 120\ncapacity = 100",
            ["replay.capacity = 100", "at least 120", "replay.sequence_length = 120"],
        ),
        (
            "[environment]\nepisode_ticks = 57",
            [
                "replay.sequence_length = 16",
                "at most 15",
                "environment.episode_ticks / environment.ticks_per",
            ],
        ),
        (
            "[environment]\nepisode_ticks = 3",
            ["environment.episode_ticks = 3", "at least environment.ticks_per_decision = 4"],
        ),
        (
            "[environment]\nimage_size = 512\n[replay]\nsequence_length = 64",
            ["environment.image_size = 512", "replay.sequence_length = 64", "65 such images", "at most 64"],
        ),
        ("[learner]\nbatch = 0\nthreads = -1", ["learner.batch = 0", "(and 1 more)"]),
        ('[learner]\n"a\\nb" = 1', ["learner.a b is no setting"]),
        ('[learner]\n"a\\u0000" = 1', ["learner.a\\u0000 is no setting"]),
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
        ("learner=3", ["learner is no setting but a section of them, such as learner.batch"]),
        ("learner.batch=many", ["should be integer, >= 1, <= 65536"]),
        ("learner.batch=1\n[run]\nname='x'", ["should be printable text in one line"]),
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
    (tmp_path / "run.toml").write_text(whole[: whole.index("final_noise_scale")])
    with pytest.raises(RunFileError, match=r"run.toml: exploration.final_noise_scale is missing"):
        read_run_file(tmp_path / "run.toml", complete=True)


def test_who_only_drives_may_have_episodes_shorter_than_a_sequence() -> None:
    run_file = read_run_file(None, ["environment.episode_ticks=8"], training=False)
    assert run_file.episode_decisions == 2
    with pytest.raises(RunFileError, match=r"should be at least environment\.ticks_per_decision"):
        read_run_file(None, ["environment.episode_ticks=3"], training=False)


def test_sequence_may_be_as_long_as_an_episode_and_no_longer() -> None:
    settings = ["environment.episode_ticks=61", "environment.ticks_per_decision=4"]
    assert read_run_file(None, settings).episode_decisions == 16 == RunFile().replay.sequence_length
    assert "should be at most 15" in _error(None, *settings, "environment.episode_ticks=60")


def test_longest_chunk_is_of_whole_sequences_that_fit_into_a_message() -> None:
    for size in (8, 32, 64, 128, 256, 512):
        run_file = read_run_file(None, [f"environment.image_size={size}", "actor.sequences_per_chunk=128"])
        longest, length = run_file.longest_chunk, run_file.replay.sequence_length
        assert longest % length == 0
        assert length <= longest <= 1024
        assert (longest + 1) * size**2 * 4 <= MAXIMUM_IMAGES_BYTES
    assert RunFile().longest_chunk == 128


def test_override_over_a_broken_section_is_refused(tmp_path: Path) -> None:
    assert "should be a table" in _error(_write(tmp_path, "learner = 3"), "learner.batch=64")


def test_missing_or_unreadable_file_is_named(tmp_path: Path) -> None:
    assert "no such file" in _error(tmp_path / "absent.toml")
    assert "is a folder" in _error(tmp_path)
    binary = tmp_path / "run.toml"
    binary.write_bytes(b"\xff\xfe\x00")
    assert "UTF-8" in _error(binary)
