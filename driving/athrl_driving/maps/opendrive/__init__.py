"""OpenDRIVE files: what they say, and the exact lane geometry and lane links that follow from it."""

from athrl_driving.maps.opendrive.model import MapError, OpenDrive
from athrl_driving.maps.opendrive.reading import read_opendrive

__all__ = ["MapError", "OpenDrive", "read_opendrive"]
