"""The realised ratio of samples to inserts is within its tolerance, however many actors there are."""

from __future__ import annotations

import contextlib
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from athrl_learner import factories, run_learner
from athrl_protocol import RunFile

pytestmark = pytest.mark.timeout(300)

STEPS = 1200
#: Counts of a report are read one after the other: so many updates and chunks may lie between two of them.
BETWEEN = 3


@pytest.fixture
def long_run(run_file: RunFile) -> RunFile:
    return run_file.model_copy(
        update={
            "run": run_file.run.model_copy(update={"environment_steps": STEPS}),
            "exploration": run_file.exploration.model_copy(update={"random_decisions": 200}),
        }
    )


def pace(make_chunk, seconds: float):
    """Make chunks no faster than one in so many seconds."""

    def make(**fields: object):
        time.sleep(seconds)
        return make_chunk(**fields)

    return make


@pytest.mark.parametrize("leads", ["actors", "learner"])
@pytest.mark.parametrize("actors", [1, 4, 16])
def test_ratio_stays_within_its_tolerance(long_run, make_chunk, make_actor, actors, leads):
    made = make_chunk if leads == "actors" else pace(make_chunk, actors / 30)
    crew = [make_actor(made, f"actor-{number}") for number in range(actors)]
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
    assert max(values[waiting] for values in during) > 0.2
    delivered = sum(actor.statistics.acknowledged for actor in crew)
    assert delivered * long_run.replay.sequence_length == summary.environment_steps
