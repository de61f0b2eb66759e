"""`evaluate_driver`: the same scores for the same seed, whatever the batch is, for every driver."""

import math
import subprocess
import sys
from pathlib import Path

import pytest
from athrl_driving.policy import InvalidPolicy, OnnxPolicy
from athrl_evaluator import REFERENCE_DRIVERS, Scores, evaluate_driver
from athrl_evaluator.drivers import GreedyPolicy
from athrl_evaluator.episodes import drive_episodes
from athrl_evaluator.evaluate import environment_for, make_batch
from athrl_protocol.run_file import EnvironmentSection

ENVIRONMENT = EnvironmentSection(vehicles=20, episode_ticks=60)


def evaluate(driver: object, **changes: object) -> Scores:
    arguments = {"environment": ENVIRONMENT, "episodes": 4, "seed": 11} | changes
    return evaluate_driver(driver, **arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize("driver", REFERENCE_DRIVERS)
def test_reference_drivers_score_the_same_again_and_in_any_batch(driver: str):
    assert evaluate(driver) == evaluate(driver) == evaluate(driver, batch=1) == evaluate(driver, batch=3)


def test_a_policy_scores_the_same_in_any_batch(artefact: bytes):
    policy = OnnxPolicy(artefact)
    long = ENVIRONMENT.model_copy(update={"episode_ticks": 300})
    wanted = evaluate(policy, episodes=10, environment=long)
    for batch in (1, 3, 10):
        assert evaluate(policy, episodes=10, environment=long, batch=batch) == wanted


def test_another_seed_gives_other_episodes(artefact: bytes):
    policy = OnnxPolicy(artefact)
    assert evaluate(policy, seed=11) != evaluate(policy, seed=500)


def test_results_come_in_the_order_of_the_seeds(artefact: bytes):
    batch = make_batch(ENVIRONMENT, 2)
    seeds = [9, 3, 7, 5]
    results = drive_episodes(GreedyPolicy(OnnxPolicy(artefact), 2), batch, seeds)
    assert [result.seed for result in results] == seeds


def test_a_policy_file_is_scored_like_the_policy(artefact: bytes, tmp_path: Path):
    file = tmp_path / "policy.onnx"
    file.write_bytes(artefact)
    assert evaluate(file) == evaluate(str(file)) == evaluate(OnnxPolicy(artefact))


def test_a_file_that_is_no_policy_is_named(tmp_path: Path):
    file = tmp_path / "policy.onnx"
    file.write_bytes(b"no policy")
    with pytest.raises(InvalidPolicy, match=r"policy\.onnx is not a policy"):
        evaluate(file)


def test_a_policy_drives_with_the_ranges_that_it_was_trained_for(artefact: bytes):
    other = EnvironmentSection(maximum_speed=20.0, waypoint_half_angle=80.0, image_size=64, vehicles=7)
    fitted = environment_for(OnnxPolicy(artefact).metadata, other)
    assert (fitted.image_size, fitted.vehicles) == (32, 7)
    assert fitted.maximum_speed == pytest.approx(7.95)
    assert math.radians(fitted.waypoint_half_angle) == pytest.approx(math.pi / 6)


def test_the_rule_based_driver_beats_random():
    rule_based, random = (evaluate(driver, episodes=6) for driver in ("rule-based", "random"))
    assert rule_based.return_mean - rule_based.return_ci95 > random.return_mean + random.return_ci95


def test_the_evaluator_never_imports_torch():
    program = (
        "import sys, athrl_evaluator, athrl_evaluator.watch, athrl_evaluator.recording_drawing;"
        "sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", program], timeout=120).returncode == 0
