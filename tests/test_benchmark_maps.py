"""Benchmarks that drive on maps say in one line which map they cannot use."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("name", ["drivers", "flow", "maps"])
def test_a_map_that_cannot_be_used_is_one_line(name: str, tmp_path: Path) -> None:
    path = tmp_path / "broken.xodr"
    path.write_text("<town/>")
    assert last_words(name, path) == "broken.xodr: line 1: the root is <town>, it must be <OpenDRIVE>\n"


def test_a_map_without_room_for_the_vehicles_is_one_line() -> None:
    said = last_words("drivers", "town02", "--vehicles", "500", "--seeds", "1")
    assert said == "vehicles_count is 500, but the town has room for 161 at most\n"


def last_words(name: str, *maps: object) -> str:
    """Return what a benchmark that fails says."""
    command = [sys.executable, "-m", f"benchmarks.{name}", "--maps", *map(str, maps)]
    found = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert found.returncode == 1
    return found.stderr
