"""A fingerprint tells every bit of a state, and nothing else."""

import numpy as np
import pytest
import torch
from athrl_learner import factories
from athrl_learner.checkpoint import fingerprint


def test_same_state_has_the_same_fingerprint_whatever_holds_it():
    state = {"b": torch.arange(4.0), "a": [1, "two", None, 0.5]}
    assert fingerprint.fingerprint(state) == fingerprint.fingerprint(dict(reversed(list(state.items()))))
    assert fingerprint.fingerprint(torch.arange(4.0)) == fingerprint.fingerprint(
        np.arange(4, dtype=np.float32)
    )
    assert len(fingerprint.fingerprint(state)) == fingerprint.DIGITS


@pytest.mark.parametrize(
    "other",
    [
        np.nextafter(np.zeros(3, np.float32), np.float32(1)),
        np.zeros(3, np.float64),
        np.zeros((3, 1), np.float32),
        np.array([0.0, -0.0, 0.0], np.float32),
        [0.0, 0.0, 0.0],
    ],
)
def test_every_bit_type_and_shape_counts(other):
    assert fingerprint.fingerprint(other) != fingerprint.fingerprint(np.zeros(3, np.float32))


def test_what_has_no_fingerprint_is_refused():
    with pytest.raises(TypeError, match="set"):
        fingerprint.fingerprint({"a": {1, 2}})


def test_update_changes_parameters_and_optimisers_and_a_sample_the_replay(run_file, make_chunk):
    agent = factories.make_agent(run_file)
    replay = factories.make_replay(run_file, agent)
    reader = factories.make_reader(run_file, agent)
    for _ in range(4):
        (sequence,) = reader.sequences(make_chunk())
        replay.insert(sequence)

    def all_three() -> list[str]:
        return [
            fingerprint.parameters(agent),
            fingerprint.optimisers(agent),
            fingerprint.replay_content(replay),
        ]

    before = all_three()
    assert all_three() == before
    batch = replay.sample(10)
    drawn = all_three()
    assert drawn[:2] == before[:2]
    assert drawn[2] != before[2]
    agent.update(batch)
    trained = all_three()
    assert trained[0] != drawn[0]
    assert trained[1] != drawn[1]
    assert trained[2] == drawn[2]
