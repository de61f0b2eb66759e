"""Learning curves of a study as a picture: means over seeds, with bands of 95 %."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from athrl.errors import needs
from athrl.study.learning import POINTS
from athrl.study.statistics import estimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_KINDS = {"training": "with exploration", "greedy": "greedy"}
_INCHES = (5.2, 3.4)
_DOTS_AN_INCH = 120


def picture(found: Mapping[str, Any]) -> bytes | None:
    """Return a PNG of returns over decisions: a line of panels for each town, a curve for each row.

    Args:
        found: what `athrl.study.table.tabulated` returned.

    Returns:
        None while no run has a curve.
    """
    with needs("study"):
        from matplotlib.figure import Figure
    runs = [run for run in found["runs"] if any(run.get("curves", {}).values())]
    towns = list(dict.fromkeys(run["town"] for run in runs))
    if not towns:
        return None
    figure = Figure(figsize=(len(_KINDS) * _INCHES[0], len(towns) * _INCHES[1]), layout="constrained")
    panels = figure.subplots(len(towns), len(_KINDS), squeeze=False)
    for town, line in zip(towns, panels, strict=True):
        for (kind, words), panel in zip(_KINDS.items(), line, strict=True):
            _draw(panel, [run for run in runs if run["town"] == town], kind)
            panel.set(title=f"{town}, {words}", xlabel="decisions", ylabel="return of an episode")
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=_DOTS_AN_INCH, metadata={"Software": None})
    return content.getvalue()


def _draw(panel: Axes, runs: Sequence[Mapping[str, Any]], kind: str) -> None:
    """Draw the curve of each row with its band."""
    for planner, variant in dict.fromkeys((run["planner"], run["variant"]) for run in runs):
        seeds = [
            run["curves"][kind]
            for run in runs
            if (run["planner"], run["variant"]) == (planner, variant) and run["curves"][kind]
        ]
        if not seeds:
            continue
        steps, estimates = over_seeds(seeds)
        line = panel.plot(
            steps, [each.mean for each in estimates], label=", ".join(filter(None, (planner, variant)))
        )
        if estimates[0].low is not None:
            panel.fill_between(
                steps,
                [each.low for each in estimates],
                [each.high for each in estimates],
                color=line[0].get_color(),
                alpha=0.2,
                linewidth=0,
            )
    if panel.lines:
        panel.legend(fontsize="small")
    panel.grid(alpha=0.3)


def over_seeds(seeds: Sequence[Sequence[Sequence[float]]]) -> tuple[list[float], list[Any]]:
    """Return decisions, and the mean of the seeds' curves there with its interval.

    Seeds are scored at different decisions, so each curve is interpolated, over what all of them cover.
    """
    import numpy as np

    first = max(curve[0][0] for curve in seeds)
    last = max(first, min(curve[-1][0] for curve in seeds))
    steps = np.linspace(first, last, POINTS if last > first else 1)
    drawn = [np.interp(steps, *np.transpose(curve)) for curve in seeds]
    return steps.tolist(), [estimate([list(map(float, values))]) for values in zip(*drawn, strict=True)]
