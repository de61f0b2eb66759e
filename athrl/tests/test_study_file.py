"""The file of a study is checked when it is read, and a folder is that of one study."""

from __future__ import annotations

import errno
import shutil
import sqlite3
import threading
import tomllib
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from athrl.errors import CommandError
from athrl.runs import declare_installed_planners
from athrl.study.file import StudyFile, read_study_file
from athrl.study.folder import StudyFolder
from athrl.study.grid import driver_name
from athrl.study.places import require_places, require_room_at_home
from athrl.study.plan import PlannedRun, planned_runs, require_search
from athrl.study.search import Search
from athrl_driving.maps.town import _FOLDER as TOWNS
from athrl_protocol.run_file import declare_planners, declared_planners, read_run_file
from athrl_protocol.run_file.toml_values import to_toml_value

ROOT = Path(__file__).parents[2]

GOOD: dict[str, Any] = {
    "study": {"name": "one", "seeds": [1, 2]},
    "grid": [{"planners": ["ddpg", "hddpg"], "towns": ["town03"]}],
}
MANY = "environment.vehicles=5000"
SEARCH = {"trials": 3, "ranges": {"planner.n_step": {"low": 1, "high": 4}}}


@pytest.fixture(autouse=True, scope="module")
def _planners() -> Any:
    before = declared_planners()
    declare_installed_planners()
    yield
    declare_planners(before)


def written(folder: Path, content: dict[str, Any]) -> Path:
    """Write a study as TOML, its grids and searches as inline tables."""
    lines = []
    for section, value in content.items():
        tables = value if isinstance(value, list) else [value]
        for table in tables:
            lines.append(f"[[{section}]]" if isinstance(value, list) else f"[{section}]")
            lines += [f"{key} = {to_toml(each)}" for key, each in table.items()]
    path = folder / "study.toml"
    path.write_text("\n".join(lines) + "\n")
    tomllib.loads(path.read_text())
    return path


def to_toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{to_toml_value(key)} = {to_toml(each)}" for key, each in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(to_toml, value)) + "]"
    return to_toml_value(value)


def read(path: Path) -> tuple[StudyFile, list[PlannedRun]]:
    study = read_study_file(path)
    planned = planned_runs(path, study)
    require_places(path, study, planned)
    return study, planned


def elsewhere(**place: Any) -> dict[str, Any]:
    """The good study with a place where its policies are scored, too."""
    return {**GOOD, "elsewhere": [{"name": "there", **place}]}


