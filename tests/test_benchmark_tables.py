"""docs/benchmarks.md is what benchmarks/results say, and a damaged file there is refused in one line."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from benchmarks import tables
from benchmarks.result_tables import RESULTS, ResultsError, read_tables

PEERS = {
    "town": "town03",
    "seconds": 300.0,
    "cores": 2,
    "seed": 0,
    "episodes": 100,
    "processor": "a processor",
    "libraries": {"torch": "2"},
    "rule_based": {"return_mean": 3000, "return_ci95": 60, "collision_rate": 0, "off_lane_rate": 0,
                   "full_episode_rate": 1},
    "ours": {"return_mean": 3300, "return_ci95": 50, "collision_rate": 0.01, "off_lane_rate": 0,
             "full_episode_rate": 0.99, "decisions": 400_000, "seconds": 300.2},
    "sb3_ppo": {"error": "ended with code 1"},
}  # fmt: skip


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A repository with nothing but the results and the pages."""
    shutil.copytree(tables.ROOT / RESULTS, tmp_path / RESULTS)
    shutil.copytree(
        tables.ROOT / "docs", tmp_path / "docs", ignore=shutil.ignore_patterns("pictures", "*.py")
    )
    return tmp_path


def damage(root: Path, name: str, change: Callable[[dict[str, Any]], object]) -> None:
    file = root / RESULTS / name
    content = json.loads(file.read_text())
    change(content)
    file.write_text(json.dumps(content))


def test_the_pages_are_what_the_results_say() -> None:
    assert tables.stale_pages(tables.ROOT) == []


@pytest.mark.parametrize(
    ("name", "change", "told"),
    [
        ("traffic.json", lambda c: c.pop("rows"), "rows: should be there"),
        ("traffic.json", lambda c: c.update(colums=[]), "colums: should be one of"),
        ("traffic.json", lambda c: c.update(subject="flow"), "subject: should be the file's name, traffic"),
        ("traffic.json", lambda c: c.update(section="Other"), "section: should be one of Driving"),
        ("traffic.json", lambda c: c.update(columns="a"), "columns: should be a list"),
        ("traffic.json", lambda c: c.update(question=""), "question: should be a text of 1 to 120"),
        ("traffic.json", lambda c: c.update(date="today"), "date: should be a date"),
        ("traffic.json", lambda c: c.update(commit="HEAD"), "commit: should be 7 to 40 hexadecimal digits"),
        ("traffic.json", lambda c: c.update(notes=["x" * 121]), "notes[0]: should be a text of 1 to 120"),
        ("traffic.json", lambda c: c["rows"][1].pop(), "rows[1]: should be a list of 2 cells"),
        (
            "traffic.json",
            lambda c: c["rows"][1].__setitem__(1, True),
            "rows[1][1]: should be a text, a finite",
        ),
        ("traffic.json", lambda c: c["rows"][1].__setitem__(1, "a | b"), "rows[1][1]: should be a text of 1"),
        ("traffic.json", lambda c: c.update(page="none.md"), "page: should be a page in docs"),
        ("default-run.json", lambda c: c["runs"]["2"].pop("return_mean"), "runs.2.return_mean: should be"),
        ("default-run.json", lambda c: c.pop("rule_based"), "rule_based: should be a JSON object"),
        ("hierarchy/default-1.json", lambda c: c.update(seed="one"), "seed: should be a finite number"),
        ("raw.json", lambda c: c["hierarchy"].update(date=1), "hierarchy.date: should be a date"),
    ],
)
def test_a_damaged_file_is_refused_in_one_line(
    copy: Path,
    capsys: pytest.CaptureFixture[str],
    name: str,
    change: Callable[[dict[str, Any]], object],
    told: str,
) -> None:
    damage(copy, name, change)
    assert tables.main(["--check"], copy) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"benchmarks/results/{name}: {told}")
    assert error.count("\n") == 1


@pytest.mark.parametrize("text", ["{", "[]", '{"subject": \x00}'])
def test_a_file_that_is_no_json_object_is_refused(copy: Path, text: str) -> None:
    (copy / RESULTS / "flow.json").write_text(text)
    with pytest.raises(ResultsError, match=r"^benchmarks/results/flow\.json: file: should be [^\n]*$"):
        read_tables(copy)


def test_commands_are_those_that_give_these_figures(copy: Path) -> None:
    damage(copy, "default-run.json", lambda content: content.update(settings=["learner.threads=1"]))
    how = {"how": {"settings": ["learner.threads=2"]}}
    peers = PEERS | {"ours": PEERS["ours"] | how, "rllib_ppo": PEERS["sb3_ppo"]}
    (copy / RESULTS / "peers-5.json").write_text(json.dumps(peers))
    read = read_tables(copy)
    assert read["default-run"].command.endswith("--seeds 1 2 3 --set learner.threads=1")
    assert read["peers-5"].command.endswith("--seed 0 --with rllib --set learner.threads=2")
    trials = [json.loads(path.read_text()) for path in sorted((copy / RESULTS / "hierarchy").glob("*.json"))]
    for trial in trials:
        for option, key in (("variants", "variant"), ("seeds", "seed"), ("decisions", "decisions")):
            asked = read["hierarchy"].command.partition(f"--{option} ")[2].partition(" --")[0]
            assert str(trial[key]) in asked.split()


def test_a_stale_page_is_told_and_written(copy: Path, capsys: pytest.CaptureFixture[str]) -> None:
    damage(copy, "traffic.json", lambda content: content["rows"].append(["another", 12345]))
    assert tables.main(["--check"], copy) == 1
    assert "docs/benchmarks.md" in capsys.readouterr().err
    assert tables.main([], copy) == 0
    assert "| another | 12,345 |" in (copy / tables.PAGE).read_text()
    assert tables.main(["--check"], copy) == 0


def test_another_page_gets_the_tables_that_it_marks(copy: Path) -> None:
    page = copy / "docs" / "reference" / "marked.md"
    markers = "<!-- {0} -->\nold\n<!-- /{0} -->\n"
    page.write_text("".join(map(markers.format, ("peers-5", "peers-99", "flow", "unknown"))))
    (copy / RESULTS / "peers-5.json").write_text(json.dumps(PEERS))
    assert tables.main([], copy) == 0
    text = page.read_text()
    assert "| athrl, default run | 400,000 | 300 | 3300 ± 50 | 1.10 | 1.0 % | 0.0 % | 99.0 % |" in text
    assert "| Stable-Baselines3 PPO | failed |" in text
    assert "(../peers.md)" in text
    assert "<!-- peers-99 -->\n\nNot measured yet.\n\n<!-- /peers-99 -->" in text
    assert "| town02 |" in text
    assert markers.format("unknown") in text
    assert tables.main(["--check"], copy) == 0
