"""The colours of the scene, RGB or RGBA."""

BACKGROUND = (22, 24, 29)
LANE = (70, 76, 88)
ROAD = (44, 48, 56)
TOWN_ROAD = (92, 98, 110)
VEHICLE = (108, 142, 191)
VEHICLE_EDGE = (160, 190, 230)
EGO = (255, 176, 46)
EGO_EDGE = (255, 224, 160)
ROUTE = (74, 190, 120)
WAYPOINT = (240, 90, 110)
REWARD_TERMS = {
    "collision": (230, 80, 80),
    "speed": (90, 200, 120),
    "fast": (240, 160, 60),
    "out": (200, 110, 220),
    "steer": (110, 170, 240),
    "lateral": (90, 210, 210),
    "constant": (150, 150, 150),
}
CURVE = (230, 230, 230)
TARGET_SPEED = (240, 90, 110)
SPEED = (90, 200, 120)
DECISION = (255, 176, 46)
RETURN = (120, 170, 250)
