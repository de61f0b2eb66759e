"""The layout of the scene when it is opened."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import rerun.blueprint as rrb

from athrl_evaluator.drawing import colours

TIMELINE = "simulated time"
INTENTION = "intention"
"""The decision that is described in words: left, straight or right."""

CAR_BOUNDS = rrb.VisualBounds2D(x_range=[-32, 32], y_range=[-42, 22])  # m; more is visible ahead than behind
RECENT = rrb.VisibleTimeRange(
    TIMELINE,
    start=rrb.TimeRangeBoundary.cursor_relative(seconds=-60.0),
    end=rrb.TimeRangeBoundary.cursor_relative(seconds=0.0),
)


def curves_of_decision(decision: Iterable[str]) -> list[str]:
    """The decided values that get a view: the intention, or without one all of them."""
    names = sorted(decision)
    return [INTENTION] if INTENTION in names else names


def make_blueprint(decided: Sequence[str] = ()) -> rrb.Blueprint:
    """Surroundings to the left, what the planner sees and the town in the middle, curves to the right.

    Args:
        decided: names of decided values that get a view each.
    """
    background = rrb.Background(color=colours.BACKGROUND)
    surroundings = rrb.Spatial2DView(
        origin="/car", name="Around the car", visual_bounds=CAR_BOUNDS, background=background
    )
    town = rrb.Spatial2DView(origin="/town", name="Town", background=background)
    sees = rrb.Horizontal(
        rrb.Spatial2DView(origin="/sees/birdeye", name="Bird's eye"),
        rrb.Spatial2DView(origin="/sees/lidar", name="Lidar"),
    )
    middle = rrb.Vertical(
        rrb.TextDocumentView(origin="/episode", name="Episode"), town, sees, row_shares=[1, 3, 2]
    )
    curves = rrb.Vertical(
        _curves("/speed", "Speed, m/s", rrb.ScalarAxis(range=(0.0, 9.0)), legend=True),
        *(_decision(name) for name in decided),
        _curves("/reward", "Reward, by term", legend=True),
        _curves("/return", "Return"),
        row_shares=[3, *[2] * len(decided), 5, 2],
    )
    return rrb.Blueprint(
        rrb.Horizontal(surroundings, middle, curves, column_shares=[5, 3, 4]),
        rrb.TimePanel(timeline=TIMELINE, state="collapsed", play_state="following"),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        auto_views=False,
        auto_layout=False,
    )


def _decision(name: str) -> rrb.TimeSeriesView:
    if name == INTENTION:
        axis = rrb.ScalarAxis(range=(-0.1, 2.1))
        return _curves(f"/decision/{name}", "Intention: 0 left, 1 straight, 2 right", axis)
    return _curves(f"/decision/{name}", name.replace("_", " ").capitalize())


def _curves(
    origin: str, name: str, axis: rrb.ScalarAxis | None = None, legend: bool = False
) -> rrb.TimeSeriesView:
    corner = rrb.PlotLegend(corner="LeftTop", visible=legend)
    return rrb.TimeSeriesView(origin=origin, name=name, axis_y=axis, plot_legend=corner, time_ranges=[RECENT])
