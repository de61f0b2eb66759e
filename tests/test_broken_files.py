"""No broken file from elsewhere kills a service or makes it hang: it is refused in one line, or is proper.

The long run of the same: `python -m benchmarks.fuzz --parser NAME --count 100000`.
"""

from __future__ import annotations

import json
import random
import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.fuzz import frame, mutations, parsers

ROOT = Path(__file__).parents[1]
PIECES = 120
FILES = [name for name in parsers.PARSERS if name != "messages"]  # of which many more are thrown elsewhere


@pytest.mark.filterwarnings("ignore::UserWarning")  # of torch and zipfile about what was broken
@pytest.mark.parametrize("name", FILES)
def test_broken_file_is_refused_in_one_line_or_proper(name: str, tmp_path: Path) -> None:
    outcome = frame.throw(parsers.load(name, tmp_path), range(PIECES), seed=3)
    assert not outcome.holes, outcome.examples
    assert outcome.refused.total() + outcome.accepted == PIECES


class Strange(Exception):  # noqa: N818
    """An error that no caller expects."""


class Ours(Exception):  # noqa: N818
    """A refusal."""


def careless(content: bytes) -> None:
    """A parser with holes."""
    if len(content) < 4:
        raise Ours("is too short")
    if len(content) % 5 == 0:
        raise Ours("is wrong\nin two lines")
    if len(content) % 7 == 0:
        raise Strange


def test_fuzz_finds_the_holes_of_a_careless_parser() -> None:
    def broken(chance: random.Random) -> bytes:
        return mutations.cut_or_stretched(chance, b"12345678")

    outcome = frame.throw(frame.Parser([b"12345678"], broken, careless, (Ours,)), range(300), seed=1)
    assert outcome.refused["Ours"] > 0
    assert outcome.accepted > 0
    assert {effect.split(" at ")[0] for effect in outcome.holes} == {"Strange", "Ours is not one line"}
    number, _ = outcome.examples["Ours is not one line"]
    again = frame.throw(frame.Parser([], broken, careless, (Ours,)), [number], seed=1)
    assert list(again.holes) == ["Ours is not one line"]


def test_fuzz_ends_with_an_object_and_tells_of_one_piece_alone() -> None:
    command = [sys.executable, "-m", "benchmarks.fuzz", "--parser", "served-run-file", "--only", "7"]
    result = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert result.returncode == 0, result.stderr
    report = json.loads(result.stdout.splitlines()[-1])
    assert (report["count"], report["refused"] + report["proper"], report["holes"]) == (1, 1, {})
