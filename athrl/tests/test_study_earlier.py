"""A study continues on another machine from its `study.json`, and no such file does harm."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from athrl.errors import CommandError
from athrl.runs import declare_installed_planners
from athrl.study.earlier import read_earlier, take_over
from athrl.study.file import SCORES, ElsewhereSection, StudyFile
from athrl.study.folder import StudyFolder
from athrl.study.grid import shares_of_cores
from athrl.study.identity import identity
from athrl.study.plan import PlannedRun, planned_runs
from athrl.study.table import tabulated
from athrl_protocol.run_file import declare_planners, declared_planners
from hypothesis import given
from hypothesis import strategies as st

STUDY = StudyFile.model_validate(
    {
        "study": {"name": "made-up", "seeds": [1, 2], "drivers": ["rule-based"]},
        "grid": [{"planners": ["athrl"], "towns": ["town03"]}],
        "elsewhere": [{"name": "crowded", "town": "town04", "vehicles": 150}],
    }
)
MADE = {"version": "1", "commit": "abc1234", "date": "2026-01-01", "cores": 1, "processor": "a processor"}
NAN = {"return_mean": float("nan")}
SCORED = {"scores": dict.fromkeys(SCORES, 0.5)}


@pytest.fixture(autouse=True, scope="module")
def _planners() -> Iterator[None]:
    before = declared_planners()
    declare_installed_planners()
    yield
    declare_planners(before)


@pytest.fixture
def runs(tmp_path: Path) -> list[PlannedRun]:
    return planned_runs(tmp_path / "study.toml", STUDY)


@pytest.fixture
def finished(tmp_path: Path, runs: list[PlannedRun]) -> StudyFolder:
    """A folder in which every run and driver was scored everywhere."""
    folder = StudyFolder(tmp_path / "there")
    for run in runs:
        facts = {"run": run.name, "planner": "athrl", "town": "town03", "variant": "", "seed": run.seed}
        learned = {
            "decisions": 300, "seconds": 60.0, "training": {"return_mean": 100.0, "speed_mps": 2.0},
            "curves": {"training": [[100, 10.0]], "greedy": []},
        }  # fmt: skip
        folder.note(run.name, {**facts, **learned, **SCORED, "made": MADE})
        folder.note(f"{run.name}@crowded", {"run": run.name, "place": "crowded", **SCORED})
    driver = {"driver": "rule-based", **SCORED}
    folder.note("driver-rule-based-town03", {**driver, "town": "town03"})
    folder.note("driver-rule-based@crowded", {**driver, "place": "crowded"})
    return folder


Written = Callable[..., Path]


@pytest.fixture
def written(tmp_path: Path, runs: list[PlannedRun], finished: StudyFolder) -> Written:
    """Writes the study.json of what the folder holds now, with changes."""

    def write(**changes: Any) -> Path:
        found = {**tabulated(STUDY, runs, finished), "begun": identity(STUDY, runs), **changes}
        path = tmp_path / "study.json"
        path.write_text(json.dumps(found))
        return path

    return write


def test_finished_runs_of_another_machine_are_not_repeated(
    tmp_path: Path, runs: list[PlannedRun], finished: StudyFolder, written: Written
) -> None:
    here = StudyFolder(tmp_path / "here")
    assert take_over(read_earlier(written(), STUDY, runs), here, STUDY, runs) == 2
    assert tabulated(STUDY, runs, here) == json.loads(json.dumps(tabulated(STUDY, runs, finished)))


def test_what_is_here_already_stays_as_it_is(
    tmp_path: Path, runs: list[PlannedRun], written: Written
) -> None:
    here = StudyFolder(tmp_path / "here")
    here.note(runs[0].name, {"run": runs[0].name, "failure": "no such device"})
    assert take_over(read_earlier(written(), STUDY, runs), here, STUDY, runs) == 1
    assert here.result(runs[0].name) == {"run": runs[0].name, "failure": "no such device"}


def test_run_that_failed_or_was_not_scored_everywhere_is_repeated(
    tmp_path: Path, runs: list[PlannedRun], finished: StudyFolder, written: Written
) -> None:
    failed = {"run": runs[0].name, "seed": 1, "failure": "no such device"}
    finished.note(runs[0].name, failed)
    finished.note(f"{runs[1].name}@crowded", {"run": runs[1].name, "place": "crowded", "failure": "no room"})
    here = StudyFolder(tmp_path / "here")
    assert take_over(read_earlier(written(), STUDY, runs), here, STUDY, runs) == 0
    assert here.result(runs[0].name) is None
    assert here.result(runs[1].name) is None
    assert here.result("driver-rule-based-town03") is not None


def test_name_outside_the_folder_is_never_written(
    tmp_path: Path, runs: list[PlannedRun], finished: StudyFolder, written: Written
) -> None:
    result = {**(finished.result(runs[0].name) or {}), "run": "../../elsewhere"}
    path = written(runs=[result])
    here = StudyFolder(tmp_path / "here" / "deep")
    before = set(tmp_path.rglob("*"))
    assert take_over(read_earlier(path, STUDY, runs), here, STUDY, runs) == 0
    names = {each.name for each in set(tmp_path.rglob("*")) - before if each.is_file()}
    assert names == {"driver-rule-based-town03.json", "driver-rule-based@crowded.json"}


GOOD_RUN = {
    "run": "athrl-town03-1", "planner": "athrl", "town": "town03", "variant": "", "seed": 1, "decisions": 300,
    "seconds": 60.0, "training": {}, "curves": {"training": [[1, 2.0]], "greedy": []}, "made": MADE, **SCORED,
}  # fmt: skip
DRIVER = {"driver": "rule-based", "town": "town03", **SCORED}
PLACE = {"name": "crowded", "runs": [], "drivers": []}


def one_run(**changes: Any) -> dict[str, Any]:
    return {"runs": [{**GOOD_RUN, **changes}]}


def test_good_run_is_good(runs: list[PlannedRun], written: Written) -> None:
    assert "athrl-town03-1" in read_earlier(written(**one_run()), STUDY, runs)


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"begun": None}, "study.json: "),
        ({"begun": {}}, "holds another study: study was begun as None, should be made-up"),
        ({"runs": 3}, "study.json: "),
        ({"runs": [3]}, "study.json: "),
        ({"runs": [{"run": []}]}, "study.json: "),
        ({"elsewhere": [{}]}, "study.json: lacks 'runs'"),
        ({"runs": [{"run": "athrl-town03-1", "scores": {}}]}, "athrl-town03-1, planner: Field required"),
        (one_run(scores={"return_mean": 1.0}), "athrl-town03-1: Value error, has no score speed_mps"),
        (
            one_run(scores={**SCORED["scores"], "return_mean": 1e308}),
            "return_mean: Input should be less than",
        ),
        (one_run(scores={**SCORED["scores"], **NAN}), "scores, return_mean: Input should be"),
        (one_run(curves={"x": [[1, 2.0]]}), "curves, training: Field required"),
        (one_run(curves={"training": [[10**400, 2.0]], "greedy": []}), "athrl-town03-1, curves, training"),
        (one_run(seconds="long"), "athrl-town03-1, seconds: Input should be a valid number"),
        (one_run(seed=2), "athrl-town03-1, seed: is 2, should be 1"),
        (one_run(town="town02"), "athrl-town03-1, town: is 'town02', should be 'town03'"),
        (
            {"drivers": [{**DRIVER, "scores": {}}]},
            "driver-rule-based-town03: Value error, has no score return_m",
        ),
        (
            {"elsewhere": [{**PLACE, "runs": [{"run": "driver-rule-based", **SCORED}]}]},
            "place: Field required",
        ),
        (
            {"elsewhere": [{**PLACE, "drivers": [{"driver": "rule-based", "place": 3, **SCORED}]}]},
            "place: Input",
        ),
    ],
)
def test_damaged_file_is_refused_in_one_line(
    runs: list[PlannedRun], written: Written, changes: dict[str, Any], told: str
) -> None:
    with pytest.raises(CommandError) as error:
        read_earlier(written(**changes), STUDY, runs)
    assert told in str(error.value)
    assert str(error.value).startswith("--from ")
    assert "\n" not in str(error.value)


def test_results_of_other_places_are_not_mixed_with_ours(
    tmp_path: Path, runs: list[PlannedRun], written: Written
) -> None:
    place = ElsewhereSection(name="crowded", town="town04", vehicles=50)
    with pytest.raises(CommandError, match="elsewhere crowded, vehicles was begun as 150, should be 50"):
        read_earlier(written(), STUDY.model_copy(update={"elsewhere": [place]}), runs)


@given(st.integers(1, 70), st.integers(1, 70))
def test_jobs_share_the_cores_and_leave_none_idle(cores: int, jobs: int) -> None:
    shares = shares_of_cores(range(100, 100 + cores), jobs)
    assert len(shares) == jobs
    assert all(shares)
    assert max(map(len, shares)) - min(map(len, shares)) <= 1
    assert set().union(*shares) == set(range(100, 100 + cores))
    if jobs <= cores:
        assert sum(map(len, shares)) == cores
