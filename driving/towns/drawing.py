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
    "motorway": "#3d5a80",
    "ramp or ring": "#7d8bd1",
    "junction": "#e9b872",
    "pavement, shoulder": "#dfe3e8",
}
_CREDIT = "CARLA, CC-BY 4.0, Computer Vision Center (CVC)"


def draw(path: Path, picture: Path, credit: str) -> None:
    """Draw one file: lanes by kind, junction areas, marks, driving directions, signals, road names."""
    drawing = read(path)
    figure = Figure(figsize=(10, 10), layout="constrained")
    axes = figure.add_subplot()
    counts = _lanes_of_roads(drawing)
    ordered = sorted(
        drawing.lanes, key=lambda lane: (float(lane.middle[:, 2].mean()), lane.kind == "driving")
    )
    used: dict[str, str] = {}
    for lane in ordered:
        kind = _kind(lane, counts)
        if kind:
            used[kind] = _KINDS[kind]
            area = np.vstack((lane.left[:, :2], lane.right[::-1, :2]))
            raised = 10 + float(lane.middle[:, 2].mean())
            axes.add_collection(PolyCollection([area], facecolors=_KINDS[kind], linewidths=0, zorder=raised))
    _draw_marks(axes, drawing)
    _draw_directions(axes, drawing)
    if drawing.signals:
        x, y = zip(*((signal.x, signal.y) for signal in drawing.signals), strict=True)
        axes.scatter(x, y, s=14, color="#d62828", zorder=40)
    _draw_names(axes, drawing)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m (OpenDRIVE: upwards)")
    handles: list[Patch | Line2D] = [
        Patch(color=color, label=kind) for kind, color in _KINDS.items() if kind in used
    ]
    if drawing.signals:
        handles.append(Line2D([], [], marker="o", linestyle="", color="#d62828", label="signal"))
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    figure.suptitle(f"{picture.stem}" + (f" ({credit})" if credit else ""))
    figure.savefig(picture, dpi=110, metadata={"Software": ""})


def _lanes_of_roads(drawing: Drawing) -> dict[str, int]:
    counts: dict[str, int] = {}
    for lane in drawing.lanes:
        if lane.kind == "driving" and lane.section == 0:
            counts[lane.road] = counts.get(lane.road, 0) + 1
    return counts


def _kind(lane: Lane, counts: dict[str, int]) -> str:
    if lane.kind in ("sidewalk", "shoulder"):
        return "pavement, shoulder"
    if lane.kind != "driving":
        return ""
    if lane.junction != "-1":
        return "junction"
    numbers = counts[lane.road]
    if lane.road_kind == "motorway" or numbers > 5 or lane.mph >= 55:
        return "motorway"
    return "two lanes and more" if numbers > 2 else "one lane a direction"


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
            arrowprops={"arrowstyle": "->", "color": "white", "linewidth": 0.6, "mutation_scale": 6},
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
    """Name the roads that have names of their own, not "start - end" or numbers."""
    longest: dict[str, Lane] = {}
    for lane in drawing.lanes:
        name = lane.road_name
        if lane.kind != "driving" or lane.junction != "-1" or " - " in name or name.startswith("Road "):
            continue
        if name and (name not in longest or lane.length > longest[name].length):
            longest[name] = lane
    for name, lane in longest.items():
        middle = _half_way(lane)[:2]
        axes.annotate(
            name,
            middle,
            fontsize=7,
            ha="center",
            va="center",
            zorder=50,
            bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.8},
        )
    for junction in drawing.root.iterfind("junction"):
        name = junction.get("name", "")
        roads = {entry.get("connectingRoad") for entry in junction.iterfind("connection")}
        inside = [lane.middle[:, :2] for lane in drawing.lanes if lane.road in roads]
        if name and not name.startswith("junction") and inside and len(roads) > 5:
            middle = np.vstack(inside).mean(axis=0)
            axes.annotate(name, middle, fontsize=6, ha="center", va="center", zorder=51)


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
