"""Networks of SUMO, written as OpenDRIVE by its netgenerate and netconvert (`pip install eclipse-sumo`)."""

from __future__ import annotations

import subprocess
from pathlib import Path

PROGRAM = "netgenerate"

_WIDE = ("--default.junctions.radius", "12", "--no-turnarounds")
"""With narrower junctions netconvert writes turns that begin beside their lane, at an angle to it."""

MAPS: dict[str, tuple[str, tuple[str, ...]]] = {
    "grid": (
        "16 junctions in four rows",
        ("--grid", "--grid.number", "4", "--grid.length", "150", *_WIDE),
    ),
    "lights": (
        "Nine junctions with traffic lights, two lanes a direction",
        ("--grid", "--grid.number", "3", "--grid.length", "200", "--default.lanenumber", "2", *_WIDE,
         "--default-junction-type", "traffic_light"),
    ),
    "spider": (
        "Three rings that six roads join",
        ("--spider", "--spider.arm-number", "6", "--spider.circle-number", "3", "--spider.omit-center",
         *_WIDE),
    ),
    "narrow": (
        "16 junctions as netgenerate makes them without options",
        ("--grid", "--grid.number", "4", "--grid.length", "150"),
    ),
}  # fmt: skip
"""By name: what it shows, and netgenerate's options."""

_SECONDS = 60.0


def write(name: str, path: Path) -> None:
    """Write a map to a file, and SUMO's own network beside it."""
    network = path.with_suffix(".net.xml")
    _run(PROGRAM, *MAPS[name][1], "--output-file", str(network))
    _run("netconvert", "--sumo-net-file", str(network), "--opendrive-output", str(path))


def _run(*command: str) -> None:
    subprocess.run(command, check=True, capture_output=True, timeout=_SECONDS)