def changed(**changes: Any) -> dict[str, Any]:
    """The good study with the first grid changed."""
    return {**GOOD, "grid": [{**GOOD["grid"][0], **changes}]}


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (changed(planners=["hdpg"]), "did you mean hddpg?"),
        (changed(towns=["town3"]), "there is no town named 'town3', did you mean 'town03'?"),
        (changed(settings=["learner.bach=64"]), "learner.bach is no setting; did you mean learner.batch?"),
        (changed(settings=["run.seed=7"]), "the study sets run.seed of each run itself, leave it out"),
        (changed(planners=["ddpg", "ddpg"]), '"ddpg" appears twice, it should appear once'),
        (changed(run_file="../{pilot}.toml"), "should be a path that has {planner} and {town} alone"),
        (changed(run_file="no-such-{planner}.toml"), "no-such-ddpg.toml: cannot be read"),
        (changed(town="town03"), "grid number 1, town is no key of a study"),
        ({**GOOD, "study": {"name": "one", "seeds": list(range(501))}}, "should have at most 500 items"),
        (
            {
                "study": {"name": "one", "seeds": list(range(500))},
                "grid": [
                    {"planners": ["ddpg"], "towns": ["town03"], "variants": {f"v{n}": [] for n in range(21)}}
                ],
            },
            "has 10,500 runs, should have at most",
        ),
        (changed(run_file="{planner:>9999999999}"), "should be a path that has {planner} and {town} alone"),
        (changed(run_file="{planner.__class__}"), "should be a path that has {planner} and {town} alone"),
        (changed(towns=["town02", ["town02", "town3"]]), "there is no town named 'town3'"),
        (changed(towns=[["town02", "town02"]]), '"town02" appears twice'),
        (elsewhere(town="town3"), "elsewhere number 1, town: there is no town named 'town3', did you"),
        (elsewhere(town="town03", vehicles=5000), "elsewhere number 1, vehicles = 5000: town03 has room for"),
        (elsewhere(case_study="roundabut"), '"roundabut" is no case study, it should be roundabout'),
        (elsewhere(), '"there" should have a town or a case_study, one of the two'),
        (elsewhere(town="town03", case_study="roundabout"), "one of the two"),
        (elsewhere(case_study="roundabout", vehicles=3), "a case study has its own vehicles"),
        (
            {**GOOD, "elsewhere": 2 * elsewhere(town="town02")["elsewhere"]},
            'elsewhere number 2, name: "there" appears twice, it should appear once',
        ),
        ({"study": GOOD["study"]}, "grid is missing"),
        ({**GOOD, "study": {"name": "one", "seeds": []}}, "study.seeds = []: "),
        (
            {**GOOD, "study": {"name": "No name"}},
            'study.name = "No name": should be a name of at most 31 characters: a-z, 0-9, _ and -',
        ),
        (
            {**GOOD, "elsewhere": [{"name": "other random", "town": "random-7"}]},
            'elsewhere number 1, name = "other random": should be a name of at most 31 characters',
        ),
        (changed(towns=["town02", 3]), "grid number 1, towns number 2"),
        (changed(settings=[MANY]), "ddpg-town03-1: environment.vehicles is 5000, town03 has room for"),
        (
            {
                **changed(towns=["town04"], settings=["environment.vehicles=800"]),
                "elsewhere": [{"name": "there", "town": "town02"}],
            },
            "elsewhere number 1: has no vehicles of its own and ddpg-town04-1 has environment.vehicles = "
            "800, town02 has room for",
        ),
        ({**GOOD, "study": {"name": "one", "drivers": ["rulebased"]}}, '"rulebased" is no driver'),
        (
            {**GOOD, "grid": [*GOOD["grid"], {"planners": ["ddpg"], "towns": ["town03"], "seeds": [2]}]},
            "ddpg in town03 with seed 2 appears twice as ddpg-town03-2, it should appear once",
        ),
    ],
)
def test_wrong_study_is_refused_in_one_line_that_names_what_is_wrong(
    tmp_path: Path, content: dict[str, Any], told: str
) -> None:
    path = written(tmp_path, content)
    with pytest.raises(CommandError) as error:
        read(path)
    assert told in str(error.value)
    assert str(error.value).startswith(str(tmp_path))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("search", "told"),
    [
        (None, "[search] is missing"),
        ({**SEARCH, "ranges": {"planner.n_stp": [1, 2]}}, "did you mean planner.n_step?"),
        ({**SEARCH, "ranges": {"planner.n_step": {"low": 0, "high": 4}}}, "planner.n_step=0"),
        ({**SEARCH, "ranges": {"planner.n_step": {"low": 4, "high": 1}}}, "low should be less"),
        ({**SEARCH, "ranges": {"run.seed": {"low": 1, "high": 4}}}, "the study sets run.seed"),
        ({**SEARCH, "trials": 0}, "search.trials = 0: "),
    ],
)
def test_wrong_search_is_refused_in_one_line(tmp_path: Path, search: Any, told: str) -> None:
    path = written(tmp_path, GOOD if search is None else {**GOOD, "search": search})
    with pytest.raises(CommandError) as error:
        require_search(path, read(path)[0])
    assert told in str(error.value)


def test_search_for_more_vehicles_than_a_town_has_room_for_is_refused(tmp_path: Path) -> None:
    ranges = {"environment.vehicles": {"low": 10, "high": 5000}}
    path = written(tmp_path, {**GOOD, "search": {**SEARCH, "ranges": ranges}})
    with pytest.raises(CommandError, match=r"environment\.vehicles is 5000, town03 has room for \d+ at most"):
        require_room_at_home(path, require_search(path, read(path)[0]))


def test_two_maps_of_one_name_are_refused_with_a_remedy(tmp_path: Path) -> None:
    maps = [tmp_path / folder / "m.xodr" for folder in ("a", "b")]
    for path in maps:
        path.parent.mkdir()
        shutil.copy(TOWNS / "town02.xodr", path)
    with pytest.raises(CommandError) as refused:
        read(written(tmp_path, changed(planners=["athrl"], towns=list(map(str, maps)))))
    for told in (*map(str, maps), "would both be named athrl-m-1", "rename a map or a variant"):
        assert told in str(refused.value)


