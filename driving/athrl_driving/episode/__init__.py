"""One decision of an episode as one compiled call: state, kernel, and how episodes begin."""

from athrl_driving.episode.episodes import Episodes
from athrl_driving.episode.observation_arrays import ObservationArrays, new_observation_arrays
from athrl_driving.episode.state import DriveSettings, EpisodeState
from athrl_driving.episode.work_flags import BEGIN, DECIDE, DRIVE, OBSERVE, SET_ACTION, TICK
from athrl_driving.episode.workers import Workers

__all__ = [
    "BEGIN",
    "DECIDE",
    "DRIVE",
    "OBSERVE",
    "SET_ACTION",
    "TICK",
    "DriveSettings",
    "EpisodeState",
    "Episodes",
    "ObservationArrays",
    "Workers",
    "new_observation_arrays",
]
