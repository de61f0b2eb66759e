"""An actor against a learner's end of the protocol, over real Zenoh on loopback."""

import logging
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from athrl_actor import run_actor
from athrl_protocol import (
    Chunk,
    NameTaken,
    Phase,
    RunNotFound,
    announce_presence,
    open_session,
    subscribe_frames,
)

JOIN_SECONDS = 150


class Service:
    """An actor in a thread."""

    def __init__(self, address: str, name: str) -> None:
        self.stop = threading.Event()
        self.error: Exception | None = None
        self._address = address
        self._name = name
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            run_actor(connect=self._address, run="test", name=self._name, stop=self.stop)
        except Exception as error:
            self.error = error

    def join(self) -> None:
        self._thread.join(JOIN_SECONDS)
        assert not self._thread.is_alive()
        if self.error is not None:
            raise self.error


Start = Callable[..., Service]


@pytest.fixture
def start(learner) -> Iterator[Start]:
    services: list[Service] = []

    def begin(name: str = "one") -> Service:
        services.append(Service(learner.address, name))
        return services[-1]

    yield begin
    for service in services:
        service.stop.set()
    for service in services:
        service._thread.join(JOIN_SECONDS)


def by_episode(chunks: list[Chunk]) -> dict[tuple[int, int], list[Chunk]]:
    episodes: dict[tuple[int, int], list[Chunk]] = {}
    for chunk in chunks:
        episodes.setdefault((chunk.environment, chunk.episode_seed), []).append(chunk)
    return episodes


def test_chunks_hold_whole_episodes_with_their_states(learner, start: Start):
    learner.publish(0)
    service = start()
    learner.wait_for_chunks(16)
    service.stop.set()
    service.join()
    episodes = by_episode(learner.chunks)
    assert {environment for environment, _ in episodes} == {0, 1}
    for chunks in episodes.values():
        step = 0
        for chunk in chunks:
            assert chunk.first_step == step
            before = step + 4 * np.arange(chunk.sequences)[:, None]
            np.testing.assert_array_equal(chunk.levels["intention"].states, np.tile(before, 3))
            np.testing.assert_array_equal(chunk.levels["trajectory"].states, np.tile(2 * before, 2))
            rewards = [level.rewards for level in chunk.levels.values()]
            np.testing.assert_array_equal(rewards[0], rewards[1])
            step += chunk.length
        assert step <= 9  # decisions in 36 ticks
    whole = [chunks for chunks in episodes.values() if chunks[-1].truncated]
    assert whole
    assert [8, 1] in [[chunk.length for chunk in chunks] for chunks in whole]


def test_uniform_exploration_fills_the_ranges_and_a_quiet_policy_does_not_explore(learner, start: Start):
    learner.publish(0, uniform=True)
    start()
    learner.wait_for_chunks(60)  # episodes of a random driver may be a few decisions short
    learner.publish(1, noise_scale=0.0)
    learner.wait_for(lambda: learner.chunks[-1].policy_version.min() == 1)
    uniform = np.concatenate([_actions(chunk, 0) for chunk in learner.chunks])
    quiet = np.concatenate([_actions(chunk, 1) for chunk in learner.chunks])
    assert uniform[:, 0].min() < 1
    assert uniform[:, 0].max() > 7
    assert np.abs(uniform[:, 1]).max() > 0.4
    np.testing.assert_allclose(quiet, np.tile([3.0, 0.0], (len(quiet), 1)))


def _actions(chunk: Chunk, version: int) -> np.ndarray:
    valid = np.arange(chunk.time) < chunk.length
    return chunk.levels["trajectory"].actions[valid & (chunk.policy_version == version)]


@pytest.fixture
def short_warm_up(learner) -> int:
    """Random decisions before training; the learner's run has so few."""
    learner.close()
    exploration = learner.run_file.exploration.model_copy(update={"random_decisions": 30})
    learner.run_file = learner.run_file.model_copy(update={"exploration": exploration})
    learner.open()
    return 30


