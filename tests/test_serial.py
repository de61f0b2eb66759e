"""A serial run is repeatable bit for bit: repeated, or stopped, interrupted or killed and resumed."""

import random
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from athrl_driving.policy import EnvironmentRaised
from athrl_evaluator import scorer
from athrl_learner import CannotResume
from athrl_learner.checkpoint import newest_intact_checkpoint
from athrl_learner.log import numbered_segments
from athrl_protocol.run_file import read_run_file

from tests.serial_runs import drive_serially, everything, require_equal, torch_left_as_it_was

pytestmark = pytest.mark.timeout(300)

SECONDS = 120.0

# Episodes end, the replay's ring goes round, checkpoints, publications and scores come several times.
TINY = (
    "serial.enabled=true",
    "run.environment_steps=640",
    "environment.vehicles=10",
    "environment.episode_ticks=120",
    "exploration.random_decisions=100",
    "planner.hidden_features=16",
    "planner.head_features=16",
    "planner.atoms=11",
    "planner.memory=lstm",
    "planner.recurrent_features=8",
    "planner.shared_trunk=false",
    "replay.capacity=300",
    "replay.sequence_length=10",
    "replay.burn_in=2",
    "learner.batch=40",
    "learner.samples_per_insert=4",
    "learner.publish_seconds=0.5",
    "learner.checkpoint_seconds=1",
    "actor.environments=3",
    "evaluator.episodes=2",
    "evaluator.final_episodes=2",
    "evaluator.seconds_between=1.5",
    "serial.trace_updates=5",
)


def arguments(folder: Path, name: str, *more: str) -> list[str]:
    settings = [*TINY, f"run.folder={folder}", *more]
    return ["train", "--name", name, *(word for setting in settings for word in ("--set", setting))]


@pytest.fixture(scope="module", autouse=True)
def torch_as_it_was() -> Iterator[None]:
    with torch_left_as_it_was():
        yield


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of all runs, with an uninterrupted one in it: `whole`."""
    folder = tmp_path_factory.mktemp("serial")
    assert drive(folder, "whole")
    return folder


def drive(folder: Path, name: str, *more: str, resume: bool = False, stop_at: int | None = None) -> bool:
    """Drive a run in this process, new or resumed; return whether it reached its end."""
    return drive_serially(folder, name, (*TINY, *more), resume=resume, stop_at=stop_at)


def require_same_run(runs: Path, name: str) -> None:
    whole, other = everything(runs / "whole"), everything(runs / name)
    assert whole["state"]["updates"] > 50
    assert len(whole["replay"]["images"]) == 30  # the ring is full, and has gone round
    require_equal(whole, other)


def updates(folder: Path) -> int:
    """How far a run's trace is."""
    trace = folder / "trace.txt"
    lines = trace.read_text().splitlines() if trace.exists() else []
    return int(lines[-1].split(",")[0].removeprefix("update ")) if lines and "end" not in lines[-1] else 0


def test_same_settings_are_the_same_run_bit_for_bit(runs: Path) -> None:
    assert drive(runs, "again")
    require_same_run(runs, "again")


def test_another_seed_is_another_run_and_scores_do_not_touch_it(runs: Path) -> None:
    drive(runs, "unscored", "evaluator.seconds_between=1000", stop_at=250)
    drive(runs, "other", "run.seed=2", stop_at=250)
    whole = (runs / "whole" / "trace.txt").read_text()
    assert whole.startswith((runs / "unscored" / "trace.txt").read_text())
    assert (runs / "other" / "trace.txt").read_text().splitlines()[0] not in whole


