"""docs/results.md is what the studies' files say; a study that was not run is there without figures."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

from benchmarks import studies_page

MADE = {"version": "1", "commit": "abc1234", "date": "2026-01-01", "cores": 1, "processor": "a processor"}
LATER = {**MADE, "commit": "def5678", "date": "2026-01-03"}
SCORE = {"mean": 3000.0, "low": 2900.0, "high": 3100.0, "values": [2900.0, 3100.0]}
FOUND: dict[str, Any] = {
    "study": "paper",
    "title": "The paper's comparison",
    "scoring": {"episodes": 200, "first_seed": 700_000},
    "rows": [
        {
            "planner": "athrl", "town": "town03", "variant": "", "seeds": [1, 2], "finished": [1, 2],
            "failed": [], "decisions": 40_000, "seconds": 3600.0, "training": {"return_mean": SCORE},
            "published": {"return_mean": 148.6}, "scores": {"return_mean": SCORE},
        }
    ],
    "over_towns": [],
    "drivers": [],
    "failures": {},
    "runs": [
        {"run": "athrl-town03-1", "seconds": 3600.0, "made": MADE},
        {"run": "athrl-town03-2", "seconds": None, "made": LATER},
        {"run": "athrl-town03-3", "failure": "no such device"},
    ],
}  # fmt: skip


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A repository with nothing but the studies, their presets and the page."""
    for folder in ("studies", "presets"):
        shutil.copytree(studies_page.ROOT / folder, tmp_path / folder)
    (tmp_path / "docs" / "pictures").mkdir(parents=True)
    shutil.copy(studies_page.ROOT / studies_page.PAGE, tmp_path / studies_page.PAGE)
    shutil.rmtree(tmp_path / "studies" / "results", ignore_errors=True)
    return tmp_path


def results(root: Path, content: str) -> None:
    folder = root / "studies" / "results"
    folder.mkdir()
    (folder / "paper.json").write_text(content)


def test_the_page_is_what_the_studies_say() -> None:
    assert studies_page.main(["--check"]) == 0


def test_study_that_was_not_run_has_published_figures_and_no_others(copy: Path) -> None:
    assert studies_page.main([], copy) == 0
    text = (copy / studies_page.PAGE).read_text()
    assert "Not measured yet" in text
    assert "| athrl | town03 | 0 of 5 | 149 | 4.98 |  |  |  |  |  |  |" in text


def test_measured_study_says_how_it_was_made_and_what_it_cost(
    copy: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    results(copy, json.dumps(FOUND))
    assert studies_page.main(["--check"], copy) == 1
    assert "stale: docs/results.md" in capsys.readouterr().err
    assert studies_page.main([], copy) == 0
    text = (copy / studies_page.PAGE).read_text()
    assert "| athrl | town03 | 2 of 2 | 3000 [2900, 3100] | 149 | 3000 [2900, 3100] |" in text
    assert "commit abc1234, def5678; 2026-01-01 to 2026-01-03; each run on 1 core of a processor; " in text
    assert "1.0 hours of training, without 1 runs" in text


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ("{", "paper.json: "),
        (json.dumps({**FOUND, "study": "short"}), "study is 'short', should be 'paper'"),
        (json.dumps({**FOUND, "runs": [{"run": "athrl-town03-1", "seconds": 1.0}]}), "lacks 'made'"),
    ],
)
def test_damaged_results_are_refused_in_one_line(
    copy: Path, capsys: pytest.CaptureFixture[str], content: str, told: str
) -> None:
    results(copy, content)
    assert studies_page.main([], copy) == 2
    said = capsys.readouterr().err
    assert told in said
    assert said.count("\n") == 1
