"""A batch records what its driver observed, decision by decision."""

import numpy as np
import pytest
from athrl_driving.policy import EnvironmentBatch, GuardedBatch
from athrl_spaces import REWARD_TERMS

CONFIG = {"vehicles_count": 10, "episode_ticks": 40}
ROOM = 4


@pytest.fixture(params=[1, 8])
def batch(request: pytest.FixtureRequest) -> EnvironmentBatch:
    batch = EnvironmentBatch(["town03"] * request.param, CONFIG, recorded=ROOM)
    for env_index in range(len(batch)):
        batch.reset(env_index, seed=env_index)
    return batch


def drive(batch: EnvironmentBatch, decisions: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Observations before and after each of so many decisions, [time + 1, batch, ...], and rewards."""
    images, motion, rewards = [batch.images.copy()], [batch.motion.copy()], []
    random = np.random.default_rng(0)
    for _ in range(decisions):
        rewards.append(batch.step(random.uniform(-1, 1, (len(batch), 2)).astype(np.float32)).rewards)
        images.append(batch.images.copy())
        motion.append(batch.motion.copy())
    return np.stack(images), np.stack(motion), np.stack(rewards)


def test_recording_holds_observations_and_rewards(batch: EnvironmentBatch):
    images, motion, rewards = drive(batch, ROOM)
    for env_index in range(len(batch)):
        np.testing.assert_array_equal(batch.recording.images[env_index], images[:, env_index])
        np.testing.assert_array_equal(batch.recording.motion[env_index], motion[:, env_index])
        np.testing.assert_array_equal(batch.recording.rewards[env_index, 1:], rewards[:, env_index])


def test_recorded_terms_are_what_info_tells_and_sum_to_the_reward(batch: EnvironmentBatch):
    random, told = np.random.default_rng(1), []
    for _ in range(ROOM):
        infos = batch.step(random.uniform(-1, 1, (len(batch), 2)).astype(np.float32)).infos
        told.append(np.stack([infos["reward_terms"][term] for term in REWARD_TERMS], axis=-1))
    terms = batch.recording.terms[:, 1:]
    np.testing.assert_array_equal(terms, np.stack(told, axis=1).astype(np.float32))
    np.testing.assert_allclose(terms.sum(axis=2), batch.recording.rewards[:, 1:], rtol=1e-5, atol=1e-5)
    steering = [REWARD_TERMS.index("steer"), REWARD_TERMS.index("lateral")]
    assert (terms[..., steering] < 0).any()
    assert (terms[..., REWARD_TERMS.index("speed")] != 0).any()


def test_recording_holds_what_another_held_whose_state_it_loads(batch: EnvironmentBatch):
    drive(batch, 3)
    batch.recording.rewind(0, 2)
    state = batch.recording.state()
    columns = ("images", "motion", "rewards", "terms")
    held = {name: getattr(batch.recording, name).copy() for name in columns}
    other = EnvironmentBatch(batch.towns, CONFIG, recorded=ROOM)
    for env_index in range(len(other)):
        other.reset(env_index, seed=50 + env_index)
    drive(other, ROOM)
    assert not np.array_equal(other.recording.terms, held["terms"])
    other.recording.load_state(state)
    drive(batch, 1)  # the state is a copy
    for name, column in held.items():
        np.testing.assert_array_equal(getattr(other.recording, name), column)
    assert all(np.array_equal(one, state[name]) for name, one in other.recording.state().items())


def test_removed_decisions_make_room_and_the_next_begin_with_the_last_observation(batch: EnvironmentBatch):
    for _ in range(3):
        images, _, rewards = drive(batch, 2)
        for env_index in range(len(batch)):
            np.testing.assert_array_equal(batch.recording.images[env_index, :3], images[:, env_index])
            np.testing.assert_array_equal(batch.recording.rewards[env_index, 1:3], rewards[:, env_index])
            batch.recording.rewind(env_index, 2)


def test_an_episode_is_recorded_from_its_beginning(batch: EnvironmentBatch):
    drive(batch, 3)
    batch.recording.rewind(0, 3)
    drive(batch, 1)
    last = len(batch) - 1
    batch.reset(0, seed=77)
    batch.reset(last, seed=78)
    images, _, _ = drive(batch, 2)
    for env_index in (0, last):
        np.testing.assert_array_equal(batch.recording.images[env_index, :3], images[:, env_index])


def test_decisions_beyond_the_capacity_are_not_recorded(batch: EnvironmentBatch):
    images, _, _ = drive(batch, 3 * ROOM)
    for env_index in range(len(batch)):
        np.testing.assert_array_equal(batch.recording.images[env_index], images[: ROOM + 1, env_index])


def test_guarded_batch_records_and_a_replaced_one_starts_again(monkeypatch: pytest.MonkeyPatch):
    guarded = GuardedBatch(["town03"] * 2, CONFIG, seconds=60, recorded=ROOM)
    try:
        before = guarded.recording
        assert before.images.shape == (2, ROOM + 1, 32, 32, 4)
        with monkeypatch.context() as patch:
            patch.setattr(EnvironmentBatch, "step", lambda *_: 1 / 0)
            with pytest.raises(Exception, match="ZeroDivisionError"):
                guarded.step(np.zeros((2, 2), np.float32))
        assert guarded.recording is not before
    finally:
        guarded.close()
