"""One decision of an episode as one compiled call: state, kernel, and the Python that begins episodes."""

from .episodes import Episodes
from .orders import BEGIN, DECIDE, DRIVE, SEE, TAKE, TICK
from .state import DriveSettings, EpisodeState

__all__ = ["BEGIN", "DECIDE", "DRIVE", "SEE", "TAKE", "TICK", "DriveSettings", "EpisodeState", "Episodes"]
