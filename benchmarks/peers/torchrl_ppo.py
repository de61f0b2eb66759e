"""TorchRL's PPO: its collector, advantages and loss, in its own environment (`--with torchrl`)."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import NormalParamExtractor, TensorDictModule, TensorDictSequential
from torch import nn
from torchrl.collectors import Collector
from torchrl.data import Bounded, Composite, Unbounded
from torchrl.envs import EnvBase
from torchrl.envs.utils import ExplorationType, set_exploration_type
from torchrl.modules import ProbabilisticActor, TanhNormal, ValueOperator
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from benchmarks.peers.comparison import Act, Observation, Training
from benchmarks.peers.network import Encoder, head
from benchmarks.peers.town import REWARD_SCALE, make_towns

ENVIRONMENTS = 32
STEPS = 128
EPOCHS = 4
BATCH = 512
DISCOUNT = 0.97
RATE = 3e-4
GRADIENT_NORM = 0.5


class Towns(EnvBase):
    """A gymnasium vector of towns, which TorchRL resets where an episode has ended."""

    def __init__(self, towns: VectorEnv, seed: int) -> None:
        count = towns.num_envs
        super().__init__(batch_size=[count])
        self._towns, self._first_seed = towns, seed
        image = Unbounded((count, *towns.single_observation_space["image"].shape), dtype=torch.uint8)
        self.observation_spec = Composite(image=image, motion=Unbounded((count, 2)), shape=(count,))
        self.action_spec = Bounded(-1.0, 1.0, (count, 2), dtype=torch.float32)
        self.reward_spec = Unbounded((count, 1))
        flag = Unbounded((count, 1), dtype=torch.bool)
        self.done_spec = Composite(done=flag, terminated=flag.clone(), truncated=flag.clone(), shape=(count,))

    def _reset(self, tensordict: TensorDictBase | None = None, **_: Any) -> TensorDict:
        """Begin new episodes in all environments, or in those of the entry `_reset`."""
        if tensordict is not None and tensordict.get("_reset", None) is not None:
            mask = tensordict["_reset"].reshape(-1).numpy()
            observation, _ = self._towns.reset(options={"reset_mask": mask})
        else:
            observation, _ = self._towns.reset(seed=self._first_seed)
        no = torch.zeros(*self.batch_size, 1, dtype=torch.bool)
        flags = {name: no.clone() for name in ("done", "terminated", "truncated")}
        return TensorDict({**_tensors(observation), **flags}, self.batch_size)

    def _step(self, tensordict: TensorDictBase) -> TensorDict:
        """Make one decision in each."""
        observation, reward, terminated, truncated, _ = self._towns.step(tensordict["action"].numpy())
        values = {
            **_tensors(observation),
            "reward": _column(reward * REWARD_SCALE).float(),
            "done": _column(terminated | truncated),
            "terminated": _column(terminated),
            "truncated": _column(truncated),
        }
        return TensorDict(values, self.batch_size)

    def _set_seed(self, seed: int | None) -> None:
        self._first_seed = seed or self._first_seed


class Features(nn.Module):
    """The encoder on images as they come, uint8 [..., S, S, 4]."""

    def __init__(self) -> None:
        super().__init__()
        self.encoder = Encoder().to(memory_format=torch.channels_last)

    def forward(self, image: torch.Tensor, motion: torch.Tensor) -> torch.Tensor:
        """Encode a batch with any leading dimensions."""
        leading = image.shape[:-3]
        image = image.reshape(-1, *image.shape[-3:]).permute(0, 3, 1, 2).float() / 255
        features = self.encoder(image, motion.reshape(-1, 2))
        return features.reshape(*leading, -1)


def train(training: Training) -> dict[str, Any]:
    """PPO: 32 environments of 128 steps, then 4 epochs in batches of 512."""
    towns = make_towns(training.comparison, ENVIRONMENTS, AutoresetMode.DISABLED)
    environment = Towns(towns, training.comparison.training_seed)
    features = TensorDictModule(Features(), ["image", "motion"], ["features"])
    to_action = nn.Sequential(head(4), NormalParamExtractor())
    actor = ProbabilisticActor(
        TensorDictSequential(features, TensorDictModule(to_action, ["features"], ["loc", "scale"])),
        in_keys=["loc", "scale"],
        distribution_class=TanhNormal,
        return_log_prob=True,
        spec=environment.action_spec_unbatched,
    )
    critic = TensorDictSequential(features, ValueOperator(head(1), in_keys=["features"]))
    advantage = GAE(gamma=DISCOUNT, lmbda=0.95, value_network=critic)
    loss = ClipPPOLoss(
        actor, critic, clip_epsilon=0.2, entropy_coeff=0.0, critic_coeff=0.5, loss_critic_type="l2",
        normalize_advantage=True,
    )  # fmt: skip
    adam = torch.optim.Adam(loss.parameters(), RATE)
    decisions = ENVIRONMENTS * STEPS
    collector = Collector(environment, actor, frames_per_batch=decisions, total_frames=-1)
    seen, act = 0, _greedy(actor)
    training.begin()
    for batch in collector:
        with torch.no_grad():
            advantage(batch)
        seen += decisions
        adam.param_groups[0]["lr"] = training.falling(RATE)
        _update(loss, adam, batch.reshape(-1))
        if not training.goes_on(seen, act):
            break
    training.end(seen, act)
    collector.shutdown()
    return {"environments": ENVIRONMENTS, "n_steps": STEPS, "batch_size": BATCH, "n_epochs": EPOCHS}


def _update(loss: ClipPPOLoss, adam: torch.optim.Adam, transitions: TensorDictBase) -> None:
    for _ in range(EPOCHS):
        for chosen in torch.randperm(len(transitions)).split(BATCH):
            found = loss(transitions[chosen])
            adam.zero_grad()
            (found["loss_objective"] + found["loss_critic"]).backward()
            nn.utils.clip_grad_norm_(adam.param_groups[0]["params"], GRADIENT_NORM)
            adam.step()


def _greedy(actor: ProbabilisticActor) -> Act:
    def act(observation: Observation) -> NDArray[np.float32]:
        with torch.no_grad(), set_exploration_type(ExplorationType.DETERMINISTIC):
            seen = TensorDict(_tensors(observation), [len(observation["motion"])])
            return actor(seen)["action"].numpy()

    return act


def _tensors(observation: Observation) -> dict[str, torch.Tensor]:
    return {name: torch.from_numpy(values) for name, values in observation.items()}


def _column(values: NDArray) -> torch.Tensor:
    return torch.from_numpy(values)[:, None]
