"""What a planner is told: its observation, its actions and how it learns. The defaults are the caller's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

NoiseKind = Literal["ornstein-uhlenbeck", "gaussian"]


@dataclass(frozen=True)
class ObservationSettings:
    """An observation: an image uint8 [size, size, channels] and a motion vector float32 [motion]."""

    image_size: int  # pixels
    image_channels: int = 4
    motion_names: tuple[str, ...] = ("speed_over_8", "steering_over_0.3")

    def __post_init__(self) -> None:
        if self.image_size < 8:
            raise ValueError(f"image_size is {self.image_size}; three halvings need at least 8 pixels")

    @property
    def motion_size(self) -> int:
        """Numbers in the motion vector."""
        return len(self.motion_names)

    @property
    def image_shape(self) -> tuple[int, int, int]:
        """Height, width, channels of an image."""
        return self.image_size, self.image_size, self.image_channels


@dataclass(frozen=True)
class ActionRange:
    """One number that a level decides, in physical units, and the noise with which actors explore it."""

    name: str
    unit: str
    low: float
    high: float
    noise: NoiseKind
    noise_scale: float  # half-ranges
    damping: float = 0.0  # of the Ornstein-Uhlenbeck process; a Gaussian has none

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise ValueError(f"the range of {self.name} is {self.low}..{self.high}; low must be below high")

    @property
    def centre(self) -> float:
        """The value of a normalised 0."""
        return (self.high + self.low) / 2

    @property
    def half_range(self) -> float:
        """The distance from the centre to a normalised 1."""
        return (self.high - self.low) / 2


@dataclass(frozen=True)
class PlannerSettings:
    """How both levels learn. Every field is required; the run file documents them and has the defaults."""

    hidden_features: int  # width of the layers before and after the LSTM
    recurrent_features: int  # units of each LSTM
    discount: float  # of one decision
    learning_rate: float  # Adam, actors and critics
    soft_target: float  # share of the online weights taken into the targets at each update
    reward_scale: float  # factor on rewards before they reach the critics
    saturation_penalty: float  # weight of the squared pre-tanh output in the actors' loss
    twin_critics: bool  # two critics and the smaller value (TD3)
    actor_delay: int  # critic updates for each actor update
    target_noise: float  # deviation of the noise on target actions, half-ranges
    intention_gradient: float  # weight of the trajectory critic's gradient through the intention
    gradient_norm: float  # gradients are clipped to this norm
    average_decay: float  # decay of the averaged actor that is published; 0 publishes the newest
    burn_in: int  # first decisions of a sequence that only warm the recurrent states
