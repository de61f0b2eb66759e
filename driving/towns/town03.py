"""town03: a roundabout between crossings, a junction of five arms, and a ring of streets round them.

  .------- north gate -- orchard ---.
  |            |           |        |
  |     .-- chapel ----- garden     |
mill    |      ‖           |        |
  |  \\  |      ‖           |        |
  |   star == circle === market === east gate      (= and ‖: two lanes in each direction)
  |  /  |      ‖           |        |
harbour |      ‖           |        |
  |     '--- school -------'        |
  |            |                    |
  '------- south gate --------------'
"""

from athrl_driving.maps.making.description import Bend, Node, Road, Roundabout, Town

TOWN03 = Town(
    name="town03",
    nodes=(
        Roundabout("circle", 0.0, 0.0, radius=22.0),
        Node("star", -165.0, 0.0),
        Node("market", 165.0, 0.0),
        Node("chapel", 0.0, 165.0),
        Node("school", 0.0, -165.0),
        Node("garden", 165.0, 165.0),
        Node("orchard", 165.0, 311.0),
        Node("north gate", 0.0, 311.0),
        Node("east gate", 318.0, 0.0),
        Node("south gate", 0.0, -311.0),
        Node("mill", -318.0, 110.0),
        Node("harbour", -318.0, -110.0),
    ),
    roads=(
        Road("star", "circle", lanes=(2, 2), mph=40, name="Circle Road West"),
        Road("circle", "market", lanes=(2, 2), mph=40, major=True, name="Circle Road East"),
        Road("circle", "chapel", lanes=(2, 2), mph=40, name="Circle Road North"),
        Road("circle", "school", lanes=(2, 2), mph=40, name="Circle Road South"),
        Road("market", "east gate", lanes=(2, 2), mph=50, major=True, name="Market Road"),
        Road("chapel", "north gate", name="Chapel Hill"),
        Road("school", "south gate", name="School Lane"),
        Road("market", "garden", name="Garden Street"),
        Road("garden", "chapel", name="Cherry Street"),
        Road("garden", "orchard", name="Orchard Street"),
        Road("market", "school", bends=(Bend(165.0, -165.0, 60.0),), name="River Street"),
        Road("star", "chapel", bends=(Bend(-111.4, 165.0, 50.0),), name="Vineyard Street"),
        Road("star", "school", bends=(Bend(-111.4, -165.0, 50.0),), name="Weaver Street"),
        Road("star", "mill", bends=(Bend(-255.0, 65.4, 30.0), Bend(-275.0, 110.0, 20.0))),
        Road("star", "harbour", bends=(Bend(-255.0, -65.4, 30.0), Bend(-275.0, -110.0, 20.0))),
        Road("mill", "harbour", mph=40, major=True, name="Meadow Road"),
        Road("north gate", "mill", bends=(Bend(-318.0, 311.0, 90.0),), mph=40, major=True),
        Road("north gate", "orchard", mph=40, major=True),
        Road("orchard", "east gate", bends=(Bend(318.0, 311.0, 90.0),), mph=40, major=True),
        Road("south gate", "east gate", bends=(Bend(318.0, -311.0, 90.0),), mph=40, major=True),
        Road("south gate", "harbour", bends=(Bend(-318.0, -311.0, 90.0),), mph=40, major=True),
    ),
)
