"""Environments that raise or stall lose only their episodes; too many failures end the actor."""

import logging
import math
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from athrl_actor import TooManyFailures, run_actor
from athrl_actor.failures import WINDOW_SECONDS, FailureCount
from athrl_driving.policy import BatchStep, EnvironmentBatch, EnvironmentRaised, EnvironmentStalled, guard

ENOUGH = 60.0


class FaultInjector:
    """Wraps the environments' steps or resets and fails at chosen calls."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, method: str, harm: Callable[[], None]) -> None:
        self.calls = 0
        self.at: set[int] = set()
        self.always = False
        self.ended: dict[int, int] = {}  # episodes that ended in each call that makes a step
        done = getattr(EnvironmentBatch, method)

        def instead(batch: EnvironmentBatch, *arguments: Any) -> Any:
            self.calls += 1
            if self.always or self.calls in self.at:
                harm()
            outcome = done(batch, *arguments)
            if isinstance(outcome, BatchStep):
                self.ended[self.calls] = int((outcome.terminated | outcome.truncated).sum())
            return outcome

        monkeypatch.setattr(EnvironmentBatch, method, instead)


def raise_it() -> None:
    raise ZeroDivisionError("a lane\nwithout length")


@pytest.fixture
def hang(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], None]]:
    """A call that does not return before the test ends."""
    monkeypatch.setattr(guard, "POLL_SECONDS", 0.05)
    over = threading.Event()
    yield lambda: over.wait(ENOUGH) and None
    over.set()


class Driving:
    """An actor in a thread."""

    def __init__(self, learner: Any) -> None:
        self.stop = threading.Event()
        self.error: Exception | None = None
        self._address = learner.address
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        try:
            run_actor(connect=self._address, run="test", name="one", stop=self.stop)
        except Exception as error:
            self.error = error

    def join(self) -> None:
        self._thread.join(ENOUGH)
        assert not self._thread.is_alive()


@pytest.fixture
def start(learner: Any) -> Iterator[Callable[[], Driving]]:
    started: list[Driving] = []

    def begin() -> Driving:
        started.append(Driving(learner))
        return started[-1]

    yield begin
    for driving in started:
        driving.stop.set()
        driving.join()


def configure(learner: Any, **settings: Any) -> None:
    """Change the actor's settings in the run file that the learner serves."""
    actor = learner.run_file.actor.model_copy(update=settings)
    learner.close()
    learner.run_file = learner.run_file.model_copy(update={"actor": actor})
    learner.open()


def check_episodes(learner: Any) -> None:
    """Every episode's chunks cover it from its beginning without a gap, and no two episodes share a seed."""
    steps: dict[tuple[int, int], int] = {}
    for chunk in learner.chunks:
        episode = (chunk.environment, chunk.episode_seed)
        assert chunk.first_step == steps.get(episode, 0)
        steps[episode] = chunk.first_step + chunk.length
    seeds = [seed for _, seed in steps]
    assert len(set(seeds)) == len(seeds)


def test_environment_that_raises_is_reset_with_another_seed_and_counted(
    learner, start, monkeypatch, caplog
) -> None:
    monkeypatch.setattr("athrl_actor.chunks.LONGEST_SECONDS", math.inf)  # chunks are cut by their length
    steps = FaultInjector(monkeypatch, "step", raise_it)
    steps.at = {6, 14}  # in the middle of the second chunk, and of a later one
    learner.publish(0)
    driving = start()
    assert learner.wait_for(lambda: bool(learner.reports) and learner.reports[-1].values["episodes"] >= 4)
    values = learner.reports[-1].values
    assert (values["environments_failed"], values["environments_stalled"]) == (2, 0)
    # Of both environments, both times; an episode that was just about to begin has none.
    assert values["chunks_dropped"] == 4 - steps.ended[5] - steps.ended[13]
    assert "step raised ZeroDivisionError: a lane without length; restarting 2 episodes" in caplog.text
    driving.stop.set()
    driving.join()
    assert driving.error is None
    check_episodes(learner)


