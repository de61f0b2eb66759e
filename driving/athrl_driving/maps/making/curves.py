"""Straight lines and circular arcs, and how to join two directions with them smoothly.

Metres and radians in OpenDRIVE's frame: x to the right, y upwards, headings grow counter-clockwise, and what
lies to the left of a direction is positive.
"""

import math
from dataclasses import dataclass

_SAME = 1e-9


def wrap(angle: float) -> float:
    """Return the same direction within [-pi, pi)."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi


@dataclass(frozen=True)
class Pose:
    """A point (m) and a heading (rad)."""

    x: float
    y: float
    heading: float

    def ahead(self, distance: float) -> "Pose":
        """Return the pose `distance` metres straight ahead."""
        return Pose(
            self.x + distance * math.cos(self.heading),
            self.y + distance * math.sin(self.heading),
            self.heading,
        )

    def beside(self, lateral: float) -> "Pose":
        """Return the pose `lateral` metres to the left (negative: to the right)."""
        return Pose(
            self.x - lateral * math.sin(self.heading), self.y + lateral * math.cos(self.heading), self.heading
        )

    def turned_back(self) -> "Pose":
        """Return the same point, facing the other way."""
        return Pose(self.x, self.y, self.heading + math.pi)


@dataclass(frozen=True)
class Piece:
    """A line (curvature 0) or an arc from `start`; positive curvature (1/m) turns left."""

    start: Pose
    curvature: float
    length: float

    def at(self, distance: float) -> Pose:
        """Return the pose `distance` metres along the piece."""
        if self.curvature == 0.0:
            return self.start.ahead(distance)
        heading = self.start.heading + self.curvature * distance
        x = self.start.x + (math.sin(heading) - math.sin(self.start.heading)) / self.curvature
        y = self.start.y - (math.cos(heading) - math.cos(self.start.heading)) / self.curvature
        return Pose(x, y, heading)

    @property
    def end(self) -> Pose:
        """The pose at the end."""
        return self.at(self.length)


def rounded_polyline(corners: list[tuple[float, float, float]]) -> list[Piece]:
    """Return lines through `corners` with rounded corners.

    A corner is (x, y, radius); the radii of the first and the last are not used.

    Raises `ValueError` where two arcs do not fit between their corners.
    """
    pieces: list[Piece] = []
    consumed = 0.0
    for index in range(len(corners) - 1):
        x0, y0, _ = corners[index]
        x1, y1, radius = corners[index + 1]
        heading, distance = math.atan2(y1 - y0, x1 - x0), math.hypot(x1 - x0, y1 - y0)
        turn = 0.0
        if index + 2 < len(corners):
            x2, y2, _ = corners[index + 2]
            turn = wrap(math.atan2(y2 - y1, x2 - x1) - heading)
        tangent = radius * math.tan(abs(turn) / 2.0)
        length = distance - consumed - tangent
        if length < -_SAME:
            raise ValueError(
                f"the bend at ({x1}, {y1}) with radius {radius} m needs {-length:.1f} m more of straight road"
            )
        start = Pose(x0, y0, heading)
        if length > 1e-6:
            pieces.append(Piece(start.ahead(consumed), 0.0, length))
        if abs(turn) > _SAME:
            curvature = math.copysign(1.0 / radius, turn)
            pieces.append(Piece(start.ahead(distance - tangent), curvature, radius * abs(turn)))
        consumed = tangent
    return pieces


def cut(pieces: list[Piece], start: float, end: float) -> list[Piece]:
    """Return the part of a chain of pieces between two positions along it, m."""
    result = []
    position = 0.0
    for piece in pieces:
        first, last = max(start - position, 0.0), min(end - position, piece.length)
        if last - first > 1e-6:
            result.append(Piece(piece.at(first), piece.curvature, last - first))
        position += piece.length
    return result


def length_of(pieces: list[Piece]) -> float:
    """Return the length of a chain of pieces, m."""
    return sum(piece.length for piece in pieces)


def join(start: Pose, end: Pose, smallest_radius: float) -> list[Piece]:
    """Return one to three pieces that lead from `start` to `end` without a jump in position or heading.

    A single line where both lie on it, lines and an arc where the two directions meet ahead, two arcs
    otherwise.

    Raises `ValueError` where neither is possible with `smallest_radius`, m.
    """
    turn = wrap(end.heading - start.heading)
    dx, dy = end.x - start.x, end.y - start.y
    along = dx * math.cos(start.heading) + dy * math.sin(start.heading)
    aside = -dx * math.sin(start.heading) + dy * math.cos(start.heading)
    if abs(turn) < _SAME and abs(aside) < 1e-6 and along > 0.0:
        return [Piece(start, 0.0, along)]
    choices = [
        choice for choice in (_line_and_arc(start, end, turn, along, aside), _two_arcs(start, end)) if choice
    ]
    choices = [choice for choice in choices if tightest_radius(choice) >= smallest_radius]
    if not choices:
        raise ValueError(f"no smooth way with a radius of {smallest_radius} m leads from {start} to {end}")
    return min(choices, key=length_of)


def tightest_radius(pieces: list[Piece]) -> float:
    """Return the smallest radius on a chain of pieces, m."""
    return min(math.inf if piece.curvature == 0.0 else 1.0 / abs(piece.curvature) for piece in pieces)


def _line_and_arc(start: Pose, end: Pose, turn: float, along: float, aside: float) -> list[Piece]:
    if abs(turn) < 1e-4 or abs(turn) > 3.0:
        return []
    after = aside / math.sin(turn)
    before = along - after * math.cos(turn)
    tangent = min(before, after)
    if tangent <= 0.1:
        return []
    radius = tangent / math.tan(abs(turn) / 2.0)
    arc = Piece(start.ahead(before - tangent), math.copysign(1.0 / radius, turn), radius * abs(turn))
    pieces = [
        Piece(start, 0.0, before - tangent),
        arc,
        Piece(end.ahead(tangent - after), 0.0, after - tangent),
    ]
    return [piece for piece in pieces if piece.length > 1e-6]


def _two_arcs(start: Pose, end: Pose) -> list[Piece]:
    dx, dy = end.x - start.x, end.y - start.y
    cos0, sin0 = math.cos(start.heading), math.sin(start.heading)
    cos1, sin1 = math.cos(end.heading), math.sin(end.heading)
    projection = dx * (cos0 + cos1) + dy * (sin0 + sin1)
    bend = 2.0 * (1.0 - cos0 * cos1 - sin0 * sin1)
    squared = dx * dx + dy * dy
    divisor = projection + math.sqrt(projection * projection + bend * squared)
    reach = squared / divisor if divisor > _SAME else -1.0
    if reach <= 0.0:
        return []
    first, last = start.ahead(reach), end.ahead(-reach)
    arc = _arc_to(start, (first.x + last.x) / 2.0, (first.y + last.y) / 2.0)
    return [arc, _arc_to(arc.end, end.x, end.y)]


def _arc_to(start: Pose, x: float, y: float) -> Piece:
    """Return the arc that leaves `start` along its heading and ends at the point."""
    distance = math.hypot(x - start.x, y - start.y)
    half_turn = wrap(math.atan2(y - start.y, x - start.x) - start.heading)
    if abs(half_turn) < _SAME:
        return Piece(start, 0.0, distance)
    curvature = 2.0 * math.sin(half_turn) / distance
    return Piece(start, curvature, 2.0 * half_turn / curvature)
