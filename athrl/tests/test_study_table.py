"""The table of a study says what its runs came to, with failures, and intervals that hold."""

from __future__ import annotations

import csv
import io
import json
import statistics
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from athrl.runs import declare_installed_planners
from athrl.study import learning
from athrl.study.curves import over_seeds, picture
from athrl.study.file import SCORES, ElsewhereSection, StudyFile
from athrl.study.folder import StudyFolder
from athrl.study.plan import planned_runs
from athrl.study.statistics import estimate
from athrl.study.table import as_csv, markdown, tabulated
from athrl_evaluator.event_files import EventFiles
from athrl_protocol.run_file import declare_planners, declared_planners

STUDY = StudyFile.model_validate(
    {
        "study": {"name": "made-up", "seeds": [1, 2, 3], "drivers": ["rule-based"]},
        "grid": [{"planners": ["athrl", "ddpg"], "towns": ["town02", "town03"]}],
        "published": [{"planner": "athrl", "town": "town03", "return_mean": 148.6, "speed_mps": 4.98}],
    }
)


@pytest.fixture(autouse=True, scope="module")
def _planners() -> Any:
    before = declared_planners()
    declare_installed_planners()
    yield
    declare_planners(before)


@pytest.fixture
def found(tmp_path: Path) -> dict[str, Any]:
    """What is found of a study in which two runs of DDPG in town02 failed and one has not ended."""
    folder = StudyFolder(tmp_path / "out")
    runs = planned_runs(tmp_path / "study.toml", STUDY)
    for number, run in enumerate(runs):
        facts = {
            "run": run.name,
            "planner": run.row.planner,
            "town": run.row.town,
            "variant": "",
            "seed": run.seed,
        }
        if (run.row.planner, run.row.town) == ("ddpg", "town02"):
            if run.seed > 1:
                folder.note(run.name, {**facts, "failure": "ended with code 2: no such device"})
            continue
        scores = dict.fromkeys(SCORES, 0.5) | {"return_mean": 1000.0 + 10 * number}
        curve = [[100, 10.0 * run.seed], [200, 20.0 * run.seed]]
        folder.note(
            run.name,
            {
                **facts, "decisions": 300, "seconds": 60.0, "scores": scores,
                "training": {"return_mean": 100.0 * run.seed, "speed_mps": 2.0},
                "curves": {"training": curve, "greedy": curve},
            },
        )  # fmt: skip
    for town in ("town02", "town03"):
        scores = dict.fromkeys(SCORES, 1.0)
        folder.note(f"driver-rule-based-{town}", {"driver": "rule-based", "town": town, "scores": scores})
    return tabulated(STUDY, runs, folder)


def test_table_has_means_intervals_published_figures_and_what_failed(found: dict[str, Any]) -> None:
    lines = markdown(found).splitlines()
    row = next(line for line in lines if line.startswith("| athrl | town03"))
    assert "| 3 of 3 | 200 [100, 300] | 2.00 [2.00, 2.00] | 149 | 4.98 | " in row
    assert next(line for line in lines if line.startswith("| ddpg | town02")).startswith(
        "| ddpg | town02 | 0 of 3 |"
    )
    assert sum(line.startswith("| rule-based") for line in lines) == 2
    assert lines.count("- ddpg-town02-2 failed: ended with code 2: no such device") == 1
    assert any(line.startswith("- athrl over town02, town03: greedy return ") for line in lines)
    assert not any(line.startswith("- ddpg over") for line in lines)  # town02 is missing
    assert len({line.count("|") for line in lines if line.startswith("|")}) == 1


def test_place_elsewhere_has_a_table_with_the_share_of_the_rule_based_return(tmp_path: Path) -> None:
    study = STUDY.model_copy(
        update={"elsewhere": [ElsewhereSection(name="crowded", town="town04", vehicles=150, episodes=40)]}
    )
    folder = StudyFolder(tmp_path / "out")
    runs = planned_runs(tmp_path / "study.toml", study)
    scores = dict.fromkeys(SCORES, 0.5)
    for run in runs[:3]:
        facts = {"run": run.name, "seed": run.seed, "seconds": 60.0, "training": {}}
        folder.note(run.name, {**facts, "scores": scores | {"return_mean": 1800.0}})
        folder.note(f"{run.name}@crowded", {"run": run.name, "scores": scores | {"return_mean": 900.0}})
    folder.note(f"{runs[3].name}@crowded", {"run": runs[3].name, "failure": "ended with code 1: no room"})
    rule_based = {"driver": "rule-based", "place": "crowded", "scores": scores | {"return_mean": 1000.0}}
    folder.note("driver-rule-based@crowded", rule_based)
    lines = markdown(tabulated(study, runs, folder)).splitlines()
    assert "town04 with 150 vehicles, 40 episodes." in lines
    own = lines[lines.index("### Elsewhere: crowded") :]
    finished = [line for line in own if line.endswith("| 0.50 | 0.90 |")]
    assert sum(int(line.split("|")[3].split()[0]) for line in finished) == 3
    assert any(line.startswith("| rule-based |") for line in own)
    assert f"- {runs[3].name} in crowded failed: ended with code 1: no room" in lines


