"""For how many background vehicles a town has room when an ego drives in it, too."""

import numpy as np

from athrl_driving.episode.beginning import CLEARANCE
from athrl_driving.episode.starts import Journeys
from athrl_driving.maps import Town
from athrl_driving.maps.lane_graph import Floats, Integers
from athrl_driving.maps.outlines import points_on
from athrl_driving.traffic.lane_links import LaneLinks
from athrl_driving.traffic.spawn import JITTER
from athrl_driving.traffic.state import lane_links_of

_EGOS = 400
"""Starts that are tried."""

_SHARE = 0.7
"""Of the starts, on which there is the room: that none of the 20 that an episode may draw is among them is
practically excluded."""


def places_beside_an_ego(town: Town) -> int:
    """Return for how many vehicles there is room beside an ego, which takes the starting places around it."""
    links, shapes = lane_links_of(town), town.lane_shapes
    lanes = _lanes_of_places(links)
    places = points_on(shapes, lanes, links.start_position - links.link_offset[lanes])
    journeys, generator = Journeys(town, 1.0), np.random.default_rng(0)
    starts: Floats = np.array([journeys.draw(generator).start[:2] for _ in range(_EGOS)])
    taken = [
        int((np.hypot(*(places - ego).T) <= CLEARANCE + JITTER).sum())
        for ego in points_on(shapes, starts[:, 0].astype(np.int64), starts[:, 1])
    ]
    return len(places) - int(np.quantile(taken, _SHARE, method="higher"))


def _lanes_of_places(links: LaneLinks) -> Integers:
    """Return the lane of each starting place, int64 [places]."""
    lanes = []
    for link, position in zip(links.start_link.tolist(), links.start_position.tolist(), strict=True):
        own = links.lanes[links.lane_start[link] : links.lane_start[link + 1]]
        lanes.append(own[np.searchsorted(links.link_offset[own], position, side="right") - 1])
    return np.array(lanes, dtype=np.int64)
