"""Drives a recorded episode again from its seed and its actions, and compares every decision.

Where the same kernels run on the same processor the states are the same to the last bit. Elsewhere last bits
differ, as compilers and libraries round differently: then numbers may differ by `TOLERANCE`, and images, in
which a pixel turns on a last bit, are not compared.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from athrl_driving.envs import EnvView
from athrl_driving.envs.settings import ACTION_KIND_OF_TYPE
from athrl_driving.errors import DrivingError
from athrl_driving.maps import load_town
from athrl_driving.policy import AnyBatch, GuardedBatch
from athrl_protocol import Frame, encode_frame
from athrl_protocol.run_file import ActorSection
from google.protobuf.message import Message
from numpy.typing import NDArray

from athrl_evaluator.errors import EvaluatorError
from athrl_evaluator.recording.frames import frame_of_step
from athrl_evaluator.recording.origin import Origin, computed_by
from athrl_evaluator.recording.reading import read_driven, read_frames
from athrl_evaluator.scoring.drivers import Decisions
from athrl_evaluator.scoring.episodes import EpisodeObserver, EpisodeStep, Stopped, drive_episodes

TOLERANCE = 1e-6
"""Largest difference of any number, in its unit, where the last bits may differ."""
DIGITS_SHOWN = 12
"""Of a checksum."""


@dataclass(frozen=True)
class Difference:
    """A number that is not as it was recorded; `number` is its place in `Frame`: `vehicles[3].x`."""

    decision: int
    time: float
    number: str
    recorded: float
    replayed: float

    @property
    def size(self) -> float:
        """How large it is, in the number's unit; infinite where one of them is no number."""
        size = abs(self.recorded - self.replayed)
        return math.inf if math.isnan(size) else size


@dataclass(frozen=True)
class Verdict:
    """What driving a recorded episode again has shown.

    Attributes:
        driver, town, seed: of the episode.
        policy: name of the policy's file, if the recording has it.
        decisions: that were compared.
        seconds: simulated.
        recorded_by: what computed the recording, if that was not what computes here; then the last bits may
            differ. Empty: the same did, and everything has to be equal to the last bit.
        first: the first difference beyond what is allowed; None: the states are the same.
        largest: the largest difference; None: there is none.
    """

    driver: str
    policy: str
    town: str
    seed: int
    decisions: int
    seconds: float
    recorded_by: str
    first: Difference | None
    largest: Difference | None

    @property
    def same(self) -> bool:
        """Whether the states are the same."""
        return self.first is None


def replay(path: Path, town: str | None = None) -> Verdict:
    """Drive the episode of a recording again.

    Args:
        path: the recording.
        town: where its map is now, if it is not where it was.

    Raises:
        InvalidRecording: it is no recorded episode, or does not say how it was driven.
        EvaluatorError: its map is not there or has become another one, or its settings are unknown.
        EnvironmentFailure: the environment fails.
    """
    driven = read_driven(path)
    batch = _environment(path, driven.origin, town)
    try:
        return _compare(path, driven.origin, driven.actions, batch)
    finally:
        batch.close()


class _RecordedActions:
    """A driver that decides what was decided before."""

    policy_version = 0

    def __init__(self, name: str, action_kind: str, actions: NDArray[np.float32]) -> None:
        self.name, self.action_kind = name, action_kind
        self._actions = iter(actions)

    def begin(self, env_index: int, environment: EnvView, seed: int) -> None:
        """There is nothing to begin."""

    def decide(self, batch: AnyBatch, active: NDArray[np.bool_]) -> Decisions:
        """Return the next action; raises Stopped after the last."""
        action = next(self._actions, None)
        if action is None:
            raise Stopped
        return Decisions(action[None])


class _Comparison(EpisodeObserver):
    """Compares each decision with the recorded frame."""

    def __init__(self, driver: _RecordedActions, frames: Iterator[Frame], *, bit_for_bit: bool) -> None:
        self._driver, self._frames, self._bit_for_bit = driver, frames, bit_for_bit
        self.last = Frame()
        self.first: Difference | None = None
        self.largest: Difference | None = None

    def on_step(self, step: EpisodeStep) -> None:
        """Compare with the next frame."""
        recorded = next(self._frames)
        replayed = frame_of_step(self._driver, step)
        self.last = recorded
        # What is not of the simulation.
        replayed.driver, replayed.policy_version = recorded.driver, recorded.policy_version
        replayed.town = recorded.town
        replayed.decision.update(recorded.decision)
        encode_frame(replayed)
        if _bytes(replayed) == _bytes(recorded):
            return
        differences = list(_differences(recorded, replayed))
        if self._bit_for_bit and not differences:
            differences = [_of_images(recorded, replayed)]
        for difference in differences:
            if self.largest is None or difference.size > self.largest.size:
                self.largest = difference
            if self.first is None and (self._bit_for_bit or not difference.size <= TOLERANCE):
                self.first = difference


