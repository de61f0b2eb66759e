"""OpenDRIVE files: what they say, and the exact lane geometry and lane links that follow from it."""

from athrl_driving.maps.opendrive.model import MapError, OpenDrive
from athrl_driving.maps.opendrive.reading import parse_opendrive, read_opendrive

__all__ = ["MapError", "OpenDrive", "parse_opendrive", "read_opendrive"]
