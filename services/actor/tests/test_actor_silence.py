"""An actor that waits for its learner says so once, and only if that takes nothing at all."""

from athrl_actor.silence import Silence


class Clock:
    now = 100.0

    def __call__(self) -> float:
        return self.now


def test_learner_that_takes_nothing_is_told_of_once():
    clock = Clock()
    silence = Silence(30.0, acknowledged=7, clock=clock)
    told = []
    for _ in range(90):
        clock.now += 1.0
        told.append(silence.worth_telling(7))
    assert [seconds for seconds in told if seconds is not None] == [31.0]


def test_learner_that_takes_chunks_meanwhile_is_not_called_silent():
    clock = Clock()
    silence = Silence(30.0, acknowledged=7, clock=clock)
    for second in range(90):
        clock.now += 1.0
        assert silence.worth_telling(7 + second // 20) is None


def test_silence_that_comes_later_is_counted_from_the_last_chunk_taken():
    clock = Clock()
    silence = Silence(30.0, acknowledged=7, clock=clock)
    clock.now += 25.0
    assert silence.worth_telling(8) is None
    clock.now += 25.0
    assert silence.worth_telling(8) is None
    clock.now += 10.0
    assert silence.worth_telling(8) == 35.0
