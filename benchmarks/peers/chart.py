"""Return and collisions over the wall time of training, as a picture and as a table."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib import pyplot
from matplotlib.axes import Axes

from benchmarks.peers.comparison import Learned

TITLES = {
    "ours": "athrl, default run",
    "sb3_ppo": "Stable-Baselines3 PPO",
    "sb3_td3": "Stable-Baselines3 TD3",
    "sb3_sac": "Stable-Baselines3 SAC",
    "torchrl_ppo": "TorchRL PPO",
    "rllib_ppo": "RLlib PPO",
}
_COLOURS = ("#0b62a4", "#d1495b", "#edae49", "#66a182", "#7a5195", "#8d6e63")


def draw(learned: Mapping[str, Learned], rule_based: Mapping[str, float], file: Path) -> None:
    """Draw the curves of all contestants and the rule-based driver as a line, into a PNG or SVG file."""
    mpl.use("Agg")
    figure, (above, below) = pyplot.subplots(2, 1, figsize=(8.0, 7.0), sharex=True, layout="constrained")
    for name, colour in zip(TITLES, _COLOURS, strict=True):
        if name in learned:
            _draw_one(above, below, learned[name], TITLES[name], colour, bold=name == "ours")
    for axes, value in ((above, rule_based["return_mean"]), (below, 100 * rule_based["collision_rate"])):
        axes.axhline(value, color="#444444", linestyle="--", linewidth=1.0, label="rule-based driver")
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    above.set_ylabel("return (mean, 95 %)")
    above.set_ylim(bottom=0)
    above.legend(frameon=False, fontsize=9)
    below.set_ylabel("collisions, % of episodes")
    below.set_ylim(bottom=-1)
    below.set_xlabel("minutes of training")
    below.set_xlim(left=0)
    comparison = next(iter(learned.values())).comparison
    cores = "1 core" if comparison.cores == 1 else f"{comparison.cores} cores"
    figure.suptitle(
        f"{comparison.town}, {comparison.vehicles} vehicles, {cores}; "
        f"greedy, {comparison.episodes} held-out episodes a point",
        fontsize=11,
    )
    figure.savefig(file, dpi=150)
    pyplot.close(figure)


def write_curves(learned: Mapping[str, Learned], file: Path) -> None:
    """Write every point of every curve as a row of a CSV file."""
    rows = [{"who": name, **point.row()} for name, one in learned.items() for point in one.points]
    with file.open("w", newline="") as output:
        writer = csv.DictWriter(output, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def _draw_one(above: Axes, below: Axes, learned: Learned, title: str, colour: str, *, bold: bool) -> None:
    minutes = [point.seconds / 60 for point in learned.points]
    returns = [point.scores["return_mean"] for point in learned.points]
    margins = [point.scores["return_ci95"] for point in learned.points]
    style: dict[str, Any] = {
        "color": colour,
        "linewidth": 2.4 if bold else 1.4,
        "marker": "o",
        "markersize": 4,
    }
    above.plot(minutes, returns, label=title, **style)
    low, high = zip(*((r - m, r + m) for r, m in zip(returns, margins, strict=True)), strict=True)
    above.fill_between(minutes, low, high, color=colour, alpha=0.1, linewidth=0)
    below.plot(minutes, [100 * point.scores["collision_rate"] for point in learned.points], **style)
