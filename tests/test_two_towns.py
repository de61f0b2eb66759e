"""One run in several towns: the actor drives in all of them, and results say which town they are of."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytestmark = pytest.mark.timeout(300)

SECONDS = 200.0
TOWNS = ("town02", "town03")


def test_run_over_two_towns_is_scored_in_each(command, another_tiny, tmp_path: Path) -> None:
    changes = {"environment.towns": json.dumps(TOWNS), "learner.samples_per_insert": 1.0}
    words = [*another_tiny(changes), "--name", "both", "--viewer-port", "0"]
    result = command.run("train", *words, seconds=SECONDS)
    assert result.returncode == 0, result.stderr
    folder = tmp_path / "runs" / "both"
    lines = [json.loads(line) for line in (folder / "evaluations.jsonl").read_text().splitlines()]
    scored = [line for line in lines if line["driver"] == "policy"]
    assert scored
    comparison = json.loads((folder / "evaluation.json").read_text())
    assert list(comparison["towns"]) == list(TOWNS)
    for town in TOWNS:
        assert f"in {town}" in result.stdout
        assert all(f"{town}/return_mean" in line["scores"] for line in scored)
        assert set(comparison["towns"][town]) == {"policy", "random", "blind", "rule-based"}
        assert comparison["towns"][town]["policy"]["episodes"] == 2
    assert comparison["drivers"]["policy"]["episodes"] == 4
    returns = {town: comparison["towns"][town]["rule-based"]["return_mean"] for town in TOWNS}
    assert returns["town02"] != returns["town03"]