def test_a_random_policy_drives_what_the_warm_up_needs_and_no_more(learner, start: Start, short_warm_up: int):
    def driven() -> float:
        return learner.reports[-1].values["decisions"] if learner.reports else 0

    learner.answers.clear()
    learner.publish(0, uniform=True)
    start()
    assert learner.wait_for(lambda: driven() >= short_warm_up)
    before = len(learner.reports)
    assert learner.wait_for(lambda: len(learner.reports) >= before + 2)
    assert short_warm_up <= driven() < short_warm_up + 2  # two environments decide together
    learner.answers.set()
    assert learner.wait_for(lambda: sum(chunk.length for chunk in learner.chunks) == driven())
    learner.announce(Phase.TRAINING)
    before = len(learner.chunks)
    learner.publish(1)
    learner.wait_for_chunks(before + 4)
    assert {
        version for chunk in learner.chunks[before:] for version in chunk.policy_version[: chunk.length]
    } == {1}


def test_random_decisions_that_the_learner_has_lost_are_driven_again(
    learner, start: Start, short_warm_up: int
):
    learner.publish(0, uniform=True)
    start()
    assert learner.wait_for(lambda: sum(chunk.length for chunk in learner.chunks) >= short_warm_up)
    learner.chunks.clear()
    learner.announce(Phase.WARMING_UP)
    assert learner.wait_for(lambda: sum(chunk.length for chunk in learner.chunks) >= short_warm_up)


def test_a_new_policy_is_used_within_an_episode_and_the_states_are_carried_on(learner, start: Start):
    learner.publish(3)
    start()
    for version in range(4, 200):
        learner.wait_for_chunks(len(learner.chunks) + 1)
        learner.publish(version)
        if any(len(set(chunk.policy_version[: chunk.length])) > 1 for chunk in learner.chunks):
            break
    mixed = [chunk for chunk in learner.chunks if len(set(chunk.policy_version[: chunk.length])) > 1]
    assert mixed
    for chunk in learner.chunks:  # a switch would show as a counter that begins again
        np.testing.assert_array_equal(chunk.levels["intention"].states[0], [chunk.first_step] * 3)
        assert (np.diff(chunk.policy_version[: chunk.length]) >= 0).all()


def test_a_learner_that_is_full_makes_the_actor_wait_and_loses_nothing(learner, start: Start):
    learner.publish(0)
    service = start()
    learner.wait_for_chunks(4)
    learner.full = True
    full = learner.wait_for(
        lambda: bool(learner.reports) and learner.reports[-1].values["chunks_waiting"] >= 8
    )
    assert full
    learner.full = False
    learner.wait_for_chunks(30)
    service.stop.set()
    service.join()
    for chunks in by_episode(learner.chunks).values():
        ends = np.cumsum([chunk.length for chunk in chunks]).tolist()
        assert [chunk.first_step for chunk in chunks] == [0, *ends[:-1]]


def test_the_actor_continues_when_the_learner_comes_back(learner, start: Start):
    learner.publish(0)
    start()
    learner.wait_for_chunks(4)
    learner.close()
    before = len(learner.chunks)
    learner.open()
    learner.publish(1)
    learner.wait_for_chunks(before + 20)
    sequences = [chunk.sequence for chunk in learner.chunks]
    assert sequences == list(range(len(sequences)))
    assert learner.chunks[-1].policy_version[0] == 1


@pytest.mark.parametrize("how", ["state", "intake"])
def test_the_actor_ends_by_itself_when_the_run_is_finished(
    learner, start: Start, how: str, caplog: pytest.LogCaptureFixture
):
    caplog.set_level(logging.INFO)
    learner.publish(0)
    service = start()
    learner.wait_for_chunks(2)
    if how == "state":
        learner.announce(Phase.FINISHED)
    else:
        learner.finished = True
    service.join()
    assert caplog.messages[-1].startswith("the run is finished: ")


def test_stopping_sends_the_open_chunks(learner, start: Start, caplog: pytest.LogCaptureFixture):
    caplog.set_level(logging.INFO)
    learner.publish(0)
    service = start()
    learner.wait_for_chunks(3)
    service.stop.set()
    service.join()
    assert caplog.messages[-1].startswith("stopped: ")
    last = {environment: chunks[-1] for (environment, _), chunks in by_episode(learner.chunks).items()}
    decisions = [
        sum(chunk.length for chunk in learner.chunks if chunk.environment == env_index)
        for env_index in range(2)
    ]
    assert decisions[0] == decisions[1]  # both environments are stepped together, so nothing is missing
    assert len(last) == 2


