"""The dashboard is what the Grafana of compose.yaml takes, by Grafana's own types."""

from __future__ import annotations

import copy
import importlib.metadata
import json
from collections.abc import Iterator
from typing import Any

import pytest
import yaml
from grafana_foundation_sdk.cog.encoder import JSONEncoder
from grafana_foundation_sdk.cog.plugins import register_default_plugins
from grafana_foundation_sdk.models import units
from grafana_foundation_sdk.models.dashboard import Dashboard

from tests.monitoring.files import ROOT, dashboard, panels

OF_PROMETHEUS = {"/annotations/list/0/step", "/annotations/list/0/titleFormat"}
"""Settings of the data source for annotations, which are not among the types."""


def unknown(given: dict[str, Any]) -> set[str]:
    """Where a dashboard says something that Grafana's types do not have, or have otherwise."""
    register_default_plugins()
    return set(_differences(given, json.loads(JSONEncoder().encode(Dashboard.from_json(given))), ""))


def _differences(given: Any, known: Any, place: str) -> Iterator[str]:
    if isinstance(given, dict) and isinstance(known, dict):
        for key, value in given.items():
            yield from _differences(value, known.get(key), f"{place}/{key}")
    elif isinstance(given, list) and isinstance(known, list) and len(given) == len(known):
        for number, pair in enumerate(zip(given, known, strict=True)):
            yield from _differences(*pair, f"{place}/{number}")
    elif given != known:
        yield place


def test_types_are_those_of_the_grafana_that_compose_starts() -> None:
    image = yaml.safe_load((ROOT / "compose.yaml").read_text())["services"]["grafana"]["image"]
    version = importlib.metadata.version("grafana-foundation-sdk").partition("!")[2]
    assert image == f"grafana/grafana:{version}"


def test_grafana_knows_everything_that_the_dashboard_says() -> None:
    assert unknown(dashboard()) == OF_PROMETHEUS


@pytest.mark.parametrize(
    ("keys", "wrong"),
    [
        (("refesh",), "15s"),
        (("panels", 1, "options", "colourMode"), "value"),
        (("panels", 1, "fieldConfig", "defaults", "units"), "s"),
        (("panels", 1, "targets", 0, "legend"), "a"),
    ],
)
def test_a_setting_that_grafana_does_not_know_is_found(keys: tuple[Any, ...], wrong: str) -> None:
    damaged = copy.deepcopy(dashboard())
    place = damaged
    for key in keys[:-1]:
        place = place[key]
    place[keys[-1]] = wrong
    assert unknown(damaged) - OF_PROMETHEUS == {"/" + "/".join(map(str, keys))}


def test_units_are_ones_that_grafana_has() -> None:
    known = {value for value in vars(units).values() if isinstance(value, str)}
    assert {panel["fieldConfig"]["defaults"]["unit"] for panel in panels()} <= known
