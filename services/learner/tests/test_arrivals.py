"""What the learner tells about its actors, few or many."""

from __future__ import annotations

import threading

import numpy as np
from athrl_learner.intake.arrivals import NAMED, Arrivals
from athrl_protocol.announcements.metrics import decode_metrics
from athrl_protocol.messages import athrl_pb2
from athrl_protocol.messages.schema import encode_message


def test_report_about_a_thousand_actors_is_taken_and_names_those_furthest_behind(make_chunk):
    now = 0.0
    arrivals = Arrivals(clock=lambda: now)
    arrivals.published(1)
    behind = {f"actor-{number}" for number in range(0, 1000, 10)}
    for number in range(1000):
        arrivals.published_version = 9 if f"actor-{number}" in behind else 7
        arrivals.arrived(make_chunk(actor=f"actor-{number}"))
    values = arrivals.metrics()
    message = athrl_pb2.Metrics(role="learner", name="learner", time=1.0, values=values)
    assert decode_metrics(encode_message(message)).values == values
    assert values["policy_lag"] == max(values.values())
    named = {key.removeprefix("policy_lag/") for key in values if key.startswith("policy_lag/")}
    assert len(named) == NAMED
    assert named == behind


def test_policy_that_the_learner_did_not_publish_is_named_and_counted(make_chunk, caplog):
    arrivals = Arrivals()
    arrivals.published(39)
    versions = np.array([38, 39, 39, 39, 39])
    arrivals.arrived(make_chunk(policy_version=versions))
    assert arrivals.unpublished == 0
    for _ in range(2):
        arrivals.arrived(make_chunk(policy_version=np.array([39, 999, 39, 39, 39])))
    padding = np.array([39, 39, 39, 39, 999])
    arrivals.arrived(make_chunk(policy_version=padding, length=4))
    assert arrivals.unpublished == 2
    assert caplog.messages == ["actor-1 drives policy 999, which this learner did not publish"]


def test_policy_is_not_published_in_the_middle_of_noting_a_chunk(make_chunk):
    """What is iterated over there would change, which would end the intake."""
    middles = []

    def clock() -> float:
        if noting:
            noting.clear()
            publication = threading.Thread(target=arrivals.published, args=(2,))
            publication.start()
            publication.join(0.05)
            middles.append((arrivals.published_version, publication))
        return 1.0

    noting: list[bool] = []
    arrivals = Arrivals(clock)
    arrivals.published(1)
    noting.append(True)
    arrivals.arrived(make_chunk())
    ((version, publication),) = middles
    publication.join(10)
    assert (version, arrivals.published_version) == (1, 2)
