"""Whatever the map: it drives for 20 seconds as cars do, or is refused in one line, and no process dies.

The long run of the same: `python -m benchmarks.fuzz_maps`.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from multiprocessing.connection import Connection
from pathlib import Path

import pytest
from athrl_driving.envs import TownEnv

from benchmarks.fuzz_maps import batches
from benchmarks.fuzz_maps.drive import NonsenseError, Roads

ROOT = Path(__file__).parents[1]


@pytest.mark.parametrize("maps", [50, pytest.param(200, marks=pytest.mark.slow)])
def test_generated_and_damaged_maps_drive_or_are_refused(tmp_path: Path, maps: int) -> None:
    outcome = batches.drive_on_maps(range(maps), seed=1, jobs=2, folder=tmp_path)
    assert not outcome.holes, outcome.examples
    assert outcome.accepted > 0.3 * maps
    assert outcome.refused.total() > 0.15 * maps
    assert not list(tmp_path.iterdir())


def child_that_dies_at_every_third(
    numbers: Sequence[int], seed: int, folder: Path, sender: Connection
) -> None:
    sender.send("ready")
    for number in numbers:
        if number % 3 == 2:
            os.kill(os.getpid(), signal.SIGKILL)
        sender.send(batches.Fate(number, "some reason" * (number % 3), "", "", 0.0))


def test_a_process_that_dies_is_noticed_and_the_other_maps_are_tried(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batches, "_child", child_that_dies_at_every_third)
    outcome = batches.drive_on_maps(range(8), seed=1, jobs=1, folder=tmp_path)
    assert (outcome.accepted, outcome.refused) == (3, {"some reason": 3})
    assert outcome.holes == {"dies of SIGKILL": 2}
    assert outcome.examples["dies of SIGKILL"][0] == 2


@pytest.mark.parametrize(
    ("column", "value", "said"),
    [
        ("x", float("nan"), "its place is not finite"),
        ("y", 5000.0, "m from the centre of every lane"),
        ("speed", 799.0, "a vehicle has a speed of 799 m/s"),
        ("speed", float("nan"), "a vehicle has a speed of nan m/s"),
    ],
)
def test_what_no_car_does_is_noticed(column: str, value: float, said: str) -> None:
    env = TownEnv({"vehicles_count": 3}, map="town02")
    env.reset(seed=0)
    roads = Roads(env.town)
    roads.check(env)
    getattr(env.road.background, column)[1] = value
    with pytest.raises(NonsenseError, match=said):
        roads.check(env)


@pytest.mark.slow
@pytest.mark.timeout(1800)
def test_no_index_of_a_kernel_is_wrong_on_such_maps(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "benchmarks.fuzz_maps", "--count", "300", "--seed", "2", "--jobs", "2"]
    result = subprocess.run(
        [*command, "--keep", str(tmp_path)],
        cwd=ROOT, capture_output=True, text=True, timeout=1700,
        env={**os.environ, "ATHRL_CHECK_INDICES": "1"},
    )  # fmt: skip
    assert result.returncode == 0, result.stdout[-2000:] + result.stderr[-4000:]
