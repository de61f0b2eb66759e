"""Policies of every kind of action are scored, recorded, forced and watched through the same functions."""

import threading
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from athrl_driving.policy import OnnxPolicy
from athrl_evaluator import EvaluationSettings, evaluate_driver
from athrl_evaluator.errors import EvaluatorError
from athrl_evaluator.recording.reading import read_frames
from athrl_evaluator.scoring.drivers import GreedyPolicy, ReferenceDriver
from athrl_evaluator.scoring.environments import Environments, make_batch, town_labels
from athrl_evaluator.scoring.episodes import EpisodeObserver, EpisodeStep, drive_episodes
from athrl_evaluator.scoring.forced_decisions import CannotForce, read_forced
from athrl_evaluator.watching.watch_policy import LiveDrawing, watch_policy
from athrl_protocol import Frame
from athrl_protocol.run_file import EnvironmentSection

ENVIRONMENT = EnvironmentSection(vehicles=5, episode_ticks=40)
DECIDED = {
    "hddpg": {"target_speed", "waypoint_angle"},
    "ddpg": {"acceleration", "steering"},
    "hdqn": {"behaviour", "waypoint"},
}


class Kept(EpisodeObserver):
    """Stores the decisions."""

    def __init__(self) -> None:
        self.decisions: list[dict[str, float]] = []

    def on_step(self, step: EpisodeStep) -> None:
        self.decisions.append(dict(step.decision))


@pytest.mark.parametrize("kind", DECIDED)
def test_policy_of_every_kind_is_scored_alike_in_any_batch_and_its_decisions_are_recorded(
    artefacts: dict[str, bytes], tmp_path: Path, kind: str
) -> None:
    file = tmp_path / f"{kind}.onnx"
    file.write_bytes(artefacts[kind])
    settings = EvaluationSettings(episodes=3, seed=4, environment=ENVIRONMENT)
    scores = evaluate_driver(file, settings, record=tmp_path)
    assert scores == evaluate_driver(file, replace(settings, batch=1))
    frames = list(read_frames(tmp_path / f"{kind}-seed-4.mcap"))
    assert frames
    for frame in frames:
        assert set(frame.decision) == DECIDED[kind]


def test_scores_in_several_towns_are_of_the_episodes_in_each(artefacts: dict[str, bytes], tmp_path: Path):
    policy = OnnxPolicy(artefacts["hddpg"])
    settings = EvaluationSettings(episodes=2, seed=4)
    here, there = (ENVIRONMENT.model_copy(update={"towns": {town: 1.0}}) for town in ("town02", "town03"))
    both = ENVIRONMENT.model_copy(update={"towns": {"town02": 1.0, "town03": 3.0}})
    returns = [
        evaluate_driver(policy, replace(settings, environment=one)).return_mean for one in (here, there)
    ]
    scores = evaluate_driver(policy, replace(settings, environment=both), record=tmp_path)
    assert scores.episodes == 4
    assert scores.return_mean == pytest.approx(np.mean(returns))
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        f"policy-{town}-seed-{seed}.mcap" for town in ("town02", "town03") for seed in (4, 5)
    ]
    (frame, *_) = read_frames(tmp_path / "policy-town02-seed-4.mcap")
    assert frame.town == "town02"


def test_towns_with_the_same_file_name_get_different_labels():
    towns = ["town03", "a/mine.xodr", "b/mine.xodr"]
    assert list(town_labels(towns).values()) == ["town03", "mine", "mine-2"]


def test_each_kind_of_action_has_its_own_environments_which_are_made_once():
    environments = Environments(ENVIRONMENT, 2)
    waypoint, direct = (environments.batch("town03", kind) for kind in ("waypoint", "direct"))
    assert (waypoint.action_kind, direct.action_kind) == ("waypoint", "direct")
    assert environments.batch("town03", "waypoint") is waypoint
    environments.close()


def test_forced_decision_is_what_the_policy_decides_all_the_time(artefact: bytes):
    policy = OnnxPolicy(artefact)
    returns = []
    for value in (0.0, 2.0):
        kept, batch = Kept(), make_batch(ENVIRONMENT, 2)
        driver = GreedyPolicy(policy, 2, forced={"intention": value})
        returns.append(drive_episodes(driver, batch, [1, 2], [kept])[0].episode_return)
        assert {decision["intention"] for decision in kept.decisions} == {value}
        batch.close()
    assert returns[0] != returns[1]


def test_forced_choice_is_made_and_the_other_levels_stay_free(artefacts: dict[str, bytes]):
    kept, batch = Kept(), make_batch(ENVIRONMENT, 1, action_kind="waypoint-set")
    driver = GreedyPolicy(OnnxPolicy(artefacts["hdqn"]), 1, forced={"waypoint": 3.0})
    drive_episodes(driver, batch, [1], [kept])
    assert {decision["waypoint"] for decision in kept.decisions} == {3.0}
    batch.close()


