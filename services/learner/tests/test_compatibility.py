"""Resuming a run with settings that do not fit its checkpoint or log is refused, naming the settings."""

import hashlib
import shutil
import threading
from collections.abc import Callable
from pathlib import Path

import pytest
from athrl_learner import CannotResume, run_learner
from athrl_learner.errors import LearnerError
from athrl_protocol import RunFile, read_run_file, to_toml
from athrl_protocol.run_file import PlannerSection, declare_planners, declared_planners


@pytest.fixture
def stopped() -> threading.Event:
    stop = threading.Event()
    stop.set()
    return stop


@pytest.fixture(scope="module")
def never_trained(tmp_path_factory: pytest.TempPathFactory, run_file_in: Callable[[Path], RunFile]) -> Path:
    """The folder of a run that was stopped before any experience came."""
    stop = threading.Event()
    stop.set()
    return run_learner(run_file_in(tmp_path_factory.mktemp("runs")), stop=stop).folder


@pytest.fixture
def folder(never_trained: Path, run_file: RunFile) -> Path:
    """A run's folder, for each test its own, whose settings are those of `run_file`."""
    copied = Path(run_file.run.folder) / run_file.run.name
    shutil.copytree(never_trained, copied)
    (copied / "run.toml").write_text(to_toml(run_file))
    return copied


def with_planner(run_file: RunFile, **values: object) -> RunFile:
    section = PlannerSection.model_validate({**run_file.planner.model_dump(), **values})
    return run_file.model_copy(update={"planner": section})


def contents(folder: Path) -> dict[Path, str]:
    return {
        path: hashlib.sha256(path.read_bytes()).hexdigest() for path in folder.rglob("*") if path.is_file()
    }


def refusal(settings: RunFile, folder: Path, stopped: threading.Event) -> str:
    """What resuming with other settings is answered; nothing of the run has changed."""
    before = contents(folder)
    with pytest.raises(CannotResume, match="does not fit the run's settings") as refused:
        run_learner(settings, resume=folder, stop=stopped)
    assert contents(folder) == before
    assert "\n" not in str(refused.value)
    return str(refused.value)


@pytest.mark.parametrize("key", ["recurrent_features", "hidden_features", "head_features"])
def test_setting_that_the_checkpoint_does_not_fit_is_named_with_both_values(run_file, folder, stopped, key):
    before = run_file.planner.values()[key]
    line = refusal(with_planner(run_file, **{key: before + 4}), folder, stopped)
    assert line.endswith(f"; planner.{key} was {before} and is {before + 4}")


def test_run_whose_level_was_paid_otherwise_is_refused(run_file, folder, stopped):
    other = with_planner(run_file, intention_reward="progress", intention_target="experience")
    assert "planner.intention_reward was 'task' and is 'progress'" in refusal(other, folder, stopped)


@pytest.mark.parametrize("checkpoints", ["there", "removed"])
@pytest.mark.parametrize(("key", "value"), [("value_max", 30.0), ("intention_every", 2)])
def test_settings_that_give_what_was_learned_a_meaning_are_kept(
    run_file, folder, stopped, key, value, checkpoints
):
    if checkpoints == "removed":
        shutil.rmtree(folder / "checkpoints")
    line = refusal(with_planner(run_file, **{key: value}), folder, stopped)
    assert line.endswith(f"; planner.{key} was {run_file.planner.values()[key]} and is {value}")


@pytest.mark.parametrize("checkpoints", ["there", "removed"])
def test_run_of_another_planner_is_refused_by_both_kinds(run_file, folder, stopped, checkpoints):
    if checkpoints == "removed":
        shutil.rmtree(folder / "checkpoints")
    other = run_file.model_copy(update={"planner": PlannerSection.model_validate({"kind": "hdqn"})})
    line = refusal(other, folder, stopped)
    assert str(folder) in line
    assert "it was trained as athrl, planner.kind is hdqn" in line


def test_run_of_another_planner_is_refused_though_its_run_file_was_changed(run_file, folder, stopped):
    path = folder / "run.toml"
    lines = path.read_text().splitlines()
    begin = lines.index("[planner]")
    end = next(number for number in range(begin + 1, len(lines)) if lines[number].startswith("["))
    lines[begin:end] = ["[planner]", 'kind = "ddpg"', *_table("ddpg"), ""]
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(CannotResume, match="it was trained as athrl, planner"):
        run_learner(None, resume=folder, stop=stopped)


def _table(kind: str) -> list[str]:
    values = declared_planners()[kind]().model_dump()
    return [
        f"{name} = {str(value).lower() if isinstance(value, bool) else repr(value)}".replace("'", '"')
        for name, value in values.items()
    ]


@pytest.mark.parametrize("checkpoints", ["there", "removed"])
@pytest.mark.parametrize(
    ("key", "value"),
    [("image_size", 24), ("maximum_speed", 5.0), ("waypoint_half_angle", 20.0), ("speed_gain", 0.7)],
)
def test_other_sizes_or_ranges_are_refused_by_their_settings(
    run_file, folder, stopped, key, value, checkpoints
):
    if checkpoints == "removed":
        shutil.rmtree(folder / "checkpoints")
    was = getattr(run_file.environment, key)
    environment = run_file.environment.model_copy(update={key: value})
    line = refusal(run_file.model_copy(update={"environment": environment}), folder, stopped)
    assert line.endswith(f"; environment.{key} was {was!r} and is {value!r}")


def test_exploration_may_change(run_file, folder, stopped):
    assert run_learner(with_planner(run_file, noise_high=0.6), resume=folder, stop=stopped).updates == 0


def test_planner_that_does_not_exist_is_refused_though_none_were_declared(run_file, stopped, tmp_path):
    known = declared_planners()
    declare_planners({})
    try:
        unchecked = [
            read_run_file(None, [f"run.folder={tmp_path}", *wrong])
            for wrong in (
                ["planner.kind=atrhl"],
                ["planner.kind=ddpg", "planner.momentum=0.5"],
                ["planner.kind=ddpg", "planner.tau=2"],
            )
        ]
        said = []
        for run_file in unchecked:
            with pytest.raises(LearnerError) as refused:
                run_learner(run_file, stop=stopped)
            said.append(str(refused.value))
    finally:
        declare_planners(known)
    assert "did you mean athrl" in said[0]
    assert "momentum" in said[1]
    assert "tau" in said[2]
    assert not any("\n" in line for line in said)
    assert not list(tmp_path.iterdir())


def test_planners_are_known_to_whoever_resumes_without_declaring_any(run_file, folder, stopped):
    known = declared_planners()
    declare_planners({})
    try:
        run_learner(None, resume=folder, stop=stopped)
        assert set(declared_planners()) >= {"athrl", "hddpg", "ddpg", "hdqn"}
    finally:
        declare_planners(known)


@pytest.mark.parametrize("setting", [{"n_step": 6}, {"intention_every": 6}])
def test_planner_that_looks_beyond_its_sequences_is_refused_before_anything_is_written(
    run_file, stopped, setting
):
    with pytest.raises(
        LearnerError, match=r"looks 6 decisions ahead, in sequences of replay\.sequence_length = 5"
    ):
        run_learner(with_planner(run_file, **setting), stop=stopped)
    assert not (Path(run_file.run.folder) / run_file.run.name / "run.toml").exists()
