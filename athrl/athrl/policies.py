"""`athrl policies`: the shipped policies, each with its model card."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from rich.table import Table

from athrl.errors import needs
from athrl.options import JsonOption
from athrl.output import console


def policies(as_json: JsonOption = False) -> None:
    """List the shipped policies for `athrl evaluate --policy NAME` and `athrl watch --policy NAME`."""
    with needs("evaluator"):
        from athrl_evaluator.policies.shipped import shipped_policies
    cards = {name: asdict(card) for name, card in shipped_policies().items()}
    if as_json:
        print(json.dumps({"policies": cards}))
        return
    if not cards:
        print("no policies come with this program")
    for name, card in cards.items():
        console().print(_table(name, card))


def _table(name: str, card: Mapping[str, Any]) -> Table:
    table = Table(title=f"{name}: {card['purpose']}", show_header=False, title_justify="left")
    table.add_column(no_wrap=True)
    table.add_column()
    table.add_row("planner", card["planner"])
    where = f"{card['decisions']:,} decisions in {card['town']}, at {card['commit']}"
    table.add_row("trained", f"{card['trained']}; {where}")
    for driver, scores in card["scores"].items():
        table.add_row(driver, _in_words(scores))
    for limit in card["limits"]:
        table.add_row("limit", limit)
    return table


def _in_words(scores: Mapping[str, float]) -> str:
    """Return the most important scores, as far as they are known."""
    words = []
    if "return_mean" in scores:
        interval = f" ± {scores['return_ci95']:.0f}" if "return_ci95" in scores else ""
        words.append(f"return {scores['return_mean']:.0f}{interval}")
    rates = {"collision_rate": "collisions", "off_lane_rate": "off lane", "full_episode_rate": "full"}
    words += [f"{word} {scores[name]:.1%}" for name, word in rates.items() if name in scores]
    return ", ".join(words)
