"""A study by the command: real runs, a failure among them, stops and kills on the way, and a search."""

from __future__ import annotations

import json
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from athrl.train.plan import usable_cores

from tests.conftest import TINY

pytestmark = pytest.mark.timeout(900)

SECONDS = 500.0
SERIAL = {"serial.enabled": "true", "learner.samples_per_insert": 1.0}


@pytest.fixture
def study(tmp_path: Path) -> Callable[..., Path]:
    """Writes a study of H-DDPG in town03, by default with one seed, of runs that last seconds."""

    def write(more: str = "", seeds: str = "[1]", **changes: Any) -> Path:
        settings = {**TINY, "run.environment_steps": 400, **changes}
        given = json.dumps([f"{key}={value}" for key, value in settings.items()])
        path = tmp_path / "study.toml"
        path.write_text(
            f'[study]\nname = "tiny"\nseeds = {seeds}\nsettings = {given}\n'
            f'[scoring]\nepisodes = 2\n[[grid]]\nplanners = ["hddpg"]\ntowns = ["town03"]\n{more}\n'
        )
        return path

    return write


def result(folder: Path, run: str = "hddpg-town03-1") -> dict[str, Any]:
    return dict(json.loads((folder / "results" / f"{run}.json").read_text()))


def test_study_trains_and_scores_each_run_and_goes_on_after_one_that_failed(
    command, study, tmp_path: Path
) -> None:
    variants = 'variants = {plain = [], large = ["replay.capacity=1000000000000"]}'
    # Long enough that an actor reports, once a second, after the random decisions.
    elsewhere = '[[elsewhere]]\nname = "quiet"\ntown = "town02"\nvehicles = 5'
    file = study(f"{variants}\n{elsewhere}", **{"run.environment_steps": 1500})
    done = command.run("study", str(file), "--out", "out", "--jobs", "2", seconds=SECONDS)
    assert done.returncode == 1, done.stderr
    finished = result(tmp_path / "out", "hddpg-town03-plain-1")
    assert {"return_mean", "speed_mps", "collision_rate"} <= finished["scores"].keys()
    assert {"return_mean"} <= finished["training"].keys() <= {"return_mean", "speed_mps"}
    assert finished["seconds"] > 0
    assert result(tmp_path / "out", "hddpg-town03-plain-1@quiet")["scores"]["return_mean"] != 0
    assert "| hddpg, plain | town03 | 1 of 1 |" in done.stdout.partition("### Elsewhere: quiet")[2]
    failed = "hddpg-town03-large-1 failed: ended with code 2: replay.capacity is 1000000000000"
    assert f"- {failed}" in (tmp_path / "out" / "table.md").read_text()
    assert "| hddpg, plain | town03 | 1 of 1 |" in done.stdout
    assert finished["made"]["cores"] == max(1, usable_cores() // 2)
    assert (tmp_path / "out" / "curves.png").read_bytes().startswith(b"\x89PNG")
    assert not command.left()


def test_killed_study_continues_its_run_and_leaves_nothing(
    command, study, eventually, tmp_path: Path
) -> None:
    file, out = study(**{"run.environment_steps": 1500}), tmp_path / "out"
    run = out / "runs" / "hddpg-town03-1"
    first = command.start("study", str(file), "--out", "out")
    eventually(lambda: list((run / "checkpoints").glob("*/manifest.json")), SECONDS)
    first.kill()
    done = command.run("study", str(file), "--out", "out", seconds=SECONDS)
    assert done.returncode == 0, done.stderr
    assert "resuming" in (run / "logs" / "learner.log").read_text().lower()
    assert result(out)["decisions"] == 1500
    assert result(out)["seconds"] is None  # of a run in several pieces they are not known
    eventually(lambda: not command.left(), 60)


def test_stopped_study_drains_its_run_and_says_how_to_continue(
    command, study, eventually, tmp_path: Path
) -> None:
    file, out = study(seeds="[1, 2]", **SERIAL, **{"run.environment_steps": 100_000}), tmp_path / "out"
    run = out / "runs" / "hddpg-town03-1"
    process = command.start("study", str(file), "--out", "out")
    eventually(lambda: list((run / "checkpoints").glob("*/manifest.json")), SECONDS)
    process.send_signal(signal.SIGTERM)
    assert process.wait(timeout=200) == 130, command.said(process)
    assert "to continue: " in command.said(process)
    assert not (out / "results").exists()
    assert "hddpg-town03-2" not in command.said(process)  # which was not begun
    assert "| hddpg | town03 | 0 of 2 |" in (out / "table.md").read_text()
    assert not command.left()


def test_two_workers_share_a_search_and_a_killed_ones_trial_is_continued(
    command, study, eventually, tmp_path: Path
) -> None:
    ranges = '"planner.n_step" = {low = 1, high = 3}\n"planner.loss" = ["squared", "huber"]'
    file = study(f"[search]\ntrials = 2\n[search.ranges]\n{ranges}", **SERIAL)
    words, out = ("study", "--optimise", str(file), "--out", "out"), tmp_path / "out"
    killed = command.start(*words)
    eventually(lambda: (out / "logs" / "t0000-hddpg-town03-1.log").exists(), SECONDS)
    killed.kill()
    for done in command.run_together([list(words), list(words)], seconds=SECONDS):
        assert done.returncode == 0, done.stderr
    found = json.loads((out / "search.json").read_text())
    assert [trial["state"] for trial in found["trials"]] == ["complete"] * 2
    assert found["best"]["value"] == max(trial["value"] for trial in found["trials"])
    for trial in found["trials"]:
        scores = result(out, f"t{trial['trial']:04d}-hddpg-town03-1")["scores"]
        assert trial["value"] == scores["return_mean"]


def test_a_study_that_is_wrong_starts_nothing(command, study, tmp_path: Path) -> None:
    file = study()
    file.write_text(file.read_text().replace("hddpg", "hdpg"))
    done = command.run("study", str(file), "--out", "out", seconds=100)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "did you mean hddpg?" in done.stderr
    assert not (tmp_path / "out").exists()
