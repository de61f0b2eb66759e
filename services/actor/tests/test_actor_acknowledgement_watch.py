"""An actor that waits for its learner says so once, and only if the learner acknowledges nothing at all."""

from athrl_actor.acknowledgement_watch import AcknowledgementWatch


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def test_learner_that_acknowledges_nothing_is_reported_once():
    clock = Clock()
    watch = AcknowledgementWatch(30.0, acknowledged=7, clock=clock)
    reported = []
    for _ in range(90):
        clock.now += 1.0
        reported.append(watch.overdue_seconds(7))
    assert [seconds for seconds in reported if seconds is not None] == [31.0]


def test_learner_that_acknowledges_chunks_meanwhile_is_not_reported():
    clock = Clock()
    watch = AcknowledgementWatch(30.0, acknowledged=7, clock=clock)
    for second in range(90):
        clock.now += 1.0
        assert watch.overdue_seconds(7 + second // 20) is None


def test_a_later_wait_is_counted_from_the_last_acknowledged_chunk():
    clock = Clock()
    watch = AcknowledgementWatch(30.0, acknowledged=7, clock=clock)
    clock.now += 25.0
    assert watch.overdue_seconds(8) is None
    clock.now += 25.0
    assert watch.overdue_seconds(8) is None
    clock.now += 10.0
    assert watch.overdue_seconds(8) == 35.0