def test_every_row_has_a_run_before_any_has_its_second(tmp_path: Path) -> None:
    variants = {"plain": [], "far": ["planner.n_step=5"]}
    _, runs = read(written(tmp_path, changed(variants=variants)))
    assert len(runs) == 2 * 2 * 2
    assert [run.seed for run in runs] == [1] * 4 + [2] * 4
    assert {run.settings.planner.values()["n_step"] for run in runs if run.row.variant == "far"} == {5}


def test_a_run_in_several_towns_is_one_row(tmp_path: Path) -> None:
    _, runs = read(written(tmp_path, changed(planners=["hddpg"], towns=["town03", ["town02", "town04"]])))
    assert [run.name for run in runs[:2]] == ["hddpg-town03-1", "hddpg-town02-town04-1"]
    assert list(runs[1].settings.environment.towns) == ["town02", "town04"]
    assert runs[1].row.town == "town02+town04"


def test_the_papers_study_has_its_four_planners_and_is_run_by_its_recipe() -> None:
    _, runs = read(ROOT / "studies" / "paper.toml")
    rows = {(run.row.planner, run.row.town) for run in runs}
    in_town03 = {(planner, "town03") for planner in ("ddpg", "hdqn", "hddpg", "athrl")}
    assert rows == in_town03 | {(p, t) for p in ("hdqn", "athrl") for t in ("town02", "town04")}
    assert all(
        [run.seed for run in runs if (run.row.planner, run.row.town) == row] == [1, 2, 3, 4, 5]
        for row in rows
    )
    for run in runs:
        preset = read_run_file(ROOT / "presets" / f"paper-{run.row.planner}-{run.row.town}.toml")
        assert run.settings.planner == preset.planner
        assert run.settings.learner == preset.learner
        assert run.settings.run.environment_steps == 40_000


@pytest.mark.parametrize(("name", "count"), [("default", 44), ("generalisation", 15), ("ablations", 33)])
def test_the_studies_of_the_results_page_can_be_run(name: str, count: int) -> None:
    study, runs = read(ROOT / "studies" / f"{name}.toml")
    assert study.study.name == name
    assert len(runs) == count


def test_the_short_study_is_valid_also_as_a_search() -> None:
    path = ROOT / "studies" / "short.toml"
    study, runs = read(path)
    require_search(path, study)
    assert len(runs) == 4


@pytest.fixture
def begun(tmp_path: Path) -> StudyFolder:
    folder = StudyFolder(tmp_path / "out")
    with folder.locked():
        folder.claim(*read(written(tmp_path, elsewhere(town="town04"))))
    return folder


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ({**GOOD, "study": {"name": "two", "seeds": [1, 2]}}, "study was begun as one, should be two"),
        (elsewhere(town="town02"), "elsewhere there, town was begun as town04, should be town02"),
        ({**GOOD, "scoring": {"episodes": 7}}, "scoring, episodes was begun as 100, should be 7"),
        (
            changed(settings=["learner.batch=64"]),
            "run ddpg-town03-1, settings was begun as [], should be ['learner.batch=64']",
        ),
    ],
)
def test_folder_of_another_study_is_refused(
    tmp_path: Path, begun: StudyFolder, content: dict[str, Any], told: str
) -> None:
    with begun.locked(), pytest.raises(CommandError, match="holds another study") as error:
        begun.claim(*read(written(tmp_path, content)))
    assert told in str(error.value)


def test_seeds_rows_and_places_may_be_added_to_a_study(tmp_path: Path, begun: StudyFolder) -> None:
    more = {**elsewhere(town="town04"), "study": {"name": "one", "seeds": [1, 2, 3]}}
    more["elsewhere"].append({"name": "case", "case_study": "roundabout"})
    with begun.locked():
        begun.claim(*read(written(tmp_path, more)))
        begun.claim(*read(written(tmp_path, GOOD)))


