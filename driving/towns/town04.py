"""town04: a motorway of three lanes a direction round a grid of streets, joined by ramps.

The counter-clockwise carriageway lies outside. At "west gate" and "east gate", outside the ring, its ramps
meet a street that passes under both carriageways to "west terminal" and "east terminal", where the clockwise
one's ramps end. The grid's nodes are named by column a to e and row 1 (south) to 5 (north).
"""

import itertools

from athrl_driving.maps.making.description import Bend, Bridge, Gore, Motorway, Node, Road, Town

_COLUMNS = {"a": -220.0, "b": -115.0, "c": 0.0, "d": 105.0, "e": 220.0}
_ROWS = {"1": -212.0, "2": -100.0, "3": 0.0, "4": 108.0, "5": 212.0}
_CORNERS = ("a1", "a5", "e1", "e5")
_SIGNALS = ("c3",)

_EAST, _NORTH, _MEDIAN, _RADIUS = 425.0, 423.0, 4.0, 160.0
_GATE, _TERMINAL = 488.0, 376.0
_HEIGHT, _DECK, _SLOPE = 6.5, 30.0, 140.0


def _ring(outwards: float) -> tuple[Bend, ...]:
    x, y, radius = _EAST + outwards, _NORTH + outwards, _RADIUS + outwards
    return tuple(Bend(*corner, radius) for corner in ((x, y), (x, -y), (-x, -y), (-x, y)))


_BRIDGES = (
    Bridge(-_EAST, 0.0, _HEIGHT, _DECK, _SLOPE),
    Bridge(_EAST, 0.0, _HEIGHT, _DECK, _SLOPE),
)

_MOTORWAYS = (
    Motorway(
        "Ring clockwise",
        corners=_ring(0.0),
        lanes=3,
        mph=60,
        gores=(
            Gore("to west terminal", -_EAST, -200.0, leaves=True),
            Gore("from west terminal", -_EAST, 160.0, leaves=False),
            Gore("to c5", -150.0, _NORTH, leaves=True),
            Gore("to east terminal", _EAST, 200.0, leaves=True),
            Gore("from east terminal", _EAST, -160.0, leaves=False),
            Gore("from c1", -110.0, -_NORTH, leaves=False),
        ),
        bridges=_BRIDGES,
    ),
    Motorway(
        "Ring counter-clockwise",
        corners=tuple(reversed(_ring(_MEDIAN))),
        lanes=3,
        mph=60,
        gores=(
            Gore("to west gate", -_EAST, 200.0, leaves=True),
            Gore("from west gate", -_EAST, -160.0, leaves=False),
            Gore("to east gate", _EAST, -200.0, leaves=True),
            Gore("from east gate", _EAST, 160.0, leaves=False),
        ),
        bridges=_BRIDGES,
    ),
)


def _ramp(start: str, end: str, x: float, y: float, radius: float = 60.0) -> Road:
    return Road(start, end, bends=(Bend(x, y, radius),), lanes=(1, 0), mph=35)


_RAMPS = (
    _ramp("to west gate", "west gate", -_GATE, 30.0),
    _ramp("west gate", "from west gate", -_GATE, -30.0),
    _ramp("to east gate", "east gate", _GATE, -30.0),
    _ramp("east gate", "from east gate", _GATE, 30.0),
    _ramp("to west terminal", "west terminal", -_TERMINAL, -50.0),
    _ramp("west terminal", "from west terminal", -_TERMINAL, 50.0),
    _ramp("to east terminal", "east terminal", _TERMINAL, 50.0),
    _ramp("east terminal", "from east terminal", _TERMINAL, -50.0),
    _ramp("to c5", "c5", 0.0, 375.0),
    _ramp("c1", "from c1", 0.0, -375.0),
)


def _grid() -> tuple[Road, ...]:
    """Return the streets between neighbouring nodes; at the corners they bend."""
    places = {c + r: (x, y) for c, x in _COLUMNS.items() for r, y in _ROWS.items()}
    lines = [[c + r for c in _COLUMNS] for r in _ROWS] + [[c + r for r in _ROWS] for c in _COLUMNS]
    roads = []
    for line in lines:
        major = "c3" in line and "a3" in line
        for start, end in itertools.pairwise(line):
            if start not in _CORNERS and end not in _CORNERS:
                roads.append(Road(start, end, mph=35 if major else 30, major=major))
    for corner, start, end in (
        ("a1", "a2", "b1"),
        ("a5", "a4", "b5"),
        ("e1", "d1", "e2"),
        ("e5", "d5", "e4"),
    ):
        roads.append(Road(start, end, bends=(Bend(*places[corner], 40.0),)))
    return tuple(roads)


TOWN04 = Town(
    name="town04",
    nodes=(
        *(
            Node(c + r, x, y, signals=c + r in _SIGNALS)
            for c, x in _COLUMNS.items()
            for r, y in _ROWS.items()
            if c + r not in _CORNERS
        ),
        Node("west gate", -_GATE, 0.0),
        Node("east gate", _GATE, 0.0),
        Node("west terminal", -_TERMINAL, 0.0, signals=True),
        Node("east terminal", _TERMINAL, 0.0, signals=True),
    ),
    roads=(
        *_grid(),
        Road("west gate", "west terminal", mph=35, major=True, name="West Underpass"),
        Road("west terminal", "a3", mph=35, major=True, name="West Avenue"),
        Road("e3", "east terminal", mph=35, major=True, name="East Avenue"),
        Road("east terminal", "east gate", mph=35, major=True, name="East Underpass"),
        *_RAMPS,
    ),
    motorways=_MOTORWAYS,
)
