"""The settings of planners with default, unit, bounds and meaning.

The settings of a planner are a class derived from these (`athrl_planners.athrl.AtHRLSettings`, ...). The run
file's section `[planner]`, its comments, its errors and the reference page follow from it. This module does
not import torch: the command reads run files without it.
"""

from __future__ import annotations

from typing import ClassVar, Literal, Self

from athrl_spaces import Noise, Sampled
from pydantic import BaseModel, ConfigDict, Field, model_validator


class PlannerSettings(BaseModel):
    """Networks and training of a planner; unknown keys and wrong types are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    kept_by_a_run: ClassVar[frozenset[str]] = frozenset({"value_min", "value_max"})
    """Settings that a resumed run must keep, though all sizes fit: with others what its networks have learned
    or its experience would mean something else."""

    # networks
    encoder: Literal["small", "paper"] = Field(
        default="small",
        description="Image encoder; small: three convolutions of 16, 32, 64 channels; paper: a tower of five "
        "for the bird's eye view and one for the lidar.",
    )
    hidden_features: int = Field(
        default=128, ge=8, le=2048, description="Width of the layer that joins image and motion."
    )
    head_features: int = Field(
        default=256, ge=8, le=2048, description="Width of the hidden layers of actors and critics."
    )
    memory: Literal["none", "lstm"] = Field(
        default="none", description="Memory of the planner; lstm is the paper."
    )
    recurrent_features: int = Field(default=64, ge=4, le=1024, description="Units of the LSTM.")
    shared_trunk: bool = Field(
        default=True,
        description="One encoder and memory for all levels; false: each level has its own (the paper).",
    )

    # values
    discount: float = Field(default=0.97, ge=0, lt=1, description="Discount of one decision.")
    n_step: int = Field(
        default=3,
        ge=1,
        le=64,
        description="Rewards summed before the target value (n-step returns); 1 is the paper.",
    )
    reward_scale: float = Field(
        default=0.02, gt=0, le=1000, description="Factor on the rewards of the critics."
    )
    end_penalty: float = Field(
        default=4.0,
        ge=0,
        le=10_000,
        description="Extra cost, in scaled reward, of an episode that ends by collision or lane exit; only "
        "for training. 0 is the paper.",
    )
    critic: Literal["distributional", "scalar"] = Field(
        default="distributional",
        description="What a critic predicts: a distribution over returns (C51), or their mean (the paper).",
    )
    critics: int = Field(
        default=2,
        ge=1,
        le=2,
        description="Critics of a level; with two the smaller value counts. 1: the paper.",
    )
    atoms: int = Field(default=101, ge=3, le=1001, description="Values in a distributional critic's support.")
    value_min: float = Field(
        default=-24.0, ge=-1e6, le=1e6, description="Lowest value of that support, in scaled reward."
    )
    value_max: float = Field(
        default=24.0, ge=-1e6, le=1e6, description="Highest value of that support, in scaled reward."
    )
    loss: Literal["squared", "huber"] = Field(
        default="squared",
        description="Loss of a scalar critic; squared is the paper, huber its authors' code.",
    )

    # learning
    learning_rate: float = Field(
        default=6e-4, gt=0, le=1, description="Adam's step size; 0.0003 is the paper."
    )
    final_learning_rate: float = Field(
        default=0.1,
        ge=0,
        le=1,
        description="Factor on the step size at the end of the run; it falls linearly from 1. 1: the paper.",
    )
    tau: float = Field(
        default=0.05,
        gt=0,
        le=1,
        description="Target networks: weight of the online networks in each soft update; 0.005 is the paper, "
        "and too slow for runs of some thousand updates.",
    )
    gradient_norm: float = Field(
        default=10.0, gt=0, le=1e9, description="Norm to which gradients are clipped."
    )
    average_decay: float = Field(
        default=0.95,
        ge=0,
        lt=1,
        description="Decay of the moving average of weights that is published; 0: the newest weights.",
    )
    mirror: bool = Field(
        default=False,
        description="Exchange left and right in half of each batch; only without memory.",
    )

    @model_validator(mode="after")
    def _check_against_each_other(self) -> Self:
        if not self.value_min < self.value_max:
            raise ValueError(
                f"planner.value_min = {self.value_min:g}: should be below planner.value_max = "
                f"{self.value_max:g}"
            )
        if self.mirror and self.memory != "none":
            raise ValueError(
                "planner.mirror = true: should be false with planner.memory = "
                f'"{self.memory}", as remembered states cannot be mirrored'
            )
        return self


class ActorCriticSettings(PlannerSettings):
    """Settings of actor-critic planners, whose levels decide numbers."""

    update_rule: Literal["ddpg", "td3", "sac"] = Field(
        default="td3",
        description="Update rule; ddpg is the paper; td3: policy delay and target policy smoothing; sac: "
        "stochastic actors with an entropy bonus.",
    )
    saturation_penalty: float = Field(
        default=0.02,
        ge=0,
        le=100,
        description="With ddpg and td3: weight of the squared output before its tanh in the actors' loss; "
        "0 is the paper, with an action_reach of 1: above 1 nothing else brings back a saturated actor.",
    )
    action_reach: float = Field(
        default=1.1,
        ge=1,
        le=10,
        description="With ddpg and td3: factor on an actor's tanh before it is clipped to its range; above 1 "
        "the ends of a range can be reached, for instance a speed of 0. 1 is the paper.",
    )
    td3_actor_delay: int = Field(
        default=2, ge=1, le=1000, description="With td3: policy delay, critic updates for each actor update."
    )
    td3_target_noise: float = Field(
        default=0.1,
        ge=0,
        le=2,
        description="With td3: target policy smoothing, deviation of the noise, half-ranges.",
    )
    sac_temperature: float = Field(
        default=0.1, gt=0, le=100, description="With sac: initial temperature, the weight of the entropy."
    )
    sac_target_entropy: float = Field(
        default=-1.0,
        ge=-20,
        le=0.69,
        description="With sac: target entropy of each decided number; a uniform one has 0.69.",
    )
    noise_low: float = Field(
        default=0.05,
        ge=0,
        le=2,
        description="With ddpg and td3: deviation of what is added to the exploration noise at each "
        "decision, in an actor's first environment, half-ranges; with a damping of 0.15 the noise itself has "
        "1.9 times as much.",
    )
    noise_high: float = Field(
        default=0.4,
        ge=0,
        le=2,
        description="The same in its last environment; evenly spaced in between. Both 0.2 is the paper.",
    )
    noise_damping: float = Field(
        default=0.15,
        gt=0,
        le=1,
        description="Damping of the noise per decision; 1: independent noise.",
    )

    @model_validator(mode="after")
    def _check_noise(self) -> Self:
        if self.noise_low > self.noise_high:
            raise ValueError(
                f"planner.noise_low = {self.noise_low:g}: should be at most planner.noise_high = "
                f"{self.noise_high:g}"
            )
        return self

    @property
    def noise(self) -> Noise | Sampled:
        """Exploration noise of actors."""
        if self.update_rule == "sac":
            return Sampled()
        return Noise(self.noise_low, self.noise_high, self.noise_damping)


class QLearningSettings(PlannerSettings):
    """Settings of Q-learning planners, whose levels take the choice with the highest value."""

    double: bool = Field(
        default=True,
        description="Double DQN: the online network chooses the action for the target value; false: plain "
        "DQN.",
    )
    dueling: bool = Field(
        default=True,
        description="Dueling heads: value of the state and advantages of choices; false: plain DQN.",
    )
    epsilon_low: float = Field(
        default=0.02,
        ge=0,
        le=1,
        description="Share of random choices (epsilon) in an actor's first environment.",
    )
    epsilon_high: float = Field(
        default=0.2, ge=0, le=1, description="The same in its last environment. Both 0.05 is the paper."
    )

    @model_validator(mode="after")
    def _check_epsilon(self) -> Self:
        if self.epsilon_low > self.epsilon_high:
            raise ValueError(
                f"planner.epsilon_low = {self.epsilon_low:g}: should be at most planner.epsilon_high = "
                f"{self.epsilon_high:g}"
            )
        return self
