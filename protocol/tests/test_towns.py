"""The towns of a run: written in three ways, read in one, and every mistake in one line."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from athrl_protocol import RunFile, RunFileError, default_toml, read_run_file, to_toml
from athrl_protocol.announcements.evaluation import EvaluationResult, _decode, _encode


@pytest.mark.parametrize(
    ("written", "shares"),
    [
        ('"town04"', {"town04": 1.0}),
        ('["town04", "maps/mine.xodr"]', {"town04": 1.0, "maps/mine.xodr": 1.0}),
        ("{town03 = 2, town04 = 0.5}", {"town03": 2.0, "town04": 0.5}),
        ('{"maps/mine.XODR" = 3}', {"maps/mine.XODR": 3.0}),
        ('"/a path/ü \\"x\\" = 1.xodr"', {'/a path/ü "x" = 1.xodr': 1.0}),
    ],
)
def test_towns_become_a_table_of_shares(tmp_path: Path, written: str, shares: dict[str, float]) -> None:
    path = tmp_path / "run.toml"
    path.write_text(f"[environment]\ntowns = {written}\n")
    run_file = read_run_file(path)
    assert run_file.environment.towns == shares
    assert all(type(share) is float for share in run_file.environment.towns.values())
    assert list(run_file.environment.towns) == list(shares)
    assert read_run_file(None, [f"environment.towns={written}"]) == run_file
    assert RunFile.model_validate(tomllib.loads(to_toml(run_file))) == run_file
    assert RunFile.from_json(run_file.to_json()) == run_file


def test_town_on_the_command_line_needs_no_quotes() -> None:
    assert read_run_file(None, ["environment.towns=town02"]).environment.towns == {"town02": 1.0}
    assert read_run_file(None, ["environment.towns=a/b.xodr"]).environment.towns == {"a/b.xodr": 1.0}


def test_towns_are_written_as_a_table_in_one_line() -> None:
    assert "\ntowns = {town03 = 1.0}\n" in default_toml()
    two = read_run_file(None, ['environment.towns=["town04", "a b.xodr"]'])
    assert '\ntowns = {town04 = 1.0, "a b.xodr" = 1.0}\n' in to_toml(two)


MANY = ", ".join(f'"{number}.xodr"' for number in range(17))


@pytest.mark.parametrize(
    ("written", "parts"),
    [
        ('"town05"', ['"town05" is no town', "town02, town03, town04, random-1 to ", "did you mean town0"]),
        ('"Town03"', ['"Town03" is no town', "did you mean town03?"]),
        ('"map.xml"', ['"map.xml" is no town', "PATH.xodr"]),
        ('".xodr"', ['".xodr" is no town']),
        ('""', ['"" is no town']),
        ("3", ["should be a town, a list of towns, or a table of their shares"]),
        ("true", ["should be a town, a list"]),
        ("[3]", ["has a town 3, should be a town, a list"]),
        ('["town03", "town03"]', ['has "town03" twice']),
        ("[]", ["has 0 towns, should have 1 to 16"]),
        ("{}", ["has 0 towns, should have 1 to 16"]),
        (f"[{MANY}]", ["has 17 towns, should have 1 to 16"]),
        ("{town03 = 0}", ['the share of "town03" is 0, should be a number above 0']),
        ("{town03 = 2, town04 = -1.5}", ['the share of "town04" is -1.5']),
        ("{town03 = inf}", ['the share of "town03" is inf']),
        ("{town03 = nan}", ['the share of "town03" is nan']),
        ("{town03 = true}", ['the share of "town03" is True']),
        ('{town03 = "2"}', ["the share of \"town03\" is '2'"]),
        ("{town02 = 1, ring.xodr = 2}", ['has a table as the share of "ring": a path has to be in quotes']),
        ("{town3 = 1}", ['"town3" is no town', "did you mean town03?"]),
        ('"a\\u0000b.xodr"', ["printable"]),
        ('"a\\nb.xodr"', ["printable"]),
        (f'"{"a/" * 150}.xodr"', ["at most 256 printable characters"]),
        (f'"{"a" * 300}.xodr"', ["a file's name has at most 255"]),
    ],
)
def test_mistake_in_the_towns_is_one_line_that_names_it(
    tmp_path: Path, written: str, parts: list[str]
) -> None:
    path = tmp_path / "run.toml"
    path.write_text(f"[environment]\ntowns = {written}\n")
    for arguments, place in (
        ((path, []), f"{path}: environment.towns = "),
        ((None, [f"environment.towns={written}"]), "--set environment.towns="),
    ):
        with pytest.raises(RunFileError) as caught:
            read_run_file(*arguments)
        error = str(caught.value)
        assert "\n" not in error
        assert "\x00" not in error
        assert error.startswith(place)
        for part in parts:
            assert part in error, error


def test_list_without_quotes_is_told_how_to_write_it() -> None:
    with pytest.raises(RunFileError, match=r'need quotes, \["town03", "town04"\]'):
        read_run_file(None, ["environment.towns=[town03, town04]"])
    with pytest.raises(RunFileError, match=r'need quotes, \["town03", "town04"\]'):
        read_run_file(None, ["environment.towns=town03,town04"])


def test_former_name_of_the_setting_leads_to_the_new_one() -> None:
    with pytest.raises(RunFileError, match=r"did you mean environment\.towns\?"):
        read_run_file(None, ["environment.town=town04"])


def test_every_map_that_is_read_can_be_named_in_a_result() -> None:
    path = "ä" * 125 + "/" + "ä" * 125 + ".xodr"
    (town,) = read_run_file(None, [f"environment.towns={path}"]).environment.towns
    result = EvaluationResult("policy", 1, 2, town, 3, {"return_mean": 1.0})
    assert _decode(_encode(result)) == result
