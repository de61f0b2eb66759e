"""The page of a run in TensorBoard: which curves belong together, and where else to look.

The layout is in each event file, so that any TensorBoard that reads the run's folder has it, as the tab
"Custom Scalars". The links are a text beside the curves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from athrl_spaces import REFERENCE_DRIVERS
from tensorboard.compat.proto.summary_pb2 import Summary, SummaryMetadata  # type: ignore[import-untyped]
from tensorboard.compat.proto.tensor_pb2 import TensorProto  # type: ignore[import-untyped]
from tensorboard.compat.proto.tensor_shape_pb2 import TensorShapeProto  # type: ignore[import-untyped]
from tensorboard.compat.proto.types_pb2 import DT_STRING  # type: ignore[import-untyped]
from tensorboard.plugins.custom_scalar import metadata as layout_metadata  # type: ignore[import-untyped]
from tensorboard.plugins.custom_scalar.layout_pb2 import (  # type: ignore[import-untyped]
    Category,
    Chart,
    Layout,
    MarginChartContent,
    MultilineChartContent,
)
from tensorboard.plugins.text import metadata as text_metadata  # type: ignore[import-untyped]

from athrl_evaluator.recording.recordings import newest_recordings
from athrl_evaluator.watching.viewer import FRAMES_PORT, PAGE_PORT, Server

NEWEST = 5  # recordings that are named

_SCORE = "evaluation/policy/"
_DRIVERS = "|".join(("policy", *REFERENCE_DRIVERS))
_RETURN = (f"{_SCORE}return_mean", f"{_SCORE}return_low", f"{_SCORE}return_high")
"""The mean, and the ends of its interval."""

LAYOUT: Mapping[str, Mapping[str, Sequence[str]]] = {
    "Progress": {
        "Decisions a second": ["learner/learner/environment_steps_per_second"],
        "Updates a second": ["learner/learner/updates_per_second"],
        "Share of time that the learner, the actors, the disk wait": [
            "learner/learner/waiting/(learner|actors|disk)"
        ],
        "Actors that take part": ["learner/learner/actors"],
    },
    "Evaluated policy": {
        "Return, with its 95 % interval": [*_RETURN],
        "Return beside the reference drivers'": [f"evaluation/({_DRIVERS})/return_mean"],
        "Share of episodes with a collision, off the lane, to the end": [
            f"{_SCORE}(collision_rate|off_lane_rate|full_episode_rate)"
        ],
        "Driving score, success": [f"{_SCORE}(driving_score|success_rate)"],
    },
    "Actors": {
        "Decisions a second": ["actor/[^/]+/decisions_per_second"],
        "Return, with exploration": ["actor/[^/]+/return_mean"],
        "Share of episodes with a collision, with exploration": ["actor/[^/]+/collision_rate"],
        "Seconds by which policies are late": ["learner/learner/policy_lag_seconds"],
    },
    "Learning": {
        "TD error": ["learner/learner/loss/[^/]+/td_error"],
        "Value": ["learner/learner/loss/[^/]+/value"],
    },
}
"""Charts by their categories, each of the curves that these expressions match as a whole."""


def layout_value() -> Summary.Value:
    """What an event file says once: the charts of the page."""
    categories = [
        Category(title=title, chart=[_chart(name, tags) for name, tags in charts.items()])
        for title, charts in LAYOUT.items()
    ]
    content = Layout(category=categories).SerializeToString()
    return _text(layout_metadata.CONFIG_SUMMARY_TAG, content, layout_metadata.create_summary_metadata())


def links_value(recordings: Path) -> Summary.Value:
    """Where to look at the run as it drives: the live episode, and the newest recordings in a folder."""
    newest = newest_recordings(recordings)[:NEWEST]
    live = Server(FRAMES_PORT, page_port=PAGE_PORT).shown_address
    lines = [
        f"Live: [{live}]({live}), served by `athrl watch --browser`",
        "",
        *(f"- `athrl watch {recordings / file.name} --browser`" for file in newest),
    ]
    about = text_metadata.create_summary_metadata("Where to look", "")
    return _text("run/where to look", "\n".join(lines).encode(), about)


def with_interval(scores: Mapping[str, float]) -> dict[str, float]:
    """A driver's scores, with the ends of the mean return's 95 % interval: `return_low` and `return_high`."""
    mean, half = scores["return_mean"], scores["return_ci95"]
    return {**scores, "return_low": mean - half, "return_high": mean + half}


def _chart(title: str, tags: Sequence[str]) -> Chart:
    """A chart; that of `_RETURN` is a line with a band."""
    if tuple(tags) == _RETURN:
        value, lower, upper = _RETURN
        band = MarginChartContent.Series(value=value, lower=lower, upper=upper)
        return Chart(title=title, margin=MarginChartContent(series=[band]))
    return Chart(title=title, multiline=MultilineChartContent(tag=[f"{tag}$" for tag in tags]))


def _text(tag: str, content: bytes, about: SummaryMetadata) -> Summary.Value:
    tensor = TensorProto(dtype=DT_STRING, tensor_shape=TensorShapeProto(), string_val=[content])
    return Summary.Value(tag=tag, tensor=tensor, metadata=about)
