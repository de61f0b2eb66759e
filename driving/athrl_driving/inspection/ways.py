"""How far an episode can drive before the map ends."""

from __future__ import annotations

import numpy as np

from athrl_driving.episode.starts import room_to_start
from athrl_driving.maps import Town
from athrl_driving.metrics import COMPLETION_SPEED
from athrl_driving.route.state import TO_THE_EDGE, dead_end_distance, lanes_reach

EPISODE = 50.0 * COMPLETION_SPEED
"""m that an episode with the default settings has time for: 50 s at the highest speed without a penalty."""

_SHARES = np.linspace(0.05, 0.95, 10)
"""Of the places on a lane where an episode may start: those that are tried."""


def mean_way(town: Town) -> float:
    """Return how far episodes from random starts can drive in the mean, m, at most `EPISODE`.

    It is less where the map ends before and no turn leads back.
    """
    graph = town.graph
    margin, room = room_to_start(graph)
    leads_off = lanes_reach(graph) == TO_THE_EDGE
    end = np.where(leads_off, dead_end_distance(graph), np.inf)
    ways = np.minimum(end[:, None] - margin - room[:, None] * _SHARES, EPISODE).mean(axis=1)
    return float((ways * room).sum() / room.sum())
