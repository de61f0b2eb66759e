"""An agent: a planner in training. All planners share this code and differ in their definitions."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from athrl_spaces import Limits, Observation, PolicyDescription
from torch import Tensor, nn

from athrl_planners.errors import TrainingDiverged
from athrl_planners.planner import Planner
from athrl_planners.replay import Batch
from athrl_planners.settings import PlannerSettings
from athrl_planners.training.batch import BatchPreparation, TrainingBatch
from athrl_planners.training.cuda_graphs import CapturedUpdate
from athrl_planners.training.losses import actor_losses, critic_loss
from athrl_planners.training.policy import PolicyNetwork, PolicyOutput
from athrl_planners.training.precision import autocast
from athrl_planners.training.state import TrainingState
from athrl_planners.training.workers import Workers
from athrl_planners.updates.adam import Adam

Gradients = tuple[Tensor, ...]


class PartGradients(NamedTuple):
    """Results of one part of a batch: gradients of all parameters, metrics, errors."""

    critics: Gradients
    actors: Gradients
    metrics: dict[str, Tensor]
    errors: Tensor


class Agent:
    """Decides with the averaged networks, and trains on batches of the replay.

    Args:
        planner: the kind of planner.
        settings: its settings.
        observation: its observation.
        limits: limits of its decisions in environments.
        seed: equal seeds give equal networks and equal training.
        device: device of training.
        burn_in: first decisions of a sequence, which only update the recurrent state.
        precision: of the networks' products in updates; published weights are float32 in any case.
        threads: threads that compute parts of an update in parallel; one with a memory or on a GPU.

    Attributes:
        state: everything that training changes.
        description: description of the policy.
        policy: the published network; it shares the averaged weights.
        prepare: converts batches of the replay to tensors.
    """

    def __init__(
        self,
        planner: type[Planner],
        settings: PlannerSettings,
        observation: Observation,
        limits: Limits,
        seed: int,
        device: str | torch.device = "cpu",
        *,
        burn_in: int = 0,
        precision: torch.dtype = torch.float32,
        threads: int = 1,
    ) -> None:
        self.settings, self.precision = settings, precision
        self.device = torch.device(device)
        side_by_side = settings.memory == "none" and self.device.type == "cpu"
        self._workers = Workers(threads if side_by_side else 1)
        self.state = state = TrainingState(
            planner, settings, observation, limits, seed, self.device, self._workers.threads
        )
        trunk_state = {level.name: state.trunk_state_size(level.name) for level in state.levels}
        self.description = PolicyDescription(
            planner=planner.kind,
            action_kind=planner.action_kind,
            limits=limits,
            observation=observation,
            levels=tuple(level.describe(trunk_state[level.name]) for level in state.levels),
        )
        self.policy = PolicyNetwork(state)
        self.prepare = BatchPreparation(
            settings,
            state.levels,
            burn_in,
            trunk_state,
            self.device,
            state.mirroring,
            constant_shapes=self.device.type == "cuda",
        )
        self._captured = self._capture()

    @property
    def kind(self) -> str:
        """Kind of the planner."""
        return self.state.kind

    @property
    def updates(self) -> int:
        """Updates so far."""
        return self.state.updates

    @property
    def has_memory(self) -> bool:
        """Whether it is trained on whole sequences."""
        return self.settings.memory != "none"

    @torch.no_grad()
    def act(
        self,
        images: np.ndarray,
        motion: np.ndarray,
        states: Mapping[str, np.ndarray],
        noise: Mapping[str, np.ndarray] | None = None,
        forced: Mapping[str, np.ndarray] | None = None,
    ) -> PolicyOutput[np.ndarray]:
        """Decide for a batch of observations, as the artefact does; shapes as in `PolicyNetwork.forward`."""

        def tensors(arrays: Mapping[str, np.ndarray] | None) -> dict[str, Tensor]:
            return {name: self._tensor(value) for name, value in (arrays or {}).items()}

        output = self.policy(
            self._tensor(images), self._tensor(motion), tensors(states), tensors(noise), tensors(forced)
        )
        return PolicyOutput(
            actions={name: value.cpu().numpy() for name, value in output.actions.items()},
            states={name: value.cpu().numpy() for name, value in output.states.items()},
        )

    def update(self, batch: Batch, progress: float = 0.0) -> tuple[dict[str, Tensor], Tensor]:
        """Train all levels on a batch.

        Args:
            batch: a batch of the replay.
            progress: completed share of the run, 0 to 1; the step sizes fall with it.

        Returns:
            Metrics, each a scalar tensor that may not be computed yet, and the largest absolute error of each
            item of the batch, float32 [items].

        Raises:
            TrainingDiverged: on a CPU, the critics' loss is not finite; nothing has been changed.
        """
        return self.update_prepared(self.prepare(batch), progress)

    def update_prepared(self, data: TrainingBatch, progress: float = 0.0) -> tuple[dict[str, Tensor], Tensor]:
        """`update` with what `prepare` returned."""
        rate = self.settings.learning_rate * (1 - (1 - self.settings.final_learning_rate) * progress)
        with_actors = self._actors_are_due(self.updates + 1)
        if self._captured is not None and self._captured.takes(data):
            results = self._captured(data, rate, with_actors)
        else:
            results = self._compute(data, rate, with_actors)
        self.state.updates += 1
        return results

    def _compute(
        self, data: TrainingBatch, rate: float | Tensor, with_actors: bool
    ) -> tuple[dict[str, Tensor], Tensor]:
        """An update without its counter; on a GPU it does not synchronise, so that it can be recorded."""
        state = self.state
        results = self._workers.each(partial(self._gradients, with_actors), data.split(self._workers.threads))
        metrics = _summed([part.metrics for part in results])
        gradients = [part.critics for part in results]
        metrics["critic_gradient"] = self._step(
            state.critic_optimiser, state.critic_parameters, gradients, rate
        )
        if with_actors:
            gradients = [part.actors for part in results]
            metrics["actor_gradient"] = self._step(
                state.actor_optimiser, state.actor_parameters, gradients, rate
            )
        state.update_targets()
        return metrics, torch.cat([part.errors for part in results])

    def _gradients(self, with_actors: bool, number: int, data: TrainingBatch) -> PartGradients:
        """The gradients of all losses on one part of a batch; actors use the current critics."""
        self.state.noise.use(number)
        with autocast(self.device, self.precision):
            critics = critic_loss(self.state, data)
        self._require_finite(critics.loss)
        gradients = torch.autograd.grad(critics.loss, self.state.critic_parameters)
        if not with_actors:
            return PartGradients(gradients, (), critics.metrics, critics.errors)
        metrics, actors = self._actor_gradients(data, critics.contexts)
        return PartGradients(gradients, actors, critics.metrics | metrics, critics.errors)

    def _actor_gradients(
        self, data: TrainingBatch, contexts: dict[str, Tensor]
    ) -> tuple[dict[str, Tensor], Gradients]:
        """Metrics of the actors on one part of a batch, and the gradient of each actor's loss."""
        with autocast(self.device, self.precision):
            losses, metrics = actor_losses(self.state, data, contexts)
        gradients: list[Tensor] = []
        for level in self.state.levels:
            if level.name in losses:
                gradients += torch.autograd.grad(losses[level.name], level.actor_parameters)
        return metrics, tuple(gradients)

    def _actors_are_due(self, update: int) -> bool:
        delay = max(level.rule.actor_delay for level in self.state.levels)
        return delay > 0 and update % delay == 0

    def _capture(self) -> CapturedUpdate | None:
        """Recorded updates on a GPU, else None."""
        if self.device.type != "cuda":
            return None
        parameters = [*self.state.critic_parameters, *self.state.actor_parameters]
        return CapturedUpdate(self._compute, parameters, self.state.noise.generators[0], self.device)

    def _step(
        self, optimiser: Adam, parameters: list[Tensor], parts: list[Gradients], rate: float | Tensor
    ) -> Tensor:
        """Apply the clipped sum of the parts' gradients; return its norm before clipping."""
        total = list(parts[0])
        for gradients in parts[1:]:
            torch._foreach_add_(total, list(gradients))
        for parameter, gradient in zip(parameters, total, strict=True):
            parameter.grad = gradient
        norm = nn.utils.clip_grad_norm_(parameters, self.settings.gradient_norm)
        optimiser.step(rate)
        return norm.detach()

    def _require_finite(self, loss: Tensor) -> None:
        """Check the loss on a CPU, where that costs nothing; on a GPU the trainer checks it for reports."""
        if self.device.type == "cpu" and not torch.isfinite(loss):
            raise TrainingDiverged(f"the loss of update {self.updates + 1} is {float(loss.detach()):g}")

    def _tensor(self, values: np.ndarray) -> Tensor:
        return torch.as_tensor(values, device=self.device)

    def state_dict(self) -> dict[str, Any]:
        """See `TrainingState.state_dict`."""
        return self.state.state_dict()

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """See `TrainingState.load_state_dict`."""
        self.state.load_state_dict(state)
        self._captured = self._capture()  # earlier recordings refer to the memory of the old optimiser state


def _summed(parts: list[dict[str, Tensor]]) -> dict[str, Tensor]:
    """Metrics of a batch: sums of those of its parts, which are weighted sums over decisions."""
    if len(parts) == 1:
        return parts[0]
    return {name: torch.stack([part[name] for part in parts]).sum() for name in parts[0]}
