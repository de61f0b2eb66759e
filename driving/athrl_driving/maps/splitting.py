"""Cuts carriageways across all their lanes."""

from dataclasses import replace

from athrl_driving.maps.opendrive.carriageways import Carriageway


def split(carriageway: Carriageway, share: float) -> Carriageway:
    """Cut a carriageway at a share (0 to 1) of its length, in driving direction; return what is behind it.

    Each lane leads on to its other part.
    """
    cut = carriageway.start + (share if carriageway.forward else 1.0 - share) * (
        carriageway.end - carriageway.start
    )
    start, end = (cut, carriageway.end) if carriageway.forward else (carriageway.start, cut)
    rest = Carriageway(carriageway.road, carriageway.forward, start, end, [])
    for segment in carriageway.lanes:
        x, y, heading = segment.at(share * segment.length)
        middle = segment.elevation + share * (segment.end_elevation - segment.elevation)
        second = replace(
            segment, x=x, y=y, heading=heading, length=(1.0 - share) * segment.length, elevation=middle
        )
        second.successors = segment.successors
        second.carriageway = rest
        segment.successors, segment.length, segment.end_elevation = [second], share * segment.length, middle
        rest.lanes.append(second)
    carriageway.start, carriageway.end = (
        (carriageway.start, cut) if carriageway.forward else (cut, carriageway.end)
    )
    return rest
