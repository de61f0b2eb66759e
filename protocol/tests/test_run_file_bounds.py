"""A run file or an override beyond a bound of size, depth, numbers or texts is refused in one line."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from athrl_protocol import RunFile, RunFileError, read_run_file
from athrl_protocol.run_file import settings
from athrl_protocol.run_file.document import LARGEST_INTEGER, MOST_BYTES, MOST_DEPTH, MOST_PARTS

NUL = "\\u0000"


def error_of(path: Path | None, *overrides: str) -> str:
    with pytest.raises(RunFileError) as caught:
        read_run_file(path, overrides)
    text = str(caught.value)
    assert text == " ".join(text.split())
    assert len(text) < 500
    return text


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (
            f"[run]\nenvironment_steps = {2**64}",
            f"run.environment_steps = {2**64}: should be an integer from",
        ),
        (f"[run]\nseed = {-(2**63)}", "run.seed = -9223372036854775808: should be an integer from"),
        (f"[run]\nseed = 0x{'f' * 5_000}", "run.seed = an integer of 20,000 bits: should be"),
        (f"[run]\nseed = {'1' * 5_001}", "run.toml: line 2 has a number of more than 1,000 digits"),
        (f"[planner]\nanything = [1, [{2**63}]]", f"planner.anything.1.0 = {2**63}: should be an integer"),
        (f'[run]\nfolder = "a{NUL}b"', f'run.folder = "a{NUL}b": has a control character'),
        (f'[environment]\ntowns = ["a{NUL}.xodr"]', "environment.towns.0 ="),
        (f'[network]\nlisten = "tcp/a{NUL}:1"', "network.listen ="),
        (f'[network]\ncertificates = "{NUL}"', "network.certificates ="),
        (f'[run]\nfolder = "{"a/" * 2_500}"', "has 5,000 characters, should have at most 4,096"),
        (f'[run]\nfolder = "a/{"ü" * 128}/b"', "has a part of 256 bytes, a file's name has at most 255"),
        (f"[run]\nseed = {'[' * 200}{']' * 200}", f"is nested too deeply, should have at most {MOST_DEPTH}"),
        (f"[run]\nseed = {'[' * 100_000}", "is nested too deeply"),
        (f"{'a.' * 200_000}a = 1", f"has a dotted key of more than {MOST_PARTS} parts"),
        ('[["a" . ' + "'b'." * 100_000 + "a]]", f"has a dotted key of more than {MOST_PARTS} parts"),
        (f"[run]\nx = {{{'a.' * 200_000}a = 1}}", f"has a dotted key of more than {MOST_PARTS} parts"),
        (f"{'a.' * 20}a = 1", f"is nested too deeply, should have at most {MOST_DEPTH}"),
        (f"[run]\n{'x' * 500_000} = 1", "is no setting"),
        (f"{'x' * 500_000} = 1", "is no section"),
        ("[run]\nname = 2024-01-31", "run.name = 2024-01-31: should be a name"),
        ("[run]\nname = 2024-01-31T07:00:00Z", "run.name = 2024-01-31T07:00:00+00:00: should be a name"),
        ("[run]\nname = 07:00:00", "run.name = 07:00:00: should be a name"),
        ("#" * MOST_BYTES, f"is too large: should have at most {MOST_BYTES:,} bytes"),
        ("[network]\npatience = 1e400", "network.patience = inf: should be number, > 0, <= 1000000000"),
        ("[network]\npatience = 1e300", "network.patience = 1e+300: should be number, > 0, <= 1000000000"),
        ("[run]\nseed = 2024-01-01T00:00:00Z", "run.seed = "),
    ],
)
def test_what_is_out_of_bounds_is_one_line_that_names_it(tmp_path: Path, text: str, told: str) -> None:
    path = tmp_path / "run.toml"
    path.write_text(text + "\n")
    error = error_of(path)
    assert error.startswith(f"{path}: ")
    assert told in error


@pytest.mark.parametrize(
    ("override", "told"),
    [
        (f"run.environment_steps={2**63}", "--set run.environment_steps=9223372036854775808: should be"),
        (f"run.seed={'1' * 5_001}", "has a number of more than 1,000 digits"),
        (f"run.seed={'[' * 50_000}", "is nested too deeply"),
        (f"planner.kind=1\n{'a.' * 50_000}a=1", "has a dotted key of more than"),
        ("run.folder=a\0b", "--set run.folder=a\\u0000b: has a control character"),
        ("run.folder=\udcff", "is not UTF-8 text"),
        ("environment.towns=\udcff.xodr", "is not UTF-8 text"),
        (f"{'x' * 50_000}.a=1", "is no setting"),
    ],
)
def test_override_out_of_bounds_is_one_line_that_names_it(override: str, told: str) -> None:
    assert told in error_of(None, override)


def test_what_is_no_file_is_refused_without_a_wait(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert "is a pipe, socket or device, should be a file" in error_of(tmp_path / "pipe")
    assert "is a pipe, socket or device, should be a file" in error_of(Path("/dev/zero"))
    assert "is a folder, should be a file" in error_of(tmp_path)


def test_largest_integer_is_one_that_messages_take() -> None:
    run_file = read_run_file(None, [f"run.environment_steps={LARGEST_INTEGER}"])
    assert run_file.run.environment_steps == LARGEST_INTEGER == 2**63 - 1


def test_every_number_has_an_upper_bound_that_is_documented() -> None:
    numbers = [
        setting
        for setting in settings()
        if isinstance(setting.default, int | float) and not isinstance(setting.default, bool)
    ]
    assert len(numbers) > 30
    for setting in numbers:
        assert "<" in setting.expected, setting.name


def test_served_run_file_out_of_bounds_is_refused() -> None:
    for text in (
        '{"network": {"patience": 1e400}}',
        f'{{"run": {{"environment_steps": {2**64}}}}}',
        f'{{"planner": {{"kind": "other", "x": {2**64}}}}}',
        '{"run": {"folder": "a\\u0000b"}}',
        f'{{"planner": {{"kind": "other", "x": {"[" * 100 + "]" * 100}}}}}',
        "[" * 100_000,
        " " * (MOST_BYTES + 1),
    ):
        with pytest.raises(RunFileError, match=r"^served run file: "):
            RunFile.from_json(text)
