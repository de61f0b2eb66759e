"""Bounds of a map: no file takes more than some seconds and a gigabyte to be refused.

Real maps keep far below. CARLA's Town04, for comparison, has 2.1 MB, 242 roads of at most 600 m, 2,250 lanes,
263 movements through junctions, and needs 23,000 pieces.
"""

import math

LARGEST_FILE = 64 * 2**20
"""Bytes."""

MOST_ELEMENTS, MOST_ATTRIBUTES = 1_500_000, 2_500_000
"""XML elements and their attributes, which need about 130 and 230 bytes of memory each."""

GAP = 0.01
"""Metres by which lines and lanes may miss each other; such is the rounding of numbers in files."""

SAME_PLACE = 1e-6
"""Metres between two stations that are one, written with other roundings; so short a section is none."""

SHORTEST_ROAD = 1e-5
"""Metres: a road that is shorter, or has no length, is taken as so long, so that it links its neighbours."""

LARGEST_GAP = 0.3
"""Metres of a jump, or of a length that differs, which are bridged: less than a car is steered by anyway.

What is compared with it is rounded to the millimetre that messages tell: a gap of 0.3 m in the file is rarely
just that in numbers.
"""

STEP, LARGEST_STEP = 0.1, 0.5
"""Metres of a step in height: from which on it is noted, and up to which a slope stands for it."""

SHARE_OF_GAP = 0.25
"""Of the length of what is bent to bridge a gap: it turns by no more radians than that."""

LARGEST_CORNER = math.radians(45.0)
"""By which a lane turns at once into the next one: a vehicle does so too, and its end swings into the lanes
beside."""

LARGEST_NEGATIVE_WIDTH = 0.02
"""Metres below 0 that a lane's width may be, and is taken as 0."""

LARGEST_NUMBER = 1e12
"""No formula for lines and lanes overflows with numbers up to this."""

LARGEST_COORDINATE = 1e8
"""Metres; maps in projected coordinates reach 10,000 km."""

LARGEST_AREA = 4096.0
"""Square kilometres around all lanes, as the lane graph has a grid of cells; Berlin has 890."""

LARGEST_HEIGHT_RANGE = 6_000.0
"""Metres between the lowest and the highest lane, as the picture of their surface has heights of 16 bits."""

LONGEST_ROAD = 200_000.0
"""Metres; roads of public maps have up to some tens of kilometres."""

MOST_TURN = 200.0
"""Radians by which one geometry turns; the ramp of a car park turns by some 60."""

LARGEST_ID = 2**31 - 1
"""Of a lane."""

LONGEST_TEXT = 256
"""Characters of an id or a name."""

MOST_LANES_BESIDE = 200
"""Lanes of one section, and lanes that one lane leads to."""

FARTHEST_BESIDE = 1_000.0
"""Metres from a road's reference line to a lane's outer edge."""

MOST_PIECES = 400_000
"""Parts of lanes, and ten for each part of a road; it is cut where a formula changes or no arc fits."""

PIECES_OF_A_ROAD, PIECES_PER_METRE, PIECES_PER_FORMULA = 200, 2.0, 20
"""A road has at most so many pieces; on Town04 one formula makes 1.03."""

MOST_MOVEMENTS, MOST_MOVEMENT_LANES = 20_000, 200_000
"""Movements through junctions, and the lanes on all of them."""

MOST_PATHS = 200_000
"""Paths that are tried to find the movements; short roads between junctions make exponentially many."""

MOST_FORK_STEPS = 20_000_000
"""Lanes that are looked at to find forks and merges beside junctions."""

MOST_POINTS, MOST_CLOSE_POINTS, MOST_CLOSE_MOVEMENTS = 2_000_000, 8_000_000, 2_000_000
"""Points along movements, every 0.5 m; pairs of points within some metres; pairs of movements with such."""

MOST_CROSSINGS, MOST_LYING_OVER = 50_000, 2_000_000
"""Places where lanes cross outside junctions; pairs of parts of lanes, 4 m long, that lie on each other."""

MOST_GRID_ENTRIES = 16_000_000
"""Cells of the grid that a lane touches, of all lanes together."""

MOST_LIGHTS = 100_000
"""Traffic lights, references to signals, and the ranges of lanes that they hold for."""

MOST_LIGHT_STEPS = 20_000_000
"""Lights and ranges that are looked at to find those of every movement, on all roads that it leads over."""