@pytest.mark.parametrize(
    ("kind", "text", "told"),
    [
        ("hddpg", "intention=0", "the planner hddpg decides no intention, it decides target_speed, waypoint"),
        ("ddpg", "stearing=0", "did you mean steering?"),
        ("ddpg", "steering", "it should be NAME=VALUE, for instance acceleration=0"),
        ("ddpg", "steering=left", "steering should be a number from -0.3 to 0.3"),
        ("hddpg", "target_speed=9", "target_speed should be a number from 0 to 7.95 m/s"),
        ("hddpg", "target_speed=nan", "target_speed should be a number from 0 to 7.95 m/s"),
        ("hdqn", "behaviour=1.5", "behaviour should be a whole number from 0 to 2"),
        ("hdqn", "waypoint=16", "waypoint should be a whole number from 0 to 15"),
    ],
)
def test_what_cannot_be_forced_is_named_with_what_can(
    artefacts: dict[str, bytes], kind: str, text: str, told: str
) -> None:
    with pytest.raises(CannotForce, match=r"^--force ") as caught:
        read_forced([text], OnnxPolicy(artefacts[kind]).description)
    assert told in str(caught.value)
    assert text in str(caught.value)


def test_forcing_twice_or_a_driver_that_is_no_policy_is_refused(artefact: bytes):
    twice = EvaluationSettings(episodes=2, seed=1, forced=["intention=0", "intention=1"])
    with pytest.raises(CannotForce, match="intention is forced twice"):
        evaluate_driver(OnnxPolicy(artefact), twice)
    with pytest.raises(EvaluatorError, match="--force intention=0: blind is no policy"):
        evaluate_driver("blind", replace(twice, forced=["intention=0"]))


@pytest.fixture
def captions(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The captions of the frames that are drawn."""
    written: list[str] = []
    document = rr.TextDocument

    def written_down(text: str, **options: Any) -> rr.TextDocument:
        written.append(text)
        return document(text, **options)

    monkeypatch.setattr(rr, "TextDocument", written_down)
    return written


@pytest.mark.parametrize("kind", [*DECIDED, "blind"])
def test_policy_is_watched_without_a_run(
    artefacts: dict[str, bytes], captions: list[str], tmp_path: Path, kind: str
) -> None:
    file = tmp_path / f"{kind}.onnx"
    file.write_bytes(artefacts.get(kind, b""))
    driver: Path | str = file if kind in DECIDED else kind
    saved = tmp_path / "seen.rrd"
    watch_policy(driver, environment=ENVIRONMENT, episodes=2, save=saved, stop=threading.Event())
    content = saved.read_bytes()
    for entity in ["car/ego/body", *(f"decision/{name}" for name in DECIDED.get(kind, ()))]:
        assert entity.encode() in content
    assert "in town03, seed 0" in captions[0]
    assert "in town03, seed 1" in captions[-1]
    if kind == "blind":
        assert b"decision/" not in content


def test_forced_intention_is_seen_in_words(artefact: bytes, captions: list[str], tmp_path: Path):
    file, saved = tmp_path / "policy.onnx", tmp_path / "seen.rrd"
    file.write_bytes(artefact)
    arguments: dict[str, Any] = {"forced": ["intention=2"], "episodes": 1, "save": saved}
    watch_policy(file, environment=ENVIRONMENT, **arguments, stop=threading.Event())
    assert captions
    assert all("intends right (2.00)" in caption for caption in captions)


def test_watching_that_is_stopped_ends_in_the_middle_of_an_episode(tmp_path: Path):
    stop = threading.Event()
    stop.set()
    watch_policy("blind", environment=ENVIRONMENT, episodes=None, save=tmp_path / "seen.rrd", stop=stop)


def test_a_film_of_a_failure_is_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def fails(*_: Any) -> None:
        raise RuntimeError("no episode")

    monkeypatch.setattr("athrl_evaluator.watching.watch_policy.drive_episodes", fails)
    saved = tmp_path / "seen.rrd"
    with pytest.raises(RuntimeError, match="no episode"):
        watch_policy("blind", environment=ENVIRONMENT, episodes=1, save=saved, stop=threading.Event())
    assert list(tmp_path.iterdir()) == []


def test_frames_are_drawn_at_their_time_and_late_ones_immediately(monkeypatch: pytest.MonkeyPatch):
    now, drawn = [100.0], list[float]()

    class Canvas:
        def draw(self, frame: Frame) -> None:
            drawn.append(now[0])
            now[0] += late.pop(0) if late else 0.0

    def sleep(seconds: float) -> None:
        now[0] += seconds

    late = [0.0, 3.0]  # the second frame takes three seconds to draw
    monkeypatch.setattr("athrl_evaluator.watching.watch_policy.time.sleep", sleep)
    driver, batch = ReferenceDriver("blind", 1), make_batch(ENVIRONMENT, 1)
    drawing = LiveDrawing(driver, Canvas(), lambda: False, clock=lambda: now[0])  # type: ignore[arg-type]
    drive_episodes(driver, batch, [1], [drawing])
    batch.close()
    gaps = np.diff(drawn)
    np.testing.assert_allclose(gaps[0], 0.4, atol=1e-6)
    assert gaps[1] == pytest.approx(3.0)
    # One second of the delay is caught up, and then one decision follows every 0.4 s again.
    assert gaps[2] == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(gaps[-2:], 0.4, atol=1e-6)
