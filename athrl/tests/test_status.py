"""A single look at a run shows how fast it goes, and a question after a role means who has its own name."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import pytest
from athrl.run_view import RunSnapshot
from athrl.status_panel import plain_line
from athrl_protocol import Phase, RunState
from athrl_protocol.run_file import RunFile

from athrl import service_names, status

STATE = RunState(Phase.TRAINING, 1_500, 6_000, 320, 7, "")
SNAPSHOT = RunSnapshot(
    settings=RunFile(),
    state=STATE,
    metrics={("learner", "learner"): {"environment_steps_per_second": 45.0}},
    evaluations={},
    present=frozenset({("learner", "learner")}),
)


def looked_at(monkeypatch: pytest.MonkeyPatch, snapshot: RunSnapshot) -> str:
    monkeypatch.setattr(status, "METRICS_SECONDS", 0.0)
    return plain_line(status._snapshot(SimpleNamespace(snapshot=lambda: snapshot)))  # type: ignore[arg-type]


def test_single_look_shows_the_learners_own_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    assert "45/s  ETA 1:40" in looked_at(monkeypatch, SNAPSHOT)
    assert "90/s  ETA 0:50" in looked_at(monkeypatch, replace(SNAPSHOT, steps_per_second=90.0))
    assert "-/s  ETA -" in looked_at(monkeypatch, replace(SNAPSHOT, metrics={}))


def test_single_look_during_the_warm_up_tells_no_end(monkeypatch: pytest.MonkeyPatch) -> None:
    warming_up = replace(SNAPSHOT, state=replace(STATE, phase=Phase.WARMING_UP))
    assert "45/s  ETA - " in looked_at(monkeypatch, warming_up)


@pytest.mark.parametrize("role", ["actor", "router"])
def test_bare_role_means_a_service_that_this_host_named(monkeypatch: pytest.MonkeyPatch, role: str) -> None:
    monkeypatch.setattr(service_names, "host_name", lambda: "rig")
    monkeypatch.setattr(status, "host_name", lambda: "rig")
    belongs, called = status._meant(role, "")
    for name, own in (("rig", True), ("rig-4711", True), ("rig2", False), ("rig-b-4711", False)):
        assert belongs(name) == own
    assert "'rig'" in called
    assert belongs(service_names.own_name())


def test_role_with_a_name_means_that_one_alone() -> None:
    belongs, called = status._meant("router", "east")
    assert (belongs("east"), belongs("east-1"), called) == (True, False, "'east'")
    belongs, called = status._meant("evaluator", "")
    assert (belongs("evaluator"), belongs("other"), called) == (True, False, "'evaluator'")
