"""town02: eight T-junctions, close together, on streets with one wide lane a direction.

  .------------------ kiosk -----.
  |                     |        |
bakery -- fountain -- library -- cinema
  |          |                   |
pharmacy -- bank ------------ post office
  |                              |
  '------------------------------'
"""

from towns.description import Bend, Node, Road, Town

_WEST, _EAST, _SOUTH, _NORTH = 4.0, 196.0, 4.0, 196.0
_CORNER = 22.0

TOWN02 = Town(
    name="town02",
    lane_width=4.0,
    nodes=(
        Node("bakery", _WEST, 134.0),
        Node("pharmacy", _WEST, 66.0),
        Node("cinema", _EAST, 134.0),
        Node("post office", _EAST, 66.0),
        Node("kiosk", 130.0, _NORTH),
        Node("library", 130.0, 134.0),
        Node("fountain", 66.0, 134.0),
        Node("bank", 66.0, 66.0),
    ),
    roads=(
        Road("bakery", "kiosk", bends=(Bend(_WEST, _NORTH, _CORNER),), mph=25, major=True),
        Road("kiosk", "cinema", bends=(Bend(_EAST, _NORTH, _CORNER),), mph=25, major=True),
        Road("kiosk", "library", mph=25, name="Kiosk Street"),
        Road("bakery", "fountain", mph=25, name="Baker Street"),
        Road("fountain", "library", mph=25, name="Fountain Street"),
        Road("library", "cinema", mph=25, name="Cinema Street"),
        Road("bakery", "pharmacy", mph=25, major=True),
        Road("cinema", "post office", mph=25, major=True),
        Road("fountain", "bank", mph=25, name="Bank Street"),
        Road("pharmacy", "bank", mph=25, name="Mint Street"),
        Road("bank", "post office", mph=25, name="Post Street"),
        Road(
            "pharmacy",
            "post office",
            bends=(Bend(_WEST, _SOUTH, _CORNER), Bend(_EAST, _SOUTH, _CORNER)),
            mph=25,
            major=True,
            name="South Side",
        ),
    ),
)
