"""town02: eight T-junctions, close together, on streets with one wide lane a direction.

  .------------------------------.
  |                              |
bakery -- fountain -- library -- cinema
  |          |           |       |
pharmacy -- bank ----- kiosk --- post office
  |                              |
  '------------------------------'
"""

from athrl_driving.maps.making.description import Bend, Node, Road, Town

_WEST, _EAST, _SOUTH, _NORTH = 4.0, 196.0, 4.0, 196.0
_CORNER = 16.0
_LOWER, _UPPER = 60.0, 139.0
_MPH = 25

TOWN02 = Town(
    name="town02",
    lane_width=4.0,
    nodes=(
        Node("bakery", _WEST, _UPPER),
        Node("pharmacy", _WEST, _LOWER),
        Node("cinema", _EAST, _UPPER),
        Node("post office", _EAST, _LOWER),
        Node("fountain", 62.0, _UPPER),
        Node("library", 134.0, _UPPER),
        Node("bank", 62.0, _LOWER),
        Node("kiosk", 134.0, _LOWER),
    ),
    roads=(
        Road(
            "bakery",
            "cinema",
            bends=(Bend(_WEST, _NORTH, _CORNER), Bend(_EAST, _NORTH, _CORNER)),
            mph=_MPH,
            major=True,
            name="North Side",
        ),
        Road(
            "pharmacy",
            "post office",
            bends=(Bend(_WEST, _SOUTH, _CORNER), Bend(_EAST, _SOUTH, _CORNER)),
            mph=_MPH,
            major=True,
            name="South Side",
        ),
        Road("bakery", "pharmacy", mph=_MPH, major=True, name="West Side"),
        Road("cinema", "post office", mph=_MPH, major=True, name="East Side"),
        Road("bakery", "fountain", mph=_MPH, name="Baker Street"),
        Road("fountain", "library", mph=_MPH, name="Fountain Street"),
        Road("library", "cinema", mph=_MPH, name="Cinema Street"),
        Road("pharmacy", "bank", mph=_MPH, name="Mint Street"),
        Road("bank", "kiosk", mph=_MPH, name="Bank Street"),
        Road("kiosk", "post office", mph=_MPH, name="Post Street"),
        Road("fountain", "bank", mph=_MPH, name="Water Street"),
        Road("library", "kiosk", mph=_MPH, name="Paper Street"),
    ),
)
