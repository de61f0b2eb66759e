"""RLlib's PPO, all of it in this process, in its own environment (`--with rllib`)."""

from __future__ import annotations

import os
from functools import partial
from typing import Any

import numpy as np
import ray
import torch
from gymnasium.vector import AutoresetMode, VectorWrapper
from gymnasium.wrappers.vector import TransformReward
from numpy.typing import NDArray
from ray.rllib.algorithms.ppo import PPOConfig
from ray.rllib.core.columns import Columns
from ray.rllib.core.distribution.torch.torch_distribution import TorchDiagGaussian
from ray.rllib.core.learner import Learner
from ray.rllib.core.rl_module.apis import ValueFunctionAPI
from ray.rllib.core.rl_module.rl_module import RLModule, RLModuleSpec
from ray.rllib.core.rl_module.torch import TorchRLModule
from ray.tune.registry import register_env
from torch import Tensor

from benchmarks.peers.comparison import Act, Comparison, Observation, Training
from benchmarks.peers.network import Encoder, head
from benchmarks.peers.town import REWARD_SCALE, make_towns

ENVIRONMENTS = 32
STEPS = 128
EPOCHS = 4
BATCH = 512
DISCOUNT = 0.97
RATE = 3e-4


class TownModule(TorchRLModule, ValueFunctionAPI):
    """The encoder with a Gaussian's mean and log standard deviation, and a value."""

    def setup(self) -> None:
        """Make the layers."""
        self.action_dist_cls = TorchDiagGaussian
        self.encoder = Encoder().to(memory_format=torch.channels_last)
        self.action, self.value = head(4), head(1)

    def _forward(self, batch: dict[str, Any], **_: Any) -> dict[str, Tensor]:
        return {Columns.ACTION_DIST_INPUTS: self.action(self._features(batch))}

    def _forward_train(self, batch: dict[str, Any], **_: Any) -> dict[str, Tensor]:
        features = self._features(batch)
        return {Columns.ACTION_DIST_INPUTS: self.action(features), Columns.EMBEDDINGS: features}

    def compute_values(self, batch: dict[str, Any], embeddings: Tensor | None = None) -> Tensor:
        """The value of each observation."""
        features = self._features(batch) if embeddings is None else embeddings
        return self.value(features).squeeze(-1)

    def _features(self, batch: dict[str, Any]) -> Tensor:
        seen = batch[Columns.OBS]
        return self.encoder(seen["image"].permute(0, 3, 1, 2).float() / 255, seen["motion"].float())


class WithoutInfos(VectorWrapper):
    """Towns without infos, which RLlib would process at each step."""

    def reset(self, **arguments: Any) -> tuple[Observation, dict[str, Any]]:
        """Start new episodes."""
        return self.env.reset(**arguments)[0], {}

    def step(self, actions: NDArray) -> tuple[Observation, NDArray, NDArray, NDArray, dict[str, Any]]:
        """Make one decision in each."""
        return *self.env.step(actions)[:4], {}


def train(training: Training) -> dict[str, Any]:
    """PPO: 32 environments of 128 steps, then 4 epochs in batches of 512."""
    # On this machine alone, and nothing of it stays: neither reports nor a key in the home folder.
    os.environ |= {"RAY_USAGE_STATS_ENABLED": "0", "RAY_AUTH_MODE": "disabled"}
    ray.init(
        num_cpus=training.comparison.cores,
        include_dashboard=False,
        log_to_driver=False,
        _node_ip_address="127.0.0.1",
    )
    algorithm = _config(training.comparison).build_algo()
    seen, act = 0, _greedy(algorithm.get_module())
    training.begin()
    while training.goes_on(seen, act):
        algorithm.learner_group.foreach_learner(partial(_set_rate, rate=training.falling(RATE)))
        algorithm.train()
        seen += ENVIRONMENTS * STEPS
    training.end(seen, act)
    algorithm.stop()
    ray.shutdown()
    return {"environments": ENVIRONMENTS, "n_steps": STEPS, "batch_size": BATCH, "n_epochs": EPOCHS}


def _config(comparison: Comparison) -> PPOConfig:
    def make(context: dict[str, Any]) -> VectorWrapper:
        made = make_towns(comparison, context["num_envs"], AutoresetMode.NEXT_STEP)
        return WithoutInfos(TransformReward(made, lambda reward: reward * REWARD_SCALE))

    register_env("towns", make)
    shapes = make_towns(comparison, 1, AutoresetMode.NEXT_STEP)
    return (
        PPOConfig()
        .environment(
            "towns",
            observation_space=shapes.single_observation_space,
            action_space=shapes.single_action_space,
        )
        .env_runners(
            num_env_runners=0,
            num_envs_per_env_runner=ENVIRONMENTS,
            gym_env_vectorize_mode="vector_entry_point",
            rollout_fragment_length=STEPS,
        )
        .learners(num_learners=0, num_gpus_per_learner=0)
        .training(
            train_batch_size_per_learner=ENVIRONMENTS * STEPS,
            minibatch_size=BATCH,
            num_epochs=EPOCHS,
            gamma=DISCOUNT,
            lr=RATE,
            lambda_=0.95,
            clip_param=0.2,
            vf_loss_coeff=0.5,
            vf_clip_param=float("inf"),
            use_kl_loss=False,
            grad_clip=0.5,
        )
        .rl_module(rl_module_spec=RLModuleSpec(module_class=TownModule))
        .debugging(seed=comparison.training_seed, log_level="ERROR")
    )


def _set_rate(learner: Learner, rate: float) -> None:
    """Its own schedules go by decisions, not by time; the next update is with this rate."""
    for optimizer in learner._named_optimizers.values():
        optimizer.param_groups[0]["lr"] = rate


def _greedy(module: RLModule) -> Act:
    def act(observation: Observation) -> NDArray[np.float32]:
        seen = {name: torch.from_numpy(values) for name, values in observation.items()}
        with torch.no_grad():
            found = module.forward_inference({Columns.OBS: seen})[Columns.ACTION_DIST_INPUTS]
        return found[:, :2].clamp(-1, 1).numpy()

    return act