def test_csv_has_a_line_for_each_run_that_ended(found: dict[str, Any]) -> None:
    rows = {row["run"]: row for row in csv.DictReader(io.StringIO(as_csv(found)))}
    assert len(rows) == 11
    assert rows["ddpg-town02-3"]["failure"] == "ended with code 2: no such device"
    assert float(rows["athrl-town03-2"]["training_return_mean"]) == 200.0


def test_what_is_found_is_json_and_has_a_picture(found: dict[str, Any]) -> None:
    content = picture(json.loads(json.dumps(found)))
    assert content is not None
    assert content.startswith(b"\x89PNG")
    assert picture({"runs": []}) is None


def test_interval_is_that_of_the_mean() -> None:
    values = np.random.default_rng(1).normal(100.0, 10.0, 400).tolist()
    found = estimate([values])
    half = 1.96 * statistics.stdev(values) / 20
    assert found.low == pytest.approx(found.mean - half, abs=0.15 * half)
    assert found.high == pytest.approx(found.mean + half, abs=0.15 * half)


def test_seeds_are_drawn_within_their_town() -> None:
    apart = estimate([[0.0, 1.0, 2.0], [1000.0, 1001.0, 1002.0]])
    assert apart.mean == 501.0
    assert 500.0 <= (apart.low or 0.0) < 501.0 < (apart.high or 0.0) <= 502.0


def test_single_seed_has_no_interval() -> None:
    assert (estimate([[5.0]]).low, estimate([[5.0]]).high) == (None, None)
    assert estimate([[5.0, 5.0]]).low == 5.0


def test_training_averages_are_of_what_actors_reported_after_the_warm_up(tmp_path: Path) -> None:
    files = EventFiles(tmp_path / "tensorboard")
    for step, value, actor in ((50, -900.0, 1), (200, 10.0, 1), (300, 20.0, 2), (400, 30.0, 1)):
        files.add(f"actor/actor-{actor}", {"return_mean": value, "speed": value / 10}, step, time.time())
        files.add("learner/learner", {"return_mean": 7e7}, step, time.time())
    curves = learning.training_curves(tmp_path)
    assert learning.averages(curves, after=100) == {"return_mean": 20.0, "speed_mps": 2.0}
    assert learning.averages(curves, after=1000) == {}


def test_half_written_and_other_lines_of_evaluations_are_left_out(tmp_path: Path) -> None:
    scores = {"return_mean": 5.0}
    lines = [
        {"driver": "policy", "environment_steps": 200, "scores": scores},
        {"driver": "random", "environment_steps": 200, "scores": scores},
        {"driver": "policy", "environment_steps": 100, "scores": scores},
    ]
    text = "".join(json.dumps(line) + "\n" for line in lines) + '{"driver": "pol'
    (tmp_path / "evaluations.jsonl").write_text(text)
    assert learning.scores_on_the_way(tmp_path) == [(100, 5.0), (200, 5.0)]
    assert learning.scores_on_the_way(tmp_path / "none") == []


def test_kept_curve_is_bounded_and_keeps_its_mean() -> None:
    curve = [(step, float(step)) for step in range(0, 100_000, 10)]
    kept = learning.thinned(curve, 100_000)
    assert len(kept) == learning.POINTS
    assert statistics.fmean(value for _, value in kept) == pytest.approx(49_995.0)


def test_curves_of_seeds_are_compared_at_the_same_decisions() -> None:
    steps, means = over_seeds([[[0, 0.0], [100, 10.0]], [[50, 15.0], [150, 35.0]]])
    assert (steps[0], steps[-1]) == (50.0, 100.0)
    assert (means[0].mean, means[-1].mean) == (10.0, 17.5)
