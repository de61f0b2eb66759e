"""The section `[planner]`: held to what was declared, and taken as it is where nothing was."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Literal, Self

import pytest
from athrl_protocol import RunFile, RunFileError, default_toml, read_run_file, to_toml
from athrl_protocol.run_file import (
    declare_planners,
    declared_planners,
    planner_settings,
    reference_page,
    settings,
)
from pydantic import BaseModel, Field, model_validator


class Walker(BaseModel):
    """Goes where it looks."""

    stride: float = Field(default=0.7, gt=0, le=2, description="Length of a step, m.")
    legs: int = Field(default=2, ge=1, le=100, description="How many it has.")
    gait: Literal["walk", "trot"] = Field(default="walk", description="How it goes.")
    patience: float = Field(default=1.0, ge=0, description="Seconds.")
    longest_stride: float = Field(default=2.0, gt=0, description="Longest step, m.")

    @model_validator(mode="after")
    def _check_strides(self) -> Self:
        if self.stride > self.longest_stride:
            raise ValueError(
                f"planner.stride = {self.stride:g}: should be at most planner.longest_stride = "
                f"{self.longest_stride:g}"
            )
        return self


class Flyer(BaseModel):
    """Takes the way through the air."""

    wings: bool = Field(default=True, description="Whether it has any.")
    feathers: list[int] = Field(default=[3, 4], description="How many on each side.")
    name: str = Field(default="a", pattern="^[a-z]$", description="What it is called.")
    patience: float = Field(default=1.0, ge=0, description="Seconds.")


KINDS: dict[str, type[BaseModel]] = {"walker": Walker, "flyer": Flyer}


@pytest.fixture
def planners() -> None:
    declare_planners(KINDS)


def _write(folder: Path, text: str) -> Path:
    path = folder / "run.toml"
    path.write_text(text)
    return path


def _error(path: Path | None, *overrides: str) -> str:
    with pytest.raises(RunFileError) as caught:
        read_run_file(path, overrides)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.usefixtures("planners")
def test_first_kind_is_the_default_and_what_is_left_out_has_its_default() -> None:
    for run_file in (RunFile(), read_run_file(None)):
        assert run_file.planner.kind == "walker"
        assert run_file.planner.values() == Walker().model_dump()


@pytest.mark.usefixtures("planners")
def test_kind_brings_its_own_settings(tmp_path: Path) -> None:
    path = _write(tmp_path, '[planner]\nkind = "flyer"\nwings = false\nfeathers = [1]\n')
    run_file = read_run_file(path, ["planner.patience=3"])
    assert run_file.planner.kind == "flyer"
    assert run_file.planner.values() == {"wings": False, "feathers": [1], "name": "a", "patience": 3.0}
    by_command = read_run_file(None, ["planner.wings=false", "planner.feathers=[1]", "planner.kind=flyer"])
    assert by_command.planner.values() == {**run_file.planner.values(), "patience": 1.0}


@pytest.mark.usefixtures("planners")
@pytest.mark.parametrize("kind", KINDS)
def test_run_file_of_every_kind_survives_toml_and_json(tmp_path: Path, kind: str) -> None:
    run_file = read_run_file(None, [f"planner.kind={kind}", "planner.patience=7"])
    assert RunFile.from_json(run_file.to_json()) == run_file
    assert RunFile.model_validate(tomllib.loads(to_toml(run_file))) == run_file
    assert read_run_file(_write(tmp_path, to_toml(run_file)), complete=True) == run_file


@pytest.mark.usefixtures("planners")
def test_actor_to_which_nothing_was_declared_keeps_what_the_learner_serves() -> None:
    served = read_run_file(None, ["planner.kind=flyer", "planner.feathers=[9, 8]"])
    text, written = served.to_json(), to_toml(served)
    declare_planners({})
    received = RunFile.from_json(text)
    assert received == served
    assert received.planner.kind == "flyer"
    assert received.planner.values() == {"wings": True, "feathers": [9, 8], "name": "a", "patience": 1.0}
    assert RunFile.model_validate(tomllib.loads(to_toml(received))) == served
    assert tomllib.loads(to_toml(received)) == tomllib.loads(written)


def test_process_without_declared_planners_reads_any_section(tmp_path: Path) -> None:
    path = _write(tmp_path, '[planner]\nkind = "swimmer"\nfins = 3\n')
    planner = read_run_file(path, ["planner.depth=2.5"]).planner
    assert (planner.kind, planner.values()) == ("swimmer", {"fins": 3, "depth": 2.5})
    assert "planner.kind = 3: should be the name of a planner" in _error(
        _write(tmp_path, "[planner]\nkind = 3\n")
    )
    assert "should be the name of a planner" in _error(None, 'planner.kind="a b"')


@pytest.mark.usefixtures("planners")
@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("strid = 1.0", ["planner.strid is no setting", "did you mean planner.stride?"]),
        ("stride = 0.0", ["planner.stride = 0.0", "should be number, > 0, <= 2 (Length of a step, m.)"]),
        ("stride = nan", ["planner.stride = nan", "should be number, > 0"]),
        ("patience = inf", ["planner.patience = inf", "should be number, >= 0"]),
        ("legs = 2.5", ["planner.legs = 2.5", "should be integer, >= 1, <= 100"]),
        ('legs = "2"', ['planner.legs = "2"', "should be integer"]),
        ("legs = true", ["planner.legs = true", "should be integer"]),
        ('gait = "gallop"', ['planner.gait = "gallop"', 'should be "walk" or "trot"']),
        ("legs = 0\nstride = 9", ["planner.stride = 9", "(and 1 more)"]),
        ("wings = true", ['planner.wings is a setting of planner.kind = "flyer"', 'planner.kind = "walker"']),
        ('kind = "flyr"', ['planner.kind = "flyr"', 'should be "walker" or "flyer"', "did you mean flyer?"]),
        ('kind = "snake"', ['planner.kind = "snake"', 'should be "walker" or "flyer"']),
        ("kind = 3", ["planner.kind = 3", 'should be "walker" or "flyer"']),
        (
            'kind = "flyer"\nlegs = 3',
            ["planner.legs is a setting of", '"walker"', 'has planner.kind = "flyer"'],
        ),
        ('kind = "flyer"\nwings = 1', ["planner.wings = 1", "should be true or false (Whether it has any.)"]),
        ('kind = "flyer"\nname = "ab"', ['planner.name = "ab"', 'should be text like "a"']),
        ("stride = 1.5\nlongest_stride = 1", [": planner.stride = 1.5: should be at most planner.longest"]),
    ],
)
def test_mistake_in_the_planner_is_one_line_that_names_it(
    tmp_path: Path, text: str, parts: list[str]
) -> None:
    path = _write(tmp_path, f"[planner]\n{text}\n")
    error = _error(path)
    for part in [str(path), *parts]:
        assert part in error, error


@pytest.mark.usefixtures("planners")
@pytest.mark.parametrize(
    ("overrides", "parts"),
    [
        (["planner.kind=flyr"], ["--set planner.kind=flyr", "did you mean flyer?"]),
        (["planner.wings=true"], ["--set planner.wings=true", 'is a setting of planner.kind = "flyer"']),
        (["planner.kind=flyer", "planner.legs=3"], ["--set planner.legs=3", '"walker"']),
        (["planner.stride=9"], ["--set planner.stride=9: should be number, > 0, <= 2"]),
        (["planner.feathers=3", "planner.kind=flyer"], ["--set planner.feathers=3: should be "]),
        (["planner.legs.left=3"], ["planner.legs.left is no setting", "did you mean planner.legs?"]),
        (["stride=1"], ["stride is no setting", "did you mean planner.stride?"]),
        (["planner=flyer"], ["planner is no setting but a section of them, such as planner.kind"]),
    ],
)
def test_mistake_in_an_override_is_one_line_that_names_it(overrides: list[str], parts: list[str]) -> None:
    error = _error(None, *overrides)
    for part in parts:
        assert part in error, error


@pytest.mark.usefixtures("planners")
@pytest.mark.parametrize(("kind", "other"), [("walker", "flyer"), ("flyer", "walker")])
def test_override_makes_of_a_whole_file_of_one_kind_a_run_of_another(
    tmp_path: Path, kind: str, other: str
) -> None:
    path = _write(tmp_path, default_toml(kind).replace("patience = 1.0\n", "patience = 5.0\n"))
    planner = read_run_file(path, [f"planner.kind={other}"]).planner
    expected = {**KINDS[other]().model_dump(), "patience": 5.0}
    assert (planner.kind, planner.values()) == (other, expected)
    assert read_run_file(path, [f"planner.kind={kind}"]) == read_run_file(path)


@pytest.mark.usefixtures("planners")
@pytest.mark.parametrize(("was", "is_now"), [("legs = 2", "legs = 3"), ("legs = 2", "legs = true")])
def test_setting_that_another_kind_lacks_is_refused_where_it_is_not_the_default(
    tmp_path: Path, was: str, is_now: str
) -> None:
    error = _error(_write(tmp_path, default_toml().replace(was, is_now)), "planner.kind=flyer")
    assert 'planner.legs is a setting of planner.kind = "walker"' in error
    assert 'this run has planner.kind = "flyer"' in error


@pytest.mark.usefixtures("planners")
def test_misspelt_setting_is_not_left_out_for_another_kind(tmp_path: Path) -> None:
    path = _write(tmp_path, "[planner]\nlegz = 2\n")
    assert "planner.legz is no setting" in _error(path, "planner.kind=flyer")
    error = _error(_write(tmp_path, default_toml()), "planner.kind=flyer", "planner.legs=2")
    assert '--set planner.legs=2: planner.legs is a setting of planner.kind = "walker"' in error


@pytest.mark.usefixtures("planners")
@pytest.mark.parametrize("kind", KINDS)
def test_cut_off_file_lacks_a_setting_of_its_kind(tmp_path: Path, kind: str) -> None:
    whole = default_toml(kind)
    path = _write(tmp_path, whole)
    assert read_run_file(path, complete=True).planner.kind == kind
    path.write_text(whole[: whole.index("\npatience = 1.0")])
    with pytest.raises(RunFileError, match=r"planner\.patience is missing, the file is damaged"):
        read_run_file(path, complete=True)


@pytest.mark.usefixtures("planners")
def test_run_file_of_a_planner_that_is_not_there_is_refused_by_its_name(tmp_path: Path) -> None:
    path = _write(tmp_path, default_toml("flyer"))
    served = read_run_file(path).to_json()
    declare_planners({"walker": Walker})
    with pytest.raises(RunFileError, match=r'planner\.kind = "flyer": should be "walker"'):
        read_run_file(path, complete=True)
    with pytest.raises(RunFileError, match=r"planner\.kind = 'flyer': should be \"walker\""):
        RunFile.from_json(served)


@pytest.mark.usefixtures("planners")
def test_default_run_file_documents_the_settings_of_its_kind() -> None:
    for kind in KINDS:
        lines = default_toml(kind).splitlines()
        for setting in planner_settings(kind):
            assert f"# {setting.description} ({setting.expected})" in lines
        keys = list(tomllib.loads(default_toml(kind))["planner"])
        assert keys == ["kind", *KINDS[kind].model_fields]
        assert [setting.key for setting in settings(kind) if setting.section == "planner"] == keys
    meaning = "The kind of planner: walker (Goes where it looks), flyer (Takes the way through the air)."
    assert f'# {meaning} ("walker" or "flyer")\nkind = "walker"\n' in default_toml()


@pytest.mark.usefixtures("planners")
def test_reference_page_has_every_setting_of_every_kind_once() -> None:
    page = reference_page()
    names = [setting.key for kind in KINDS for setting in planner_settings(kind)]
    for key in {*names, *(setting.key for setting in settings())}:
        assert f"| `{key}` |" in page, key
    planners = page[page.index("## [planner]") : page.index("## [exploration]")]
    assert planners.count("| `patience` |") == 1
    assert planners.index("| `patience` |") < planners.index('### planner.kind = "walker"')
    assert planners.index("| `wings` |") > planners.index('### planner.kind = "flyer"')


class WithKind(BaseModel):
    kind: str = "a"


class WithoutDefault(BaseModel):
    legs: int


class WithNothing(BaseModel):
    legs: int | None = None


@pytest.mark.parametrize(
    ("kind", "table", "text"),
    [
        ("a", WithKind, "the planner a has a setting 'kind'"),
        ("a", WithoutDefault, "the planner a has no default for its setting 'legs'"),
        ("a", WithNothing, "the planner a has legs = None, for which TOML has no value"),
        ("a b", Walker, "a kind of planner is 'a b'"),
    ],
)
def test_table_that_cannot_be_declared_leaves_the_declared_ones(
    kind: str, table: type[BaseModel], text: str
) -> None:
    declare_planners(KINDS)
    with pytest.raises(ValueError, match=re.escape(text)):
        declare_planners({"walker": Walker, kind: table})
    assert list(declared_planners()) == list(KINDS)


def test_tables_that_are_declared_again_stay_what_they_were() -> None:
    declare_planners(KINDS)
    before = declared_planners()
    declare_planners({})
    declare_planners(before)
    assert declared_planners() == before


def test_planners_own_table_is_not_changed_by_being_declared() -> None:
    declare_planners(KINDS)
    assert Walker(legs="3").legs == 3  # type: ignore[arg-type]  # as lenient as it was


@pytest.mark.usefixtures("planners")
def test_planner_of_a_run_cannot_be_changed() -> None:
    planner = RunFile().planner
    planner.values()["legs"] = 9
    assert planner.values()["legs"] == 2
    with pytest.raises(ValueError, match="frozen"):
        planner.legs = 9  # type: ignore[attr-defined]
