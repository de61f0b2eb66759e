"""The ego as numbers: its controllers and its bicycle model, compiled.

The motion is that of highway-env's `Vehicle` with two differences: the axles are where such a car has them
and not at its bumpers, and brakes stop the car and do not push it backwards.
"""

import math

from athrl_driving.control import WHEEL_ANGLE_PER_STEERING, acceleration_command, steering_command
from athrl_driving.kernels.compilation import compiled
from athrl_driving.maps.lane_graph import Floats
from athrl_driving.traffic.ego_columns import ELEVATION, HEADING, LENGTH, PRESENT, SPEED, WIDTH, X, Y

(
    TARGET_SPEED,
    WAYPOINT_X,
    WAYPOINT_Y,
    STEERING,
    WHEEL_ANGLE,
    ACCELERATION,
    SPEED_MEMORY,
    STEERING_MEMORY,
    CONTROL_SIZE,
) = (0, 1, 2, 3, 4, 5, 6, 8, 10)
"""Places in `control`, float64 [10]: the decision (m/s, m, m; NaN where commands are given directly), the
last commands (share of full lock, rad, m/s2), and the memories of the two loops, two numbers each."""

EGO_LENGTH, EGO_WIDTH = 4.9, 2.1
"""Size of the ego, m."""

EGO_WHEELBASE = 2.85
"""Distance between the axles, m; with 21 degrees of steering the centre turns with a radius of 7.6 m."""

LARGEST_SPEED = 40.0
"""highway-env's bound of a vehicle's speed, m/s."""


@compiled
def place_ego(ego: Floats, control: Floats, x: float, y: float, heading: float, elevation: float) -> None:
    """Place the ego, standing, with cleared controllers."""
    ego[X], ego[Y], ego[HEADING], ego[SPEED] = x, y, heading, 0.0
    ego[LENGTH], ego[WIDTH], ego[ELEVATION], ego[PRESENT] = EGO_LENGTH, EGO_WIDTH, elevation, 1.0
    control[:] = 0.0
    control[WAYPOINT_X], control[WAYPOINT_Y] = x, y
    control[SPEED_MEMORY + 1] = math.nan
    control[STEERING_MEMORY + 1] = math.nan


@compiled
def control_ego(ego: Floats, control: Floats, speed_gain: float, interval: float) -> None:
    """Run both controllers for one tick of `interval` seconds; without a target the last commands hold.

    `speed_gain` is the speed loop's, 1/s.
    """
    if math.isnan(control[TARGET_SPEED]):
        return
    control[STEERING] = steering_command(
        control[STEERING_MEMORY : STEERING_MEMORY + 2],
        ego[X], ego[Y], ego[HEADING], control[WAYPOINT_X], control[WAYPOINT_Y], interval,
    )  # fmt: skip
    control[WHEEL_ANGLE] = control[STEERING] * WHEEL_ANGLE_PER_STEERING
    control[ACCELERATION] = acceleration_command(
        control[SPEED_MEMORY : SPEED_MEMORY + 2], ego[SPEED], control[TARGET_SPEED], speed_gain, interval
    )


@compiled
def move_ego(ego: Floats, control: Floats, crashed: bool, wheelbase: float, interval: float) -> None:
    """Move for `interval` seconds with the commands in `control`; after a crash it only brakes."""
    speed = ego[SPEED]
    if crashed:
        control[WHEEL_ANGLE], control[ACCELERATION] = 0.0, -speed
    if speed > LARGEST_SPEED:
        control[ACCELERATION] = min(control[ACCELERATION], LARGEST_SPEED - speed)
    elif speed < -LARGEST_SPEED:
        control[ACCELERATION] = max(control[ACCELERATION], -LARGEST_SPEED - speed)
    acceleration = max(control[ACCELERATION], -speed / interval)
    slip = math.atan(0.5 * math.tan(control[WHEEL_ANGLE]))
    ego[X] += speed * math.cos(ego[HEADING] + slip) * interval
    ego[Y] += speed * math.sin(ego[HEADING] + slip) * interval
    ego[HEADING] += speed * math.sin(slip) / (wheelbase / 2.0) * interval
    ego[SPEED] += acceleration * interval
