"""The observation of a planner."""

from __future__ import annotations

from dataclasses import dataclass

CHANNELS = ("drivable", "vehicles", "route", "lidar")
"""Channels of the image: three of the bird's eye view, and the lidar's points on the same map."""

MOTION = ("speed_over_8", "steering_over_0.3")
"""Entries of the motion vector: speed over 8 m/s, and the last steering command over full lock."""

_SMALLEST_IMAGE = 8


@dataclass(frozen=True)
class Observation:
    """An image uint8 [size, size, channels] and a motion vector float32 [motion].

    Attributes:
        image_size: height and width of the image, pixels.
        channels: names of the image's channels.
        motion: names of the motion vector's entries.
    """

    image_size: int
    channels: tuple[str, ...] = CHANNELS
    motion: tuple[str, ...] = MOTION

    def __post_init__(self) -> None:
        if self.image_size < _SMALLEST_IMAGE:
            raise ValueError(f"image_size is {self.image_size}; it should be {_SMALLEST_IMAGE} or more")

    @property
    def motion_size(self) -> int:
        """Numbers in the motion vector."""
        return len(self.motion)

    @property
    def image_shape(self) -> tuple[int, int, int]:
        """Height, width and channels of an image."""
        return self.image_size, self.image_size, len(self.channels)
