"""An actor drives with its first policy's kind of action, in all towns of its run, and with no other."""

import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from athrl_actor import run_actor
from athrl_actor.actor import make_batch
from athrl_actor.statistics import DrivingStatistics
from athrl_driving.policy import InvalidPolicy
from athrl_protocol import RunFile

JOIN_SECONDS = 150


class Service:
    """An actor in a thread."""

    def __init__(self, address: str) -> None:
        self.stop = threading.Event()
        self.error: Exception | None = None
        self._thread = threading.Thread(target=self._run, args=(address,), daemon=True)
        self._thread.start()

    def _run(self, address: str) -> None:
        try:
            run_actor(connect=address, run="test", name="one", stop=self.stop)
        except Exception as error:
            self.error = error

    def join(self) -> None:
        self._thread.join(JOIN_SECONDS)
        assert not self._thread.is_alive()


@pytest.fixture
def start(learner: Any) -> Iterator[Callable[[], Service]]:
    services: list[Service] = []

    def begin() -> Service:
        services.append(Service(learner.address))
        return services[-1]

    yield begin
    for service in services:
        service.stop.set()
        service.join()


def choices_of(learner: Any, version: int) -> np.ndarray:
    """What was chosen by one version of the policy, float32 [decisions, 2]."""
    found = []
    for chunk in learner.chunks:
        decided = (np.arange(chunk.time) < chunk.length) & (chunk.policy_version == version)
        found.append(chunk.levels["choice"].actions[decided])
    return np.concatenate(found)


def test_policy_that_chooses_is_explored_by_choosing_at_random(learner, start) -> None:
    learner.publish(0, uniform=True, choosing=True)
    service = start()
    learner.wait_for_chunks(40)
    learner.publish(1, noise_scale=1.0, choosing=True)
    assert learner.wait_for(lambda: len(learner.chunks) > 80 and len(choices_of(learner, 1)) > 200)
    learner.publish(2, noise_scale=0.0, choosing=True)
    assert learner.wait_for(lambda: learner.chunks[-1].policy_version.min() == 2)
    service.stop.set()
    service.join()
    assert service.error is None
    favourite = np.array([2, 11])  # of conftest's policy
    uniform, explored, quiet = (choices_of(learner, version) for version in range(3))
    assert set(uniform[:, 0]) == {0, 1, 2}
    assert set(uniform[:, 1]) <= set(range(16))
    assert len(set(uniform[:, 1])) > 8
    # Epsilon rises from 0.1 to 0.5 among the two environments; one choice in three or sixteen is the same.
    assert 0.05 < (explored != favourite).mean() < 0.5
    assert (quiet == favourite).all()


def test_chunks_of_a_policy_without_memory_carry_no_states(learner, start) -> None:
    learner.publish(0, choosing=True)
    start()
    learner.wait_for_chunks(4)
    for chunk in learner.chunks:
        assert chunk.levels["choice"].states.shape == (chunk.sequences, 0)


def test_policy_of_another_kind_than_the_one_before_ends_the_actor(learner, start) -> None:
    learner.publish(0)
    service = start()
    learner.wait_for_chunks(2)
    learner.publish(1, choosing=True)
    service.join()
    assert isinstance(service.error, InvalidPolicy)
    assert "policy 1 is of another run" in str(service.error)
    assert {version for chunk in learner.chunks for version in chunk.policy_version[: chunk.length]} == {0}


def test_environments_drive_in_every_town_of_the_run() -> None:
    settings = {"environment": {"towns": {"town03": 2.0, "town02": 1.0}, "vehicles": 3}}
    run_file = RunFile(**settings, actor={"environments": 6})
    batch = make_batch(run_file, "waypoint")
    assert sorted(batch.towns) == ["town02", "town02", *["town03"] * 4]
    for env_index, town in enumerate(batch.towns):
        assert batch.environments[env_index].config["town"] == town
    batch.close()


def test_statistics_tell_of_each_town_where_there_are_several() -> None:
    statistics = DrivingStatistics()
    statistics.decided(np.array([4.0, 6.0]))
    statistics.episode_ended("town03", 100.0, False)
    alone = statistics.report()
    assert not any("/" in name for name in alone)
    statistics.episode_ended("maps/mine.xodr", 50.0, True)
    values = statistics.report()
    assert (alone["decisions"], alone["speed"], values["episodes"]) == (2, 5.0, 2)
    assert (values["return_mean"], values["return_mean/town03"], values["return_mean/mine"]) == (75, 100, 50)
    assert (values["collision_rate/town03"], values["collision_rate/mine"]) == (0, 1)
