"""One decision of an episode as one compiled call: state, kernel, and the Python that begins episodes."""

from .drive import BEGIN, DECIDE, DRIVE, SEE, TAKE, TICK
from .episodes import Episodes
from .state import DriveSettings, EpisodeState

__all__ = ["BEGIN", "DECIDE", "DRIVE", "SEE", "TAKE", "TICK", "DriveSettings", "EpisodeState", "Episodes"]
