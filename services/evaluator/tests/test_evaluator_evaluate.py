"""`evaluate_driver`: the same scores for the same seed with any batch size, for every driver."""

import hashlib
import json
import math
import subprocess
import sys
import threading
from pathlib import Path

import gymnasium
import pytest
from athrl_driving.policy import InvalidPolicy, OnnxPolicy
from athrl_evaluator import EvaluationSettings, Scores, evaluate_driver
from athrl_evaluator.policies.files import load_policy
from athrl_evaluator.recording.reading import read_frames
from athrl_evaluator.scoring.drivers import GreedyPolicy
from athrl_evaluator.scoring.environments import environment_for, make_batch
from athrl_evaluator.scoring.episodes import drive_episodes
from athrl_protocol import RunFileError
from athrl_protocol.run_file import EnvironmentSection
from athrl_spaces import CASE_STUDIES, REFERENCE_DRIVERS

ENVIRONMENT = EnvironmentSection(vehicles=20, episode_ticks=60)


def evaluate(driver: object, record: Path | None = None, **changes: object) -> Scores:
    settings = {"environment": ENVIRONMENT, "episodes": 4, "seed": 11} | changes
    return evaluate_driver(driver, EvaluationSettings(**settings), record=record)  # type: ignore[arg-type]


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


def facts_of(artefact: bytes) -> str:
    return json.dumps({"version": 3, "sha256": hashlib.sha256(artefact).hexdigest()})


def test_a_policy_file_is_used_only_if_its_facts_match(artefact: bytes, tmp_path: Path):
    file, facts = tmp_path / "latest.onnx", tmp_path / "latest.json"
    file.write_bytes(artefact)
    facts.write_text(facts_of(artefact))
    assert load_policy(file).description == OnnxPolicy(artefact).description
    at = len(artefact) // 2
    flipped = artefact[:at] + bytes([artefact[at] ^ 1]) + artefact[at + 1 :]
    file.write_bytes(flipped)
    with pytest.raises(
        InvalidPolicy, match=r"latest\.onnx is not .* latest\.json .* it should be [0-9a-f]{64};"
    ):
        evaluate(file)


@pytest.mark.parametrize("facts", ["", "[]", "{}", '{"sha256": 3}'])
def test_a_policy_file_without_a_recorded_sha256_is_accepted(artefact: bytes, tmp_path: Path, facts: str):
    file = tmp_path / "latest.onnx"
    file.write_bytes(artefact)
    file.with_suffix(".json").write_text(facts)
    assert load_policy(file).description == OnnxPolicy(artefact).description


def test_a_policy_that_is_published_just_now_is_waited_for(artefact: bytes, tmp_path: Path):
    file = tmp_path / "latest.onnx"
    file.write_bytes(b"the one before")
    file.with_suffix(".json").write_text(facts_of(artefact))
    publish = threading.Timer(0.3, file.write_bytes, (artefact,))
    publish.start()
    try:
        assert load_policy(file).description == OnnxPolicy(artefact).description
    finally:
        publish.join()


def test_a_policy_drives_with_the_ranges_that_it_was_trained_for(artefact: bytes):
    changed = {"maximum_speed": 20.0, "waypoint_half_angle": 80.0, "waypoint_radius": 5.0, "image_size": 64}
    changed |= {"speed_gain": 3.0}
    other = EnvironmentSection(**changed, vehicles=7)
    fitted = environment_for(OnnxPolicy(artefact).description, other)
    assert (fitted.image_size, fitted.vehicles) == (32, 7)
    assert fitted.maximum_speed == pytest.approx(7.95)
    assert fitted.waypoint_radius == 8.0
    assert fitted.speed_gain == 2.0
    assert math.radians(fitted.waypoint_half_angle) == pytest.approx(math.pi / 6)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("image_size", 64),
        ("maximum_speed", 5.0),
        ("waypoint_half_angle", 45.0),
        ("waypoint_radius", 4.0),
        ("speed_gain", 1.0),
    ],
)
def test_a_setting_that_a_policy_was_not_made_for_is_refused_by_its_name(
    artefact: bytes, key: str, value: float
):
    with pytest.raises(RunFileError, match=f"environment.{key} is {value:g}, but the policy was made for"):
        evaluate(OnnxPolicy(artefact), environment=EnvironmentSection(**{key: value}))


def test_settings_that_say_what_the_policy_was_made_for_are_no_conflict(artefact: bytes):
    section = EnvironmentSection(**EnvironmentSection(vehicles=3, episode_ticks=20).model_dump())
    assert evaluate(OnnxPolicy(artefact), environment=section, episodes=2).episodes == 2


@pytest.mark.parametrize("name", CASE_STUDIES)
def test_a_case_study_is_the_environment_of_its_id(name: str):
    batch = make_batch(EnvironmentSection(), 1, case_study=name)
    env = gymnasium.make(CASE_STUDIES[name]).unwrapped
    config = batch.environments[0].config
    assert {key: config[key] for key in config if env.config[key] != config[key]} == {
        "offscreen_rendering": None
    }
    batch.reset(0, 5)
    env.reset(seed=5)
    assert batch.environments[0].vehicle.position.tolist() == env.vehicle.position.tolist()
    batch.close()


def test_a_case_study_takes_explicit_settings_of_the_section():
    batch = make_batch(EnvironmentSection(vehicles=7), 1, case_study="roundabout")
    assert batch.environments[0].config["vehicles_count"] == 7
    assert batch.environments[0].config["episode_ticks"] == 1000
    batch.close()


def test_the_rule_based_driver_arrives_in_every_case_study_and_every_episode_is_recorded(tmp_path: Path):
    for name in CASE_STUDIES:
        folder = tmp_path / name
        scores = evaluate("rule-based", environment=None, case_study=name, episodes=2, record=folder, batch=2)
        assert scores.success_rate == 1.0
        files = sorted(path.name for path in folder.iterdir())
        assert files == ["rule-based-seed-11.mcap", "rule-based-seed-12.mcap"]
        frames = list(read_frames(folder / files[0]))
        assert (frames[0].town, frames[0].episode_seed) == ("town03", 11)


def test_recordings_that_were_there_stay(tmp_path: Path):
    older = [tmp_path / f"older-{number}.mcap" for number in range(5)]
    for path in older:
        path.write_bytes(b"older")
    evaluate("blind", episodes=2, record=tmp_path)
    assert all(path.exists() for path in older)


def test_the_rule_based_driver_beats_random():
    rule_based, random = (evaluate(driver, episodes=6) for driver in ("rule-based", "random"))
    assert rule_based.return_mean - rule_based.return_ci95 > random.return_mean + random.return_ci95


def test_the_evaluator_never_imports_torch():
    program = (
        "import sys, athrl_evaluator, athrl_evaluator.evaluator, athrl_evaluator.watching.watch;"
        "sys.exit('torch' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", program], timeout=120).returncode == 0
