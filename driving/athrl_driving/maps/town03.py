"""town03: a roundabout, a grid of streets, and a boulevard with two lanes a direction in the south east.

            mill --------- chapel
   .---------+---------------+---------.
   |         |               |         |
  gate --- circle -------- market --- station
   |      (roundabout)       |         ‖
   |         |               |         ‖
harbour -- school --------- park ---- depot
   |         |                         ‖
   '------ bridge =====================’          (= and ‖: two lanes in each direction)
"""

from athrl_driving.maps.description import BOULEVARD_SPEED, Bend, Node, Street, TownDescription

TOWN03 = TownDescription(
    name="town03",
    nodes=(
        Node("mill", 230.0, 0.0),
        Node("chapel", 450.0, 0.0),
        Node("gate", 0.0, 190.0),
        Node("circle", 230.0, 190.0, ring_radius=26.0),
        Node("market", 450.0, 200.0),
        Node("station", 680.0, 190.0),
        Node("harbour", 0.0, 380.0),
        Node("school", 230.0, 380.0),
        Node("park", 450.0, 390.0),
        Node("depot", 680.0, 380.0),
        Node("bridge", 230.0, 560.0),
    ),
    streets=(
        Street("gate", "mill", bends=(Bend(0.0, 0.0, 40.0),)),
        Street("mill", "chapel"),
        Street("chapel", "station", bends=(Bend(680.0, 0.0, 60.0),)),
        Street("mill", "circle"),
        Street(
            "chapel",
            "market",
            bends=(Bend(450.0, 60.0, 50.0), Bend(470.0, 110.0, 50.0), Bend(450.0, 155.0, 50.0)),
        ),
        Street("gate", "circle"),
        Street("circle", "market"),
        Street("market", "station", bends=(Bend(530.0, 203.0, 90.0), Bend(600.0, 190.0, 90.0))),
        Street(
            "gate",
            "harbour",
            bends=(Bend(-3.0, 230.0, 60.0), Bend(-30.0, 285.0, 40.0), Bend(-3.0, 340.0, 60.0)),
        ),
        Street("circle", "school"),
        Street("market", "park"),
        Street("harbour", "school"),
        Street("school", "park"),
        Street("park", "depot"),
        Street("harbour", "bridge", bends=(Bend(0.0, 560.0, 30.0),)),
        Street("school", "bridge"),
        Street("station", "depot", lanes=2, speed_limit=BOULEVARD_SPEED),
        Street("depot", "bridge", bends=(Bend(680.0, 560.0, 50.0),), lanes=2, speed_limit=BOULEVARD_SPEED),
    ),
)
