"""One number or one choice that a planner decides, and how actors explore it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


def ranks(environments: int) -> NDArray[np.float64]:
    """Ranks of environments, evenly from 0 to 1, float64 [environments]; a single one has 0.5."""
    return np.linspace(0.0, 1.0, environments) if environments > 1 else np.array([0.5])


@dataclass(frozen=True)
class Noise:
    """Noise on a continuous action: `x <- (1 - damping) x + deviation N(0, 1)`, in half-ranges.

    This is tf-agents' Ornstein-Uhlenbeck process; with a damping of 1 it is white Gaussian noise. The
    environments of an actor explore differently: the deviation rises from `low` to `high` with the rank of
    the environment.
    """

    low: float
    high: float
    damping: float = 0.15

    def __post_init__(self) -> None:
        if not 0 <= self.low <= self.high:
            raise ValueError(f"the deviations of noise are {self.low}..{self.high}; they should rise from 0")
        if not 0 < self.damping <= 1:
            raise ValueError(f"the damping of noise is {self.damping}; it should be above 0, at most 1")

    def deviations(self, ranks: NDArray[np.float64]) -> NDArray[np.float64]:
        """Deviation in environments of these ranks (0..1), float64 [environments], half-ranges."""
        return self.low + (self.high - self.low) * ranks


@dataclass(frozen=True)
class Sampled:
    """The policy is itself random (SAC): it takes one standard normal number a decision as its noise."""


@dataclass(frozen=True)
class Epsilon:
    """Exploration of a choice: the probability of a random choice; it rises with the rank as noise does."""

    low: float
    high: float

    def __post_init__(self) -> None:
        if not 0 <= self.low <= self.high <= 1:
            raise ValueError(f"epsilon is {self.low}..{self.high}; it should rise within 0..1")

    def probabilities(self, ranks: NDArray[np.float64]) -> NDArray[np.float64]:
        """Probability in environments of these ranks (0..1), float64 [environments]."""
        return self.low + (self.high - self.low) * ranks


@dataclass(frozen=True)
class Continuous:
    """A number within a range, in physical units.

    Attributes:
        name: unique among everything that a planner decides.
        unit: as text; empty if it has none.
        low: lower bound.
        high: upper bound.
        exploration: noise that actors add.
        sideways: whether it changes its sign, about the centre of its range, when left and right are
            exchanged.
    """

    name: str
    unit: str
    low: float
    high: float
    exploration: Noise | Sampled = field(default=Noise(0.0, 0.0))
    sideways: bool = False

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

    @property
    def bounds(self) -> tuple[float, float]:
        """Lowest and highest value."""
        return self.low, self.high


@dataclass(frozen=True)
class Discrete:
    """A choice, written as its index from 0.

    Attributes:
        name: unique among everything that a planner decides.
        choices: what each index means, as text.
        exploration: how often actors choose at random.
        mirrored: the index of each choice after left and right are exchanged; empty: unchanged.
    """

    name: str
    choices: tuple[str, ...]
    exploration: Epsilon = field(default=Epsilon(0.0, 0.0))
    mirrored: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if len(self.choices) < 2:
            raise ValueError(f"{self.name} has {len(self.choices)} choices; there should be 2 or more")
        if self.mirrored and sorted(self.mirrored) != list(range(len(self.choices))):
            raise ValueError(f"the mirrored choices of {self.name} should be each of its choices once")

    @property
    def bounds(self) -> tuple[float, float]:
        """Lowest and highest index."""
        return 0.0, float(len(self.choices) - 1)


Action = Continuous | Discrete
"""One entry of a decision."""
