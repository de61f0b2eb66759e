"""One decision of an episode as one compiled call: state, kernel, and the Python that begins episodes."""

from athrl_driving.episode.crew import Crew
from athrl_driving.episode.episodes import Episodes
from athrl_driving.episode.orders import BEGIN, DECIDE, DRIVE, SEE, TAKE, TICK
from athrl_driving.episode.sight import Sight, new_sight
from athrl_driving.episode.state import DriveSettings, EpisodeState

__all__ = [
    "BEGIN",
    "DECIDE",
    "DRIVE",
    "SEE",
    "TAKE",
    "TICK",
    "Crew",
    "DriveSettings",
    "EpisodeState",
    "Episodes",
    "Sight",
    "new_sight",
]