def test_changed_run_file_makes_it_another_study(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_text("[learner]\nbatch = 64\n")
    path = written(tmp_path, changed(run_file="run.toml"))
    folder = StudyFolder(tmp_path / "out")
    with folder.locked():
        folder.claim(*read(path))
        (tmp_path / "run.toml").write_text("[learner]\nbatch = 128\n")
        with pytest.raises(CommandError, match="run ddpg-town03-1, run_file was begun as"):
            folder.claim(*read(path))


def test_folder_with_other_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").write_text("")
    with pytest.raises(CommandError, match="holds other files and no study"), StudyFolder(tmp_path).locked():
        pass


def test_study_is_begun_though_the_disk_was_full_or_another_worker_begins_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    folder, wanted = StudyFolder(tmp_path / "out"), read(written(tmp_path, GOOD))
    with monkeypatch.context() as patched:
        patched.setattr("os.replace", full)
        with folder.locked(), pytest.raises(CommandError, match="no space left on device"):
            folder.claim(*wanted)
    assert [each.name for each in folder.path.iterdir()] == ["study.lock"]
    (folder.path / "begun.json.7.part").write_text("{")
    with folder.locked():
        folder.claim(*wanted)


def test_folder_that_cannot_be_locked_is_not_said_to_be_in_use(
    begun: StudyFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    def without_locks(*_: object) -> None:
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", without_locks)
    with pytest.raises(CommandError, match="cannot be locked: no locks available; mount"), begun.locked():
        pass


def test_two_processes_do_not_work_on_the_same_grid(begun: StudyFolder) -> None:
    with begun.locked(), pytest.raises(CommandError, match="another athrl study works in it"), begun.locked():
        pass


def test_several_workers_of_a_search_share_a_folder(begun: StudyFolder) -> None:
    refused = pytest.raises(CommandError, match="another athrl study works in it")
    with begun.locked(shared=True), begun.locked(shared=True), refused, begun.locked():
        pass


def search_in(folder: Path) -> Search:
    """Begin or continue a search in a folder."""
    path = written(folder, GOOD | {"search": SEARCH})
    return Search(path, read(path)[0], StudyFolder(folder), threading.Event(), lambda line: None)


def test_failed_run_fails_its_trial_and_a_folder_that_cannot_be_written_ends_the_search(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    search, results = search_in(tmp_path), iter([{"failure": "ended with code 2"}])

    def run(*_: object) -> dict[str, Any]:
        for result in results:
            return result
        raise CommandError("cannot write results/t0001.json: no space left on device")

    monkeypatch.setattr("athrl.study.search.GridRunner.run", run)
    with pytest.raises(CommandError, match=r"^cannot write results/t0001\.json: no space left on device$"):
        search.run()
    trials = search.found()["trials"]
    assert [trial["state"] for trial in trials] == ["fail", "running"]  # another worker continues that
    assert trials[0]["failure"].endswith(": ended with code 2")


def test_search_of_another_version_of_optuna_ends_with_one_line(tmp_path: Path) -> None:
    search_in(tmp_path)
    with closing(sqlite3.connect(tmp_path / "search.db")) as tables, tables:
        tables.execute("UPDATE alembic_version SET version_num = 'v9.0.0.a'")
    with pytest.raises(CommandError, match=r"^the file of the search .*search\.db is of another version of"):
        search_in(tmp_path)


def test_search_whose_file_is_damaged_ends_with_one_line(tmp_path: Path) -> None:
    search = search_in(tmp_path)
    (tmp_path / "search.db").write_bytes(b"damaged" * 2000)
    told = "^the file of the search .*search.db cannot be used: file is not a database$"
    for use in (search.run, search.found, lambda: search_in(tmp_path)):
        with pytest.raises(CommandError, match=told):
            use()


def test_random_towns_with_numbers_in_a_row_are_told_in_short(tmp_path: Path) -> None:
    towns = ["town02", "random-1", "random-2", "random-3", "random-9", "random-8"]
    _, runs = read(written(tmp_path, changed(planners=["athrl"], towns=[towns])))
    assert runs[0].row.town == "town02+random-1..3+random-9+random-8"
    assert runs[0].name == "athrl-town02-random-1--3-random-9-random-8-1"
    assert list(runs[0].settings.environment.towns) == towns


def test_results_of_a_driver_in_towns_with_long_paths_can_be_written(tmp_path: Path) -> None:
    folder = StudyFolder(tmp_path / "out")
    towns = [f"/{'a long folder/' * 20}{name}.xodr" for name in ("north", "s\u00fcd")]
    names = [driver_name("rule-based", "+".join(order)) for order in (towns, towns[::-1])]
    for name in names:
        folder.note(name, {"driver": "rule-based"})
        assert folder.result(name) == {"driver": "rule-based"}
    assert names[0] != names[1]
