"""Bounds of the settings that run files and environments share."""

from __future__ import annotations

BOUNDS: dict[str, tuple[type, float, float]] = {
    "vehicles": (int, 0, 10_000),
    "image_size": (int, 8, 512),
    "episode_ticks": (int, 1, 10**9),
    "ticks_per_decision": (int, 1, 1000),
    "maximum_speed": (float, 0.1, 40.0),
    "waypoint_radius": (float, 1.0, 100.0),
    "waypoint_half_angle": (float, 1.0, 90.0),
    "speed_gain": (float, 0.05, 10.0),
}
"""Type, lowest and highest value by name: vehicles, pixels, ticks, ticks, m/s, m, degrees, 1/s."""