def _compare(path: Path, origin: Origin, actions: NDArray[np.float32], batch: GuardedBatch) -> Verdict:
    frames = read_frames(path)
    here = computed_by()
    bit_for_bit = (origin.kernels, origin.numpy) == (here["kernels"], here["numpy"])
    recorded_by = "" if bit_for_bit else _computer(**{name: getattr(origin, name) for name in here})
    driver = _RecordedActions("replay", batch.action_kind, actions)
    comparison = _Comparison(driver, frames, bit_for_bit=bit_for_bit)
    with suppress(Stopped):
        drive_episodes(driver, batch, [origin.seed], [comparison])
    first = comparison.first
    if first is None and (missing := next(frames, None)) is not None:  # the episode has ended before
        first = Difference(missing.step, missing.time, "time", missing.time, math.nan)
    last = comparison.last
    return Verdict(
        driver=last.driver,
        policy=origin.policy,
        town=last.town,
        seed=origin.seed,
        decisions=last.step,
        seconds=last.time,
        recorded_by=recorded_by,
        first=first,
        largest=comparison.largest,
    )


def _environment(path: Path, origin: Origin, town: str | None) -> GuardedBatch:
    """The environment of a recorded episode, with the same map."""
    settings = {name: value for name, value in origin.settings.items() if name != "town"}
    place = origin.settings["town"] if town is None else town
    _require_the_map(path, origin, place, "" if town else "; say where its map is now by --town")
    try:
        action = _action_kind(settings.pop("action", None))
        return GuardedBatch([place], settings, action, seconds=ActorSection().stall_seconds)
    except (DrivingError, LookupError, TypeError, ValueError) as error:
        raise EvaluatorError(f"{path} cannot be driven again: {error}") from None


def _require_the_map(path: Path, origin: Origin, place: str, cure: str) -> None:
    """Raise EvaluatorError, with the cure at its end, unless the recorded episode's map is at `place`."""
    try:
        found = load_town(place).file
    except DrivingError as error:
        raise EvaluatorError(f"{path} cannot be driven again: {error}{cure}") from None
    assert found is not None  # as it was loaded
    if found.checksum != origin.town_checksum:
        raise EvaluatorError(
            f"{path}: {place} is another map than the recorded episode's (SHA-256 "
            f"{found.checksum[:DIGITS_SHOWN]}..., should be {origin.town_checksum[:DIGITS_SHOWN]}...){cure}"
        )


def _action_kind(setting: object) -> str:
    """The kind of actions of the setting `action`; raises ValueError if it names none."""
    named = setting.get("type") if isinstance(setting, dict) else None
    for name, kind in ACTION_KIND_OF_TYPE.items():
        if name == named:
            return kind
    types = " or ".join(ACTION_KIND_OF_TYPE)
    raise ValueError(f"the setting action is {setting!r:.60}, its type should be {types}")


def _computer(kernels: str, numpy: str, athrl: str, processor: str) -> str:
    """What determines the last bits, in words."""
    return f"athrl-driving {athrl}, numpy {numpy}, {processor}, kernels {kernels}"


def _bytes(frame: Frame) -> bytes:
    return frame.SerializeToString(deterministic=True)


def _differences(recorded: Frame, replayed: Frame) -> Iterator[Difference]:
    """Yield the numbers that are not the same; one that only one of them has counts as no number."""
    was, now = dict(_numbers(recorded)), dict(_numbers(replayed))
    for name in was | now:
        before, after = was.get(name, math.nan), now.get(name, math.nan)
        if before != after and not (math.isnan(before) and math.isnan(after)):
            yield Difference(recorded.step, recorded.time, name, before, after)


def _of_images(recorded: Frame, replayed: Frame) -> Difference:
    """The first pixel that is not the same, or another field."""
    for name in ("birdeye", "lidar"):
        was, now = (np.frombuffer(getattr(frame, name), np.uint8) for frame in (recorded, replayed))
        if was.shape != now.shape:
            return Difference(recorded.step, recorded.time, f"{name} bytes", was.size, now.size)
        if unlike := np.flatnonzero(was != now).tolist():
            place = unlike[0]
            return Difference(recorded.step, recorded.time, f"{name}[{place}]", was[place], now[place])
    return Difference(recorded.step, recorded.time, "frame", math.nan, math.nan)


def _numbers(message: Message, path: str = "") -> Iterator[tuple[str, float]]:
    """Yield the numbers of the simulation in a message, by their place in it."""
    for field in message.DESCRIPTOR.fields:
        name, value = f"{path}{field.name}", getattr(message, field.name)
        if field.name == "decision":
            continue
        if field.message_type is not None and field.message_type.GetOptions().map_entry:
            yield from ((f"{name}[{key}]", number) for key, number in sorted(value.items()))
        elif field.message_type is not None and field.is_repeated:
            for place, each in enumerate(value):
                yield from _numbers(each, f"{name}[{place}].")
        elif field.message_type is not None:
            if message.HasField(field.name):
                yield from _numbers(value, f"{name}.")
        elif field.type == field.TYPE_DOUBLE:
            yield name, value
