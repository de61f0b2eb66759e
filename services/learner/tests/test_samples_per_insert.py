"""The realised ratio of samples to inserts is within its tolerance, however many actors there are."""

from __future__ import annotations

import contextlib
import itertools
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from athrl_learner import factories, run_learner
from athrl_learner.reporting import reporter
from athrl_protocol import RunFile

pytestmark = pytest.mark.timeout(300)

STEPS, WARM_UP = 800, 200
LENGTH = 5
WAITING = 0.2
#: Counts of a report are read one after the other: so many updates and chunks may lie between two of them.
BETWEEN = 3


@pytest.fixture
def long_run(run_file: RunFile) -> RunFile:
    """Policies and checkpoints are rare, as sixteen actors that decode them are no part of the promise."""
    return run_file.model_copy(
        update={
            "run": run_file.run.model_copy(update={"environment_steps": STEPS}),
            "learner": run_file.learner.model_copy(
                update={"publish_seconds": 1.0, "checkpoint_seconds": 1000.0}
            ),
            "exploration": run_file.exploration.model_copy(update={"random_decisions": WARM_UP}),
        }
    )


def slowly(make_chunk, make_actor, actors: int):
    """Actors that make thirty chunks a second, and hold half of them back until the learner waits."""
    crew = []
    numbers = itertools.count()
    first_report = []

    def the_learner_has_waited() -> bool:
        reports = [report.values for report in crew[0].metrics[first_report[0] :]]
        return any(
            values.get("waiting/learner", 0.0) > WAITING and values["environment_steps"] > WARM_UP
            for values in reports
        )

    def make(**fields: object):
        time.sleep(actors / 30)
        if next(numbers) * LENGTH >= STEPS / 2:
            first_report.append(len(crew[0].metrics) + 1)  # that is about nothing before
            crew[0].wait_for(the_learner_has_waited)
        return make_chunk(**fields)

    crew += [make_actor(make, f"actor-{number}") for number in range(actors)]
    return crew


@pytest.mark.parametrize("leads", ["actors", "learner"])
@pytest.mark.parametrize("actors", [1, pytest.param(4, marks=pytest.mark.slow), 16])
def test_ratio_stays_within_its_tolerance(long_run, make_chunk, make_actor, monkeypatch, actors, leads):
    monkeypatch.setattr(reporter, "INTERVAL", 0.1)
    if leads == "actors":
        crew = [make_actor(make_chunk, f"actor-{number}") for number in range(actors)]
    else:
        crew = slowly(make_chunk, make_actor, actors)
    with ThreadPoolExecutor(1) as pool, contextlib.ExitStack() as stack:
        learner = pool.submit(run_learner, long_run, stop=threading.Event())
        for actor in crew:
            stack.enter_context(actor)
        summary = learner.result(timeout=200)
    assert summary.finished
    limiter = factories.make_limiter(long_run, factories.make_agent(long_run))
    slack = BETWEEN * (limiter.largest_sample + limiter.ratio * limiter.largest_insert)
    received = max((actor.metrics for actor in crew), key=len)
    reports = [report.values for report in received if report.role == "learner"]
    begun = limiter.minimum_inserts
    during = [values for values in reports if begun < values["environment_steps"] < STEPS]
    assert during
    ahead = [
        (limiter.ratio - values["samples_per_insert"]) * (values["environment_steps"] - begun)
        for values in during
    ]
    assert max(map(abs, ahead)) <= limiter.error_bound + slack
    print(  # shown by -s
        f"\n{actors} actors, {leads} lead: {summary.samples_per_insert:.2f} samples per insert in the end, "
        f"{min(ahead):+.0f} to {max(ahead):+.0f} samples off on the way, allowed {limiter.error_bound:.0f}"
    )
    tolerance = long_run.learner.samples_per_insert_tolerance
    assert summary.samples_per_insert == pytest.approx(limiter.ratio, rel=tolerance)
    # Otherwise there was nothing to hold back.
    waiting = "waiting/actors" if leads == "actors" else "waiting/learner"
    assert max(values[waiting] for values in during) > WAITING
    delivered = sum(actor.statistics.acknowledged for actor in crew)
    assert delivered * long_run.replay.sequence_length == summary.environment_steps
