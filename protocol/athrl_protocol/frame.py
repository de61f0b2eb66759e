"""A frame: one decision of an episode as it is shown live and recorded; see `Frame` in the schema."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from athrl_protocol.athrl_pb2 import Frame, Point, Vehicle
from athrl_protocol.errors import InvalidMessage
from athrl_protocol.limits import LARGEST_FRAME
from athrl_protocol.schema import check_numbers, check_text, decode_message, encode_message

MOST_DECIDED = 256
"""Numbers and choices that a planner decides at once."""

__all__ = ["Frame", "Point", "Scene", "Vehicle", "decode_frame", "encode_frame", "frame_of"]


class Scene(Protocol):
    """What a frame takes from a moment of a simulation; positions in town coordinates, metres."""

    @property
    def time(self) -> float:
        """Simulated seconds since the episode began."""

    @property
    def ego(self) -> Any:
        """The ego, an object with the attributes of the message `Vehicle`."""

    @property
    def vehicles(self) -> Sequence[Any]:
        """The others."""

    @property
    def route(self) -> np.ndarray:
        """float64 [waypoints, 2]"""

    @property
    def waypoint(self) -> np.ndarray | None:
        """float64 [2], the planner's; None where it decides none"""

    @property
    def target_speed(self) -> float:
        """m/s; NaN where the planner decides none"""

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
    """Describe a moment.

    Args:
        scene: the simulation.
        image: uint8 [height, width, 4], what the planner sees of it.
        driver: policy, random, blind or rule-based.
        town: where it drives.
        policy_version: version of the policy, 0 for other drivers.
        episode_seed: seed with which the episode was reset.
        step: decision of the episode, from 0.
        decision: everything that was decided by name, physical units or a choice's index; may be empty.
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
    """Return a frame as bytes, live or for a recording."""
    return encode_message(frame)


def decode_frame(payload: bytes) -> Frame:
    """Return the frame in a message.

    Raises:
        InvalidMessage: it is no frame of this schema, too large, cannot be shown, or its images do not have
            the size it says.
    """
    frame = decode_message(Frame, payload, largest=LARGEST_FRAME)
    check_numbers("frame", frame.reward_terms)
    check_numbers("frame", frame.decision, most=MOST_DECIDED)
    for kind, text in (("driver", frame.driver), ("town", frame.town)):
        check_text("frame", kind, text)
    pixels = frame.image_height * frame.image_width
    for name, image, channels in (("birdeye", frame.birdeye, 3), ("lidar", frame.lidar, 1)):
        if len(image) not in (0, pixels * channels):
            raise InvalidMessage(
                "size", f"frame: {name} has {len(image)} bytes, should have {pixels * channels}"
            )
    return frame
