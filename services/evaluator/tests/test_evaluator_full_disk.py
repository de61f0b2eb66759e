"""A full disk: results are not lost, and recordings that were requested end in an error."""

import json
import shutil
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path

import pytest
from athrl_evaluator import EvaluationSettings, evaluate_driver
from athrl_evaluator.errors import EvaluatorError
from athrl_evaluator.event_files import EventFiles
from athrl_evaluator.recording.recorder import Recorder
from athrl_evaluator.scoring.drivers import ReferenceDriver
from athrl_evaluator.scoring.environments import make_batch
from athrl_evaluator.scoring.episodes import drive_episodes
from athrl_evaluator.scoring.results import ResultsFolder
from athrl_evaluator.video import Shot, film
from athrl_protocol import EvaluationResult
from athrl_protocol.run_file import EnvironmentSection
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

ENVIRONMENT = EnvironmentSection(vehicles=5, episode_ticks=40)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 64 KiB; skips where this user may mount none."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = [shutil.which("mount") or "false", "-t", "tmpfs", "-o", "size=64k", "tmpfs", folder]
    if subprocess.run(command, capture_output=True).returncode:
        pytest.skip("this user may not mount a file system")
    yield folder
    subprocess.run(["umount", folder], check=True)


def fill(disk: Path) -> Path:
    ballast = disk / "ballast"
    with ballast.open("wb", buffering=0) as file:
        while file.write(bytes(4096)) == 4096:
            if shutil.disk_usage(disk).free < 4096:
                break
    return ballast


def test_recordings_that_were_asked_for_and_do_not_fit_end_the_evaluation_and_leave_no_half_file(small_disk):
    fill(small_disk)
    settings = EvaluationSettings(episodes=2, seed=1, environment=ENVIRONMENT)
    with pytest.raises(EvaluatorError, match=r"^cannot write .*/rule-based-seed-\d\.mcap: no space left"):
        evaluate_driver("rule-based", settings, record=small_disk)
    assert not list(small_disk.glob("*.mcap*"))


def test_a_video_that_does_not_fit_leaves_no_half_file(small_disk):
    ballast = fill(small_disk)
    with pytest.raises(EvaluatorError, match=r"^cannot write .*/a.mp4: .*No space left"):
        film("blind", Shot("town02", 100, 1, 2.0, (64, 64)), small_disk / "a.mp4", threading.Event())
    assert list(small_disk.iterdir()) == [ballast]


def test_a_run_is_scored_though_its_recordings_do_not_fit(small_disk, caplog):
    fill(small_disk)
    driver = ReferenceDriver("rule-based", 2)
    recorder = Recorder(driver, small_disk, episodes=2, kept=10)
    results = drive_episodes(driver, make_batch(ENVIRONMENT, 2), [1, 2, 3], [recorder])
    assert len(results) == 3
    assert caplog.text.count("is not recorded any more") == 1
    assert not list(small_disk.glob("*.mcap*"))


def test_curves_have_a_gap_where_the_disk_was_full_and_continue_after_it(small_disk, caplog):
    files = EventFiles(small_disk / "tensorboard")
    ballast = fill(small_disk)
    (small_disk / "rest").write_bytes(bytes(shutil.disk_usage(small_disk).free))
    for step in range(50):
        files.add("learner", {"loss": float(step)}, step, 1.0)
    assert caplog.text.count("no space left on device; curves continue when it can be written") == 1
    ballast.unlink()
    files.add("learner", {"loss": 7.0}, 100, 2.0)
    read = EventAccumulator(str(small_disk / "tensorboard"))
    read.Reload()
    points = [(point.step, point.value) for point in read.Scalars("learner/loss")]
    assert points == [(100, 7.0)]


def test_a_full_disk_is_one_line_a_minute_whatever_does_not_fit(small_disk, caplog):
    folder = ResultsFolder(small_disk, "run")
    files = EventFiles(folder.tensorboard, folder.warn)
    fill(small_disk)
    (small_disk / "rest").write_bytes(bytes(shutil.disk_usage(small_disk).free))
    for step in range(20):
        files.add("learner", {"loss": float(step)}, step, 1.0)
        folder.add(EvaluationResult("policy", step, 100, "town03", 1, {"note": "x" * 5000}))
    assert caplog.text.count("cannot write") == 1


def test_a_folder_of_results_that_cannot_be_made_is_named(tmp_path: Path):
    (tmp_path / "README.md").write_text("no folder")
    with pytest.raises(EvaluatorError, match=r"^cannot write .*README\.md/run/recordings: not a directory$"):
        ResultsFolder(tmp_path / "README.md", "run")


def test_a_result_that_the_disk_does_not_take_is_written_when_there_is_room(small_disk, caplog):
    folder = ResultsFolder(small_disk, "run")
    first, second, third = (
        EvaluationResult("policy", version, 100, "town03", 1, {"note": float(version)})
        for version in range(3)
    )
    folder.add(first)
    lines = small_disk / "run" / "evaluations.jsonl"
    with lines.open("ab") as stream:  # to the end of its block, so that the next one does not fit in there
        stream.write(b" " * (4095 - lines.stat().st_size) + b"\n")
    whole, ballast = lines.read_bytes(), fill(small_disk)
    folder.add(second)
    assert lines.read_bytes() == whole
    assert "no space left on device; the result is kept for later" in caplog.text
    with pytest.raises(EvaluatorError, match=r"cannot write .*evaluation\.json: no space left"):
        folder.write_comparison("run", [first])
    assert not list(small_disk.glob("**/evaluation.json*"))
    ballast.unlink()
    folder.add(third)
    told = [json.loads(line)["policy_version"] for line in lines.read_text().splitlines() if line.strip()]
    assert told == [0, 1, 2]