def test_score_that_fails_costs_that_score_and_does_not_touch_the_run(
    runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drive_episodes, calls = scorer.drive_episodes, []

    def fail_once(*arguments: Any) -> Any:
        calls.append(1)
        if len(calls) == 1:
            raise EnvironmentRaised("step raised ZeroDivisionError: a lane without length", [0])
        return drive_episodes(*arguments)

    monkeypatch.setattr(scorer, "drive_episodes", fail_once)
    assert drive(runs, "one-score-less")
    whole, ours = runs / "whole", runs / "one-score-less"
    later = (whole / "evaluations.jsonl").read_text().partition("\n")[2]
    scores = (ours / "evaluations.jsonl").read_text()
    assert scores
    assert later.startswith(scores)
    assert "was not scored: step raised" in (ours / "logs" / "serial.log").read_text()
    assert (whole / "trace.txt").read_text().startswith((ours / "trace.txt").read_text())


def test_two_halves_equal_the_whole_bit_for_bit(command, runs: Path) -> None:
    first = command.run(*arguments(runs, "halves"), "--stop-at", "300", seconds=SECONDS)
    assert first.returncode == 0, first.stderr
    assert "--stop-at" in first.stderr
    steps = newest_intact_checkpoint(runs / "halves" / "checkpoints")[1].state["environment_steps"]
    assert 300 <= steps < 330
    second = command.run("train", "--resume", str(runs / "halves"), seconds=SECONDS)
    assert second.returncode == 0, second.stderr
    assert "rule-based" in second.stdout
    require_same_run(runs, "halves")


@pytest.mark.slow
def test_stops_at_random_places_change_nothing(runs: Path) -> None:
    places = sorted(random.Random(5).sample(range(1, 600), 7))
    for turn, place in enumerate(places):
        assert not drive(runs, "pieces", resume=turn > 0, stop_at=place)
    assert drive(runs, "pieces", resume=True)
    require_same_run(runs, "pieces")


def test_finished_run_repeats_its_comparison_and_changes_nothing(runs: Path) -> None:
    shutil.copytree(runs / "whole", runs / "finished")
    (runs / "finished" / "evaluation.json").unlink()
    assert drive(runs, "finished", resume=True)
    require_same_run(runs, "finished")


def interrupt(command, runs: Path, name: str, how: signal.Signals, *, when: Callable[[], bool]) -> None:
    """Run the command, from the beginning or on, and send it a signal in the middle."""
    begun = (runs / name / "run.toml").exists()
    run = command.start(*(["train", "--resume", str(runs / name)] if begun else arguments(runs, name)))
    deadline = time.monotonic() + SECONDS
    while not when():
        assert time.monotonic() < deadline, command.said(run)
        assert run.poll() is None, command.said(run)
        time.sleep(0.005)
    run.send_signal(how)
    assert run.wait(timeout=60) == (-how if how == signal.SIGKILL else 130), command.said(run)
    assert (how == signal.SIGKILL) != ("stopping after this round" in command.said(run))


def test_terminated_run_repeats_itself(command, runs: Path) -> None:
    interrupt(command, runs, "terminated", signal.SIGTERM, when=lambda: updates(runs / "terminated") >= 25)
    assert drive(runs, "terminated", resume=True)
    require_same_run(runs, "terminated")


@pytest.mark.slow
def test_killed_run_repeats_itself(command, runs: Path) -> None:
    folder = runs / "killed"

    def written() -> int:
        found = newest_intact_checkpoint(folder / "checkpoints")
        return found[1].state["updates"] if found is not None else 0

    # Once before there is any checkpoint, once behind one.
    begun = folder / "experience" / "segment-00000001.log"
    interrupt(command, runs, "killed", signal.SIGKILL, when=lambda: begun.exists())
    assert written() == 0
    interrupt(command, runs, "killed", signal.SIGKILL, when=lambda: updates(folder) >= 30)
    assert 0 < written() < updates(folder)  # what came after the checkpoint is there
    assert not drive(runs, "killed", resume=True, stop_at=1)  # at once, so nothing comes instead
    assert updates(folder) == written()
    newest = newest_intact_checkpoint(folder / "checkpoints")[1]
    assert max(numbered_segments(folder / "experience")) < newest.log.next_segment
    assert drive(runs, "killed", resume=True)
    require_same_run(runs, "killed")


def test_kinds_of_runs_are_told_apart_in_one_line(command, runs: Path) -> None:
    whole = str(runs / "whole")
    distributed = runs / "distributed"
    shutil.copytree(runs / "whole", distributed)
    text = (distributed / "run.toml").read_text()
    (distributed / "run.toml").write_text(text.replace("enabled = true", "enabled = false"))
    calls = {
        "environment.ticks_per_decision was 4, is 5: a serial run can only be resumed with the same": [
            *("train", "--resume", whole, "--set", "environment.ticks_per_decision=5"),
        ],
        "environment.towns was": ["train", "--resume", whole, "--set", "environment.towns=town02"],
        "has no separate learner": ["learner", "--resume", whole],
        "can only be resumed as one": ["train", "--resume", whole, "--set", "serial.enabled=false"],
        "hold no environments": ["train", "--serial", "--resume", str(distributed)],
        "of a serial run": ["learner", "--resume", str(distributed)],
        "--stop-at is for serial runs": ["train", "--stop-at", "5"],
        "one actor": [*arguments(runs, "two"), "--actors", "2"],
    }
    results = command.run_together(list(calls.values()), seconds=SECONDS)
    for words, result in zip(calls, results, strict=True):
        assert result.returncode == 2, result.stderr
        told = [line for line in result.stderr.splitlines() if line.startswith("athrl: ")]
        assert len(told) == 1, result.stderr
        assert words in told[0], told


def test_settings_that_the_environments_do_not_fit_change_nothing(runs: Path) -> None:
    with pytest.raises(CannotResume, match="does not fit the run's settings"):
        drive(runs, "whole", "actor.environments=4", resume=True)
    with pytest.raises(CannotResume, match="is not in its earlier state"):
        drive(runs, "whole", "environment.ticks_per_decision=5", resume=True)
    assert read_run_file(runs / "whole" / "run.toml", complete=True).environment.ticks_per_decision == 4


def test_damaged_log_is_named_since_the_run_could_not_be_the_same(runs: Path) -> None:
    shutil.copytree(runs / "whole", runs / "damaged")
    segment = sorted((runs / "damaged" / "experience").glob("segment-*.log"))[-1]
    content = bytearray(segment.read_bytes())
    content[-10] ^= 1
    segment.write_bytes(content)
    with pytest.raises(CannotResume, match=r"damaged.*run\.name"):
        drive(runs, "damaged", resume=True)