def test_reset_that_raises_is_tried_with_another_seed_and_loses_no_finished_chunk(
    learner, start, monkeypatch
) -> None:
    resets = FaultInjector(monkeypatch, "reset", raise_it)
    resets.at = {2, 5}
    learner.publish(0)
    driving = start()
    assert learner.wait_for(lambda: bool(learner.reports) and learner.reports[-1].values["episodes"] >= 6)
    values = learner.reports[-1].values
    assert values["environments_failed"] == 2
    assert values["chunks_dropped"] == 0
    driving.stop.set()
    driving.join()
    check_episodes(learner)
    ends = [chunk for chunk in learner.chunks if chunk.truncated or chunk.terminated]
    assert len(ends) >= values["episodes"]


def test_environment_that_stalls_is_abandoned_and_driving_continues(
    learner, start, monkeypatch, hang, caplog
) -> None:
    configure(learner, stall_seconds=0.5)
    steps = FaultInjector(monkeypatch, "step", hang)
    steps.at = {6}
    learner.publish(0)
    driving = start()
    assert learner.wait_for(
        lambda: bool(learner.reports) and learner.reports[-1].values.get("environments_stalled", 0) == 1
    )
    before = len(learner.chunks)
    learner.wait_for_chunks(before + 10)
    assert "step did not return within 0.5 s; restarting 2 episodes" in caplog.text
    driving.stop.set()
    driving.join()
    assert driving.error is None
    check_episodes(learner)


def test_actor_whose_environments_fail_repeatedly_exits_with_the_reason(learner, start, monkeypatch) -> None:
    configure(learner, failures_allowed=3)
    steps = FaultInjector(monkeypatch, "step", raise_it)
    learner.publish(0)
    driving = start()
    learner.wait_for_chunks(6)
    steps.always = True
    driving.join()
    assert isinstance(driving.error, TooManyFailures)
    said = str(driving.error)
    assert "failed 4 times" in said
    assert "actor.failures_allowed is 3" in said
    assert "a lane without length" in said
    assert "\n" not in said
    check_episodes(learner)
    assert learner.wait_for(lambda: learner.intake.statistics().stored == len(learner.chunks))
    produced = learner.chunks[-1].sequence + 1  # all complete chunks arrived in order
    assert [chunk.sequence for chunk in learner.chunks] == list(range(produced))


def test_old_failures_do_not_count() -> None:
    now = 0.0
    count = FailureCount(1, clock=lambda: now)
    for _ in range(5):
        count.add(EnvironmentRaised("step raised", [0]), 1)
        now += WINDOW_SECONDS
    count.add(EnvironmentStalled("stalled", [0, 1]), 2)
    with pytest.raises(TooManyFailures):
        count.add(EnvironmentRaised("step raised", [0]), 0)
    assert count.report() == {"environments_failed": 6, "environments_stalled": 1, "chunks_dropped": 7}


def test_time_in_which_the_process_was_paused_is_no_stall(monkeypatch) -> None:
    """After SIGCONT a wait has expired although the environments had no time to answer."""
    batch = guard.GuardedBatch(["town03"], {"vehicles_count": 2}, seconds=5)
    batch.reset(0, 1)
    batch.reset(0, 2)
    get, waits = guard.SimpleQueue.get, []

    class Paused(guard.SimpleQueue):
        def get(self, block: bool = True, timeout: float | None = None) -> Any:
            if timeout is not None and not waits:
                waits.append(timeout)
                time.sleep(0.01)
                raise guard.Empty  # the pause used up this wait, however long it was
            return get(self, block, timeout)

    monkeypatch.setattr(batch._worker, "_outcomes", outcomes := Paused())
    monkeypatch.setattr(batch._worker, "_calls", calls := guard.SimpleQueue())
    threading.Thread(target=guard._serve, args=(calls, outcomes), daemon=True).start()
    batch.reset(0, 3)
    assert waits == [guard.POLL_SECONDS]
    batch.close()


def test_failures_are_told_in_the_log_with_their_reason(caplog) -> None:
    with caplog.at_level(logging.WARNING):
        FailureCount(1).add(EnvironmentRaised("reset of environment 3 raised ValueError: no room", [3]), 0)
    assert caplog.messages == ["reset of environment 3 raised ValueError: no room; restarting 1 episode"]
