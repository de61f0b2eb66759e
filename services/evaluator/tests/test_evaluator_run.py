"""An evaluator against a learner's end of the protocol, over real Zenoh on loopback."""

import json
import logging
import os
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
from athrl_driving.policy import EnvironmentBatch, EnvironmentFailure
from athrl_evaluator import run_evaluator
from athrl_evaluator.recording.reading import read_frames
from athrl_protocol import Phase, subscribe_frames
from athrl_spaces import REFERENCE_DRIVERS
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

JOIN_SECONDS = 150
SCORES = {
    "episodes",
    "return_mean",
    "return_ci95",
    "speed_mps",
    "distance_m",
    "collision_rate",
    "off_lane_rate",
    "full_episode_rate",
    "success_rate",
    "driving_score",
    "comfort",
    "time_to_collision_kept",
    "red_lights",
}
"""All but `success_seconds`, which is there only after a success."""


def is_complete(scores: Iterable[str]) -> bool:
    return set(scores) - {"success_seconds"} == SCORES


class Service:
    """An evaluator in a thread."""

    def __init__(self, address: str, folder: Path) -> None:
        self.stop = threading.Event()
        self.error: Exception | None = None
        self._arguments = {"connect": address, "run": "test", "name": "evaluator", "folder": folder}
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            run_evaluator(**self._arguments, stop=self.stop)  # type: ignore[arg-type]
        except Exception as error:
            self.error = error

    def join(self) -> None:
        self._thread.join(JOIN_SECONDS)
        assert not self._thread.is_alive()
        if self.error is not None:
            raise self.error


Start = Callable[[], Service]


@pytest.fixture
def start(learner, tmp_path: Path) -> Iterator[Start]:
    services: list[Service] = []

    def begin() -> Service:
        services.append(Service(learner.address, tmp_path))
        return services[-1]

    yield begin
    for service in services:
        service.stop.set()
        service.join()


def test_each_new_version_is_scored_recorded_and_published(learner, start: Start, tmp_path: Path):
    learner.publish(0)
    start()
    first = learner.wait_for_result(0)
    learner.publish(4)
    second = learner.wait_for_result(4)
    assert (first.driver, first.town, first.seed) == ("policy", "town03", 1_000_000)
    assert is_complete(first.scores)
    assert second.scores == first.scores  # the same weights on the same seeds
    assert second.environment_steps == 400
    names = os.listdir(tmp_path / "test" / "recordings")
    assert sorted(name for name in names if name.endswith(".mcap")) == [
        f"policy-{version:06d}-seed-{seed}.mcap"
        for version in (0, 4)
        for seed in (1_000_000, 1_000_001, 1_000_002)
    ]
    lines = (tmp_path / "test" / "evaluations.jsonl").read_text().splitlines()
    assert [json.loads(line)["policy_version"] for line in lines] == [0, 4]


def test_a_finished_run_is_compared_with_the_reference_drivers(learner, start: Start, tmp_path: Path, caplog):
    caplog.set_level(logging.INFO)
    learner.publish(7)
    learner.announce(Phase.FINISHED, 7)
    start().join()
    assert caplog.messages[0] == "takes part in the run test as evaluator"
    assert caplog.messages[-1] == f"the run is finished, and its comparison is in {tmp_path / 'test'}"
    comparison = json.loads((tmp_path / "test" / "evaluation.json").read_text())
    assert set(comparison["drivers"]) == {"policy", "random", "blind", "rule-based"}
    assert all(is_complete(scores) for scores in comparison["drivers"].values())
    assert all(scores["episodes"] == 2 for scores in comparison["drivers"].values())
    assert (comparison["policy_version"], comparison["environment_steps"]) == (7, 700)
    published = {result.driver: result.scores for result in learner.results}
    assert published == comparison["drivers"]
    assert not list((tmp_path / "test" / "recordings").glob("*.part"))


def test_the_comparison_waits_for_the_runs_last_policy(learner, start: Start, tmp_path: Path):
    learner.publish(7)
    learner.announce(Phase.FINISHED, 8)
    service = start()
    assert learner.presence.wait_for(lambda present: ("evaluator", "evaluator") in present, 60)
    learner.publish(8)
    service.join()
    assert json.loads((tmp_path / "test" / "evaluation.json").read_text())["policy_version"] == 8