def test_an_actor_can_be_stopped_while_the_learner_is_away(
    learner, start: Start, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("athrl_actor.actor.DRAIN_SECONDS", 0.2)
    learner.publish(0)
    service = start()
    learner.wait_for_chunks(2)
    learner.close()
    service.stop.set()
    service.join()
    learner.open()


def test_an_actor_that_waits_for_its_learner_can_be_stopped():
    stop = threading.Event()
    stop.set()
    run_actor(connect="tcp/127.0.0.1:9", run="test", name="one", stop=stop)


def test_an_actor_waits_for_the_first_policy_and_can_be_stopped_meanwhile(learner, start: Start):
    service = start()
    assert learner.presence.wait_for(lambda present: ("actor", "one") in present, 30)
    service.stop.set()
    service.join()
    assert not learner.chunks


def test_a_taken_name_is_an_error_that_says_what_to_do(
    learner, start: Start, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("athrl_protocol.announcements.joining.NAME_SECONDS", 0.2)
    with (
        open_session(connect=learner.address, timeout=JOIN_SECONDS) as session,
        announce_presence(session, "test", "actor", "one"),
    ):
        assert learner.presence.wait_for(lambda present: ("actor", "one") in present, 30)
        service = start("one")
        with pytest.raises(NameTaken, match=r"already has an actor 'one'.*--name"):
            service.join()
        service.error = None


def test_a_run_that_does_not_exist_is_an_error_that_names_those_that_do(learner):
    with pytest.raises(RunNotFound, match="test"):
        run_actor(connect=learner.address, run="other", name="one", stop=threading.Event())


def test_metrics_report_the_driving(learner, start: Start):
    learner.publish(5)
    start()
    assert learner.wait_for(lambda: any("return_mean" in report.values for report in learner.reports))
    values = learner.reports[-1].values
    assert values["policy_version"] == 5
    assert values["decisions_per_second"] > 0
    assert values["episodes"] >= 1
    assert 0 <= values["collision_rate"] <= 1
    assert 0 <= values["speed"] < 8
    assert values["policy_lag_seconds"] >= 0
    assert values["chunks_given_up"] == 0


def test_frames_flow_while_they_are_watched(learner, start: Start):
    learner.publish(2)
    start()
    frames: list = []
    several = threading.Event()

    def take(frame) -> None:
        frames.append(frame)
        if len(frames) == 12:
            several.set()

    with subscribe_frames(learner.session, "test", "actor", "one", take):
        assert several.wait(60)
    frame = frames[0]
    assert (frame.town, frame.policy_version, len(frame.vehicles)) == ("town03", 2, 4)
    assert len(frame.birdeye) == 32 * 32 * 3
    assert set(frame.reward_terms) >= {"collision", "speed"}
    assert sum(frame.reward_terms.values()) == pytest.approx(frame.reward, abs=1e-3)
    assert {frame.step for frame in frames} > {1, 2}
    assert set(frame.decision) == {"intention", "target_speed", "waypoint_angle"}
    assert 0 <= frame.decision["intention"] <= 2


def test_the_actor_never_imports_torch():
    program = "import sys, athrl_actor; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], timeout=120).returncode == 0


def test_the_last_report_accounts_for_every_chunk(learner, start: Start, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("athrl_actor.actor.DRAIN_SECONDS", 0.2)
    learner.publish(0)
    service = start()
    learner.wait_for_chunks(3)
    learner.full = True
    assert learner.wait_for(lambda: learner.reports and learner.reports[-1].values["chunks_waiting"] > 0)
    service.stop.set()
    service.join()
    assert learner.wait_for(lambda: learner.reports[-1].values["chunks_waiting"] == 0)
    values = learner.reports[-1].values
    assert values["chunks_given_up"] > 0
    assert values["chunks_produced"] == values["chunks_acknowledged"] + values["chunks_given_up"]
    assert values["chunks_acknowledged"] == len(learner.chunks)
    reasons = [count for name, count in values.items() if name.startswith("chunks_given_up/")]
    assert sum(reasons) == values["chunks_given_up"]


def test_policy_that_never_arrives_is_warned_of_once(learner, start: Start, caplog) -> None:
    learner.close()
    network = learner.run_file.network.model_copy(update={"patience": 0.5})
    learner.run_file = learner.run_file.model_copy(update={"network": network})
    learner.open()
    start()
    assert learner.wait_for(lambda: len(learner.reports) >= 3)
    assert [record.message for record in caplog.records if "no policy" in record.message] == [
        "no policy has arrived for 0.5 s"
    ]
    learner.publish(0)
    learner.wait_for_chunks(1)
