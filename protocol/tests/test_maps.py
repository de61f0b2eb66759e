"""A run's maps are kept with whole paths and checksums; other maps under these paths are refused."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import pytest
import zenoh
from athrl_protocol import RunFile, RunFileError, join_run, read_run_file, serve_run_file
from athrl_protocol.run_file import are_other_towns, require_same_maps, saved_toml, with_whole_maps

CONTENT = b"<OpenDRIVE/>"
CHECKSUM = hashlib.sha256(CONTENT).hexdigest()


@pytest.fixture
def map_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "maps" / "m.xodr"
    path.parent.mkdir()
    path.write_bytes(CONTENT)
    return path


@pytest.fixture
def run_file(map_file: Path) -> RunFile:
    return with_whole_maps(read_run_file(None, ['environment.towns={"maps/m.xodr" = 2, town03 = 1}']))


def refusal(check: Callable[[RunFile], object], run_file: RunFile) -> str:
    with pytest.raises(RunFileError) as refused:
        check(run_file)
    assert "\n" not in str(refused.value)
    return str(refused.value)


def test_path_is_absolute_and_the_share_stays(run_file: RunFile, map_file: Path) -> None:
    assert run_file.environment.towns == {str(map_file): 2.0, "town03": 1.0}
    assert run_file.run.map_checksums == {str(map_file): CHECKSUM}


def test_run_file_with_whole_maps_stays_as_it_is(
    run_file: RunFile, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "run.toml").write_text(saved_toml(run_file))
    monkeypatch.chdir("/")
    assert read_run_file(tmp_path / "run.toml", complete=True) == run_file
    assert with_whole_maps(run_file) == RunFile.from_json(run_file.to_json()) == run_file
    require_same_maps(run_file)


def test_other_content_is_refused_by_who_resumes_and_by_who_joins(run_file: RunFile, map_file: Path) -> None:
    map_file.write_bytes(CONTENT + b" ")
    for check in (with_whole_maps, require_same_maps):
        assert f"{map_file} is another map than the run's" in refusal(check, run_file)


def test_missing_map_is_refused_by_who_starts_or_joins_and_not_by_a_learner_that_resumes(
    run_file: RunFile, map_file: Path
) -> None:
    map_file.unlink()
    assert with_whole_maps(run_file) == run_file
    assert f"{map_file}: there is no such file on this machine" in refusal(require_same_maps, run_file)
    new = run_file.model_copy(update={"run": run_file.run.model_copy(update={"map_checksums": {}})})
    assert f"{map_file}: there is no such file on this machine" in refusal(with_whole_maps, new)


def test_other_map_under_another_name_replaces_path_and_checksum(run_file: RunFile, map_file: Path) -> None:
    other = map_file.with_name("other.xodr")
    other.write_bytes(b"other")
    towns = {"maps/other.xodr": 1.0}
    changed = with_whole_maps(
        run_file.model_copy(update={"environment": run_file.environment.model_copy(update={"towns": towns})})
    )
    assert changed.run.map_checksums == {str(other): hashlib.sha256(b"other").hexdigest()}


def resumed_in(run_file: RunFile, *towns: str) -> RunFile:
    """The settings of a run with other towns."""
    environment = run_file.environment.model_copy(update={"towns": dict.fromkeys(towns, 1.0)})
    return run_file.model_copy(update={"environment": environment})


def test_moved_map_is_the_same_town_also_under_another_name(run_file: RunFile, map_file: Path) -> None:
    for name in ("m.xodr", "renamed.xodr"):
        (map_file.parent / "new").mkdir(exist_ok=True)
        moved = map_file.parent / "new" / name
        moved.write_bytes(CONTENT)
        assert not are_other_towns(run_file, resumed_in(run_file, f"maps/new/{name}", "town03"))
    assert not are_other_towns(run_file, resumed_in(run_file, "town03", "maps/m.xodr"))


def test_other_content_under_the_name_of_a_moved_map_is_refused_with_both(
    run_file: RunFile, map_file: Path
) -> None:
    moved = map_file.parent.with_name("moved") / "m.xodr"
    moved.parent.mkdir()
    moved.write_bytes(b"other")
    said = refusal(
        lambda resumed: are_other_towns(run_file, resumed), resumed_in(run_file, str(moved), "town03")
    )
    other = hashlib.sha256(b"other").hexdigest()
    assert f"{moved} (SHA-256 {other[:12]}...) is another map than {map_file}" in said
    assert f"({CHECKSUM[:12]}...)" in said


def test_town_or_map_of_another_name_is_another_town(run_file: RunFile, map_file: Path) -> None:
    map_file.with_name("other.xodr").write_bytes(b"other")
    for towns in (
        ["random-7", "town03"],
        ["maps/other.xodr", "town03"],
        ["maps/m.xodr"],
        ["maps/m.xodr", "town02"],
    ):
        assert are_other_towns(run_file, resumed_in(run_file, *towns))
    assert are_other_towns(run_file, resumed_in(run_file, "maps/m.xodr", "town03", "town02"))


def test_one_map_by_two_names_and_a_folder_as_a_map_are_refused(map_file: Path) -> None:
    for paths in ('["maps/m.xodr", "maps/../maps/m.xodr"]', f'["maps/m.xodr", "{map_file}"]'):
        with pytest.raises(
            RunFileError, match=r'has "maps/m.xodr" twice, also as ".*: should have each town'
        ):
            read_run_file(None, [f"environment.towns={paths}"])
    map_file.with_name("folder.xodr").mkdir()
    folder = read_run_file(None, ["environment.towns=maps/folder.xodr"])
    assert "is no file" in refusal(with_whole_maps, folder)


def test_run_in_shipped_towns_has_no_checksums() -> None:
    assert with_whole_maps(RunFile()) == RunFile()


@pytest.mark.parametrize("value", ["3", '{"a.xodr" = "abc"}', '{"a.xodr" = 3}', "[]"])
def test_checksums_that_are_none_are_refused(value: str) -> None:
    with pytest.raises(RunFileError, match="SHA-256 in hexadecimal digits by path"):
        read_run_file(None, [f"run.map_checksums={value}"])


def test_service_that_has_another_map_does_not_join(
    run_file: RunFile, map_file: Path, listen: Callable[[], zenoh.Session], address: str
) -> None:
    map_file.write_bytes(b"another")
    run = run_file.run.name
    with serve_run_file(listen(), run_file), ExitStack() as stack:
        for role in ("actor", "evaluator"):
            with pytest.raises(RunFileError, match=f"{map_file} is another map"):
                join_run(role=role, connect=address, run=run, name="one", stop=threading.Event(), stack=stack)