def test_all_services_metrics_and_the_scores_are_in_tensorboard(learner, start: Start, tmp_path: Path):
    learner.announce(Phase.TRAINING, 3)
    learner.publish(3)
    service = start()
    learner.wait_for_result(3)
    learner.metrics.publish({"updates": 30.0, "broken": float("nan")})
    learner.publish(4)
    learner.wait_for_result(4)
    service.stop.set()
    service.join()
    events = EventAccumulator(str(tmp_path / "test" / "tensorboard"))
    events.Reload()
    (metric,) = events.Scalars("learner/learner/updates")
    assert (metric.step, metric.value) == (300, 30.0)
    assert "learner/learner/broken" not in events.Tags()["scalars"]
    returns = events.Scalars("evaluation/policy/return_mean")
    assert [event.step for event in returns] == [300, 400]


def test_curves_of_a_resumed_run_wait_until_it_is_known_how_far_it_is(learner, start: Start, tmp_path: Path):
    learner.publish(0)
    service = start()
    learner.wait_for_result(0)  # so it listens
    learner.metrics.publish({"updates": 29.0})
    learner.announce(Phase.TRAINING, 3)
    learner.metrics.publish({"updates": 30.0})
    learner.publish(4)
    learner.wait_for_result(4)
    learner.metrics.publish({"updates": 31.0})  # now the state is known for certain
    events = EventAccumulator(str(tmp_path / "test" / "tensorboard"))
    tag, points, deadline = "learner/learner/updates", [], time.monotonic() + 60
    while (300, 31.0) not in points:
        assert time.monotonic() < deadline, points
        time.sleep(0.1)
        if tag in events.Reload().Tags()["scalars"]:
            points = [(event.step, event.value) for event in events.Scalars(tag)]
    service.stop.set()
    service.join()
    # Of those before, some may have waited for the state in vain.
    assert points == [(300, 29.0), (300, 30.0), (300, 31.0)][-len(points) :]
    events.Reload()
    own = [tag for tag in events.Tags()["scalars"] if tag.startswith("evaluator/")]
    assert own
    assert all(event.step == 300 for tag in own for event in events.Scalars(tag))


def test_a_finished_run_is_compared_once(learner, start: Start, tmp_path: Path):
    learner.publish(7)
    learner.announce(Phase.FINISHED, 7)
    start().join()
    comparison = tmp_path / "test" / "evaluation.json"
    written = comparison.stat().st_mtime_ns
    start().join()
    assert comparison.stat().st_mtime_ns == written
    learner.announce(Phase.FINISHED, 8)  # it was made longer
    learner.publish(8)
    start().join()
    assert json.loads(comparison.read_text())["environment_steps"] == 800


def test_an_invalid_policy_is_skipped(learner, start: Start):
    learner.publish(1, artefact=b"no policy")
    service = start()
    learner.publish(2)
    learner.wait_for_result(2)
    assert service.error is None


def test_stopping_in_the_middle_of_an_evaluation_leaves_nothing_half_done(
    learner, start: Start, tmp_path: Path
):
    learner.publish(0)
    service = start()
    recordings = tmp_path / "test" / "recordings"
    while not recordings.is_dir() or not os.listdir(recordings):
        assert service.error is None
    service.stop.set()
    service.join()
    assert not list(recordings.glob("*.part"))
    for file in recordings.glob("*.mcap"):
        assert list(read_frames(file))


def test_the_evaluator_can_be_stopped_while_the_learner_is_away(learner, start: Start):
    learner.publish(0)
    service = start()
    learner.wait_for_result(0)
    learner.close()
    service.stop.set()
    service.join()


def test_the_first_episode_is_shown_to_viewers(learner, start: Start):
    learner.publish(5)
    start()
    learner.wait_for_result(5)
    frames: list = []
    several = threading.Event()

    def take(frame) -> None:
        frames.append(frame)
        if len(frames) == 3:
            several.set()

    with subscribe_frames(learner.session, "test", "evaluator", "evaluator", take):
        assert several.wait(60)
    assert [frame.step for frame in frames[:3]] == [1, 2, 3]
    assert {(frame.policy_version, frame.episode_seed) for frame in frames} == {(5, 1_000_000)}


