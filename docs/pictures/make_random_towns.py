"""Draws six random towns side by side: run `python docs/pictures/make_random_towns.py`."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import matplotlib.pyplot as plt
import numpy as np
from athrl_driving.maps import load_town
from athrl_driving.maps.outlines import outlines
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection

NUMBERS = (1, 3, 7, 11, 13, 15)
SIDE = 640.0
"""Metres that each picture shows, so that towns can be compared."""
_ROAD, _IN_JUNCTION = "#5c677d", "#e9b872"


def draw(axes: Axes, number: int) -> None:
    """Draw one town: its lanes, those through junctions in another colour."""
    town = load_town(f"random-{number}")
    areas = outlines(town.lane_polylines(), town.graph.width)
    in_junction = town.graph.movement >= 0
    for wanted, colour in ((True, _IN_JUNCTION), (False, _ROAD)):
        chosen = [area for area, inside in zip(areas, in_junction, strict=True) if inside == wanted]
        axes.add_collection(PolyCollection(chosen, facecolors=colour, edgecolors=colour, linewidths=0.2))
    points = np.concatenate(areas)
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    axes.set_xlim(middle[0] - SIDE / 2.0, middle[0] + SIDE / 2.0)
    axes.set_ylim(middle[1] - SIDE / 2.0, middle[1] + SIDE / 2.0)
    axes.set_aspect("equal")
    axes.set_axis_off()
    axes.set_title(town.name, fontsize=9)


def main() -> None:
    """Draw all of them into random-towns.png."""
    figure, places = plt.subplots(2, 3, figsize=(9.0, 6.2), layout="constrained")
    for axes, number in zip(places.flat, NUMBERS, strict=True):
        draw(axes, number)
    figure.savefig(Path(__file__).with_name("random-towns.png"), dpi=90, metadata={"Software": None})


if __name__ == "__main__":
    main()
