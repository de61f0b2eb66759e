"""How well an episode was driven: CARLA's driving score, MetaDrive's rates, nuPlan's comfort and safety."""

from athrl_driving.metrics.episode import (
    COMPLETION_SPEED,
    LEAST_TIME_TO_COLLISION,
    LONGEST_TIME_TO_COLLISION,
    PENALTIES,
    TickRecord,
    note_tick,
    prepare_summary,
    reset_metrics,
    summary,
)
from athrl_driving.metrics.state import (
    COMFORT_BOUNDS,
    NO_COLLISION,
    STATIC_COLLISION,
    VEHICLE_COLLISION,
    MetricsState,
    environment_metrics,
    new_metrics,
)

__all__ = [
    "COMFORT_BOUNDS",
    "COMPLETION_SPEED",
    "LEAST_TIME_TO_COLLISION",
    "LONGEST_TIME_TO_COLLISION",
    "NO_COLLISION",
    "PENALTIES",
    "STATIC_COLLISION",
    "VEHICLE_COLLISION",
    "MetricsState",
    "TickRecord",
    "environment_metrics",
    "new_metrics",
    "note_tick",
    "prepare_summary",
    "reset_metrics",
    "summary",
]