def test_an_environment_that_raises_costs_that_evaluation_and_says_why(
    learner, start: Start, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, tmp_path: Path
):
    step, calls = EnvironmentBatch.step, []

    def fail_once(batch: EnvironmentBatch, *arguments: Any) -> Any:
        calls.append(1)
        if len(calls) == 5:
            raise ZeroDivisionError("a lane without length")
        return step(batch, *arguments)

    monkeypatch.setattr(EnvironmentBatch, "step", fail_once)
    learner.publish(0)
    service = start()
    while "policy 0 was not scored: step raised ZeroDivisionError: a lane without length" not in caplog.text:
        assert service.error is None
    learner.publish(1)
    assert learner.wait_for_result(1).scores["episodes"] > 0
    assert not list((tmp_path / "test" / "recordings").glob("*.part"))


def test_a_comparison_that_cannot_be_driven_ends_with_its_reason(
    learner, start: Start, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
):
    def fail(batch: EnvironmentBatch, *arguments: Any) -> Any:
        raise ZeroDivisionError("a lane without length")

    monkeypatch.setattr(EnvironmentBatch, "step", fail)
    learner.publish(7)
    learner.announce(Phase.FINISHED, 7)
    service = start()
    with pytest.raises(EnvironmentFailure, match="step raised ZeroDivisionError: a lane without length"):
        service.join()
    service.error = None
    assert not (tmp_path / "test" / "evaluation.json").exists()


def test_run_in_several_towns_is_scored_as_a_whole_and_in_each_of_them(learner, start: Start, tmp_path: Path):
    learner.serve(towns={"town03": 2.0, "town02": 1.0})
    learner.publish(7)
    learner.announce(Phase.FINISHED, 7)
    start().join()
    comparison = json.loads((tmp_path / "test" / "evaluation.json").read_text())
    assert comparison["town"] == "2 towns"
    assert list(comparison["towns"]) == ["town03", "town02"]
    over_all, by_town = comparison["drivers"]["policy"], comparison["towns"]
    assert is_complete(over_all)
    assert is_complete(by_town["town02"]["policy"])
    assert (over_all["episodes"], by_town["town02"]["policy"]["episodes"]) == (4, 2)
    means = [drivers["policy"]["return_mean"] for drivers in by_town.values()]
    assert over_all["return_mean"] == pytest.approx(sum(means) / 2)
    # The policy may have been scored once before the evaluator heard that the run is finished.
    assert learner.wait_for(
        lambda: {result.driver for result in learner.results} == {"policy", *REFERENCE_DRIVERS}
    )
    told = {result.driver: result for result in learner.results}["policy"].scores
    assert told["return_mean"] == over_all["return_mean"]
    assert told["town02/return_mean"] == by_town["town02"]["policy"]["return_mean"]
    events = EventAccumulator(str(tmp_path / "test" / "tensorboard"))
    events.Reload()
    assert {"evaluation/policy/return_mean", "evaluation/blind/town02/return_mean"} <= set(
        events.Tags()["scalars"]
    )
    recordings = {path.name for path in (tmp_path / "test" / "recordings").glob("*.mcap")}
    assert "policy-000007-town02-seed-1000000.mcap" in recordings
    (frame, *_) = read_frames(tmp_path / "test" / "recordings" / "policy-000007-town02-seed-1000000.mcap")
    assert frame.town == "town02"


@pytest.mark.parametrize("kind", ["hdqn", "ddpg"])
def test_policy_with_other_actions_is_compared_with_drivers_through_environments_of_their_own(
    learner, start: Start, artefacts: dict[str, bytes], tmp_path: Path, kind: str
):
    learner.publish(1, artefact=artefacts[kind])
    learner.announce(Phase.FINISHED, 1)
    start().join()
    comparison = json.loads((tmp_path / "test" / "evaluation.json").read_text())
    assert set(comparison["drivers"]) == {"policy", "random", "blind", "rule-based"}
