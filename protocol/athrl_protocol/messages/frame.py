"""A frame: one decision of an episode for live viewers and recordings; see `Frame` in the schema."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from google.protobuf.message import Message

from athrl_protocol.errors import InvalidMessage
from athrl_protocol.messages.athrl_pb2 import Frame, Point, Vehicle
from athrl_protocol.messages.limits import LARGEST_FRAME
from athrl_protocol.messages.schema import check_numbers, check_text, decode_message, encode_message

MOST_DECIDED = 256
"""Most entries in one decision of a planner."""
LARGEST_NUMBER = 1e9
"""Of any number in a frame, in its unit."""
MOST_VEHICLES, MOST_WAYPOINTS = 10_000, 1_000
"""Of a town, and of the route ahead."""
LONGEST_EPISODE = 1e8
"""Simulated seconds."""

__all__ = ["Frame", "Point", "Scene", "Vehicle", "decode_frame", "encode_frame", "frame_of"]


class Scene(Protocol):
    """What a frame needs of a simulation at one time; positions in town coordinates, metres."""

    @property
    def time(self) -> float:
        """Simulated seconds since the episode began."""

    @property
    def ego(self) -> Any:
        """The ego, an object with the attributes of the message `Vehicle`."""

    @property
    def vehicles(self) -> Sequence[Any]:
        """The other vehicles."""

    @property
    def route(self) -> np.ndarray:
        """float64 [waypoints, 2]"""

    @property
    def waypoint(self) -> np.ndarray | None:
        """float64 [2], the planner's; None if it decides none"""

    @property
    def target_speed(self) -> float:
        """m/s; NaN if the planner decides none"""

    @property
    def steering(self) -> float:
        """rad"""

    @property
    def acceleration(self) -> float:
        """m/s2"""

    @property
    def reward_terms(self) -> Mapping[str, float]:
        """Weighted terms that sum to the reward."""


def frame_of(
    scene: Scene,
    image: np.ndarray,
    *,
    driver: str,
    town: str,
    policy_version: int,
    episode_seed: int,
    step: int,
    decision: Mapping[str, float],
    reward: float,
    episode_return: float,
) -> Frame:
    """Make a frame of a simulation at one time.

    Args:
        scene: the simulation.
        image: uint8 [height, width, 4], the planner's observation.
        driver: policy, random, blind or rule-based.
        town: the town of the episode.
        policy_version: version of the policy, 0 for other drivers.
        episode_seed: seed with which the episode was reset.
        step: decision of the episode, from 0.
        decision: all decided entries by name, physical units or index of a choice; may be empty.
        reward: of this decision.
        episode_return: sum of the rewards so far.
    """
    height, width = image.shape[:2]
    return Frame(
        driver=driver,
        town=town,
        policy_version=policy_version,
        episode_seed=episode_seed,
        step=step,
        time=scene.time,
        ego=Vehicle(**vars(scene.ego)),
        vehicles=[Vehicle(**vars(vehicle)) for vehicle in scene.vehicles],
        route=[Point(x=x, y=y) for x, y in scene.route.tolist()],
        waypoint=None if scene.waypoint is None else Point(x=scene.waypoint[0], y=scene.waypoint[1]),
        target_speed=scene.target_speed,
        decision=decision,
        steering=scene.steering,
        acceleration=scene.acceleration,
        reward=reward,
        reward_terms=scene.reward_terms,
        episode_return=episode_return,
        image_height=height,
        image_width=width,
        birdeye=np.ascontiguousarray(image[:, :, :3]).tobytes(),
        lidar=np.ascontiguousarray(image[:, :, 3]).tobytes(),
    )


def encode_frame(frame: Frame) -> bytes:
    """Return a frame as bytes, for live viewers or a recording."""
    return encode_message(frame)


def decode_frame(payload: bytes) -> Frame:
    """Return the frame in a message.

    Raises:
        InvalidMessage: it is no frame of this schema, too large, cannot be shown, its images do not have the
            announced size, or a number is not finite or above `LARGEST_NUMBER`.
    """
    frame = decode_message(Frame, payload, largest=LARGEST_FRAME)
    for kind, count, most in (
        ("vehicles", len(frame.vehicles), MOST_VEHICLES),
        ("waypoints", len(frame.route), MOST_WAYPOINTS),
    ):
        if count > most:
            raise InvalidMessage("size", f"frame: {count} {kind}, should be at most {most}")
    check_numbers("frame", frame.reward_terms)
    check_numbers("frame", frame.decision, most=MOST_DECIDED)
    if not 0.0 <= frame.time <= LONGEST_EPISODE:
        raise InvalidMessage("value", f"frame: time is {frame.time:g} s, should be 0 to {LONGEST_EPISODE:g}")
    for kind, text in (("driver", frame.driver), ("town", frame.town)):
        check_text("frame", kind, text)
    for part in (frame, frame.ego, *frame.vehicles, *frame.route, frame.waypoint):
        _check_range(part)
    for values in (frame.reward_terms, frame.decision):
        for name, value in values.items():
            _check_number(name, value)
    pixels = frame.image_height * frame.image_width
    for name, image, channels in (("birdeye", frame.birdeye, 3), ("lidar", frame.lidar, 1)):
        if len(image) not in (0, pixels * channels):
            raise InvalidMessage(
                "size", f"frame: {name} has {len(image)} bytes, should have {pixels * channels}"
            )
    return frame


def _check_range(part: Message) -> None:
    """Refuse what no viewer can draw; a target speed that is not a number is none."""
    for field, value in part.ListFields():
        if isinstance(value, float) and not (field.name == "target_speed" and math.isnan(value)):
            _check_number(field.name, value)


def _check_number(name: str, value: float) -> None:
    if not abs(value) <= LARGEST_NUMBER:
        raise InvalidMessage(
            "value", f"frame: {name} is {value:g}; it should be at most {LARGEST_NUMBER:g} from 0"
        )
