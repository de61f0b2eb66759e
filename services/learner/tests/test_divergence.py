"""A number that is none stops training: the checkpoint before it is kept, and its batch can be looked at."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
import torch
from athrl_learner import LearnerError, Summary, factories, run_learner
from athrl_learner.checkpoint import newest_intact_checkpoint
from athrl_learner.training.trainer import Trainer
from athrl_planners import Agent, SequenceReplay, TrainingDiverged
from athrl_planners.training import agent
from athrl_protocol import Chunk, RunFile

GOOD_UPDATES = 5


@pytest.fixture
def longer(run_file: RunFile) -> RunFile:
    """Long enough for the loss to go wrong on the way, with checkpoints all the time."""
    run = run_file.run.model_copy(update={"environment_steps": 4000})
    learner = run_file.learner.model_copy(update={"checkpoint_seconds": 0.01})
    return run_file.model_copy(update={"run": run, "learner": learner})


def poison(
    monkeypatch: pytest.MonkeyPatch,
    loss: str,
    factor: float = float("nan"),
    good_updates: int = GOOD_UPDATES,
) -> None:
    """Multiply the critics' or the actors' loss from some update on."""
    calls = []
    critic_loss, actor_losses = agent.critic_loss, agent.actor_losses

    def poisoned_critic_loss(*arguments: object) -> object:
        calls.append(None)
        result = critic_loss(*arguments)
        return result._replace(loss=result.loss * factor) if len(calls) > good_updates else result

    def poisoned_actor_losses(*arguments: object) -> object:
        calls.append(None)
        losses, metrics = actor_losses(*arguments)
        if len(calls) > good_updates:
            losses = {level: loss * factor for level, loss in losses.items()}
        return losses, metrics

    if loss == "critic":
        monkeypatch.setattr(agent, "critic_loss", poisoned_critic_loss)
    else:
        monkeypatch.setattr(agent, "actor_losses", poisoned_actor_losses)


def all_finite(state: object) -> bool:
    if isinstance(state, torch.Tensor):
        return bool(torch.isfinite(state).all()) if state.is_floating_point() else True
    if isinstance(state, dict):
        return all(map(all_finite, state.values()))
    return True


@pytest.mark.parametrize("loss", ["critic", "actor"])
def test_training_stops_with_the_last_good_checkpoint_and_its_batch(longer, fake_actor, monkeypatch, loss):
    stopped = threading.Event()
    stopped.set()
    folder = run_learner(longer, stop=stopped).folder  # a checkpoint at least
    poison(monkeypatch, loss)
    with ThreadPoolExecutor(1) as pool, fake_actor:
        running = pool.submit(run_learner, None, resume=folder, stop=threading.Event())
        with pytest.raises(LearnerError) as refusal:
            running.result(timeout=120)
    line = str(refusal.value)
    assert "\n" not in line
    assert "nan" in line
    _, checkpoint = newest_intact_checkpoint(folder / "checkpoints")
    assert checkpoint.agent["planner"]["updates"] <= 2 * GOOD_UPDATES + 1  # actors learn every second time
    assert all_finite(checkpoint.agent["planner"]["networks"])
    (batch,) = (folder / "diverged").iterdir()
    assert str(batch) in line
    check_batch(batch, longer)
    monkeypatch.undo()
    check_that_it_is_resumed(folder)


def check_batch(path: Path, run_file: RunFile) -> None:
    sequences = run_file.learner.batch // run_file.replay.sequence_length
    with np.load(path, allow_pickle=False) as arrays:
        assert arrays["images"].shape == (sequences, 6, 32, 32, 4)
        assert arrays["actions/trajectory"].shape == (sequences, 5, 2)
        assert {"motion", "rewards/intention", "initial_state/trajectory", "length"} <= set(arrays)
        assert all(np.isfinite(arrays[name]).all() for name in arrays)


def check_that_it_is_resumed(folder: Path) -> None:
    """What was acknowledged is in the log: a resumed run has it, and training goes well this time."""
    stop = threading.Event()
    stop.set()
    resumed: Summary = run_learner(None, resume=folder, stop=stop)
    assert resumed.environment_steps > 0


def new_trainer(run_file: RunFile, make_chunk: Callable[..., Chunk]) -> tuple[Trainer, SequenceReplay, Agent]:
    learner = factories.make_agent(run_file)
    replay = factories.make_replay(run_file, learner)
    for sequence in factories.make_reader(run_file, learner).sequences(make_chunk(sequences=4)):
        replay.insert(sequence)
    return Trainer(learner, replay), replay, learner


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
@pytest.mark.parametrize("loss", ["critic", "actor"])
@pytest.mark.parametrize("factor", [float("nan"), float("inf"), 1e37])
def test_overflow_is_reported_as_what_is_no_number_is(
    run_file, make_chunk, monkeypatch, factor: float, loss: str, precision: str
):
    # With the last factor the loss is finite or overflows in some of its decisions; its gradient overflows.
    settings = run_file.learner.model_copy(update={"precision": precision})
    trainer, replay, _ = new_trainer(run_file.model_copy(update={"learner": settings}), make_chunk)
    trainer.update(replay.sample(20), 0.0)
    poison(monkeypatch, loss, factor, good_updates=0)

    def update_twice() -> None:  # actors learn every second time
        for _ in range(2):
            trainer.update(replay.sample(20), 0.0)

    with pytest.raises(TrainingDiverged, match=r"(inf|nan)$") as refusal:
        update_twice()
    assert "\n" not in str(refusal.value)


def test_overflow_of_an_error_is_reported_before_it_is_a_priority(run_file, make_chunk, monkeypatch):
    settings = run_file.replay.model_copy(update={"prioritised": True})
    trainer, replay, learner = new_trainer(run_file.model_copy(update={"replay": settings}), make_chunk)
    monkeypatch.setattr(learner, "device", torch.device("meta"))  # as on a GPU, where no loss is looked at
    before = replay.priorities()["priorities"]
    errors = torch.tensor([1.0, float("inf"), 1.0, 1.0])
    monkeypatch.setattr(learner, "update", lambda *_: ({}, errors))
    with pytest.raises(TrainingDiverged, match="an error of update 0 is inf"):
        trainer.update(replay.sample(20), 0.0)
    np.testing.assert_array_equal(replay.priorities()["priorities"], before)


def test_loss_that_nobody_has_looked_at_is_noticed_before_anything_is_kept(run_file, make_chunk, monkeypatch):
    # As on a GPU, where an update does not synchronise: a report between update and check loses nothing.
    trainer, replay, learner = new_trainer(run_file, make_chunk)
    trainer.update(replay.sample(20), 0.0)
    trainer.require_finite()
    monkeypatch.setattr(learner, "device", torch.device("meta"))
    nan = {"intention/critic_loss": torch.tensor(float("nan"))}
    monkeypatch.setattr(learner, "update", lambda *_: (nan, torch.zeros(4)))
    trainer.update(replay.sample(20), 0.0)
    assert np.isnan(trainer.metrics()["loss/intention/critic_loss"])
    with pytest.raises(TrainingDiverged, match="intention/critic_loss up to update 1 is nan"):
        trainer.require_finite()
