"""Lanes that are given by their outer borders become lanes that are given by their widths."""

from dataclasses import replace

from athrl_driving.maps.opendrive.model import Cubic, Lane, record_at


def widths_from_borders(lanes: dict[int, Lane]) -> None:
    """Give each lane of a section that has borders its widths: from the lane inside, or from the centre."""
    for side in (1, -1):
        inside: list[Cubic] = []
        for number in sorted((number for number in lanes if number * side > 0), key=abs):
            lane = lanes[number]
            if lane.widths:
                inside = _sum(inside, lane.widths)
                continue
            border = _outwards(lane.borders)
            lane.widths, lane.borders = _sum(border, [_times(-1.0, record) for record in inside]), []
            inside = border


def _outwards(borders: list[Cubic]) -> list[Cubic]:
    """Return borders as distances from the centre: to the right of it they are below 0 in files."""
    return borders if sum(record.a for record in borders) >= 0.0 else [_times(-1.0, each) for each in borders]


def _sum(first: list[Cubic], second: list[Cubic]) -> list[Cubic]:
    """Return the sum of two lists of polynomials; no list is 0, and the first of a list holds before it."""
    if not first or not second:
        return first or second
    return [
        _plus(_from(record_at(first, s) or first[0], s), _from(record_at(second, s) or second[0], s))
        for s in sorted({record.s for record in (*first, *second)})
    ]


def _from(record: Cubic, s: float) -> Cubic:
    """Return the same polynomial, written from station `s` on."""
    ds = s - record.s
    b = record.b + ds * (2.0 * record.c + ds * 3.0 * record.d)
    return replace(record, s=s, a=record.at(s), b=b, c=record.c + 3.0 * record.d * ds)


def _plus(first: Cubic, second: Cubic) -> Cubic:
    return replace(
        first, a=first.a + second.a, b=first.b + second.b, c=first.c + second.c, d=first.d + second.d
    )


def _times(factor: float, record: Cubic) -> Cubic:
    return replace(record, a=factor * record.a, b=factor * record.b, c=factor * record.c, d=factor * record.d)
