"""How fast to drive behind a leader, towards a curve and towards a stop line, compiled."""

import math

from athrl_driving.kernels.compilation import compiled

# highway-env's numbers as constants: some of its environments change those of its classes for the process.
COMFORT_ACCELERATION = 3.0
COMFORT_DECELERATION = 5.0
LARGEST_ACCELERATION = 6.0
DISTANCE_WANTED = 10.0
TIME_WANTED = 1.5
SPEED_EXPONENT = 4.0
REFERENCE_LENGTH = 5.0
"""highway-env's model measures from centre to centre: a gap between bumpers plus this length."""

_LEAST = 0.01
_GEOMETRIC_MEAN = 2.0 * math.sqrt(COMFORT_ACCELERATION * COMFORT_DECELERATION)


@compiled
def idm_acceleration(speed: float, target_speed: float, distance: float, leader_speed: float) -> float:
    """Return the Intelligent Driver Model's acceleration (m/s2), equal to that of highway-env's `IDMVehicle`.

    `distance` is from centre to centre along the path in metres, infinite without a leader; speeds in m/s.
    """
    free = abs(target_speed)
    free = free if free > _LEAST else _LEAST
    acceleration = COMFORT_ACCELERATION * (1.0 - (max(speed, 0.0) / free) ** SPEED_EXPONENT)
    if distance < math.inf:
        wanted = DISTANCE_WANTED + speed * TIME_WANTED + speed * (speed - leader_speed) / _GEOMETRIC_MEAN
        ratio = wanted / (distance if distance > _LEAST else _LEAST)
        acceleration -= COMFORT_ACCELERATION * ratio * ratio
    return acceleration


@compiled
def approach_speed(distance: float, speed_there: float, deceleration: float, dt: float) -> float:
    """Return the greatest next speed (m/s) with which `speed_there` is still met after `distance` metres."""
    if distance <= 0.0:
        return speed_there
    step = deceleration * dt
    return math.sqrt(step * step + speed_there * speed_there + 2.0 * deceleration * distance) - step
