"""A short run with fault injection. A long one: python -m tests.chaos --seed N --minutes M."""

from __future__ import annotations

import itertools
import json
import signal
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))  # tests is no installed package

from tests.chaos.schedule import FAMILIES, Group, Kind, complete, schedule

ROOT = Path(__file__).parents[2]
SEED, MINUTES = 43, 1.6
"""This seed's faults kill the learner, also on a full disk, and the router, and flood."""
PATIENCE = 200.0

pytestmark = pytest.mark.timeout(900)


def begin(command, folder: Path, *, seed: int, minutes: float) -> subprocess.Popen[str]:
    words = ["--seed", str(seed), "--minutes", str(minutes), "--folder", str(folder)]
    return subprocess.Popen(
        [sys.executable, "-m", "tests.chaos", *words],
        cwd=ROOT,
        env=command.environment(),
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


@pytest.mark.slow
def test_nothing_is_lost_or_stored_twice_under_faults(command, tmp_path: Path) -> None:
    chaos = begin(command, tmp_path / "chaos", seed=SEED, minutes=MINUTES)
    command.started.append(chaos)
    said, _ = chaos.communicate(timeout=800)
    assert chaos.returncode == 0, said[-4000:]
    report = json.loads(said.splitlines()[-1])
    assert report["failures"] == []
    happened = {Kind(kind) for kind in report["faults_by_kind"]}
    possible = frozenset(Kind) - {Kind(kind) for kind in report["left_out"]}
    assert complete(happened, possible, every=False)
    assert {Kind.LEARNER_KILLED, Kind.ROUTER_KILLED, Kind.FLOOD} <= happened
    assert report["kills"] > 1
    assert report["left_out"] or report["intake_paused"] > 0
    assert report["acknowledged"] > 200
    assert (report["lost"], report["twice"]) == (0, 0)
    assert report["malformed_refused"] > 50
    assert report["known_repeated"] > 0
    assert report["longest_stall_s"] > 0.0
    assert not command.left()


# Both raise the same exception in it, and each costs the start of six processes.
@pytest.mark.parametrize("number", [pytest.param(signal.SIGINT, marks=pytest.mark.slow), signal.SIGTERM])
def test_interrupted_fault_injection_leaves_no_process(command, tmp_path: Path, eventually, number) -> None:
    chaos = begin(command, tmp_path / "chaos", seed=1, minutes=5.0)
    command.started.append(chaos)
    eventually(lambda: len(command.left()) >= 6, PATIENCE)  # this, learner, router, two actors, evaluator
    chaos.send_signal(number)
    said, _ = chaos.communicate(timeout=PATIENCE)
    assert chaos.returncode == 130, said[-2000:]
    eventually(lambda: not command.left(), 30.0)
    assert str(tmp_path) not in Path("/proc/mounts").read_text()


TARGETS = {
    **{family: ["learner"] for family in ("learner", "disk", "intruder")},
    **{"actor": ["a", "b"], "evaluator": ["e"], "router": ["r"], "connection": ["a", "b", "e", "r"]},
}


def first(seed: int, count: int) -> list[Group]:
    return list(itertools.islice(schedule(seed, TARGETS, frozenset(Kind), longest_pause=9.0), count))


def test_seed_decides_about_the_faults() -> None:
    assert first(5, 50) == first(5, 50)
    assert first(5, 50) != first(6, 50)


def test_every_kind_of_fault_comes_before_long() -> None:
    for seed in range(20):
        faults = [fault for group in first(seed, 40) for fault in group.faults]
        assert {fault.kind for fault in faults} == set(Kind)


def test_something_of_each_family_comes_first_and_no_kind_is_preferred() -> None:
    drawn: Counter[Kind] = Counter()
    for seed in range(500):
        faults = [fault for group in first(seed, len(FAMILIES)) for fault in group.faults]
        kinds = [fault.kind for fault in faults[: len(FAMILIES)]]
        assert complete(set(kinds), frozenset(Kind), every=False)
        drawn.update(kinds)
    for family in FAMILIES.values():
        counts = [drawn[kind] for kind in family]
        assert min(counts) > 0.7 * sum(counts) / len(family)


def test_kinds_that_are_not_possible_do_not_come_and_are_not_waited_for() -> None:
    kinds = frozenset(Kind) - set(FAMILIES["disk"])
    groups = itertools.islice(schedule(1, TARGETS, kinds, longest_pause=9.0), 100)
    happened = {fault.kind for group in groups for fault in group.faults}
    assert happened == kinds
    assert complete(happened, kinds, every=True)
    assert not complete(happened, frozenset(Kind), every=False)


def test_faults_that_come_together_have_different_targets() -> None:
    groups = [group for group in first(3, 400) if len(group.faults) == 2]
    assert len(groups) > 50
    assert all(one.target != other.target for one, other in (group.faults for group in groups))
