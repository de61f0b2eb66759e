"""A batch of environments that may raise or stall without ending the process that drives them.

A thread cannot be interrupted, so the environments are driven from a thread that can be abandoned: a call
that does not return within a deadline is given up, and a new batch replaces the old one.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from queue import Empty, SimpleQueue
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from athrl_driving.envs import EnvView
from athrl_driving.errors import DrivingError
from athrl_driving.kernels.compilation import LONGEST_COMPILATION
from athrl_driving.policy.batch import BatchStep, EnvironmentBatch
from athrl_driving.policy.recording import Recording

FIRST_CALL_SECONDS = LONGEST_COMPILATION + 300.0
"""A process's first step may compile, and before that wait for another process that compiles the same."""
POLL_SECONDS = 0.5
"""The deadline is counted in such intervals, so a process that is paused for an hour loses one of them."""

_Result = TypeVar("_Result")


class EnvironmentFailure(Exception):  # noqa: N818 - the name says what happened
    """A step or a reset failed; episodes have to begin in `env_indices` before the next step.

    The message is one line that says what happened.
    """

    def __init__(self, text: str, env_indices: list[int]) -> None:
        super().__init__(text)
        self.env_indices = env_indices


class EnvironmentRaised(EnvironmentFailure):
    """A step or a reset raised an exception, which is the cause."""


class EnvironmentStalled(EnvironmentFailure):
    """A step or a reset did not return within the deadline."""


class GuardedBatch:
    """An `EnvironmentBatch` that is replaced when it fails.

    `images`, `motion`, `recording` and `environments` are those of the present batch: read them again after a
    failure.

    Args:
        towns: as for `EnvironmentBatch`, like `config` and `action_kind`.
        config: of the environments.
        action_kind: that they take.
        seconds: within which a step or a reset returns; the first of its kind may take longer.
        recorded: as for `EnvironmentBatch`.
    """

    def __init__(
        self,
        towns: Sequence[str],
        config: Mapping[str, Any],
        action_kind: str = "waypoint",
        *,
        seconds: float,
        recorded: int = 0,
    ) -> None:
        self._make = lambda: EnvironmentBatch(towns, config, action_kind, recorded)
        self._count = len(towns)
        self._seconds = seconds
        self._worker = _Worker()
        self._compiled: set[str] = set()  # calls that have returned once
        try:
            self._batch = self._call("making the environments", self._make)
        except BaseException:
            self._worker.end()  # its thread would wait for calls for ever
            raise

    def __len__(self) -> int:
        return self._count

    @property
    def towns(self) -> list[str]:
        """The town of each environment."""
        return self._batch.towns

    @property
    def ranks(self) -> NDArray[np.float64]:
        """float64 [count], evenly from 0 to 1 among the environments of a town."""
        return self._batch.ranks

    @property
    def action_kind(self) -> str:
        """Name of the kind of action that the environments take."""
        return self._batch.action_kind

    @property
    def images(self) -> NDArray[np.uint8]:
        """uint8 [count, H, W, C]; changes with every step."""
        return self._batch.images

    @property
    def motion(self) -> NDArray[np.float32]:
        """float32 [count, m]; changes with every step."""
        return self._batch.motion

    @property
    def recording(self) -> Recording:
        """Observations and rewards since each environment's recording buffer was rewound."""
        return self._batch.recording

    @property
    def environments(self) -> list[EnvView]:
        """Each environment as an object, for drivers and viewers."""
        return self._batch.environments

    def info(self, env_index: int) -> dict[str, Any]:
        """The `info` of one environment's last decision."""
        return self._batch.info(env_index)

    def reset(self, env_index: int, seed: int) -> None:
        """Begin a new episode in one environment; raises EnvironmentFailure."""
        batch = self._batch
        what = f"reset of environment {env_index}"
        self._guarded(what, lambda: batch.reset(env_index, seed), [env_index])

    def step(self, actions: NDArray[np.float32], active: NDArray[np.bool_] | None = None) -> BatchStep:
        """Step as `EnvironmentBatch` does; raises EnvironmentFailure."""
        batch, env_indices = self._batch, list(range(self._count))
        return self._guarded("step", lambda: batch.step(actions, active), env_indices)

    def close(self) -> None:
        """Close the environments and end the thread."""
        self._batch.close()
        self._worker.end()

    def _guarded(self, what: str, call: Callable[[], _Result], env_indices: list[int]) -> _Result:
        """Make a call; if it fails, replace what may be broken and raise EnvironmentFailure."""
        try:
            return self._call(what, call)
        except _Abandoned:
            self._worker = _Worker()
            text = f"{what} did not return within {self._seconds:g} s"
            failure: EnvironmentFailure = EnvironmentStalled(text, list(range(self._count)))
            cause = None
        except Exception as error:
            if what != "step":  # the other environments are intact: only this one has no episode
                raise EnvironmentRaised(_describe(what, error), env_indices) from error
            self._batch.close()
            failure, cause = EnvironmentRaised(_describe(what, error), env_indices), error
        self._renew()
        raise failure from cause

    def _renew(self) -> None:
        try:
            self._batch = self._call("making the environments", self._make)
        except _Abandoned:
            raise DrivingError(f"new environments were not made within {self._seconds:g} s") from None

    def _call(self, what: str, call: Callable[[], _Result]) -> _Result:
        kind = what.partition(" ")[0]
        result = self._worker.call(call, self._seconds if kind in self._compiled else FIRST_CALL_SECONDS)
        self._compiled.add(kind)
        return result


def _describe(what: str, error: Exception) -> str:
    return " ".join(f"{what} raised {type(error).__name__}: {error}".split())


AnyBatch = EnvironmentBatch | GuardedBatch
"""Code that drives a batch works with both."""


class _Abandoned(Exception):  # noqa: N818 - a TimeoutError of the call itself is different
    """A call did not return in time."""


class _Worker:
    """A thread that makes calls one by one, and is abandoned with a call that does not return."""

    def __init__(self) -> None:
        self._calls: SimpleQueue[Callable[[], Any] | None] = SimpleQueue()
        self._outcomes: SimpleQueue[tuple[Any, Exception | None]] = SimpleQueue()
        # The thread knows the queues, not this object: the outcome of an abandoned call is never read.
        threading.Thread(
            target=_serve, args=(self._calls, self._outcomes), name="environments", daemon=True
        ).start()

    def call(self, function: Callable[[], _Result], seconds: float) -> _Result:
        """Return what the function returns or raise what it raises; _Abandoned after so many seconds."""
        self._calls.put(function)
        left = seconds
        while left > 0:
            try:
                result, error = self._outcomes.get(timeout=min(left, POLL_SECONDS))
            except Empty:
                left -= POLL_SECONDS
                continue
            if error is not None:
                raise error
            return result
        self.end()
        raise _Abandoned

    def end(self) -> None:
        """Let the thread end once its call has returned."""
        self._calls.put(None)


def _serve(
    calls: SimpleQueue[Callable[[], Any] | None], outcomes: SimpleQueue[tuple[Any, Exception | None]]
) -> None:
    while (call := calls.get()) is not None:
        try:
            outcomes.put((call(), None))
        except Exception as error:
            outcomes.put((None, error))
