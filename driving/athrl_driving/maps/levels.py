"""Height differences between roads, and between vehicles, on different levels."""

ROAD_LEVEL_HEIGHT = 3.0
"""Metres between two roads of which one passes over the other; what is farther from the ego is not seen."""

VEHICLE_LEVEL_HEIGHT = 2.5
"""Metres between two vehicles of which one passes over the other: less than between their roads, as both
stand on slopes."""
