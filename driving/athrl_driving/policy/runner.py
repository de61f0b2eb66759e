"""Run a policy artefact with ONNX Runtime over a batch of environments."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from athrl_spaces import Discrete, LevelDescription
from athrl_spaces.policy import LARGEST_ARTEFACT
from athrl_spaces.untrusted import UntrustedFile, one_line, read_untrusted
from numpy.typing import NDArray

from athrl_driving.policy.artefact import Artefact, InvalidPolicy, takes_noise

Arrays = Mapping[str, NDArray[np.float32]]
"""An array for each level, or for some of them, by the level's name."""

_ROUNDING = 1e-4  # share of a range by which clipped values may exceed it


@dataclass(frozen=True)
class PolicyStep:
    """What a policy decided, and the states for its next step.

    Attributes:
        actions: of each level float32 [batch, n], physical units, or the index of a choice.
        states: of each level float32 [batch, state_size].
    """

    actions: dict[str, NDArray[np.float32]]
    states: dict[str, NDArray[np.float32]]


class OnnxPolicy:
    """A policy artefact, ready to run; the caller keeps the recurrent states, so policies can be switched.

    Attributes:
        description: what it sees and decides.
    """

    def __init__(self, artefact: bytes, threads: int = 1) -> None:
        """Load an artefact's bytes; raises InvalidPolicy if they are not a policy."""
        self._artefact = Artefact(artefact, threads)
        self.description = self._artefact.description
        levels = self.description.levels
        self._outputs = [level.name for level in levels]
        self._outputs += [f"next_{level.name}_state" for level in levels if level.state_size]

    @classmethod
    def load(cls, path: Path | str, threads: int = 1) -> OnnxPolicy:
        """Read a policy file; raises InvalidPolicy, naming the file."""
        try:
            content = read_untrusted(path, LARGEST_ARTEFACT)
        except UntrustedFile as error:
            raise InvalidPolicy(f"the policy {one_line(str(path))} {error}") from None
        try:
            return cls(content, threads)
        except InvalidPolicy as error:
            raise InvalidPolicy(f"{one_line(str(path))} is not a policy: {error}") from None

    def initial_states(self, batch: int) -> dict[str, NDArray[np.float32]]:
        """The recurrent states at an episode's start: float32 zeros [batch, state_size] for each level."""
        return {
            level.name: np.zeros((batch, level.state_size), np.float32) for level in self.description.levels
        }

    def step(
        self,
        images: NDArray[np.uint8],
        motion: NDArray[np.float32],
        states: Arrays,
        noise: Arrays | None = None,
        forced: Arrays | None = None,
    ) -> PolicyStep:
        """Decide for a batch; a level sees the actions of those above it, with noise or as they were forced.

        Args:
            images: uint8 [batch, height, width, channels].
            motion: float32 [batch, m].
            states: of each level with memory float32 [batch, state_size].
            noise: float32 [batch, n] of levels with a continuous action: physical units, or a standard normal
                number for an action that is sampled; none for a level that is missing.
            forced: float32 [batch, n] of any level, NaN where it is free; a value beyond a range is taken
                as the nearest bound. A level that is missing is free.

        Raises:
            InvalidPolicy: the policy returned values that are not finite or beyond their ranges, cannot be
                run, or would take too much memory or time for so many environments.
        """
        self._artefact.check_batch(len(images))
        feed = self._feed(images, motion, states, noise or {}, forced or {})
        values = dict(zip(self._outputs, self._artefact.run(self._outputs, feed), strict=True))
        actions, following = {}, {}
        for level in self.description.levels:
            actions[level.name] = values[level.name]
            _check_actions(level, values[level.name])
            if level.state_size:
                following[level.name] = values[f"next_{level.name}_state"]
                _check_finite(following[level.name])
            else:
                following[level.name] = np.zeros((len(images), 0), np.float32)
        return PolicyStep(actions=actions, states=following)

    def _feed(
        self,
        images: NDArray[np.uint8],
        motion: NDArray[np.float32],
        states: Arrays,
        noise: Arrays,
        forced: Arrays,
    ) -> dict[str, NDArray]:
        feed: dict[str, NDArray] = {"image": images, "motion": motion}
        for level in self.description.levels:
            name, shape = level.name, (len(images), level.action_size)
            if level.state_size:
                feed[f"{name}_state"] = states[name]
            if takes_noise(level):
                feed[f"{name}_noise"] = noise[name] if name in noise else np.zeros(shape, np.float32)
            if name in forced:
                feed[f"forced_{name}"] = np.clip(forced[name], level.low, level.high)
            else:
                feed[f"forced_{name}"] = np.full(shape, np.nan, np.float32)
        return feed


def _check_finite(values: NDArray[np.float32]) -> None:
    if not np.isfinite(values).all():
        raise InvalidPolicy("the policy returned values that are not finite; its training has diverged")


def _check_actions(level: LevelDescription, values: NDArray[np.float32]) -> None:
    """Refuse values beyond the ranges of the level's actions."""
    _check_finite(values)
    room = _ROUNDING * (level.high - level.low)
    within = (values >= level.low - room) & (values <= level.high + room)
    for column, action in enumerate(level.actions):
        fits = within[:, column]
        if isinstance(action, Discrete):
            fits = fits & (values[:, column] == np.rint(values[:, column]))
        if not fits.all():
            low, high = action.bounds
            what = f"a whole number from {low:g}" if isinstance(action, Discrete) else f"from {low:g}"
            wrong = float(values[int(np.argmin(fits)), column])
            raise InvalidPolicy(
                f"the policy decided {action.name} as {wrong:g}; it should be {what} to {high:g}"
            )
