"""The comparison with other libraries measures what it says, and all contestants alike."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
SCORES = {"return_mean", "return_ci95", "collision_rate", "off_lane_rate", "full_episode_rate"}


@pytest.fixture(scope="module", autouse=True)
def _benchmarks() -> None:
    """Make the package known without its folder's neighbours, which have the names of packages."""
    folder = ROOT / "benchmarks"
    specification = importlib.util.spec_from_file_location(
        "benchmarks", folder / "__init__.py", submodule_search_locations=[str(folder)]
    )
    sys.modules["benchmarks"] = importlib.util.module_from_spec(specification)


def run(*arguments: str) -> subprocess.CompletedProcess[str]:
    # Threads that wait for each other asleep: on a busy machine a hundred times as fast.
    environment = {**os.environ, "OMP_WAIT_POLICY": "passive"}
    command = [sys.executable, "-m", "benchmarks.peers", *arguments]
    return subprocess.run(
        command,
        cwd=ROOT,
        env=environment,
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=280,
    )


@pytest.mark.slow
def test_ours_and_a_peer_are_trained_scored_and_drawn(tmp_path: Path) -> None:
    words = "--minutes 0.05 --only ours,sb3_ppo --vehicles 10 --episodes 2 --points 2 --ours-steps 400"
    settings = ["exploration.random_decisions=200", "actor.environments=8", "learner.publish_seconds=0.5"]
    given = [word for setting in settings for word in ("--set", setting)]
    result = run(*words.split(), *given, "--out", str(tmp_path))
    assert result.returncode == 0, result.stderr[-2000:]
    facts = json.loads(result.stdout.splitlines()[-1])
    assert set(facts["rule_based"]) == SCORES
    for name in ("ours", "sb3_ppo"):
        assert set(facts[name]) == SCORES | {"decisions", "seconds", "how"}
        assert facts[name]["decisions"] > 0
        assert 0 <= facts[name]["full_episode_rate"] <= 1
    assert facts["first_seed"] == 700_000
    assert json.loads((tmp_path / "peers.json").read_text()) == facts
    assert (tmp_path / "peers.png").read_bytes().startswith(b"\x89PNG")
    rows = (tmp_path / "curves.csv").read_text().splitlines()
    assert set(rows[0].split(",")) == SCORES | {"who", "decisions", "seconds"}


def test_somebody_unknown_is_refused_by_name() -> None:
    result = run("--only", "ours,sb3_dqn")
    assert result.returncode == 2
    assert "sb3_dqn is none of ours, sb3_ppo, sb3_td3, sb3_sac" in result.stderr.splitlines()[-1]


def test_peers_are_scored_as_athrl_evaluate_scores() -> None:
    from athrl_driving.policy import OnnxPolicy
    from athrl_evaluator import EvaluationSettings, evaluate_driver
    from athrl_planners import PolicyExporter, make_agent
    from athrl_protocol.run_file import EnvironmentSection

    from benchmarks.peers.comparison import Comparison, Observation
    from benchmarks.peers.town import Examination

    agent = make_agent("hddpg", {"hidden_features": 16, "head_features": 16}, seed=1)
    policy = OnnxPolicy(PolicyExporter(agent).artefact())
    comparison = Comparison(vehicles=30, episodes=8)

    def act(seen: Observation) -> np.ndarray:
        step = policy.step(seen["image"], seen["motion"], policy.initial_states(8))
        return policy.description.environment_action(step.actions)

    settings = EvaluationSettings(
        episodes=8, seed=comparison.first_seed, environment=EnvironmentSection(vehicles=30)
    )
    wanted = evaluate_driver(policy, settings).as_dict()
    found = Examination(comparison).score(act)
    assert set(found) == SCORES
    assert found == pytest.approx({name: wanted[name] for name in SCORES}, rel=1e-3)


def test_truncated_episode_tells_what_was_last_seen_and_that_it_would_go_on() -> None:
    from gymnasium.vector import AutoresetMode

    from benchmarks.peers.comparison import Comparison
    from benchmarks.peers.stable_baselines import TownVecEnv
    from benchmarks.peers.town import REWARD_SCALE, make_towns

    comparison = Comparison(vehicles=5)
    as_they_are = make_towns(comparison, 2, AutoresetMode.NEXT_STEP)
    wrapped = TownVecEnv(make_towns(comparison, 2, AutoresetMode.SAME_STEP))
    as_they_are.reset(seed=[7, 8])
    wrapped.seed(7)
    wrapped.reset()
    standing = np.tile(np.float32([-1.0, 0.0]), (2, 1))
    ended = np.zeros(2, np.bool_)
    while not ended.any():
        seen, reward, terminated, truncated, _ = as_they_are.step(standing)
        after, scaled, ended, infos = wrapped.step(standing)
        np.testing.assert_allclose(scaled, reward * REWARD_SCALE, rtol=1e-6)
        np.testing.assert_array_equal(ended, terminated | truncated)
    assert truncated.any()
    for e in np.flatnonzero(ended):
        last = infos[e]["terminal_observation"]
        np.testing.assert_array_equal(last["image"], seen["image"][e].transpose(2, 0, 1))
        np.testing.assert_array_equal(last["motion"], seen["motion"][e])
        assert infos[e]["TimeLimit.truncated"] == truncated[e]
        assert (after["image"][e] != last["image"]).any()


def test_scoring_on_the_way_costs_no_training_time(monkeypatch: pytest.MonkeyPatch) -> None:
    from benchmarks.peers import comparison

    now = 0.0
    monkeypatch.setattr(comparison.time, "monotonic", lambda: now)

    def score(_: comparison.Act) -> dict[str, float]:
        nonlocal now
        now += 1000.0
        return {"return_mean": 1.0}

    training = comparison.Training(comparison.Comparison(seconds=10.0, points=5), score)
    training.begin()
    decisions = 0
    while training.goes_on(decisions, act=lambda seen: seen["motion"]):
        now += 1.0
        decisions += 3
    training.end(decisions, act=lambda seen: seen["motion"])
    assert [point.seconds for point in training.points] == [2.0, 4.0, 6.0, 8.0, 10.0]
    assert [point.decisions for point in training.points] == [6, 12, 18, 24, 30]


def test_only_results_of_the_same_comparison_are_taken_again(tmp_path: Path) -> None:
    from benchmarks.peers.__main__ import _earlier
    from benchmarks.peers.comparison import Comparison, Learned, Point

    file = tmp_path / "sb3_ppo.json"
    learned = Learned(Comparison(), [Point(1.0, 2, {"return_mean": 3.0})], {"batch_size": 512})
    assert _earlier(file, Comparison()) is None
    learned.write(file)
    assert _earlier(file, Comparison()) == learned
    assert _earlier(file, Comparison(seconds=1.0)) is None


def test_our_run_is_taken_again_only_with_the_same_settings_and_length() -> None:
    from benchmarks.peers.__main__ import _as_asked
    from benchmarks.peers.comparison import Comparison, Learned

    earlier = Learned(Comparison(), [], {"settings": ["learner.batch=64"], "decisions_wanted": 400})
    assert _as_asked(earlier, ["learner.batch=64"], None)
    assert _as_asked(earlier, ["learner.batch=64"], 400)
    assert not _as_asked(earlier, ["learner.batch=64"], 500)
    assert not _as_asked(earlier, [], None)
