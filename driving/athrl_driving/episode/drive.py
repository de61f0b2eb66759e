"""One decision as one compiled call: controllers, ego, traffic, collision, route, reward, metrics, image."""

import math

import numpy as np
from numpy.typing import NDArray

from ..compilation import compiled, inlined
from ..maps.lane_graph import Floats
from ..metrics import MetricsState, environment_metrics
from ..route import RouteState, environment_route
from ..traffic.state import Traffic, environment_traffic
from .ego import HEADING, TARGET_SPEED, WAYPOINT_X, WAYPOINT_Y, X, Y
from .observe import observe
from .state import DriveSettings, Progress, View
from .tick import tick

BEGIN, TAKE, TICK, DRIVE, SEE = 1, 2, 4, 8, 16
"""What is to be done for an environment, to be added up: begin a decision; take its action; drive one tick;
drive all its ticks or until the episode ends; draw the observation."""

DECIDE = BEGIN + TAKE + DRIVE + SEE
"""A whole decision."""


@compiled
def drive(
    settings: DriveSettings,
    traffic: Traffic,
    routes: RouteState,
    metrics: MetricsState,
    perception: View,
    progress: Progress,
    actions: NDArray[np.float32],
    work: NDArray[np.int64],
    first: int,
    last: int,
) -> None:
    """Do the `work` int64 [E] of the environments `first` to `last` - 1 with `actions` float32 [E, 2].

    The first arguments are the fields of `EpisodeState`. No environment touches what belongs to another, so
    calls on different ones may run at the same time.
    """
    for e in range(first, last):
        if work[e] == 0:
            continue
        around, route = environment_traffic(traffic, e), environment_route(routes, e)
        if work[e] & BEGIN:
            clear_decision(progress, e)
            progress.decisions[e] += 1
        if work[e] & TAKE:
            take_decision(settings, progress.ego[e], progress.control[e], actions[e])
        if work[e] & (TICK + DRIVE):
            counts = environment_metrics(metrics, e)
            ticks = settings.ticks_per_decision if work[e] & DRIVE else 1
            for _ in range(ticks):
                tick(settings, around, route, counts, progress, e)
                if progress.terminated[e] or progress.truncated[e]:
                    break
        if work[e] & SEE:
            observe(perception, around.graph, around.background, route, progress, e)


@inlined
def clear_decision(progress: Progress, e: int) -> None:
    """Let the sums over a decision's ticks begin at nothing."""
    progress.decision_ticks[e] = 0
    progress.reward[e] = progress.speed[e] = 0.0
    for term in range(progress.terms.shape[1]):
        progress.terms[e, term] = 0.0


@compiled
def take_decision(settings: DriveSettings, ego: Floats, control: Floats, action: NDArray[np.float32]) -> None:
    """Turn a normalised action (clipped to [-1, 1]) into a target speed and a waypoint in the world."""
    speed = min(max(float(action[0]), -1.0), 1.0)
    angle = min(max(float(action[1]), -1.0), 1.0)
    control[TARGET_SPEED] = (speed + 1.0) / 2.0 * settings.maximum_speed
    direction = ego[HEADING] + angle * settings.waypoint_half_angle
    control[WAYPOINT_X] = ego[X] + settings.waypoint_radius * math.cos(direction)
    control[WAYPOINT_Y] = ego[Y] + settings.waypoint_radius * math.sin(direction)
