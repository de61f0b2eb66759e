"""The layout of the arrays of vehicles and objects.

Row i < N is vehicle i of `road.vehicles`, the rows after them are `road.objects`, in their order:
highway-env breaks ties by the order of these lists. The names are highway-env's.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

# State: float64 [STATE_COLUMNS, rows], changes at every frame.
HEADING = 0
SPEED = 1
TARGET_SPEED = 2
STEERING = 3
ACCELERATION = 4
TIMER = 5
IMPACT_X = 6
IMPACT_Y = 7
YIELD_TIMER = 8
DIAGONAL = 9
LATERAL_SPEED = 10
YAW_RATE = 11
STATE_COLUMNS = 12

# Marks: int64 [MARK_COLUMNS, rows].
KIND = 0
IS_MDP = 1
LANE = 2
TARGET_LANE = 3
CRASHED = 4
HIT = 5
HAS_IMPACT = 6
SOLID = 7
COLLIDABLE = 8
CHECK_COLLISIONS = 9
ENABLE_LANE_CHANGE = 10
IS_YIELDING = 11
HAS_YIELDED = 12
ROUTE_HEAD = 13
ROUTE_END = 14
PREDICTS_STEERING = 15
MARK_COLUMNS = 16

# The kinds, ordered by capability: `kind >= CONTROLLED` is isinstance(v, ControlledVehicle).
OBSTACLE = 0
LANDMARK = 1
VEHICLE = 2
BICYCLE = 3
CONTROLLED = 4
IDM = 5
LINEAR = 6

# Parameters: float64 [PARAMETER_COLUMNS, rows]; highway-env has them as attributes of classes and of objects.
LENGTH = 0
WIDTH = 1
MAX_SPEED = 2
MIN_SPEED = 3
TAU_PURSUIT = 4
KP_A = 5
KP_HEADING = 6
KP_LATERAL = 7
MAX_STEERING_ANGLE = 8
ACC_MAX = 9
COMFORT_ACC_MAX = 10
COMFORT_ACC_MIN = 11
DISTANCE_WANTED = 12
TIME_WANTED = 13
DELTA = 14
POLITENESS = 15
LANE_CHANGE_MIN_ACC_GAIN = 16
LANE_CHANGE_MAX_BRAKING_IMPOSED = 17
LANE_CHANGE_DELAY = 18
MASS = 19
LENGTH_A = 20
LENGTH_B = 21
INERTIA_Z = 22
FRICTION_FRONT = 23
FRICTION_REAR = 24
MAX_ANGULAR_SPEED = 25
SCALAR_PARAMETERS = (
    "LENGTH",
    "WIDTH",
    "MAX_SPEED",
    "MIN_SPEED",
    "TAU_PURSUIT",
    "KP_A",
    "KP_HEADING",
    "KP_LATERAL",
    "MAX_STEERING_ANGLE",
    "ACC_MAX",
    "COMFORT_ACC_MAX",
    "COMFORT_ACC_MIN",
    "DISTANCE_WANTED",
    "TIME_WANTED",
    "DELTA",
    "POLITENESS",
    "LANE_CHANGE_MIN_ACC_GAIN",
    "LANE_CHANGE_MAX_BRAKING_IMPOSED",
    "LANE_CHANGE_DELAY",
    "MASS",
    "LENGTH_A",
    "LENGTH_B",
    "INERTIA_Z",
    "FRICTION_FRONT",
    "FRICTION_REAR",
    "MAX_ANGULAR_SPEED",
)
ACCELERATION_PARAMETERS = len(SCALAR_PARAMETERS)
STEERING_PARAMETERS = ACCELERATION_PARAMETERS + 3
PARAMETER_COLUMNS = STEERING_PARAMETERS + 2
VECTOR_PARAMETERS = ("ACCELERATION_PARAMETERS", "STEERING_PARAMETERS")

NONE = -1
"""No row, no lane, or None for the lane of a road on a route."""


class Rows(NamedTuple):
    """Vehicles and objects."""

    position: Floats
    """[rows, 2] m, the centre."""
    state: Floats
    """[STATE_COLUMNS, rows]."""
    parameters: Floats
    """[PARAMETER_COLUMNS, rows]."""
    marks: Integers
    """[MARK_COLUMNS, rows]."""
    route: Integers
    """[rows, R, 3] from node, to node, lane id or NONE; ROUTE_HEAD is the next one, ROUTE_END after the last.
    A route that is None has ROUTE_END 0."""


class Scratch(NamedTuple):
    """Working memory of a frame; kept so that no frame allocates."""

    x: Floats
    """[rows] m."""
    y: Floats
    """[rows] m."""
    cosine: Floats
    """[rows] of the heading."""
    sine: Floats
    """[rows] of the heading."""
    along: Floats
    """[rows] m along the own lane."""
    radius: Floats
    """[rows] m, half the diagonal."""
    listed: Integers
    """[L, 3] for each lane: the frame in which its list was made, its start and its end in the pool."""
    pool_along: Floats
    """[P] m along the lane, ascending in each list."""
    pool_row: Integers
    """[P] the row."""
    near: Integers
    """[rows] whether it can be on the lane that is being listed."""
    member: Integers
    """[rows] the last list that it is in."""
    counters: Integers
    """[4] the lists' frame, the used part of the pool, the row for which a kernel failed, lists made."""
    trajectory: Floats
    """[rows, TRAJECTORY_POINTS, 3] predicted x, y, heading."""
    reach: Floats
    """[rows, 4] the box around a trajectory: least x and y, greatest x and y."""
    corners: Floats
    """[10, 2] x, y in m: five corners of each of two boxes."""


FRAME = 0
POOL_USED = 1
FAILED_ROW = 2
LIST = 3

TRAJECTORY_POINTS = 11
"""RegulatedRoad looks 3 s ahead in steps of 0.25 s, without both ends."""
