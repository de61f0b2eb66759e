"""The maps that benchmarks run on: the project's towns, and CARLA's where a folder has them."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

from athrl_driving.maps import TOWNS, load_town

_CARLA = Path(os.environ.get("ATHRL_TOWNS", Path(__file__).resolve().parents[2] / "shared" / "towns"))


def add_map_options(parser: argparse.ArgumentParser) -> None:
    """Let the user choose maps."""
    parser.add_argument("--maps", nargs="+", help="names of towns or paths of OpenDRIVE files; default: all")
    parser.add_argument("--carla", type=Path, default=_CARLA, help="folder with CARLA's maps")


def chosen_maps(arguments: argparse.Namespace) -> dict[str, str]:
    """Return the chosen maps: what to call each, and what `load_town` knows it by."""
    maps = arguments.maps or [*TOWNS, *map(str, sorted(arguments.carla.glob("*.xodr")))]
    return {name if name in TOWNS else f"CARLA {load_town(name).name}": name for name in maps}
