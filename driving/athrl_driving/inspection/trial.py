"""How many vehicles a map bears, and how traffic of so many flows on it."""

from __future__ import annotations

from dataclasses import dataclass

from athrl_spaces.environment import BOUNDS

from athrl_driving.maps import Town
from athrl_driving.traffic.flow import STUCK, TICK, measure_flow, patience
from athrl_driving.traffic.state import starting_places

SHARE_OF_PLACES = 0.4
"""Of the places with room for a vehicle: on the six maps of the benchmarks such traffic reaches 59 to 74 % of
free flow, with twice as many it crawls."""

_MINUTE = 60.0


@dataclass(frozen=True)
class Trial:
    """What happened in traffic without an ego."""

    vehicles: int
    seconds: float
    """Simulated."""
    mean_speed: float
    """m/s."""
    share_of_free_flow: float
    """0 to 1, of the speed that each vehicle would reach alone."""
    standing: float
    """Share of the time that a vehicle stands, 0 to 1."""
    overlap_seconds: float
    """For how long bodies overlapped, summed over pairs; 0 without a collision."""
    stuck: int
    """Vehicles that at the end have stood for longer than `patience`."""
    patience: float
    """s: half a minute, and the longest red of a traffic light."""


def suggested_vehicles(town: Town) -> int:
    """Return with how many background vehicles traffic is dense and still flows."""
    _, _, most = BOUNDS["vehicles"]
    return min(round(SHARE_OF_PLACES * starting_places(town)), int(most))


def try_traffic(town: Town, vehicles: int, seed: int = 0) -> Trial:
    """Let background vehicles drive for a minute, and as much longer as a light may be red.

    Raises `DrivingError` where the town has no room for them.
    """
    limit = patience(town)
    seconds = _MINUTE + limit - STUCK
    flow = measure_flow(town, vehicles, seed, seconds / 60.0)
    return Trial(
        vehicles=vehicles,
        seconds=seconds,
        mean_speed=flow.mean_speed,
        share_of_free_flow=min(flow.share_of_free_flow, 1.0),
        standing=flow.mean_standing,
        overlap_seconds=flow.colliding_pairs * TICK,
        stuck=flow.stuck,
        patience=limit,
    )
