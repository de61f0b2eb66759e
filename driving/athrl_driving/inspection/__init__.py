"""Looking at a map: what it holds, what of it is driven, how it looks, how traffic flows on it."""

from athrl_driving.inspection.facts import Driven, MapFacts, facts_of
from athrl_driving.inspection.lines import lines_of
from athrl_driving.inspection.picture import draw_town
from athrl_driving.inspection.trial import Trial, suggested_vehicles, try_traffic

__all__ = [
    "Driven",
    "MapFacts",
    "Trial",
    "draw_town",
    "facts_of",
    "lines_of",
    "suggested_vehicles",
    "try_traffic",
]
