"""Draw OpenDRIVE files: `python -m towns.drawing NAME=FILE.xodr ...`, in `driving/`."""

import argparse
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from towns.reading import Drawing, Lane, read

_KINDS = {
    "one lane a direction": "#8d99ae",
    "two lanes and more": "#5c677d",
    "one-way, one or two lanes": "#7d8bd1",
    "motorway": "#3d5a80",
    "lane that ends": "#2a9d8f",
    "junction": "#e9b872",
    "pavement, shoulder": "#dfe3e8",
}
_SIGNAL_COLOUR = "#d62828"
_CREDIT = "CARLA, CC-BY 4.0, Computer Vision Center (CVC)"


def draw(path: Path, picture: Path, credit: str) -> None:
    """Draw one file: lanes by kind, junction areas, marks, driving directions, signals, names."""
    drawing = read(path)
    figure = Figure(figsize=(10, 10), layout="constrained")
    axes = figure.add_subplot()
    kinds = _draw_lanes(axes, drawing)
    _draw_marks(axes, drawing)
    _draw_directions(axes, drawing)
    if drawing.signals:
        x, y = zip(*((signal.x, signal.y) for signal in drawing.signals), strict=True)
        axes.scatter(x, y, s=9, color=_SIGNAL_COLOUR, zorder=40)
    _draw_names(axes, drawing)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    handles: list[Patch | Line2D] = [
        Patch(color=_KINDS[kind], label=kind) for kind in _KINDS if kind in kinds
    ]
    if drawing.signals:
        handles.append(Line2D([], [], marker="o", linestyle="", color=_SIGNAL_COLOUR, label="signal"))
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle(f"{picture.stem}" + (f" ({credit})" if credit else ""))
    figure.savefig(picture, dpi=90, metadata={"Software": None})


def _draw_lanes(axes: Axes, drawing: Drawing) -> set[str]:
    """Draw the lanes' areas, higher ones over lower ones, and return which kinds there are."""
    numbers: dict[str, set[int]] = {}
    for lane in drawing.lanes:
        if lane.kind == "driving":
            numbers.setdefault(lane.road, set()).add(lane.number)
    used = set()
    for lane in drawing.lanes:
        kind = _kind(lane, numbers.get(lane.road, set()))
        if not kind:
            continue
        used.add(kind)
        area = np.vstack((lane.left[:, :2], lane.right[::-1, :2]))
        # Driving lanes over pavements, and both over what lies more than a metre below.
        height = 10.0 + 0.1 * float(lane.middle[:, 2].max()) + (0.05 if lane.kind == "driving" else 0.0)
        colour = _KINDS[kind]
        # A thin edge of the same colour closes the hairlines between neighbouring areas.
        axes.add_collection(
            PolyCollection([area], facecolors=colour, edgecolors=colour, linewidths=0.2, zorder=height)
        )
    return used


def _kind(lane: Lane, numbers: set[int]) -> str:
    """Return the kind of a lane on a road with these driving lanes, empty where it is not drawn."""
    if lane.kind in ("sidewalk", "shoulder"):
        return "pavement, shoulder"
    if lane.kind != "driving":
        return ""
    if lane.junction != "-1":
        return "junction"
    if lane.ends:
        return "lane that ends"
    one_way = min(numbers) > 0 or max(numbers) < 0
    if lane.road_kind == "motorway" or len(numbers) > (2 if one_way else 4):
        return "motorway"
    if one_way:
        return "one-way, one or two lanes"
    return "two lanes and more" if len(numbers) > 2 else "one lane a direction"


def _draw_marks(axes: Axes, drawing: Drawing) -> None:
    """Draw broken marks between lanes, the only ones that tell something at this scale."""
    lines = [
        lane.right[:, :2]
        for lane in drawing.lanes
        if lane.kind == "driving" and lane.mark.startswith("broken") and lane.junction == "-1"
    ]
    axes.add_collection(LineCollection(lines, colors="white", linewidths=0.4, linestyles="dashed", zorder=30))


def _draw_directions(axes: Axes, drawing: Drawing) -> None:
    extent = max(np.ptp(np.vstack([lane.middle[:, :2] for lane in drawing.lanes]), axis=0))
    for lane in drawing.lanes:
        if lane.kind != "driving" or lane.junction != "-1" or lane.length < extent / 20.0:
            continue
        x0, y0, x1, y1 = _half_way(lane)
        axes.annotate(
            "",
            (x1, y1),
            (x0, y0),
            arrowprops={"arrowstyle": "->", "color": "white", "linewidth": 0.8, "mutation_scale": 8},
            zorder=31,
        )


def _half_way(lane: Lane) -> tuple[float, float, float, float]:
    """Return x, y half-way along a lane, and x, y a metre further on."""
    steps = np.hypot(*np.diff(lane.middle[:, :2], axis=0).T)
    along = np.concatenate(([0.0], np.cumsum(steps)))
    half = along[-1] / 2.0
    (x0, x1), (y0, y1) = (np.interp([half, half + 1.0], along, lane.middle[:, axis]) for axis in (0, 1))
    return x0, y0, x1, y1


def _draw_names(axes: Axes, drawing: Drawing) -> None:
    """Name the roads and junctions that have names of their own, not numbers or "start - end"."""
    longest: dict[str, Lane] = {}
    for lane in drawing.lanes:
        name = lane.road_name
        if lane.kind != "driving" or lane.junction != "-1" or " - " in name or name.startswith("Road "):
            continue
        if name and (name not in longest or lane.length > longest[name].length):
            longest[name] = lane
    for name, lane in longest.items():
        _write(axes, name, *_half_way(lane)[:2], size=7, above=0)
    for junction in drawing.root.iterfind("junction"):
        name = junction.get("name", "")
        roads = {entry.get("connectingRoad") for entry in junction.iterfind("connection")}
        inside = [lane.middle[:, :2] for lane in drawing.lanes if lane.road in roads]
        part_of_ring = name.rsplit(" ", 1)[0] in longest
        if inside and name and not name.startswith("junction") and not part_of_ring and len(roads) > 4:
            x, y = np.vstack(inside).mean(axis=0)
            _write(axes, name, x, y, size=6, above=12)


def _write(axes: Axes, text: str, x: float, y: float, size: int, above: int) -> None:
    axes.annotate(
        text,
        (x, y),
        (0, above),
        textcoords="offset points",
        fontsize=size,
        ha="center",
        va="center",
        zorder=50,
        bbox={"boxstyle": "round,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.75},
    )


def main() -> None:
    """Draw every file that is named on the command line."""
    parser = argparse.ArgumentParser(description="Draw OpenDRIVE files.")
    parser.add_argument("files", nargs="+", help="NAME=FILE.xodr, or FILE.xodr; carla-... is credited")
    parser.add_argument("--folder", type=Path, default=Path("../docs/pictures"), help="where pictures go")
    arguments = parser.parse_args()
    matplotlib.rcParams["font.size"] = 9
    for file in arguments.files:
        name, _, path = file.rpartition("=")
        name = name or Path(path).stem
        picture = arguments.folder / f"{name}.png"
        draw(Path(path), picture, _CREDIT if name.startswith("carla") else "")
        print(picture)


if __name__ == "__main__":
    main()
